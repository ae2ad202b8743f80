"""Tables in 60 columns, without colors, and not on a terminal: no line is wider, no word is lost, no escape code."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import pytest
from rich.console import RenderableType

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.rendering import terminal
from polishd.rendering.terminal import Terminal, cycle_table, figure_table, key_table, record_table
from tests.unit.cli_result import Polishd

NARROW = 60
ESCAPE = "\x1b"


def rendered(table: RenderableType, width: int = NARROW, **how: object) -> str:
    out = StringIO()
    Terminal(file=out, width=width, **how).print(table)
    return out.getvalue()


def require_readable(text: str, width: int = NARROW) -> None:
    assert text
    assert ESCAPE not in text
    assert "…" not in text
    assert [line for line in text.splitlines() if len(line) > width] == []


# Commands on a cell that need no daemon; their tables are as wide as those of any command.
COMMANDS = (
    "doctor",
    "doctor {cell}",
    "check {cell}",
    "tif {cell}",
    "compliance {cell}",
    "plugins",
    "plugins {cell}",
    "queue list {cell}",
    "top {cell} --once",
    "device list",
    "device show delta_ms300",
    "device check delta_ms300",
    "program dialects",
    "program inspect {program}",
    "map formats",
)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    files = write_demo(tmp_path_factory.mktemp("narrow") / "demo", None, 2.0, 4, None)
    (program,) = files.cell.parent.glob("*.rnc")
    return {"cell": files.cell, "program": program}


@pytest.mark.one_of_each
@pytest.mark.parametrize("line", COMMANDS)
def test_the_table_of_a_command(
    line: str, demo: dict[str, Path], polishd: Polishd, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal.stdout, "width", NARROW)
    words = line.format(**demo).split()
    said = polishd(*words)
    lines = said.out.splitlines()
    # Lines below a table stay whole, so that their paths and commands can be copied.
    table = [one for one in lines if re.match(r"[│┏┡└┃┌╭╰]| \S", one)]
    assert len(table) > 1
    require_readable("\n".join(table))


def test_a_table_that_does_not_fit_is_a_list_with_every_value() -> None:
    columns = ("a column with a name", "another column", "path", "value")
    rows = [("long_word_in_a_cell", "text of several words", "/a/path/that/is/longer/than/a/column", n) for n in (1, 2)]
    wide, narrow = (rendered(record_table("title", columns, rows), width) for width in (160, NARROW))
    require_readable(narrow)
    require_readable(wide, 160)
    assert "┃" in wide
    assert "┃" not in narrow
    for words in (narrow, wide):
        assert all(str(cell) in words for row in rows for cell in row)
    assert narrow.count("another column") == 2
    fitting = record_table("title", ("a", "b"), [("1", "2")])
    assert "┃" in rendered(fitting)


def test_a_word_longer_than_the_terminal_is_folded() -> None:
    path = "/" + "x" * 150
    for table in (key_table("t", [("path", path)]), record_table("t", ("a", "b", "c"), [("p", path, "r")])):
        text = rendered(table)
        require_readable(text)
        assert text.count("x") == 150


CYCLE = {
    "pv_nm": 123.4, "rms_nm": 12345.67, "lsf_rms_nm": 1.25, "band_rms_nm": 2.5, "predicted_rms_nm": 3.5,
    "expected_low_nm": 1.0, "expected_high_nm": 2.0, "dwell_s": 123456.7, "executed_s": 61728.3, "rate": 1.25,
    "tool": "pad_of_polyurethane", "how": "held", "uncertain": [(3, 5)], "tolerance": {},
}  # fmt: skip


@pytest.mark.parametrize(
    "table",
    [
        lambda: cycle_table({"job": "J", "outcome": "held", "tolerance_period_mm": 3.0, "cycles": [CYCLE, CYCLE]}),
        lambda: figure_table("estimates", ("tool", *(f"column {n}" for n in range(9))), [["pad"] + ["1234.567"] * 9]),
    ],
)
def test_tables_of_many_figures(table: Callable[[], RenderableType]) -> None:
    narrow = rendered(table())
    require_readable(narrow)
    assert re.search(r"1234\.567|12345\.67", narrow)


def test_no_color_is_plain_text_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    table = key_table("title", [("name", "value")])
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert ESCAPE in rendered(table, force_terminal=True)
    monkeypatch.setenv("NO_COLOR", "1")
    assert ESCAPE not in rendered(table, force_terminal=True)


def on_a_terminal(*words: str, **environment: str) -> str:
    """What the command prints on a terminal of 60 columns."""
    controller, port = pty.openpty()
    command = [sys.executable, "-m", "polishd", *words]
    settings = {**os.environ, "COLUMNS": str(NARROW), "TERM": "xterm-256color", **environment}
    with subprocess.Popen(command, stdin=port, stdout=port, stderr=port, env=settings) as process:
        os.close(port)
        parts = []
        while True:
            try:
                part = os.read(controller, 65536)
            except OSError:  # the last writer has closed it
                break
            parts.append(part)
            if not part:
                break
        process.wait()
    os.close(controller)
    return b"".join(parts).decode()


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("words", [("--help",), ("run",), ("nothing",), ("program", "dialects")], ids=" ".join)
def test_no_color_on_a_real_terminal(words: tuple[str, ...]) -> None:
    require_readable(on_a_terminal(*words, NO_COLOR="1").replace("\r\n", "\n"))
    assert ESCAPE in on_a_terminal(*words), "with colors there are codes"


@pytest.mark.full
def test_columns_sets_the_width_of_a_pipe() -> None:
    def widest(**environment: str) -> int:
        command = [sys.executable, "-m", "polishd", "program", "dialects"]
        settings = {key: value for key, value in os.environ.items() if key != "COLUMNS"} | environment
        ended = subprocess.run(command, capture_output=True, check=True, timeout=60, env=settings, text=True)
        assert ESCAPE not in ended.stdout
        return max(map(len, ended.stdout.splitlines()))

    assert widest(COLUMNS="60") <= NARROW < widest() <= terminal.WIDE


def test_json_is_one_line_at_each_width(polishd: Polishd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal.stdout, "width", 20)
    (line,) = polishd("program", "dialects", "--json").out.splitlines()
    assert json.loads(line)
