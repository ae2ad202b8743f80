"""From looks at LinuxCNC to records: each block once, in order, with the time that it can have taken."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.drivers.linuxcnc.driver import LinuxCncProgramFile, LinuxCncProgramTracker
from polishd.drivers.linuxcnc.protocol import RshSnapshot, Status
from polishd.drivers.transport.program_tracker import START_S
from tests.programs import plan_of


def look(
    time_s: float, line: int, status: Status = "running", x: float | None = None, display: str = ""
) -> RshSnapshot:
    """``x`` where it stands; it moves with time otherwise."""
    return RshSnapshot(time_s, line, status, (time_s if x is None else x, 0.0, 0.0, 0.0, 0.0, 0.0), display)


def watch_of(
    blocks: int, stops: tuple[int, ...] = (), asked: dict[int, float] | None = None, dwells: bool = False
) -> LinuxCncProgramTracker:
    lines = [b"G1 X%d" % at for at in range(blocks)]
    plan = plan_of(lines)
    at = np.array(sorted(asked or {}), dtype=np.int64)
    times = np.array([(asked or {})[k] for k in at.tolist()])
    program = replace(plan.program, block=at, time_s=times, encoding="dwell" if dwells else "feed")
    watch = LinuxCncProgramTracker(replace(plan, program=program, expected_time_s=times), blocks)
    watch.file = LinuxCncProgramFile(lines, stops, "t")
    return watch


def records(watch: LinuxCncProgramTracker) -> list[tuple[float, float]]:
    return [(round(watch[k].start_s, 6), round(watch[k].end_s, 6)) for k in range(len(watch))]


def test_blocks_end_where_the_next_line_moves() -> None:
    watch = watch_of(3)
    watch.go(100.0)
    for at, line in ((100.1, 1), (100.2, 1), (100.3, 2), (100.5, 3)):
        watch.update(look(at, line))
    assert records(watch) == [(0.0, 0.3), (0.3, 0.5)]
    watch.update(look(100.7, 3, "idle", 9.0, "polishd t 3"))
    assert records(watch)[2] == (0.5, 0.7)
    assert (watch.state, watch.ended) == ("done", True)


def test_a_dwell_gets_the_time_at_rest() -> None:
    watch = watch_of(3, asked={1: 0.4}, dwells=True)
    watch.go(0.0)
    watch.update(look(0.1, 1, x=1.0))
    watch.update(look(0.2, 1, x=2.0))
    watch.update(look(0.4, 1, x=2.0))
    watch.update(look(0.6, 3, x=2.0))
    assert records(watch) == [(0.0, 0.2), (0.2, 0.6)]


def test_blocks_of_one_look_share_its_time_by_what_they_ask() -> None:
    watch = watch_of(4, asked={1: 0.1, 2: 0.3})
    watch.go(0.0)
    watch.update(look(0.4, 4))
    assert records(watch) == [(0.0, 0.0), (0.0, 0.1), (0.1, 0.4)], "a line that carries no time took none"


def test_standing_at_a_stop_takes_no_process_time() -> None:
    watch = watch_of(4, stops=(2,))
    watch.go(0.0)
    watch.update(look(0.1, 1))
    watch.update(look(0.5, 2, "running", 5.0, "polishd t 2"))
    assert watch.state == "running"
    watch.update(look(0.6, 2, "paused", 5.0))
    assert (watch.state, watch.held_at, len(watch)) == ("held", 2, 2)
    watch.update(look(50.0, 2, "paused", 5.0))
    watch.go(60.0)
    watch.update(look(60.2, 5, x=6.0))
    assert watch[2].end_s == pytest.approx(0.8)


def test_held_on_the_way_is_no_stop_and_no_block_more() -> None:
    watch = watch_of(4, stops=(2,))
    watch.go(0.0)
    watch.update(look(0.1, 1))
    watch.update(look(0.2, 1, "paused"))
    assert watch.state == "running", "it still brakes"
    watch.update(look(0.2, 1, "paused"))
    assert (watch.state, watch.held_at, watch.detail, len(watch)) == ("held", None, "paused", 0)


def test_after_an_abort_the_line_read_ahead_counts_nothing() -> None:
    watch = watch_of(2000)
    watch.go(0.0)
    watch.update(look(0.1, 12))
    watch.update(look(0.2, 1519, "idle", 4.0))
    assert (watch.state, len(watch)) == ("fault", 11)
    assert "ended at the controller" in watch.detail


def test_a_program_may_take_a_while_to_begin() -> None:
    watch = watch_of(2)
    watch.go(0.0)
    states = []
    for at_s in (0.1, START_S + 0.1):
        watch.update(look(at_s, 0, "idle", 0.0))
        states.append(watch.state)
    assert states == ["running", "fault"]


def test_a_program_over_before_the_first_look_is_done() -> None:
    watch = watch_of(2)
    watch.go(0.0)
    watch.update(look(0.1, 0, "idle", 1.0, "polishd t 2"))
    assert (watch.state, len(watch)) == ("done", 2)


def test_words_of_an_earlier_file_end_nothing() -> None:
    watch = watch_of(2)
    watch.go(0.0)
    watch.update(look(0.1, 1, display="polishd old 2"))
    watch.update(look(0.2, 1, "idle", 1.0))
    assert watch.state == "fault"


def test_who_starts_it_at_the_controller_is_seen() -> None:
    watch = watch_of(3, stops=(1,))
    watch.go(0.0)
    watch.update(look(0.1, 1, "paused", 1.0, "polishd t 1"))
    watch.update(look(0.2, 1, "paused", 1.0))
    assert watch.state == "held"
    watch.update(look(5.0, 1, "running", 1.0))
    assert (watch.state, watch.detail) == ("running", "started at the controller")


def test_words_of_the_program_itself_hide_no_stop() -> None:
    """linuxcncrsh returns one message per poll."""
    watch = watch_of(4, stops=(2,))
    watch.go(0.0)
    watch.update(look(0.1, 2, x=1.0, display="look out"))
    watch.update(look(0.2, 2, "paused", 1.0, "another"))
    assert (watch.state, watch.held_at, len(watch)) == ("held", None, 1)
    watch.update(look(0.3, 2, "paused", 1.0, "polishd t 2"))
    assert (watch.state, watch.held_at, len(watch)) == ("held", 2, 2)
    assert watch[1].end_s == pytest.approx(0.2)


def test_a_stop_right_after_a_start_at_the_controller_is_seen() -> None:
    watch = watch_of(4, stops=(1, 2))
    watch.go(0.0)
    watch.update(look(0.1, 1, "paused", 1.0, "polishd t 1"))
    watch.update(look(0.2, 1, "paused", 1.0))
    watch.update(look(5.0, 2, "running", 1.0, "polishd t 2"))
    watch.update(look(5.1, 2, "paused", 1.0))
    assert (watch.state, watch.held_at, len(watch)) == ("held", 2, 2)


def test_nothing_counts_before_it_is_started() -> None:
    watch = watch_of(3)
    watch.update(look(0.1, 3))
    assert (watch.state, len(watch)) == ("held", 0)


def test_a_dropped_program_gets_no_more_records() -> None:
    watch = watch_of(3)
    watch.go(0.0)
    watch.update(look(0.1, 2))
    watch.drop("aborted")
    watch.update(look(0.2, 3))
    assert (watch.state, watch.ended, len(watch)) == ("held", True, 1)


def test_a_clock_that_jumps_back_takes_no_time_away() -> None:
    watch = watch_of(3)
    watch.go(100.0)
    watch.update(look(100.5, 1))
    watch.update(look(40.0, 2))
    watch.update(look(40.5, 3))
    assert records(watch) == [(0.0, 0.5), (0.5, 1.0)]


@given(
    st.lists(st.tuples(st.floats(0.001, 0.5), st.integers(0, 45), st.booleans()), max_size=40),
    st.dictionaries(st.integers(0, 39), st.floats(0.001, 2.0), max_size=40),
    st.booleans(),
)
def test_records_are_in_order_once_and_fill_the_time(
    looks: list[tuple[float, int, bool]], asked: dict[int, float], dwells: bool
) -> None:
    watch = watch_of(40, asked=asked, dwells=dwells)
    watch.go(0.0)
    now = 0.0
    for step_s, line, rests in looks:
        now += step_s
        watch.update(look(now, line, x=1.0 if rests else now))
    found = [watch[k] for k in range(len(watch))]
    assert all(one.start_s <= one.end_s for one in found)
    assert all(a.end_s == b.start_s for a, b in pairwise(found))
    assert not found or (found[0].start_s == 0.0 and found[-1].end_s <= now + 1e-9)


def test_a_line_that_the_motion_cannot_have_reached_is_not_believed() -> None:
    """At the start LinuxCNC reports the line that it read last, but no block was executed."""
    watch = watch_of(1000, stops=(4, 998), asked=dict.fromkeys(range(4, 998), 0.1))
    watch.go(0.0)
    watch.update(look(0.01, 999))
    assert len(watch) == 0
    watch.update(look(0.5, 6))
    watch.update(look(0.6, 7))
    assert len(watch) == watch.file.block_at(7) if watch.file is not None else False
    for seconds in np.arange(0.7, 45.0, 0.1).tolist():
        watch.update(look(seconds, 999))
    assert len(watch) == watch.file.block_at(999), "it may be there by now, at the greatest override"
