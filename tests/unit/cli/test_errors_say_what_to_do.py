"""Typical bad input of each command: one message without a traceback, and its end says what to do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import typer

from polishd.cli.app import app
from polishd.commissioning.rehearsal.simulated_cell import write_demo
from tests.unit.cli.test_command_group import commands
from tests.unit.cli_result import CliResult, Polishd

TO_DO = re.compile(
    r"(?:^|[.;:?)] |, (?:and |or |then )?)(?:to do: )?'?(?:add|ask|check|connect|correct|export|fetch|install|measure"
    r"|name|plug|put|remove|run|save|set|start|use|write)\b",
    re.IGNORECASE,
)
NO_MOTION = "This run opened nothing and moved nothing"
# Each takes a cell or another file of a given kind as its first argument.
FILE_COMMANDS = (
    "approve", "check", "compliance", "estimates forget", "estimates show", "estop", "events", "hil", "history",
    "hold", "notify", "opcua", "plugins", "probe", "queue list", "rehearse", "resume", "run", "service show --user",
    "shop connect", "shop history", "shop list", "shop serve", "shop status", "status", "stop", "study run",
    "tif", "top --once", "web",
)  # fmt: skip
FILES = ("gone.toml", "folder", "binary.toml", "broken.toml", "empty.toml")
LINES = (
    # a cell's commands
    "approve CELL", "estop CELL", "hold CELL", "resume CELL", "stop CELL", "status CELL", "history CELL", "notify CELL",
    "check wrong.toml", "opcua CELL", "shop connect CELL", "doctor gone.toml",
    "queue add CELL gone.toml", "queue add CELL job.toml", "queue move CELL X first", "queue remove CELL X",
    "web CELL --remove-user none", "web CELL --add-user a/b", "probe CELL --only nothing",
    "run CELL --until-empty", "run CELL CELL", "run CELL --queue --correction linear", "run CELL --record gone/x",
    "plan CELL gone.dat --out p", "plan CELL text.dat --out p", "plan CELL text.dat --out folder",
    "tif CELL --depth-ratio -1", "tif CELL --out gone/x.png", "compliance CELL --program gone.rnc",
    "compliance CELL --program bad.rnc", "hil CELL --level contact", "hil CELL --simulate none",
    "hil CELL --motion gone.rnc --level no-contact", "rehearse CELL --out bad.csv", "rehearse CELL --spede 3",
    "service install gone.toml --user", "service show CELL --user --of opcua", "service show shop.toml --user --of web",
    # without a cell
    "init new --from gone.toml", "init new --from broken.toml", "init new --from empty.toml",
    "demo --surface gone.dat", "demo --surface text.dat", "demo --out bad.csv",
    "device show none", "device check none", "device show broken.toml", "device check delta_ms300 --raw x",
    "device check delta_ms300 --raw a=b", "device scan delta_ms300 foo", "device scan delta_ms300 serial:gone",
    "study empty.toml", "study show gone", "study show folder",
    "recording show gone", "recording show bad.csv",
    "certificate make gone --out c.pdf", "certificate make folder --out c.pdf", "certificate make CELL --out c.pdf",
    "certificate make folder --out c.txt", "certificate verify gone.pdf", "certificate verify text.dat --key gone",
    "certificate keygen bad.csv",
    "shop estimates gone.toml",
    "shop add shop.toml gone.toml", "shop add shop.toml job.toml", "shop release shop.toml X --by me",
    "shop remove shop.toml X --by me", "shop serve shop.toml --remove-user x", "shop serve shop.toml --remove-cell x",
    # maps and programs
    "map gone.dat", "map text.dat", "map none.dat", "map folder", "map compare text.dat gone.dat",
    "map report text.dat --out r.html", "map report text.dat --out r.txt", "map convert gone.dat x.x3p",
    "map average text.dat --out m.x3p", "map subtract text.dat text.dat", "map stitch text.dat --at gone.csv",
    "map absolute text.dat",
    "map commission gone.toml text.dat", "map formats --cell gone.toml", "map figures text.dat --profile gone.toml",
    "program inspect gone.rnc", "program inspect bad.rnc", "program inspect none.dat", "program inspect folder",
    "program inspect bad.rnc --dialect none", "program inspect bad.rnc --dialect fanuk",
    "program inspect bad.rnc --dialect gone.toml", "program rewrite bad.rnc --dwell gone.csv --out x.rnc",
    "program verify bad.rnc gone.rnc", "program make raster --out x.rnc --aperture circle:-1",
    "program make raster --out gone/x.rnc --aperture circle:20",
    "program make spiral --out x.rnc --aperture circle:50 --pitch -1",
    "program make raster --out x.rnc --aperture polygon:gone.csv",
    # calibration
    "calibrate stiffness gone.csv", "calibrate stiffness bad.csv", "calibrate tif gone.dat text.dat --seconds 3",
    "calibrate exponent gone.csv", "calibrate exponent bad.csv", "calibrate first-touch CELL --out folder",
    "calibrate instrument CELL gone.dat --angles 0",
    "map ragged.xyz",
)  # fmt: skip
NEED_NO_INPUT = {"certificate schema", "device list", "device new", "program dialects", "sim"}
"""Commands that no bad input reaches here; ``sim`` reports from its own process."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that are wrong in the usual ways, and a cell that is right."""
    here = tmp_path_factory.mktemp("bad")
    cell = write_demo(here / "demo", None, 2.0, 4, None).cell
    (here / "binary.toml").write_bytes(b"\xff\xfe\x00[")
    (here / "broken.toml").write_text("[cell\nname = 1\n")
    (here / "empty.toml").touch()
    (here / "wrong.toml").write_text(
        cell.read_text(encoding="utf-8").replace("[spindle]", "[spinel]"), encoding="utf-8"
    )
    (here / "text.dat").write_text("hello\n")
    (here / "none.dat").touch()
    (here / "ragged.xyz").write_text("0 0 1\n1 0 2\n0 1\n")
    (here / "bad.rnc").write_text("&ACCESS\n")
    (here / "bad.csv").write_text("a,b\n1,x\n")
    (here / "job.toml").write_text('[job]\nid = "x"\n[nope]\na = 1\n')
    (here / "shop.toml").write_text('[shop]\nname = "s"\nstate_dir = "shop"\n')
    (here / "folder").mkdir()
    return here


def require_advice(said: CliResult) -> None:
    assert said.code not in {0, 1}, said
    text = said.err or said.out
    assert "Traceback" not in text
    if said.code == 2:  # of typer: the command with --help, and what is wrong
        assert re.search(r"Try 'polishd .*-h' for help", text)
        return
    lines = [line for line in text.splitlines() if line.strip() and NO_MOTION not in line]
    # The advice is in the last two sentences or clauses; behind it may stand the choices.
    ends = [" ".join(re.split(r"(?<=[.;:?)]) ", line)[-4:]) for line in lines[-2:]]
    assert any(map(TO_DO.search, ends)), text


@pytest.mark.one_of_each("command")
@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("command", FILE_COMMANDS)
def test_a_file_that_cannot_be_used(
    command: str, name: str, folder: Path, polishd: Polishd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    require_advice(polishd(*command.split(), name))


@pytest.mark.one_of_each
@pytest.mark.parametrize("line", LINES)
def test_other_bad_input(line: str, folder: Path, polishd: Polishd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    words = ["demo/cell.toml" if word == "CELL" else word for word in line.split()]
    said = polishd(*words)
    if words[0] == "doctor":  # a table on stdout: each problem has its column of what to do
        assert (said.code, "name a TOML file" in said.out) == (3, True)
        return
    require_advice(said)


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("run CELL --correction exakt", "'exakt' is not allowed. Use one of 'none', 'pointwise',"),
        ("web CELL --role boss", "'boss' is not allowed. Use one of 'watch', 'operate', 'engineer'"),
        ("events CELL --last -1", "'--last': must be at least 0"),
        ("events CELL --last ten", "'--last': must be a whole number"),
        ("tif CELL --depth-ratio two", "'--depth-ratio': must be a number"),
        ("demo --cycles 0", "'--cycles': must be at least 1"),
        ("service install CELL", "Missing option. Add --system or --user."),
        ("recording CELL", "No such command 'CELL'. Use one of show."),
        ("queue put CELL", "No such command 'put'. Use one of add, list, move, remove."),
        ("completion", "Use 'polishd --install-completion'."),
        ("map text.dat --units mm,foo", "use two units of length, of coordinates and heights, such as mm,nm"),
        ("map compare text.dat text.dat --bands 1,2", "use periods in mm in descending order, such as 33,0.12"),
        ("map text.dat --mask round:1", "'round:1' is not a shape. Use circle:X,Y,R"),
        ("program make raster --out x.rnc --aperture round:20", "'round:20' is not a shape. Use circle:D, annulus:D,d"),
        (
            "program make raster --out x.rnc --aperture circle:9 --optic cup",
            "'cup' is not a surface. Use flat",
        ),
    ],
)
def test_wrong_usage_names_what_is_allowed(
    line: str, advice: str, folder: Path, polishd: Polishd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "300")
    said = polishd(*line.split())
    assert said.code == 2
    assert advice in said.err


def test_each_command_is_tried() -> None:
    every = {" ".join(path) for path, one in commands(typer.main.get_command(app)) if not hasattr(one, "commands")}
    lines = [*LINES, *FILE_COMMANDS]
    tried = {name for name in every if any(line == name or line.startswith(f"{name} ") for line in lines)}
    tried |= {"map figures", "study run"}  # their names may be left out
    assert every - tried == NEED_NO_INPUT


def test_the_check_finds_a_message_without_advice() -> None:
    require_advice(CliResult(3, "", "polishd: a.toml: is missing; add it\n"))
    with pytest.raises(AssertionError):
        require_advice(CliResult(3, "", "polishd: the cell has actuator, robot\n"))
