"""Errors for programs: one JSON object on stdout with ``--json``, the text on stderr, the exit code of the error."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from polishd.cli import cell
from polishd.cli.json_error import error_facts
from polishd.model.errors import ConfigError, DeviceFault, LinkError, MapError, PolishdError, ProgramError
from polishd.rendering.terminal import emit
from tests.unit.cli_result import Polishd

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "cell.toml"


def test_an_error_is_printed_as_text_and_as_json(polishd: Polishd, tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text('[cell]\nname = "c"\nstate_dir = "s"\nstart = 3\n')
    people = polishd("check", file)
    programs = polishd("check", file, "--json")
    assert (people.code, people.out, programs.code, programs.err) == (3, "", 3, people.err)
    error = json.loads(programs.out)
    assert programs.err == f"polishd: {error['error']}\n"
    assert (error["code"], error["exit_code"], error["file"]) == ("ConfigError", 3, str(file))
    assert f"{file}:{error['line']}: {error['key']}: " in error["error"]


@pytest.mark.parametrize(
    ("error", "located"),
    [
        (ConfigError("a.toml:3: job.id: is empty"), {"file": "a.toml", "line": 3, "key": "job.id"}),
        (
            ConfigError("2 problems:\na.toml:3: job.id: is empty\na.toml:4: x: y"),
            {"file": "a.toml", "line": 3, "key": "job.id"},
        ),
        (ConfigError("a.toml:3: not TOML: a key is missing"), {"file": "a.toml", "line": 3}),
        (ConfigError("a.toml (override): job.id: is empty"), {}),
        (ProgramError("k1.src:1: column: 3"), {"file": "k1.src", "line": 1}),
        (ProgramError('e.nc, line 2: # is not read: "G1 X#1": 3'), {"file": "e.nc", "line": 2}),
        (ProgramError("nothing was written:\ne.nc, line 2: x"), {"file": "e.nc", "line": 2}),
        (ProgramError('/x/d.csv, row 2 is not a number: "x"'), {"file": "/x/d.csv"}),
        (ConfigError("/x/cell.toml: cannot be read: No such file"), {"file": "/x/cell.toml"}),
        (ConfigError("/x/cell.toml (override): job.id: is empty"), {}),
        (ConfigError("job.id: is empty"), {}),
        (MapError("/x/a.dat: is too short"), {"file": "/x/a.dat"}),
        (LinkError("/dev/ttyS0: no answer"), {}),
        (PermissionError(13, "Permission denied", "a.txt"), {"file": "a.txt"}),
        (MemoryError("a map"), {}),
        (LinkError("10.0.0.2:502: no answer"), {}),
        (PolishdError("failed"), {}),
    ],
    ids=str,
)
def test_the_location_is_that_of_the_message(error: Exception, located: dict[str, object]) -> None:
    facts = error_facts(error, str(error), 3)
    assert facts == {"ok": False, "error": str(error), "code": type(error).__name__, "exit_code": 3, **located}


@pytest.mark.parametrize(
    ("words", "located"),
    [
        (("check", "none.toml"), {"file": "none.toml"}),
        (("program", "inspect", "e.nc"), {"file": "e.nc", "line": 2}),
        (("program", "inspect", "none.nc"), {"file": "none.nc"}),
        (("program", "rewrite", "good.nc", "--dwell=d.csv", "--out", "n.nc"), {"file": "d.csv"}),
        (("plan", EXAMPLE, "torn.dat", "--out", "plan"), {"file": "torn.dat"}),
    ],
    ids=lambda value: str(value[:2]) if isinstance(value, tuple) else "",
)
def test_files_of_the_command_line_are_named(
    polishd: Polishd,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[object, ...],
    located: dict[str, object],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("e.nc").write_text("G21 G90 G94\nG1 X#1 F600\nM2\n")
    Path("good.nc").write_text("G21 G90 G94\nG0 X0\nG1 X1 F600\nG4 P0.5\nM2\n")
    Path("d.csv").write_text("x\n")
    Path("torn.dat").write_bytes(b"\x88\x1b\x03\x6f" + b"\0" * 99)
    said = polishd(*words, "--json")
    assert said.failure in (3, 8, 9)
    facts = json.loads(said.out)
    assert {key: facts[key] for key in ("file", "line") if key in facts} == located


@pytest.mark.parametrize("command", ["check", "plan"])
def test_a_file_that_may_not_be_read_is_refused_as_a_missing_one(
    polishd: Polishd, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text("")

    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("polishd.util.files.open_input", refuse)
    monkeypatch.setattr(os, "access", lambda *_, **__: False)  # what typer asks, and is yes to root
    said = polishd(command, cell, *([] if command == "check" else ["map.dat", "--out", tmp_path / "plan"]), "--json")
    assert said.failure == 3
    assert json.loads(said.out)["file"] == str(cell)
    assert "Permission denied" in said.err


def test_an_error_after_the_json_of_a_command_prints_no_second_object(
    polishd: Polishd, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_cell: object, *, as_json: bool) -> None:
        emit({"plugins": []}, as_json=as_json)
        raise DeviceFault("one failed")

    monkeypatch.setattr(cell, "plugins_verb", fails)
    for _ in range(2):  # the state of one call does not reach the next
        said = polishd("plugins", "--json")
        assert (said.code, json.loads(said.out), said.err) == (5, {"plugins": []}, "polishd: one failed\n")
    monkeypatch.setattr(cell, "plugins_verb", lambda *_, **__: (_ for _ in ()).throw(DeviceFault("all failed")))
    assert json.loads(polishd("plugins", "--json").out)["error"] == "all failed"


@pytest.mark.parametrize(
    ("error", "code", "exit_code"),
    [
        (PermissionError(13, "Permission denied", "a.txt"), "PermissionError", 1),
        (MemoryError("a map"), "MemoryError", 10),
    ],
    ids=repr,
)
def test_errors_of_the_computer_have_the_same_form(
    polishd: Polishd, error: Exception, code: str, exit_code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(cell, "plugins_verb", fails)
    said = polishd("plugins", "--json")
    shown = json.loads(said.out)
    assert (said.code, shown["code"], shown["exit_code"]) == (exit_code, code, exit_code)
    assert said.err == f"polishd: {shown['error']}\n"
