"""Text from outside is shown by a terminal, a log, a mail and a table, and obeyed by none of them."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Group
from rich.panel import Panel
from rich.text import Text

from polishd.cli import app
from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.daemon.journal.journal import Journal
from polishd.daemon.runtime.process import LOG_NAME, logging_to
from polishd.model.errors import DeviceRefused
from polishd.model.events import CommandReceived, PartRequested
from polishd.model.notification import Notification
from polishd.model.states import NOT_ASKED, Severity
from polishd.model.text import printable
from polishd.pipeline.records import table
from polishd.rendering import terminal as tables
from polishd.rendering.terminal import Terminal, escape_logs, key_table, record_table
from tests.unit.cli_result import Polishd
from tests.unit.plugins.interferometer.map_files import metropro
from tests.unit.web.page_server import served

OSC = "\x1b]0;owned\x07"
EVIL = f"a{OSC}b\x9b2J\x7f\u202e[bold]"
SHOWN = re.compile(r"a\\u001b\]0;owned(\\u0007)?b")
"""Rich takes a bell out, where others show its escape."""
SOURCES = Path(app.__file__).parent
RAW = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")


def require_shown(text: str) -> None:
    """What was said is there, and nothing in it acts."""
    assert SHOWN.search(text), text
    assert not RAW.search(text), ascii(text)


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return write_demo(tmp_path / "demo", None, 2.0, 4, None).cell


def test_tab_and_line_feed_stay_and_all_else_is_escaped() -> None:
    assert printable("a\tb\nc\r\u00e4\u2013\u4e2d") == "a\tb\nc\\u000d\u00e4\u2013\u4e2d"
    require_shown(printable(EVIL))
    assert printable("a\ud800b") == r"a\ud800b"
    assert json.loads(printable(json.dumps(EVIL, ensure_ascii=False))) == EVIL


def test_reasons_and_names_of_parts_reach_terminal_and_json(polishd: Polishd, cell: Path) -> None:
    config = load_config(cell)
    name = f"a{OSC}b"
    config.state_dir.mkdir()
    with Journal.open(config.state_dir, job=name, part_id=name, terms={}) as journal:
        journal.record_event(PartRequested(job=name, part_id=name, standing=NOT_ASKED))
        journal.record_event(CommandReceived(order="hold", reason=name, by=name))
        journal.flush()
    require_shown(polishd("events", cell).out)
    require_shown(polishd("events", cell, "--json").out)
    for verb in (("history", cell), ("status", cell), ("top", cell, "--once")):
        said = polishd(*verb)
        assert not RAW.search(said.out + said.err), verb
    require_shown(polishd("history", cell, "--json").out)


def test_a_maps_metadata_and_a_files_name_reach_the_terminal(polishd: Polishd, tmp_path: Path) -> None:
    path = tmp_path / f"a{OSC}b.dat"
    path.write_bytes(metropro(part=(name := f"a{OSC}b".encode()), serial=name))
    for verb in ((path,), (path, "--json")):
        said = polishd("map", *verb)
        assert said.code == 0, said.err
        require_shown(said.out)
    assert polishd("map", path, "--json").answer["part_id"] == f"a{OSC}b"
    path.write_bytes(b"no map")
    require_shown(polishd("map", path).err)


def test_a_programs_comments_and_name_reach_the_terminal(polishd: Polishd, tmp_path: Path) -> None:
    path = tmp_path / f"a{OSC}b.rnc"
    path.write_bytes(f"G21 G90 G94\nG0 X0 Y0 Z0\n(a{OSC}b)\nG1 X1 F60\nM2\n".encode())
    said = polishd("program", "inspect", path)
    assert not RAW.search(said.out + said.err)
    require_shown(said.out + said.err)
    path.write_bytes(f"G21 G90 G94\nG0 X0 Y0 Z0\nG1 X1 F60\na{OSC}b\nM2\n".encode())
    require_shown(polishd("program", "inspect", path).err)


def test_a_devices_words_reach_the_terminal(polishd: Polishd, cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise DeviceRefused(f"robot: {EVIL}")

    monkeypatch.setattr("polishd.cli.cell.probe_verb", refused)
    said = polishd("probe", cell)
    assert said.code == DeviceRefused.exit_code
    require_shown(said.err)
    assert "[bold]" in said.err


def test_what_rich_lays_out_is_shown_whole_and_moves_no_cursor(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal(width=400)
    shown = [key_table(EVIL, [(EVIL, EVIL)]), record_table(EVIL, [EVIL], [[EVIL]]), Panel(Text(EVIL), title=Text(EVIL))]
    terminal.print(Group(*shown), EVIL)
    with terminal.status(EVIL) as status:
        status.update(EVIL)
        terminal.print(status.renderable)
    said = capsys.readouterr().out
    require_shown(said)
    assert said.count("[bold]") == len(SHOWN.findall(said)) >= 9


def test_what_moves_the_cursor_is_richs_own(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal(width=80)
    terminal._force_terminal = True
    terminal.print(Text("red", style="red"))
    terminal.show_cursor(False)
    assert "\x1b[" in capsys.readouterr().out


def test_the_log_of_a_cell_and_that_on_stderr(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with logging_to(tmp_path):
        logging.getLogger("polishd.test").warning("the robot says %s", EVIL)
    text = (tmp_path / LOG_NAME).read_text()
    require_shown(text)
    assert json.loads(text)["message"] == f"the robot says {EVIL}"
    escape_logs()
    assert logging.lastResort is not None
    record = logging.LogRecord("polishd", logging.ERROR, "", 0, "GET %s failed", (EVIL,), None)
    require_shown(logging.lastResort.format(record))


def test_a_notifications_title_and_text() -> None:
    words = {"what": EVIL, "now": EVIL, "todo": EVIL, "cell": EVIL, "job": EVIL, "part": EVIL, "run_dir": EVIL}
    at = "2026-11-22T02:14:09+00:00"
    notification = Notification(id="1", event="failed", severity=Severity.ALARM, cycle=1, at=at, **words)
    require_shown(notification.title)
    require_shown(notification.text)


def test_a_table_in_a_file() -> None:
    require_shown(table({EVIL: np.zeros(2)}).decode())


def test_the_web_answers_in_ascii(tmp_path: Path) -> None:
    with served(tmp_path) as web:
        web.daemon.refuse = EVIL
        said = web.ask("POST", "/api/orders/resume")
        assert said.status_code == 409
        require_shown(said.content.decode("ascii"))
        assert said.json()["error"] == EVIL


def test_nothing_else_writes_to_a_terminal() -> None:
    """One place: whatever prints does so by ``say``, or by the consoles of ``rendering.terminal``."""
    own = {SOURCES / "show/terminal.py", Path(tables.__file__)}
    for path in SOURCES.rglob("*.py"):
        if path in own or "sim_backends" in path.parts:
            continue
        source = path.read_text()
        for word in ("typer.echo(", "click.echo(", "secho(", " Console("):
            assert word not in source, (path, word)


@pytest.mark.parametrize("verb", [("hil",), ("map", "report"), ("hil", "--help")])
def test_help_shows_what_stands_in_brackets(polishd: Polishd, verb: tuple[str, ...]) -> None:
    said = " ".join(re.sub(r"[\u2500-\u257f]", " ", polishd(*verb, "--help").out).split())
    assert ("[[tolerance]] of a cell" if verb[0] == "map" else "Needs polishd[testing].") in said
