"""Errors for programs: one JSON object on stdout with ``--json``, the text on stderr, the exit code of the error."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from polishd.cli import cell
from polishd.cli.json_error import error_facts
from polishd.model.errors import ConfigError, DeviceFault, LinkError, PolishdError, ProgramError
from polishd.rendering.terminal import emit
from tests.unit.cli_result import Polishd


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
        (LinkError("10.0.0.2:502: no answer"), {}),
        (PolishdError("failed"), {}),
    ],
    ids=str,
)
def test_the_location_is_that_of_the_message(error: PolishdError, located: dict[str, object]) -> None:
    facts = error_facts(error, str(error), error.exit_code)
    assert facts == {
        "ok": False, "error": str(error), "code": type(error).__name__, "exit_code": error.exit_code, **located,
    }  # fmt: skip


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
