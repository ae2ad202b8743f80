"""From samples to what was executed: times, states, and numbers that cannot be."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Sequence
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.api import ProtocolError
from polishd.drivers.universal_robots.rtde import RtdeSample, ScriptPhase, UrRuntimeState
from polishd.drivers.universal_robots.script import START_S, UrProgramTracker, blocks_of
from tests.programs import plan_of

MOVE, DWELL, COMMENT = b"movel(P1, a=1, v=0.1)", b"sleep(0.3)", b"# nothing"
PROGRAM = [COMMENT, MOVE, DWELL, MOVE, DWELL]
RATE_S = 0.008
START = RtdeSample(
    100.0, UrRuntimeState.PLAYING, 7, 1, 1.0, 1.0, 0.0, token=5, block=0, phase=ScriptPhase.WAITS, turns=0
)


def go(found: UrProgramTracker, until: int) -> None:
    found.until = until
    found.go(0.0)


def watch(lines: Sequence[bytes] = PROGRAM) -> UrProgramTracker:
    found = UrProgramTracker(plan_of(lines), len(lines))
    found.sent(5, blocks_of(lines))
    found.update(START)
    go(found, len(lines))
    return found


def at(tick: int, block: int, phase: ScriptPhase = ScriptPhase.RUNS, **changes: float) -> RtdeSample:
    return replace(START, **{"time_s": 100.0 + tick * RATE_S, "block": block, "phase": phase, "turns": tick, **changes})


def feed(found: UrProgramTracker, samples: Sequence[RtdeSample]) -> UrProgramTracker:
    for sample in samples:
        found.update(sample)
    return found


def done(found: UrProgramTracker, tick: int) -> UrProgramTracker:
    last = found.blocks
    return feed(found, [at(tick, last), at(tick + 1, last, ScriptPhase.DONE), at(tick + 2, last, ScriptPhase.DONE)])


def test_a_block_lasts_from_the_sample_that_names_it_to_the_one_that_names_the_next() -> None:
    found = feed(watch(), [at(1, 1), at(2, 1), at(3, 2), at(4, 2), at(10, 3), at(11, 4), at(12, 4)])
    done(found, 20)
    took = [round((found[seq].end_s - found[seq].start_s) / RATE_S) for seq in range(5)]
    assert took == [0, 3, 7, 1, 9]
    assert found[4].end_s == pytest.approx(20 * RATE_S)
    assert found.state == "done"


def test_the_sum_is_exact_whatever_samples_are_lost() -> None:
    found = feed(watch(), [at(1, 1), at(30, 4)])
    done(found, 50)
    assert found[4].end_s - found[0].start_s == pytest.approx(50 * RATE_S)
    assert all(a.end_s == b.start_s for a, b in itertools.pairwise([found[seq] for seq in range(5)]))
    dwell = found[2].end_s - found[2].start_s
    assert dwell == pytest.approx(30 * RATE_S), "it asks for more than there was: the moves get nothing"


def test_blocks_of_one_sample_share_it_by_what_they_ask_for() -> None:
    found = feed(watch(), [at(1, 1), at(126, 4), at(127, 4)])
    took = [found[seq].end_s - found[seq].start_s for seq in range(4)]
    assert took[0] == 0.0
    assert took[2] == pytest.approx(0.3)
    assert took[1::2] == pytest.approx([(126 * RATE_S - 0.3) / 2] * 2)


def test_a_dwell_of_nothing_gets_nothing_of_the_move_before_it() -> None:
    found = feed(watch([MOVE, b"sleep(0)", MOVE]), [at(1, 0), at(10, 2), at(11, 2)])
    assert [found[seq].end_s - found[seq].start_s for seq in (0, 1)] == pytest.approx([9 * RATE_S, 0.0])


def test_the_two_samples_that_show_standstill_count_all_that_was_executed() -> None:
    """``hold`` returns with the second one: the count must not go up after it."""
    found = feed(watch(), [at(1, 1), at(2, 1)])
    stopped = at(3, 3, ScriptPhase.HELD, runtime=UrRuntimeState.STOPPED)
    assert not stopped.plays
    feed(found, [stopped, replace(stopped, time_s=stopped.time_s + RATE_S)])
    assert (len(found), found.state) == (3, "held")
    feed(found, [replace(stopped, time_s=stopped.time_s + more * RATE_S) for more in (2, 3, 4)])
    assert len(found) == 3


def test_no_time_passes_while_it_waits_or_is_held() -> None:
    found = watch()
    go(found, 2)
    feed(
        found,
        [at(1, 1), at(2, 1), at(3, 2, ScriptPhase.WAITS), at(4, 2, ScriptPhase.WAITS), at(200, 2, ScriptPhase.WAITS)],
    )
    assert (found.state, len(found)) == ("held", 2)
    go(found, 5)
    feed(found, [at(201, 2), at(202, 2), at(203, 3), at(204, 3)])
    assert found[2].end_s - found[2].start_s == pytest.approx(2 * RATE_S)


def test_a_start_that_does_not_come_is_a_fault_by_our_own_clock() -> None:
    """Samples from before the order may come in a heap after it."""
    now_s = 50.0
    found = UrProgramTracker(plan_of(PROGRAM), len(PROGRAM), lambda: now_s)
    found.sent(5, blocks_of(PROGRAM))
    found.update(START)
    go(found, len(PROGRAM))
    feed(found, [at(tick, 0, ScriptPhase.WAITS) for tick in range(1, 3000)])
    assert found.state == "running"
    now_s += START_S + 0.1
    feed(found, [at(3000, 0, ScriptPhase.WAITS)])
    assert (found.state, found.detail) == ("fault", "it does not begin block 0")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"safety_mode": 3}, "protective stop"),
        ({"safety_mode": 7}, "emergency stop of the robot"),
        ({"safety_mode": 99}, "safety mode 99"),
        ({"robot_mode": 3}, "switched off"),
        ({"robot_mode": 42}, "robot mode 42"),
        ({"slider": 0.5}, "speed slider is at 50 %"),
        ({"slider": 0.0}, "speed slider is at 0 %"),
        ({"runtime": UrRuntimeState.PAUSING}, "paused at the controller"),
        ({"token": 6}, "another program"),
        ({"turns": 1, "time_s": 101.0}, "another program, or ours hangs"),
    ],
)
def test_what_is_not_as_planned_is_a_fault_at_the_first_sample(changes: dict[str, float], said: str) -> None:
    found = feed(watch(), [at(1, 1), at(2, 1, **changes)])
    assert found.state == "fault"
    assert said in found.detail
    assert found.ended


def test_a_program_that_was_stopped_is_a_fault_and_one_that_ends_is_none() -> None:
    found = feed(
        watch(), [at(1, 1), at(2, 1, runtime=UrRuntimeState.STOPPED), at(3, 1, runtime=UrRuntimeState.STOPPED)]
    )
    assert (found.state, found.detail) == ("fault", "the program was stopped at the controller")
    ended = feed(
        watch(),
        [at(1, 4), at(2, 5), at(3, 5, ScriptPhase.DONE), at(4, 5, ScriptPhase.DONE, runtime=UrRuntimeState.STOPPED)],
    )
    assert ended.state == "done"


def test_a_pause_while_it_is_held_anyway_is_reported_and_no_fault() -> None:
    found = watch()
    go(found, 0)
    feed(found, [at(1, 0, ScriptPhase.WAITS), at(2, 0, ScriptPhase.WAITS, runtime=UrRuntimeState.PAUSED)])
    assert (found.state, found.ended) == ("held", False)
    assert "paused" in found.detail


def test_a_register_of_an_earlier_script_means_nothing() -> None:
    found = UrProgramTracker(plan_of(PROGRAM), len(PROGRAM))
    feed(found, [at(1, 4)])
    found.sent(9, blocks_of(PROGRAM))
    feed(found, [at(2, 4), at(3, 4, ScriptPhase.DONE)])
    assert (len(found), found.live, found.state) == (0, False, "held")


@pytest.mark.parametrize("blocks", [(3, 2), (3, 6), (3, -1)])
def test_a_block_that_goes_back_or_is_none_is_no_block(blocks: tuple[int, int]) -> None:
    found = feed(watch(), [at(1, blocks[0])])
    with pytest.raises(ProtocolError, match="block"):
        found.update(at(2, blocks[1]))


WIRE = struct.Struct(">dIiidd6diiii")


def packed(sample: RtdeSample) -> bytes:
    numbers = (sample.time_s, sample.runtime, sample.robot_mode, sample.safety_mode, sample.slider, sample.scaling)
    speed = (sample.speed_m_s, 0.0, 0.0, 0.0, 0.0, 0.0)
    return WIRE.pack(*numbers, *speed, sample.token, sample.block, sample.phase, sample.turns)


def unpacked(data: bytes) -> RtdeSample:
    values = WIRE.unpack(data)
    return RtdeSample(
        *values[:6], speed_m_s=values[6], token=values[12], block=values[13], phase=values[14], turns=values[15]
    )


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 9), st.integers(0, 8 * WIRE.size - 1))
def test_no_turned_bit_counts_a_block_that_did_not_run(which: int, bit: int) -> None:
    """TCP has a checksum of 16 bits; a number that comes through it wrong all the same is not believed alone."""
    truth = [at(tick + 1, tick // 2) for tick in range(10)]
    data = bytearray(packed(truth[which]))
    data[bit // 8] ^= 1 << bit % 8
    found = watch()
    try:
        last_s = START.time_s
        for tick, sample in enumerate(truth):
            seen = unpacked(bytes(data)) if tick == which else sample
            if not seen.time_s > last_s:
                return  # the link ends it there
            last_s = seen.time_s
            found.update(seen)
            assert len(found) <= sample.block
    except ProtocolError:
        assert len(found) <= truth[which].block
