"""From reports of a controller to records: each block once, in order, and within the reports that bound it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.config.controller_profile import LineVariable, ProgramTable
from polishd.drivers.plc_robot.program_tracker import (
    START_REPORTS,
    ControllerReport,
    LineCheck,
    PlcProgramFile,
    PlcProgramTracker,
)
from tests.programs import plan_of

LINE = LineVariable(address="line", type="uint32", shows="executed")
TABLE = ProgramTable()


def report(time_s: float, line: int, *states: str, began_s: float | None = None, **more: object) -> ControllerReport:
    return replace(ControllerReport(time_s, frozenset(states or ("running",)), line, began_s), **more)


def watch_of(
    blocks: int, stops: tuple[int, ...] = (), expected: list[float] | None = None, proof_s: tuple[float, ...] = ()
) -> PlcProgramTracker:
    """A tracker of that many blocks, started at 0 s; a stop has one line in the file before it, and dwells."""
    lines = [b"G1 X%d" % at for at in range(blocks)]
    plan = plan_of(lines, approach_blocks=stops[0] if stops else 0)
    if expected is not None:
        program = replace(plan.program, block=np.arange(blocks), line=np.arange(1, blocks + 1))
        plan = replace(plan, program=program, expected_time_s=np.array(expected))
    watch = PlcProgramTracker(plan, blocks)
    watch.file = PlcProgramFile(lines, stops, TABLE, line=LINE, proof_s=proof_s)
    watch.proof = LineCheck(watch.file.proof, proof_s, 1.0)
    watch.update(report(0.0, 77, "ready"))
    watch.go(0.0)
    return watch


def records(watch: PlcProgramTracker) -> list[tuple[float, float]]:
    return [(round(watch[k].start_s, 2), round(watch[k].end_s, 2)) for k in range(len(watch))]


def test_blocks_last_as_long_as_they_are_expected_to_within_the_reports() -> None:
    watch = watch_of(3, expected=[0.13, 0.14, 0.2])
    for at, line in ((0.1, 1), (0.2, 2), (0.3, 3), (0.5, 3)):
        watch.update(report(at, line))
    assert records(watch)[0] == (0.05, 0.18), "as expected: it began half-way between two reports"
    assert records(watch)[1] == (0.18, 0.3), "not 0.32: by then the next one was seen"


def test_a_wrong_expectation_is_bounded_by_each_report_and_does_not_add_up() -> None:
    """Blocks of 0.25 s that were expected to last 0.2 s."""
    watch = watch_of(40, expected=[0.2] * 40)
    for step in range(1, 100):
        at = step / 10
        watch.update(report(at, int(at / 0.25) + 1))
    ends = np.array([watch[k].end_s for k in range(len(watch))])
    assert np.abs(ends - 0.25 * np.arange(1, len(ends) + 1) + 0.05).max() < 0.1


def test_the_controllers_own_word_on_a_blocks_begin_is_taken() -> None:
    watch = watch_of(4, expected=[0.2] * 4)
    watch.update(report(0.1, 1, began_s=0.03))
    watch.update(report(0.2, 2, began_s=0.111))
    watch.update(report(0.3, 3, began_s=0.257))
    spans = [watch[k].end_s - watch[k].start_s for k in range(2)]
    assert spans == pytest.approx([0.081, 0.146], abs=1e-3)


def test_a_dwell_whose_end_no_report_shows_is_not_as_long_as_the_next_move_too() -> None:
    """Moves of 0.1 s and dwells of 0.3 s: the next report after the dwell comes when the next one has begun."""
    lines = [b"G1 X%d" % at for at in range(6)]
    plan = plan_of(lines)
    program = replace(plan.program, encoding="dwell", block=np.array([1, 3, 5]), time_s=np.full(3, 0.3))
    watch = PlcProgramTracker(replace(plan, program=program, expected_time_s=np.full(3, 0.4)), 6)
    watch.file = PlcProgramFile(lines, (), TABLE, line=LINE)
    watch.go(0.0)
    for at_s, line, began_s in ((0.05, 1, 0.0), (0.15, 2, 0.1), (0.55, 4, 0.5), (0.95, 6, 0.9)):
        watch.update(report(at_s, line, began_s=began_s))
    assert [watch[k].end_s for k in (1, 3)] == pytest.approx([0.4, 0.8], abs=2e-3)


def test_the_start_time_is_taken_from_the_report() -> None:
    watch = watch_of(4, expected=[0.1] * 4)
    watch.update(report(0.1, 77, "ready"))
    watch.update(report(0.2, 1, state_began_s=0.13))
    watch.update(report(0.3, 2, began_s=0.27, state_began_s=0.13))
    assert watch[0].end_s - watch[0].start_s == pytest.approx(0.14, abs=1e-3)


def test_when_a_stretch_began_is_settled_by_the_end_of_its_first_block() -> None:
    """It was seen running at 0.2 s, not at 0.1 s; the second block began at 0.27 s."""
    watch = watch_of(4, expected=[0.1] * 4)
    watch.update(report(0.1, 77, "ready"))
    watch.update(report(0.2, 1, began_s=-5.0))
    watch.update(report(0.3, 2, began_s=0.27))
    assert watch[0].end_s - watch[0].start_s == pytest.approx(0.1)


@pytest.mark.full
@given(
    st.lists(st.floats(0.02, 1.0), min_size=5, max_size=40),
    st.floats(0.7, 1.4),
    st.floats(0.02, 0.15),
    st.integers(0, 2**31),
)
def test_every_block_is_reported_once_and_within_two_reports(
    true_s: list[float], off: float, report_s: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    ends = np.cumsum(true_s)
    watch = watch_of(len(true_s), expected=[off * one for one in true_s])
    at = 0.0
    while at < ends[-1] + 3 * report_s:
        at += report_s * rng.uniform(0.8, 1.2)
        under_way = int(np.searchsorted(ends, at, side="right"))
        over = under_way == len(true_s)
        watch.update(report(at, min(under_way + 1, len(true_s)), "done" if over else "running"))
    assert watch.state == "done"
    ends_s = np.array([watch[k].end_s for k in range(len(watch))])
    assert len(ends_s) == len(true_s)
    assert all(a.end_s == b.start_s for a, b in pairwise(watch[k] for k in range(len(ends_s))))
    assert (np.diff(ends_s, prepend=0.0) > 0).all()
    assert np.abs(ends_s - ends).max() < 2 * 1.2 * report_s
    assert ends_s[-1] == pytest.approx(ends[-1], abs=2 * 1.2 * report_s)


def test_a_hundred_milliseconds_leave_little_of_their_jitter() -> None:
    """Reports alone leave 29 ms rms a boundary; what is expected of each block leaves less."""
    rng = np.random.default_rng(1)
    true_s = rng.uniform(0.05, 0.5, 400)
    ends = np.cumsum(true_s)
    watch = watch_of(400, expected=(true_s * rng.normal(1.0, 0.02, 400)).tolist())
    at = 0.0
    while len(watch) < 399:
        at += 0.1
        watch.update(report(at, int(np.searchsorted(ends, at, side="right")) + 1))
    ends_s = np.array([watch[k].end_s for k in range(399)])
    error = ends_s - ends[:399]
    assert error.std() < 0.029
    assert (ends_s[-1] - ends_s[0]) == pytest.approx(ends[398] - ends[0], rel=1e-3)


def test_what_a_line_says_before_the_controller_was_seen_running_is_of_another_program() -> None:
    watch = watch_of(3)
    watch.update(report(0.1, 77, "ready"))
    watch.update(report(0.2, 77, "running"))
    assert len(watch) == 0
    watch.update(report(0.3, 1, "running"))
    assert len(watch) == 0


def test_it_stands_at_a_pause_of_the_file_once_two_reports_say_so() -> None:
    watch = watch_of(4, stops=(2,))
    for at, line in ((0.1, 1), (0.2, 2)):
        watch.update(report(at, line))
    watch.update(report(0.3, 3, "paused"))
    assert (len(watch), watch.state) == (2, "running")
    watch.update(report(0.4, 3, "paused"))
    assert (watch.state, watch.held_at, watch.stopped) == ("held", 2, "")


@pytest.mark.parametrize(
    ("seen", "why"),
    [
        ({"feed_held": True}, "feed is held"),
        ({"override": 0.0}, "override is 0 %"),
    ],
)
def test_a_feed_hold_is_reported_with_the_report_that_shows_it(seen: dict[str, object], why: str) -> None:
    watch = watch_of(4)
    watch.update(report(0.1, 1))
    watch.update(report(0.2, 2, **seen))
    assert why in watch.stopped
    watch.update(report(0.3, 2, "held"))
    watch.update(report(0.4, 3, "running"))
    assert why in watch.stopped, "also after it was released: the reason is reported"


def test_a_hold_that_was_asked_for_is_no_fault() -> None:
    watch = watch_of(4)
    watch.update(report(0.1, 1))
    watch.stays = True
    for at in (0.2, 0.3):
        watch.update(report(at, 1, "held"))
    assert (watch.state, watch.stopped) == ("held", "")


def test_a_controller_that_does_not_start_is_reported() -> None:
    watch = watch_of(4)
    for step in range(START_REPORTS + 2):
        watch.update(report(0.2 * (step + 1), 1, "ready"))
    assert watch.stopped == "it does not start"


def test_an_end_before_the_programs_is_a_fault() -> None:
    watch = watch_of(4)
    watch.update(report(0.1, 1))
    watch.update(report(0.2, 2, "idle"))
    assert (watch.state, watch.detail) == ("fault", "the program was ended at the controller")


def test_without_a_word_for_done_the_pause_before_the_end_tells_it() -> None:
    for reaches, seen, state in ((True, True, "done"), (True, False, "done"), (False, True, "fault")):
        lines = [b"G1 X1", b"G1 X2", b"M2"]
        watch = PlcProgramTracker(plan_of(lines), 3)
        watch.file = PlcProgramFile(lines, (), TABLE, line=LINE, pause_at_end=True)
        watch.update(report(0.0, 1, "ready"))
        watch.go(0.0)
        watch.update(report(0.1, 1))
        watch.update(report(0.2, 2))
        if reaches:
            for at in (0.3, 0.4):
                watch.update(report(at, 3, "paused"))
            assert watch.held_at == 2
            watch.go(0.5)
            if seen:  # the line of the end may be over between two reports
                watch.update(report(0.6, 4))
        for at in (0.7, 0.8):
            watch.update(report(at, 0, "ended"))
        assert watch.state == state


DWELLS = (0.5, 0.8)


def through(watch: PlcProgramTracker, lag: int, seconds: tuple[float, float] = DWELLS) -> None:
    """Two moves of 0.3 s, the dwells, the pause; the line runs ahead of the motion by this number."""
    ends = np.cumsum([0.3, 0.3, *seconds])
    for step in range(1, int((ends[-1] + 0.3) / 0.05)):
        at = step * 0.05
        line = int(np.searchsorted(ends, at, side="right")) + 1
        watch.update(report(at, min(line + lag, 5), "running" if at < ends[-1] else "paused"))


def test_dwells_of_known_times_prove_the_line_before_contact() -> None:
    watch = watch_of(5, stops=(2,), proof_s=DWELLS)
    through(watch, 0)
    assert (watch.state, watch.held_at, len(watch)) == ("held", 2, 2)


@pytest.mark.parametrize(("lag", "seconds"), [(1, DWELLS), (2, DWELLS), (0, (0.1, 0.8)), (0, (2.6, 0.8))])
def test_a_line_that_is_read_ahead_or_another_file_is_found_out(lag: int, seconds: tuple[float, float]) -> None:
    watch = watch_of(5, stops=(2,), proof_s=DWELLS)
    through(watch, lag, seconds)
    assert watch.state == "fault"
    assert "not the executed block" in watch.detail
    assert len(watch) < 2, "no landing follows"


@pytest.mark.parametrize(("less_s", "is_proved"), [(0.0, False), (0.04, True)])
def test_without_a_clock_a_dwell_may_seem_shorter_by_the_age_of_a_report(less_s: float, is_proved: bool) -> None:
    check = LineCheck((3,), (0.2,), 1.0, less_s)
    said = [check.look(line, at) for at, line in ((0.0, 2), (0.02, 3), (0.15, 3), (0.17, 4))]
    assert (check.over, any(said)) == (True, not is_proved)


def test_the_last_block_of_the_approach_is_over_when_the_dwells_are() -> None:
    """Reported earlier, the tool would land while the controller still runs."""
    watch = watch_of(5, stops=(2,), proof_s=DWELLS)
    watch.update(report(0.05, 1))
    watch.update(report(0.3, 2))
    watch.update(report(0.6, 3))
    assert len(watch) == 1
