"""The command line: what it prints for programs, and the exit code of each kind of end."""

from __future__ import annotations

import errno
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from polishd import __version__
from polishd.cli import cell, demo
from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, demo_program, with_values, write_demo
from polishd.config.cell import load_config
from polishd.config.instrument_profile import load_profile
from polishd.config.simulator import load_simulator
from polishd.config.study import load_study
from polishd.daemon.runtime.events import killed_safety, record_exit, safety_of
from polishd.daemon.runtime.exit_record import RECORD_NAME, EndCause
from polishd.daemon.socket import client
from polishd.model import errors
from polishd.model.errors import ConfigError, DeviceFault, PolishdError
from polishd.plugins.rnc_robot.dialect import FOLDER, dialect
from polishd.programs import plan as planning
from polishd.util.command_line import terminal_user
from tests.unit.cli_result import CliResult, Polishd
from tests.unit.maps.maps import dat, surface


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    """A small part's."""
    found = write_demo(tmp_path_factory.mktemp("cell") / "out", None, 2.0, 4, None)
    change = {"part": {"aperture_mm": 20.0}, "process": {"grid_mm": 2.0}}
    found.cell.write_text(with_values(found.cell.read_text(), change))
    config = load_config(found.cell)
    config.program_path.write_bytes(demo_program(config))
    return found


def test_version(polishd: Polishd) -> None:
    assert polishd("--version") == CliResult(0, f"{__version__}\n", "")


@pytest.mark.one_of_each
@pytest.mark.parametrize("words", [["polsih"], ["check"], ["run", "cell.toml", "--correction", "some"], ["--jsn"]])
def test_usage(polishd: Polishd, words: list[str]) -> None:
    assert polishd(*words).code == 2


# check


@pytest.mark.full
def test_check(polishd: Polishd, files: DemoFiles) -> None:
    said = polishd("check", files.cell, "--json")
    facts = json.loads(said.out)
    assert said.code == 0
    assert "timed points" in facts["program"]
    assert facts["correction"] == "exact"
    assert facts["tolerance"] == "RMS <= 2 nm"
    pit = facts["pit"]
    assert pit["removal_nm"] == pytest.approx(pit["rate_nm_s"] * (pit["notice_s"] + pit["release_s"]))
    assert 0.6 < pit["notice_s"] < 0.9, "a block, the age of a report, two looks, the overhead of a point"
    assert facts["time limits"][-1]["seconds"] == pytest.approx(pit["notice_s"], abs=1e-3)
    assert f"removes up to {pit['removal_nm']:.0f} nm" in facts["warnings"][0]
    assert {limit["key"]: limit["seconds"] for limit in facts["time limits"]}["robot.watchdog_s"] == 8.0
    people = polishd("check", files.cell)
    assert (people.code, "nothing was opened" in people.out) == (0, True)
    words = ("tool up after the last command", "6.2 s", "robot.watchdog_s", "standstill of the robot", "warning: A")
    for said_to_people in words:
        assert said_to_people in people.out


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        ({"dwell": {"solver": "newton"}}, 3, "newton_cg"),
        ({"robot": {"watchdog_s": 2.0}}, 3, "robot.watchdog_s: watchdog of the robot: 2 s; at least 6.7 s"),
        ({"actuator": {"retract_s": 9.0}}, 3, "robot.watchdog_s: watchdog of the robot: 8 s; at least 10.7 s"),
        ({"job": {"stream_ahead_s": 1.0}}, 3, "job.stream_ahead_s: motion held by the robot: 1 s; at least 6.2 s"),
        ({"program": {"path": "gone.rnc"}}, 3, "gone.rnc"),
        ({"robot": {"type": "robot"}}, 3, "robot_link"),
        ({"plugins": {"load": ["rnc_robot", "rnc_rboot"]}}, 3, "rnc_rboot"),
        ({"part": {"aperture_mm": -1.0}}, 3, "aperture_mm"),
        ({"part": {"origin_mm": [9000.0, 0.0, 2315.0]}}, 3, "part.origin_mm: program.rnc:5: the tip's radius is "),
    ],
)
def test_what_check_finds(polishd: Polishd, files: DemoFiles, change: dict[str, Any], code: int, says: str) -> None:
    wrong = files.out / "wrong.toml"
    wrong.write_text(with_values(files.cell.read_text(), change))
    said = polishd("check", wrong)
    assert said.out == ""
    assert said.code == code
    assert said.err.startswith("polishd: ")
    assert says in said.err


def test_a_robot_that_cannot_read_the_program_is_reported_with_the_key(polishd: Polishd, files: DemoFiles) -> None:
    """URScript is the only language of a UR."""
    wrong = files.out / "wrong.toml"
    text = files.cell.read_text().replace('type = "robot_link"', 'type = "universal_robots"')
    wrong.write_text(text)
    said = polishd("check", wrong)
    assert said.code == 3
    line = next(k for k, line in enumerate(wrong.read_text().splitlines(), 1) if line.startswith("format"))
    assert said.err == (
        f"polishd: {wrong}:{line}: program.format: program.rnc: robot (universal_robots) does not take it: no line of "
        "the program moves or waits in URScript. Check [program] format.\n"
    )


def test_check_says_what_the_program_covers_and_where_the_seat_is_proved(polishd: Polishd, files: DemoFiles) -> None:
    found = polishd("check", files.cell, "--json").answer
    assert found["seat"].startswith("checked with 0.8 N at x 0.0, y 8.5 mm; x -7.4, ")
    covers = found["covers"]
    assert covers.startswith("program.rnc reaches 16.0 mm from the part's center, the part is a circle of 20 mm; ")
    assert covers.endswith("the program leaves out 0.0 % of the clear aperture")


@pytest.mark.full
@pytest.mark.parametrize(
    ("change", "reach_mm", "says"),
    [
        ({"part": {"aperture_mm": 60.0}}, 16.0, "the part is a circle of 60 mm; the program leaves out "),
        (
            {"program": {"offset_mm": [40.0, 0.0, 0.0]}},
            52.7,
            "% of its path lies more than 10 mm beyond the part's rim: name the program of this part",
        ),
    ],
)
def test_the_program_of_another_part(
    polishd: Polishd, files: DemoFiles, change: dict[str, dict[str, Any]], reach_mm: float, says: str
) -> None:
    other = files.out / "other.toml"
    other.write_text(with_values(files.cell.read_text(), change))
    said = polishd("check", other)
    line = other.read_text().splitlines().index('path = "program.rnc"') + 1
    assert said.code == 3
    assert said.err.startswith(
        f"polishd: {other}:{line}: program.path: program.rnc reaches {reach_mm:.1f} mm from the part's center"
    )
    assert says in said.err
    other.write_text(other.read_text().replace('path = "program.rnc"', 'path = "program.rnc"\ncoverage = "zone"'))
    assert polishd("check", other).code == (0 if "part" in change else 3), "a zone lies on the part"


@pytest.mark.parametrize("kind", ["cell", "profile", "study", "simulator", "dialect"])
def test_a_byte_order_mark_is_no_fault(tmp_path: Path, kind: str) -> None:
    """Editors of Windows put one before their UTF-8; the message of tomllib is not helpful."""
    examples = Path(__file__).parents[3] / "examples"
    load: dict[str, tuple[Path, Callable[[Path], object]]] = {
        "cell": (examples / "cell.toml", load_config),
        "profile": (examples / "instrument.toml", load_profile),
        "study": (examples / "table_iii.toml", load_study),
        "simulator": (examples / "sim.toml", load_simulator),
        "dialect": (FOLDER / "haas.toml", dialect),
    }
    source, loaded = load[kind]
    shutil.copy(examples / "cell.toml", tmp_path)  # the simulator's file names it
    marked = tmp_path / source.name
    marked.write_bytes(b"\xef\xbb\xbf" + source.read_bytes().replace(b"\n", b"\r\n"))
    loaded(marked)
    marked.write_bytes(source.read_text().encode("utf-16"))
    with pytest.raises(ConfigError, match=r"UTF-8|utf-8"):
        loaded(marked)


@pytest.mark.full
def test_a_config_that_is_not_there(polishd: Polishd, tmp_path: Path) -> None:
    for verb in ("check", "run", "probe", "status", "hold", "resume", "stop", "plugins"):
        said = polishd(verb, tmp_path / "gone.toml")
        assert (said.code, "gone.toml" in said.err) == (3, True), verb


# plan


def test_plan_refuses_what_is_there(polishd: Polishd, files: DemoFiles) -> None:
    program = files.out / "program.rnc"
    said = polishd("plan", files.cell, program, "--program", program, "--out", files.out)
    assert (said.code, "exists already" in said.err) == (3, True)


def test_plan_names_the_key_of_a_program_that_the_robot_cannot_follow(
    polishd: Polishd, files: DemoFiles, tmp_path: Path
) -> None:
    wrong = files.out / "wrong.toml"
    wrong.write_text(with_values(files.cell.read_text(), {"process": {"dip_deg": 3.0, "grid_mm": 0.5}}))
    part = dat(tmp_path / "part.dat", surface(81, 81), 0.25, part=load_config(wrong).part.id)
    said = polishd("plan", wrong, part, "--out", tmp_path / "plan")
    assert said.code == 3, said.err
    assert re.search(r"wrong\.toml:\d+: process\.dip_deg: program\.rnc:\d+: .* the process says 3", said.err)


def test_plan_takes_the_cells_own_program(polishd: Polishd, files: DemoFiles, tmp_path: Path) -> None:
    """Read before anything is computed: the error names the broken file."""
    (files.out / "program.rnc").write_text("G21 G90 G94\nG91\nM2\n")
    part = load_config(files.cell).part.id
    said = polishd("plan", files.cell, dat(tmp_path / "part.dat", surface(), part=part), "--out", tmp_path / "plan")
    assert said.code == 9, said.err
    assert "program.rnc" in said.err


@pytest.mark.full
@pytest.mark.parametrize("verb", ["plan", "demo"])
def test_a_folder_that_cannot_be_written_is_one_line_at_once(
    polishd: Polishd, files: DemoFiles, tmp_path: Path, verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def begins(*arguments: object) -> None:
        raise AssertionError("it began")

    monkeypatch.setattr(planning, "make_recipes", begins)
    monkeypatch.setattr(demo, "write_demo", begins)
    words = ("plan", files.cell, files.cell, "--program", files.cell) if verb == "plan" else ("demo",)
    (tmp_path / "file").touch()
    for out in (tmp_path / "file" / "a" / "b", Path("/proc/polishd/out")):
        said = polishd(*words, "--out", out)
        assert said.code == 3
        (line,) = said.err.strip().splitlines()
        assert line.startswith(f"polishd: {out.parent if verb == 'plan' else out}: cannot be written: ")


def test_a_file_that_cannot_be_had_is_one_line(polishd: Polishd, monkeypatch: pytest.MonkeyPatch) -> None:
    for error, says in (
        (OSError(errno.ENOSPC, "No space left on device"), "a file: No space left on device; make room"),
        (
            OSError(errno.EACCES, "Permission denied", "journal.sqlite"),
            "journal.sqlite: Permission denied; check the path, its permissions and its disk",
        ),
    ):

        def fails(*arguments: object, error: OSError = error, **named: object) -> None:
            raise error

        monkeypatch.setattr(cell, "plugins_verb", fails)
        assert polishd("plugins") == CliResult(1, "", f"polishd: {says}\n")


def test_plan_refuses_a_map_that_is_none(polishd: Polishd, files: DemoFiles, tmp_path: Path) -> None:
    program = files.out / "program.rnc"
    said = polishd("plan", files.cell, program, "--program", program, "--out", tmp_path / "plan")
    assert (said.code, "no loaded reader knows this file" in said.err) == (8, True)
    assert not (tmp_path / "plan").exists()


# the daemon's verbs


@pytest.mark.full
def test_no_daemon(polishd: Polishd, files: DemoFiles) -> None:
    for verb in ("status", "hold", "resume", "stop"):
        assert polishd(verb, files.cell).code == 5, verb


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("state", "unsafe", "tool", "says"),
    [
        ("stopped", (), "yes", "which holds"),
        ("failed", ("actuator: no answer",), "not confirmed", "correct the cause, then: polishd run"),
        ("cycles_used", (), "yes", "begins a new one"),
        ("failed", None, "not asked", "correct the cause, then: polishd run"),
        ("held", (), "yes", "inspect the cell, then: polishd run"),
        ("polishing", killed_safety(["actuator", "robot"]), "not confirmed", "inspect the cell, then: polishd run"),
    ],
)
def test_status_where_no_daemon_runs_tells_how_the_last_one_ended(
    polishd: Polishd, files: DemoFiles, state: str, unsafe: tuple[str, ...] | None, tool: str, says: str
) -> None:
    files.state_dir.mkdir(exist_ok=True)
    cause = asdict(EndCause("09:00", "SafetyStop", "force", ended=True))
    record_exit(files.state_dir, {**safety_of(state, "why", unsafe).data, "run_dir": "runs/demo", "causes": [cause]})
    said = polishd("status", files.cell, "--json")
    shown = json.loads(said.out)
    killed = state in ("held", "polishing")
    assert (said.code, shown["ok"], shown["state"]) == (5, False, "killed" if killed else state)
    assert (shown["tool_off"], shown["run_dir"], shown["causes"]) == (tool, "runs/demo", [cause])
    assert (shown["ok"], shown["code"], shown["exit_code"]) == (False, "NoDaemon", 5)
    assert "no daemon is running" in shown["error"]
    assert "why" in shown["reason"]
    assert ("was killed" in shown["reason"]) == killed
    people = polishd("status", files.cell)
    assert people.code == 5
    lines = people.out.splitlines()
    assert lines[0].endswith(": no daemon is running")
    assert {"cause: 09:00 ended: SafetyStop: force", f"tool off the part: {tool}"} <= set(lines)
    assert lines[-1].startswith("next: ")
    assert says in lines[-1]
    says_resume = "polishd resume" in people.out
    assert says_resume == ("which holds" in lines[-1]), "without a daemon there is nothing to resume"


@pytest.mark.one_of_each
@pytest.mark.parametrize("content", [None, b"", b"{}", b"[1]", b"\xff"])
def test_status_where_nothing_is_known(polishd: Polishd, files: DemoFiles, content: bytes | None) -> None:
    files.state_dir.mkdir(exist_ok=True)
    record = files.state_dir / RECORD_NAME
    record.unlink(missing_ok=True)
    if content is not None:
        record.write_bytes(content)
    said = polishd("status", files.cell, "--json")
    shown = json.loads(said.out)
    assert (said.code, shown["state"], shown["tool_off"]) == (5, "unknown", "not asked")
    assert polishd("status", files.cell).code == 5
    record.unlink(missing_ok=True)


@pytest.mark.one_of_each
@pytest.mark.parametrize("verb", ["hold", "resume", "stop", "estop"])
def test_orders(polishd: Polishd, files: DemoFiles, verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Path, str, dict[str, str]]] = []

    def request(state_dir: Path, word: str, args: dict[str, str]) -> dict[str, Any]:
        asked.append((state_dir, word, args))
        return {"ok": True, "state": "held"}

    monkeypatch.setattr(client, "request", request)
    assert json.loads(polishd(verb, files.cell, "--json").out) == {"ok": True, "state": "held"}
    polishd(verb, files.cell, "--reason", "a scratch")
    by = {"by": terminal_user()}
    assert asked == [(files.state_dir, verb, args) for args in (by, {"reason": "a scratch", **by})]


def test_an_order_that_is_refused_says_why_and_ends_so(
    polishd: Polishd, files: DemoFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = {"ok": False, "error": "resume is refused: spindle: deaf", "exit_code": 5}
    monkeypatch.setattr(client, "request", lambda *_, **__: answer)
    people = polishd("resume", files.cell)
    assert (people.code, people.out, people.err) == (5, "", "polishd: resume is refused: spindle: deaf\n")
    programs = polishd("resume", files.cell, "--json")
    error = {"ok": False, "error": answer["error"], "code": "PolishdError", "exit_code": 5}
    assert (programs.code, json.loads(programs.out), programs.err) == (5, error, people.err)


def test_status(polishd: Polishd, files: DemoFiles, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = {
        "ok": True,
        "state": "held",
        "reason": "by order",
        "unsafe": [],
        "cycles": [{"rms_nm": 20.456}],
        "devices": {
            "robot.left": {"vendor": "Acme", "model": "arm", "serial": "7", "used": True, "heard_s_ago": 0.25},
            "robot.right": {"used": False, "heard_s_ago": None},
        },
        "health": {
            "loop_lag_s": {"value": 0.012, "limit": 0.5, "least": False, "fits": True, "advice": "end something"},
            "state_disk_mb": {"value": 12.0, "limit": 128, "least": True, "fits": False, "advice": "make room"},
        },
    }
    monkeypatch.setattr(client, "request", lambda state_dir, verb: answer)
    assert json.loads(polishd("status", files.cell, "--json").out) == answer
    people = polishd("status", files.cell).out
    assert "RMS 20.46 nm" in people
    assert "by order" in people
    assert "robot.left" in people
    assert "Acme arm 7, answered 0.2 s ago" in people
    assert "0.012 (at most 0.5)" in people
    assert "12 (at least 128: make room)" in people
    assert "(not used by this job)" in people
    assert "unsafe" not in people, "nothing to say"


def test_probe_without_devices(polishd: Polishd, files: DemoFiles) -> None:
    said = polishd("probe", files.cell)
    assert said.code == 5
    assert "4 of 4 devices failed: actuator, robot, spindle, metrology" in said.err
    shown = json.loads(polishd("probe", files.cell, "--only", "robot", "--json").out)
    assert list(shown) == ["robot"]
    assert "the port is closed" in shown["robot"]["error"]


# plugins


def test_plugins(polishd: Polishd) -> None:
    said = json.loads(polishd("plugins", "--json").out)
    names = [plugin["name"] for plugin in said["loaded"]]
    assert {"rnc_robot", "devices", "voice_coil", "interferometer", "run_report"} <= set(names)
    assert said["refused"] == []
    brings = {plugin["name"]: plugin["brings"] for plugin in said["loaded"]}
    solvers = brings["dwell_solvers"]["polishd_dwell_solvers"]
    own = ["auto", "newton_cg", "douglas_rachford", "interior_point", "lucy_richardson"]
    assert solvers[:6] == [*own, "qp"]
    assert "qp:clarabel" in solvers
    assert "checks and events" in polishd("plugins").out


def test_a_plugin_that_is_refused_is_reported_and_fails(polishd: Polishd, files: DemoFiles) -> None:
    wrong = files.out / "plugins.toml"
    wrong.write_text(with_values(files.cell.read_text(), {"plugins": {"load": ["rnc_robot", "missing"]}}))
    said = polishd("plugins", wrong, "--json")
    answer = json.loads(said.out)
    assert said.code == 3
    assert [plugin["name"] for plugin in answer["loaded"]] == ["rnc_robot"]
    assert answer["refused"][0]["name"] == "missing"


# the demo


def test_a_demo_does_not_write_into_what_is_there(polishd: Polishd, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert polishd("demo", "--out", tmp_path).code == 3
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.full
def test_a_simulator_that_does_not_start_is_reported(
    polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*arguments: object) -> None:
        raise DeviceFault("the simulated cell did not start: port 1 is taken")

    monkeypatch.setattr(demo, "simulated_cell", refuses)
    monkeypatch.setattr(demo.signal, "signal", lambda *arguments: None)  # this process keeps its own
    said = polishd("demo", "--out", tmp_path / "out")
    assert (said.code, "did not start" in said.err) == (5, True)


@pytest.mark.full
def test_load_cell_overrides_the_correction(files: DemoFiles) -> None:
    config, hooks = cell.load_cell(files.cell, "none")
    assert config.process.correction == "none"
    assert len(hooks.report.loaded) == len(config.plugins.load)
    assert issubclass(errors.PluginError, PolishdError)
