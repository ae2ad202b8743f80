"""A damaged row of the journal, however it is damaged: each endpoint names it, or answers; none ends in a fault."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.daemon.journal.history import read_events
from polishd.daemon.journal.journal import ARRAYS_NAME, JOURNAL_NAME, Journal
from polishd.daemon.journal.store import ArrayStore
from polishd.model.errors import JournalDamage
from polishd.model.events import AlarmAcknowledged, CellHeld
from polishd.model.states import CyclePhase
from tests.unit.web.page_server import Served, served

READS = ("jobs", "jobs/1/cycles", "jobs/1/cycles/0/certificate", "history", "journal", "alarms", "queue", "state")
STATS = b'"rms_nm": 1.5'
DAMAGES = [
    pytest.param(STATS, b'"rms_nm"z 1.5', "map", ("jobs/1/cycles", "history"), id="map, no JSON"),
    pytest.param(STATS, b'"sms_nm": 1.5', "map", ("history",), id="map, another key"),
    pytest.param(b'{"rms_nm": 1.5', b'["rms_nm", 1.5', "map", ("jobs/1/cycles", "history"), id="map, a list"),
    pytest.param(STATS, b'"rms_nm"\xff 1.5', "map", ("jobs/1/cycles", "history"), id="map, no UTF-8"),
    pytest.param(b'"certificate": {', b'"aertificate": {', "pass", ("jobs/1/cycles/0/certificate",), id="pass, key"),
    pytest.param(b'"certificate": {', b'"certificate"z {', "pass", ("jobs/1/cycles", "history"), id="pass, no JSON"),
    pytest.param(b'"error": "the wire', b'"error"z "the wire', "event", ("journal", "alarms"), id="event"),
    pytest.param(b'"alarms": [77]', b'"blarms": [77]', "event", ("alarms",), id="event, another key"),
    pytest.param(b'"kind": "LinkError"', b'"lind": "LinkError"', "event", ("history",), id="fault"),
]  # fmt: skip


@pytest.fixture
def web(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        asyncio.run(_filled(found.config.state_dir))
        yield found


async def _filled(state: Path) -> None:
    with Journal.open(state, job="demo", part_id="P", terms={}) as journal:
        async with journal.phase(0, CyclePhase.MEASURE):
            journal.record_map(0, "ab" * 32, "map.dat", {"rms_nm": 1.5, "judged": []}, "x")
        ArrayStore(state / ARRAYS_NAME)
        journal.begin_pass(0, "program", "boot", 3, contact=(1, 2), facts={"rate": 1.0, "certificate": {"gap": 1e-6}})
        journal.end_pass(0, "done")
        journal.record_event(CellHeld(error="the wire is cut", kind="LinkError"))
        journal.record_event(AlarmAcknowledged(alarms=[77], by="anna"))


def damage(state: Path, value: bytes, instead: bytes) -> None:
    """In the database's own file: SQLite would write another checksum."""
    assert len(value) == len(instead)
    content = (state / JOURNAL_NAME).read_bytes()
    assert value in content
    (state / JOURNAL_NAME).write_bytes(content.replace(value, instead))


@pytest.mark.one_of_each
@pytest.mark.parametrize(("value", "instead", "table", "paths"), DAMAGES)
def test_a_damaged_row_is_named_by_each_endpoint_that_reads_it(
    web: Served, value: bytes, instead: bytes, table: str, paths: tuple[str, ...]
) -> None:
    before = {path: web.ask("GET", f"/api/{path}").status_code for path in READS}
    assert set(before.values()) == {200}
    damage(web.config.state_dir, value, instead)
    answers = {path: web.ask("GET", f"/api/{path}") for path in READS}
    for path in paths:
        assert answers[path].status_code == 503, path
        said = answers[path].json()["error"]
        assert f" of {table} does not match its checksum. Check the disk" in said
    assert {one.status_code for path, one in answers.items() if path not in paths} <= {200, 503}
    assert answers["state"].status_code == 200, "the daemon's state is still shown"
    hold = web.ask("POST", "/api/orders/hold", json={"reason": "look"})
    assert hold.status_code == 200, "and orders go through"


def test_the_command_line_names_it_as_well(web: Served) -> None:
    damage(web.config.state_dir, b'"error": "the wire', b'"error"z "the wire')
    with pytest.raises(JournalDamage, match=r"the row id = \d+ of event does not match its checksum"):
        read_events(web.config.state_dir, 10)


def test_an_error_that_is_no_damage_stays_a_fault(web: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault of our own is not laid to the disk."""
    from polishd.web import run_data

    monkeypatch.setattr(run_data, "_pass", lambda row: dict(row)["missing"])
    assert web.ask("GET", "/api/jobs/1/cycles").status_code == 500
