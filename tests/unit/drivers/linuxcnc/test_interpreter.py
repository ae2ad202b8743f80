"""LinuxCNC's interpreter as a reader: its calls, its refusals in its own words, its faults, and nothing left behind."""

from __future__ import annotations

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from polishd.drivers.linuxcnc import interpreter
from polishd.drivers.linuxcnc.interpreter import Call, canonical_calls, exact_python
from polishd.model.errors import ProgramError

PROGRAM = b"G21 G90 G94\nG0 X0 Y0 Z20\nG1 X10.123456789 F600\nG4 P0.123456789\ng 4 p 0 . 7 5\nM2\n"
BAD = b"G21 G90\nG1 X1 F100\nG4 X1\nM2\n"

needs_linuxcnc = pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC is not installed")
needs_doubles = pytest.mark.skipif(exact_python() is None, reason="LinuxCNC's module gcode is not installed")


def calls(program: bytes | Path, *, exact: bool = False) -> list[Call]:
    with canonical_calls(program, "t.ngc", exact=exact) as found:
        return list(found)


def named(found: list[Call], name: bytes) -> list[Call]:
    return [call for call in found if call.name == name]


@needs_linuxcnc
def test_rs274_gives_calls_with_four_decimals() -> None:
    found = calls(PROGRAM)
    assert [call.numbers() for call in named(found, b"DWELL")] == [[0.1235], [0.75]]
    assert named(found, b"STRAIGHT_FEED") == [
        Call(0, b"STRAIGHT_FEED", b"10.1235, 0.0000, 20.0000, 0.0000, 0.0000, 0.0000")
    ]


@needs_doubles
def test_the_module_has_the_same_tools() -> None:
    (call,) = [call for call in calls(b"G21 G43 H99\nM2\n", exact=True) if b"TOOL" in call.name]
    assert not any(call.numbers())
    with pytest.raises(ProgramError, match="Requested tool 100 not found"):
        calls(b"G21 G43 H100\nM2\n", exact=True)


@needs_doubles
def test_the_module_gives_doubles_and_lines() -> None:
    found = calls(PROGRAM, exact=True)
    assert [(call.line, call.numbers()) for call in named(found, b"DWELL")] == [(4, [0.123456789]), (5, [0.75])]
    (feed,) = named(found, b"STRAIGHT_FEED")
    assert feed.line == 3
    assert feed.numbers()[0] * 25.4 == pytest.approx(10.123456789, abs=1e-12), "inches, whatever the program says"


@needs_linuxcnc
@pytest.mark.parametrize("exact", [False, pytest.param(True, marks=needs_doubles)])
@pytest.mark.parametrize(
    ("program", "words"),
    [
        (BAD, "Dwell time missing with g4"),
        (b"G21 G90\nG1 X1 F100\n", "File ended with no percent sign or program end"),
        (b"G1 X1 F1 Q\nM2\n", "No characters found in reading real value"),
        (b"G1 X1 Q F1\nM2\n", "Unknown word starting with f"),
    ],
)
def test_it_refuses_in_its_own_words(program: bytes, words: str, exact: bool) -> None:
    with pytest.raises(ProgramError, match=rf"^t\.ngc: LinuxCNC's interpreter refuses it: .*{words}"):
        calls(program, exact=exact)


@needs_linuxcnc
@pytest.mark.parametrize("exact", [False, pytest.param(True, marks=needs_doubles)])
def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, exact: bool) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    odd = tmp_path / "-g odd name $HOME.rnc"
    odd.write_bytes(PROGRAM)
    assert calls(odd, exact=exact) == calls(PROGRAM, exact=exact)
    assert list(tmp_path.iterdir()) == [odd]
    assert odd.read_bytes() == PROGRAM


@needs_linuxcnc
def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProgramError, match="Unable to open file"):
        calls(tmp_path / "none.ngc")


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on the path for a rs274 of the test's own; the module ``gcode`` is out of sight."""
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setattr(interpreter, "exact_python", lambda: None)
    return tmp_path


def script(folder: Path, *lines: str) -> None:
    path = folder / "rs274"
    path.write_text("\n".join(["#!/bin/sh", *lines, ""]))
    path.chmod(0o755)


def test_it_is_called_as_a_batch_with_no_input(fake: Path) -> None:
    script(fake, f'echo "$@" > {fake}/args', "cat", 'echo "    1 N..... DWELL(0.5)"')
    assert calls(b"M2\n", exact=True) == [Call(0, b"DWELL", b"0.5")], "without the module: what rs274 prints"
    assert (fake / "args").read_text() == "-t tool.tbl -v program.var -g program.ngc\n"


@pytest.mark.full
@needs_linuxcnc
def test_many_at_once_do_not_tread_on_each_other() -> None:
    """They would meet in ~/.tool.mmap."""
    alone = calls(PROGRAM)
    with ThreadPoolExecutor(8) as pool:
        assert all(found == alone for found in pool.map(lambda _: calls(PROGRAM), range(80)))


@needs_linuxcnc
def test_what_is_set_up_on_this_machine_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (call,) = named(calls(b"G21 G43 H7\nM2\n"), b"USE_TOOL_LENGTH_OFFSET")
    assert call.arguments == b"0.0000 0.0000 0.0000, 0.0000 0.0000 0.0000, 0.0000 0.0000 0.0000"
    with pytest.raises(ProgramError, match="Requested tool 100 not found"):
        calls(b"G21 G43 H100\nM2\n")
    assert list(tmp_path.iterdir()) == []


def test_a_call_counts_in_any_width(fake: Path) -> None:
    script(fake, 'echo "1234567 N01234 ON_RESET()"')
    assert calls(b"M2\n") == [Call(1234, b"ON_RESET", b"")]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (
            ["echo executing >&2", "echo 'it hurts' >&2", "echo 'G4 X1' >&2", "exit 1"],
            "refuses it: it hurts; G4 X1. C",
        ),
        (["exit 3"], "no reason, exit code 3"),
        (["kill -7 $$"], r"it ended with signal 7\."),
        (["echo nonsense"], "printed b'nonsense.n', which is not a canonical call"),
        (["echo '1 N..... HALF'"], "which is not a canonical call"),
        (["head -c 1000000 /dev/zero | tr '\\0' x >&2", "exit 1"], "refuses it: xxx"),
    ],
    ids=["words", "silent", "killed", "nonsense", "half a line", "a flood of words"],
)
def test_faults_are_one_clear_error(fake: Path, lines: list[str], words: str) -> None:
    script(fake, *lines)
    with pytest.raises(ProgramError, match=words) as raised:
        calls(b"M2\n")
    assert len(str(raised.value)) < 5000


def test_calls_before_the_fault_are_given(fake: Path) -> None:
    script(fake, 'echo "1 N..... DWELL(1)"', "exit 1")
    with canonical_calls(b"M2\n", "t.ngc") as found:
        assert next(found).name == b"DWELL"
        with pytest.raises(ProgramError):
            next(found)


def test_one_that_never_ends_is_killed(fake: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interpreter, "LIMIT_S", 0.2)
    script(fake, "exec sleep 1000")
    with pytest.raises(ProgramError, match=r"ended with signal 9, perhaps at the limit of 0\.2 s"):
        calls(b"M2\n")


def test_it_does_not_outlive_a_reader_that_stops(fake: Path) -> None:
    script(fake, f"echo $$ > {fake}/pid", 'echo "1 N..... DWELL(1)"', "exec sleep 1000")
    with canonical_calls(b"M2\n", "t.ngc") as found:
        next(found)
    with pytest.raises(ProcessLookupError):
        os.kill(int((fake / "pid").read_text()), 0)


def test_where_it_is_missing_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ProgramError, match=r"rs274 is not installed.*linuxcnc-uspace"):
        calls(b"M2\n")
