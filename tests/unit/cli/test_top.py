"""``polishd top`` and ``events``: what is old looks old, a lost daemon is shown, and a line describes an event."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from polishd.cli import events as happened
from polishd.cli import top
from polishd.cli.top import CellView, picture
from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.daemon.journal.journal import Journal
from polishd.daemon.socket import client
from polishd.model import events
from polishd.model.errors import LinkError, NoDaemon
from tests.unit.cli_result import Polishd

LIVE = {
    "state": "polishing",
    "phase": "run",
    "reason": "",
    "next": "",
    "part": "P-[1]",
    "job": "demo",
    "cycle": 1,
    "pressing": True,
    "readings": {
        "force": {"force_n": 11.94, "setpoint_n": 12.0, "age_s": 0.1},
        "speed": {"rpm": 1000.0, "age_s": 0.1},
        "sensed": None,
        "robot": {"state": "running", "executed": 322, "buffer_s": 12.6, "age_s": 0.2},
    },
    "ages_s": {"actuator": 0.1, "metrology": 7.1, "spindle": None},
    "signals": {"flow": {"text": "0.1 l/min", "wrong": "too little"}},
    "health": {"disk": {"name": "disk", "value": 3.0, "fits": False, "advice": "make room"}},
    "unsafe": ["actuator: does not answer"],
}
CYCLES = [
    {"rms_nm": 17.99, "how": "done", "predicted_rms_nm": 3.0, "dwell_s": 600.0, "executed_s": 600.0},
    {"rms_nm": 3.21, "how": "begun", "predicted_rms_nm": 0.4, "dwell_s": 600.0, "executed_s": 240.0},
]


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    return write_demo(tmp_path / "demo", None, 2.0, 4, None).cell


def shown(*seen: CellView, now_s: float = 100.0) -> str:
    console = Console(width=120, color_system=None, record=True)
    with console.capture() as captured:
        console.print(picture(seen, now_s))
    return captured.get()


def watched(cell: Path, **known: Any) -> CellView:
    return CellView(load_config(cell), cell, **{"live": LIVE, "last_reply_s": 99.9, "cycles": CYCLES, **known})


def test_it_says_what_goes_on_and_how_old_that_is(cell: Path) -> None:
    text = shown(watched(cell))
    for words in (
        "bench-cell: polishing, run",
        "P-[1], job demo, cycle 1",
        "RMS 17.99 > 3.21 nm, then 0.40 predicted",
        "6.0 of 10.0 min left",
        "ON THE PART",
        "11.94 N of 12.0  (0.2 s ago)",
        "running, block 322, 12.6 s buffered",
        "0.1 l/min: too little",
        "3: make room",
        "NOT SAFE",
    ):
        assert words in text, text
    assert "heard spindle" not in text, "it never sent anything"


def test_what_is_old_is_reported_by_its_age_and_style() -> None:
    assert top._aged("12 N", 0.3).style == ""
    assert top._aged("12 N", 9.0).style == "dim italic"


def test_a_silent_daemon_is_said_over_what_was_known(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def silent(*_: Any) -> dict[str, Any]:
        raise LinkError("no answer")

    one = watched(cell, last_reply_s=60.0)
    monkeypatch.setattr(client, "request", silent)
    one.look()
    assert "THE DAEMON DOES NOT ANSWER: no answer; these values are 40 s old" in shown(one)


def test_without_a_daemon_it_says_how_the_last_one_ended(polishd: Polishd, cell: Path) -> None:
    said = polishd("top", cell)
    assert said.code == 0
    assert "NO DAEMON RUNS" in said.out


def test_measurements_are_asked_for_seldom(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def request(_state_dir: Path, verb: str, _within_s: float) -> dict[str, Any]:
        asked.append(verb)
        return {"cycles": CYCLES} if verb == "status" else LIVE

    monkeypatch.setattr(client, "request", request)
    one = CellView(load_config(cell), cell)
    for _ in range(3):
        one.look()
    assert asked == ["live", "status", "live", "live"]
    assert one.cycles == CYCLES


def test_events_are_the_journals_own_the_newest_last(polishd: Polishd, cell: Path) -> None:
    state = load_config(cell).state_dir
    state.mkdir(parents=True)
    with Journal.open(state, job="demo", part_id="P") as journal:
        journal.record_event(events.CellHeld(error="the spindle\nis silent", kind="LinkError"))
        journal.record_event(events.PassProgressed(cycle=0, block=50))
        journal.record_event(events.CommandReceived(order="resume", reason="mended", by="anna (web)"))
        journal.flush()
    said = polishd("events", cell)
    held, ordered = said.out.splitlines()
    assert "held" in held
    assert held.endswith("the spindle is silent"), "one line an event"
    assert ordered.endswith("mended; anna (web)")
    (last,) = polishd("events", cell, "--last", "1", "--json").out.splitlines()
    assert json.loads(last)["data"]["order"] == "resume"


def test_events_of_a_cell_that_never_ran_are_none(polishd: Polishd, cell: Path) -> None:
    assert polishd("events", cell).out == ""


def test_events_to_come_follow_those_of_the_journal(
    polishd: Polishd, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def subscribe(_state_dir: Path) -> Any:
        yield {"name": "pass_ended", "cycle": 3, "data": {"executed_s": 600.0}}

    monkeypatch.setattr(client, "subscribe", subscribe)
    (line,) = polishd("events", cell, "--follow").out.splitlines()
    assert "cycle 3" in line
    assert "pass_ended" in line


def test_events_to_come_need_a_daemon(polishd: Polishd, cell: Path) -> None:
    said = polishd("events", cell, "--follow")
    assert (said.code, "no daemon is running" in said.err) == (NoDaemon.exit_code, True)


def test_a_long_line_is_cut() -> None:
    event = {"at_s": 0.0, "cycle": None, "name": "held", "data": {"error": "x" * 500}}
    assert len(happened.line_of(event)) == happened.MOST_CHARACTERS


def test_short_help(polishd: Polishd) -> None:
    assert polishd("status", "-h").code == 0
