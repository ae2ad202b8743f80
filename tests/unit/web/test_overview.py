"""Limits, progress and time left, from a journal with a pass under way."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.journal.store import Row, Store
from polishd.web.overview import Overview, reading_row
from tests.unit.web.filled_journal import NOW_S, PASS, FilledCell, facts_of

SEGMENT = "INSERT INTO segment (job, cycle, seq, start_s, end_s, touched, recovered) VALUES (?,?,?,?,?,?,0)"
PHASE = "INSERT INTO phase (job, cycle, phase, started, ended, outcome) VALUES (?,?,?,?,?,?)"
DWELL_S = 400.0


class Clock:
    """The time as the test sets it."""

    now_s = NOW_S

    def __call__(self) -> float:
        return self.now_s


def block(job: int, seq: int) -> Row:
    """One block of a second; the first ten are off the part."""
    return SEGMENT, (job, 1, seq, float(seq), seq + 1.0, int(seq >= 10))


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    return load_config(write_demo(tmp_path / "demo", None, 2.0, 4, None).cell)


def under_way(config: CellConfig, earlier: int, blocks: int) -> int:
    """Write a journal with a pass under way since 110 s; earlier passes took 1.5 times as long as planned."""
    cell = FilledCell(config)
    for number in range(earlier):
        cell.part(f"old-{number}", NOW_S - 90_000 + number, [20.0, 1.5])
    job = cell.part("now", NOW_S - 7200, [18.0, 4.0], "under way")
    for k, (sql, values) in enumerate(cell.rows):
        if sql == PASS:
            rest, began, plan = values[:-3], values[-3], values[-1]
            cell.rows[k] = (sql, (*rest, began, began + 1.5 * json.loads(values[3])["dwell_s"], plan))
    facts = {**facts_of(4.0, 1.2, 1.2), "dwell_s": DWELL_S}
    began = (PASS.replace("'done'", "NULL"), (job, 1, "ab" * 32, json.dumps(facts), NOW_S - 110, None, ""))
    phases = [
        (PHASE, (job, 0, "run", NOW_S - 4000, NOW_S - 2000, "done")),
        (PHASE, (job, 1, "run", NOW_S - 110, None, None)),
    ]
    cell.rows += [began, *phases, *(block(job, seq) for seq in range(blocks))]
    cell.write()
    return job


def write(config: CellConfig, rows: list[Row]) -> None:
    store = Store.open(config.state_dir / JOURNAL_NAME)
    try:
        store.write(*rows)
    finally:
        store.close()


def test_without_a_journal_the_limits_are_those_of_the_cell(config: CellConfig) -> None:
    facts = Overview(config, Clock()).facts()
    assert facts["limits"]["force_n"] == config.process.force_n
    assert facts["limits"]["force_band"] == config.limits.force_band
    assert [line["limit"] for line in facts["tolerance"]] == [line.limit for line in config.lines]
    assert facts["pass"] is facts["phase"] is facts["job"] is None


def test_the_time_left_is_the_rest_of_the_plan_at_the_pace_of_earlier_passes(config: CellConfig) -> None:
    under_way(config, 3, 110)
    found = Overview(config, Clock()).facts()["pass"]
    assert (found["done"], found["contact_s"], found["dwell_s"]) == (110, 100.0, DWELL_S)
    assert found["left"]["s"] == pytest.approx(1.5 * 300.0)
    assert found["left"]["error_s"] == pytest.approx(0.02 * 450.0)  # all took the same: the least error that is stated
    assert (found["left"]["basis"], found["left"]["earlier"]) == ("passes", 4)


def test_without_earlier_passes_the_pace_is_that_of_this_one_and_its_error_is_larger(config: CellConfig) -> None:
    job = under_way(config, 0, 110)
    write(config, [("DELETE FROM pass WHERE job = ? AND cycle = 0", (job,))])
    left = Overview(config, Clock()).facts()["pass"]["left"]
    assert (left["basis"], left["s"], left["error_s"]) == ("this pass", pytest.approx(330.0), pytest.approx(33.0))


def test_blocks_are_read_once_and_an_answer_is_given_again_for_two_seconds(config: CellConfig) -> None:
    job, clock = under_way(config, 1, 20), Clock()
    overview = Overview(config, clock)
    assert overview.facts()["pass"]["done"] == 20
    write(config, [block(job, seq) for seq in range(20, 2000)])
    assert overview.facts()["pass"]["done"] == 20
    clock.now_s += 2.5
    found = overview.facts()["pass"]
    assert (found["done"], found["contact_s"]) == (2000, 1990.0)
    assert len(found["executed"]) <= 480
    assert found["executed"][-1] == (2000.0, 2000)
    clock.now_s -= 60  # a clock that is set back makes no answer last
    write(config, [block(job, 2000)])
    assert overview.facts()["pass"]["done"] == 2001


def test_a_phase_has_the_time_that_earlier_ones_took(config: CellConfig) -> None:
    under_way(config, 1, 20)
    found = Overview(config, Clock()).facts()["phase"]
    assert (found["phase"], found["earlier"], found["left"]["s"]) == ("run", 1, pytest.approx(1890.0))


@pytest.mark.parametrize(
    ("readings", "row"),
    [
        ({}, (1.0, None, None, None)),
        ({"force": None, "speed": None}, (1.0, None, None, None)),
        ({"force": {"force_n": 12.1, "setpoint_n": 12.0, "age_s": 0.1}}, (1.0, 12.1, 12.0, None)),
        ({"force": {"force_n": 12.1, "age_s": 2.0}, "speed": {"rpm": 9.0, "age_s": 0.0}}, (1.0, None, None, 9.0)),
    ],
)  # fmt: skip
def test_an_old_reading_is_no_reading(readings: dict[str, Any], row: tuple[float | None, ...]) -> None:
    assert reading_row({"readings": readings}, 1.0, 2.0) == row


def test_a_pass_with_a_figure_that_is_not_a_number_is_no_fault(config: CellConfig) -> None:
    """The journal writes NaN, which SQLite's JSON functions refuse."""
    under_way(config, 2, 110)
    write(config, [("UPDATE pass SET facts = replace(facts, '{', '{\"x\": NaN, ') WHERE how = 'done' AND job = 1", ())])
    left = Overview(config, Clock()).facts()["pass"]["left"]
    assert (left["basis"], left["s"]) == ("passes", pytest.approx(1.5 * 300.0))
