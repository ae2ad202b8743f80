"""The help in panels and at each width, renamed commands, and completion in the shell."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from polishd.cli.app import PANEL_OF, PANELS, app
from polishd.cli.command_group import RENAMED_COMMANDS
from polishd.config.job_file import JobFile
from polishd.daemon.queue.queue import NewJob, Queue

NARROW, USUAL = 60, 100
ESCAPE = "\x1b"


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in group.commands.items():
        yield (*path, name), command
        yield from commands(command, (*path, name)) if hasattr(command, "commands") else ()


ALL = dict(commands(typer.main.get_command(app)))


def helped(*words: str, width: int, **environment: str) -> str:
    result = CliRunner().invoke(app, [*words, "--help"], env={"COLUMNS": str(width), **environment})
    assert result.exit_code == 0, result.output
    return result.output


def test_each_command_is_in_one_panel() -> None:
    assert sorted(PANEL_OF) == sorted(path[0] for path in ALL if len(path) == 1)
    assert sum(map(len, PANELS.values())) == len(PANEL_OF)


def test_the_panels_are_in_their_order_with_their_commands() -> None:
    text = helped(width=USUAL)
    titles = re.findall(r"^╭─ (.*?) ─+╮$", text, re.MULTILINE)
    assert titles == ["Options", *PANELS]
    shown = re.findall(r"^│ ([a-z]+) {2,}", text, re.MULTILINE)
    assert shown == [name for names in PANELS.values() for name in names]


def test_the_version_is_an_option_of_polishd_only() -> None:
    assert CliRunner().invoke(app, ["--version"]).exit_code == 0
    assert [path for path, command in ALL.items() if any("--version" in one.opts for one in command.params)] == []


@pytest.mark.one_of_each
@pytest.mark.parametrize("path", [(), *ALL], ids=" ".join)
@pytest.mark.parametrize("width", [NARROW, USUAL])
def test_help_fits_the_terminal_and_loses_no_word(path: tuple[str, ...], width: int) -> None:
    text = helped(*path, width=width, NO_COLOR="1")
    assert ESCAPE not in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("path", list(ALL), ids=" ".join)
def test_each_option_has_a_help_without_a_full_stop(path: tuple[str, ...]) -> None:
    for param in ALL[path].params:
        assert param.help, param.name
        assert not re.search(r"[.!]$|\b(whatever|whoever|somebody|nobody)\b", param.help), param.help
        assert param.help[0].isupper(), param.help


def test_a_narrow_help_has_units_limits_and_choices_in_its_text() -> None:
    words = " ".join(re.sub(r"[│]", " ", helped("demo", width=NARROW)).split())
    for text in ("NM, x>=0.01: RMS to reach", "none, pointwise, linear, power, exact: Override process.correction"):
        assert text in words


@pytest.mark.one_of_each
@pytest.mark.parametrize("old", sorted(RENAMED_COMMANDS))
def test_an_old_command_is_refused_with_the_new_one(old: str) -> None:
    new = RENAMED_COMMANDS[old]
    result = CliRunner().invoke(app, [*old.split(), "cell.toml"], env={"COLUMNS": "200"})
    assert (result.exit_code, f"'polishd {old}' was renamed. Use 'polishd {new}'." in result.output) == (2, True)
    if not new.startswith("--"):
        group, _, names = new.partition(" ")
        assert all((group, *filter(None, [name])) in ALL for name in names.split("|"))


# Completion, as the shell starts it.


def completed(line: str) -> list[str]:
    """Completions of the last word of this command line in bash."""
    environment = {"_POLISHD_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
    result = CliRunner().invoke(app, [], prog_name="polishd", env=environment)
    assert result.exit_code == 0, result.output
    return result.output.split()


EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name in ("cell.toml", "job.toml", "sim.toml", "table_iii.toml", "instrument.toml"):
        (tmp_path / name).write_text((EXAMPLES / name).read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "shop.toml").write_text('[shop]\nname = "s"\nstate_dir = "shop"\n')
    (tmp_path / "broken.toml").write_text("[cell\n")
    (tmp_path / "cells").mkdir()
    (tmp_path / "cells" / "north.toml").write_text('[cell]\nname = "north"\n')
    (tmp_path / ".hidden").mkdir()
    return tmp_path


@pytest.mark.one_of_each
@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("polishd status ", ["cell.toml", "cells/"]),
        ("polishd status cells", ["cells/north.toml"]),
        ("polishd run cell.toml ", ["cells/"]),
        ("polishd tif cells/no", ["cells/north.toml"]),
        ("polishd map figures --cell ce", ["cell.toml", "cells/"]),
        ("polishd queue add cell.toml j", ["job.toml"]),
        ("polishd shop status s", ["shop.toml"]),
        ("polishd sim s", ["sim.toml"]),
        ("polishd study run t", ["table_iii.toml"]),
        ("polishd program inspect x.nc --dialect fan", ["fanuc", "fanuc-tp"]),
        ("polishd program make raster --dialect rap", ["rapid"]),
        ("polishd device show delta", ["delta_ms300"]),
        ("polishd probe cell.toml --only s", ["spindle"]),
        ("polishd hil cell.toml --simulate robot,s", ["robot,spindle"]),
        ("polishd plan cell.toml m.dat --correction po", ["pointwise", "power"]),
        ("polishd status nowhere/", []),
        ("polishd probe broken.toml --only ", []),
        ("polishd queue remove cell.toml ", []),
        ("polishd esti", ["estimates"]),
        ("polishd estimates ", ["show", "forget"]),
    ],
)
def test_completion(line: str, found: list[str]) -> None:
    assert completed(line) == found


@pytest.mark.full
def test_completion_of_the_jobs_of_a_queue(folder: Path) -> None:
    with Queue.at_rest(folder / "state") as queue:
        queue.add([NewJob(name, "P", JobFile(folder / "j.toml", ""), {}) for name in ("lens-1", "lens-2", "mirror")])
    assert completed("polishd queue remove cell.toml l") == ["lens-1", "lens-2"]
    assert completed("polishd queue move cell.toml mirror before ") == ["lens-1", "lens-2", "mirror"]
    assert completed("polishd certificate make cell.toml --job m") == ["mirror"]


def test_completion_of_the_parts_of_a_shop(folder: Path) -> None:
    path = folder / "lens.toml"
    path.write_text('[job]\nid = "lens-9"\n[part]\nid = "P-9"\n')
    assert completed("polishd shop release shop.toml ") == []
    assert CliRunner().invoke(app, ["shop", "add", str(folder / "shop.toml"), str(path)]).exit_code == 0
    assert completed("polishd shop release shop.toml ") == ["lens-9"]
