"""Time shares of executed blocks, and the link that is polled."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from operator import ne
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.drivers.plc_robot.program_tracker import SPREAD
from polishd.drivers.transport import program_tracker
from polishd.drivers.transport.program_tracker import (
    STANDS,
    PollingConnection,
    comes_to_rest,
    planned_block_s,
    stretch_ends,
    time_shares,
)
from polishd.model.errors import DeviceFault, LinkError
from tests.programs import plan_of
from tests.time_limits import SOON_S


@given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=20), st.floats(0.0, 2.0), st.floats(1e-3, 3.0), st.booleans())
def test_ends_rise_and_stay_between_the_reports(expected: list[float], gap: float, span: float, reaches: bool) -> None:
    low, high = 10.0 + gap, 10.0 + gap + span
    ends = stretch_ends(10.0, np.array(expected), low, high, reaches=reaches, spread=SPREAD)
    assert (np.diff(ends, prepend=low) > 0).all()
    assert ends[-1] <= high + 1e-9
    if reaches:
        assert ends[-1] == pytest.approx(high, abs=1e-9)


@pytest.mark.parametrize(
    ("asked", "asked_total_s", "rest", "shares"),
    [
        ([0.0, 0.2, 0.6], 0.4, [True, False, False], [0.6, 0.1, 0.3]),
        ([0.2, 0.6], 0.4, [False, False], [0.25, 0.75]),
        ([0.2, 0.6], 2.0, [False, True], [0.25, 0.75]),
        ([0.0, 0.0], 0.0, [True, True], [0.5, 0.5]),
        ([0.0, 0.0], 0.0, [False, False], [0.0, 0.0]),
    ],
)
def test_blocks_that_ask_share_their_time_and_the_rest_share_what_is_left(
    asked: list[float], asked_total_s: float, rest: list[bool], shares: list[float]
) -> None:
    found = time_shares(1.0, np.array(asked), asked_total_s, np.array(rest))
    assert found == pytest.approx(shares)


@pytest.mark.parametrize(
    ("encoding", "planned"), [("dwell", [0.0, 0.08, 0.3, 0.1, 0.5, 0.7]), ("feed", [0.0, 0.0, 0.38, 0.0, 0.6, 0.7])]
)
def test_the_time_of_a_move_before_a_dwell_belongs_to_the_move(encoding: str, planned: list[float]) -> None:
    """Blocks 2, 4, 5 and 9 are timed; before 5 there is no move, and 9 is not among the first six."""
    plan = plan_of([b"G1 X%d" % at for at in range(10)])
    program = replace(
        plan.program,
        encoding=encoding,
        block=np.array([2, 4, 5, 9]),
        line=np.array([3, 5, 6, 10]),
        time_s=np.array([0.3, 0.5, 0.6, 0.2]),
    )
    plan = replace(plan, program=program, expected_time_s=np.array([0.38, 0.6, 0.7, 0.3]))
    assert planned_block_s(plan, 6) == pytest.approx(planned)


class Counting(PollingConnection[list[str], float]):
    """A toy controller: its speed is what ``speeds`` gives next, and its link ends with them."""

    def __init__(self, speeds: Sequence[float]) -> None:
        super().__init__("toy", SOON_S, self._take)
        self.speeds = list(speeds)
        self.taken: list[float] = []
        self.closed = 0

    async def _take(self, speed: float) -> None:
        self.taken.append(speed)

    async def _connect(self) -> list[str]:
        return ["open"]

    async def _disconnect(self, link: list[str]) -> None:
        assert link == ["open"]
        self.closed += 1

    async def _snapshots(self, link: list[str]) -> AsyncIterator[float]:
        while link:
            if not self.speeds:
                raise LinkError("toy: silent")
            yield self.speeds.pop(0) if len(self.speeds) > 1 else self.speeds[0]
            await asyncio.sleep(1e-3)

    def _stands(self, recent: Sequence[float]) -> bool:
        return not any(recent)


async def test_a_robot_that_brakes_across_an_exact_stop_has_not_stopped_there() -> None:
    link = Counting([5.0, 5.0, *([0.0] * 10), *([5.0] * 20), 0.0])
    await link.open()
    await link.standstill("hold", SOON_S)
    assert link.taken.count(5.0) == 22
    moved = link.count
    await link.standstill("hold", SOON_S)
    assert link.count - moved <= STANDS + 1, "a robot that has long stood is not waited for again"
    await link.close()


async def test_a_standstill_is_two_snapshots_that_are_later_than_the_command() -> None:
    link = Counting([0.0, 0.0, 5.0, 0.0, 5.0, 0.0])
    await link.open()
    assert link.stands
    await link.standstill("hold", SOON_S)
    assert link.taken[: link.count][-2:] == [0.0, 0.0]
    assert 5.0 in link.taken, "what was seen before the command does not count"
    link.speeds = [5.0]
    with pytest.raises(DeviceFault, match="hold"):
        await link.standstill("hold", 0.05)
    await link.close()
    assert link.closed == 1


async def test_the_end_of_the_link_reaches_all_who_wait_and_it_can_be_opened_again() -> None:
    link = Counting([0.0])
    await link.open()
    waiting = asyncio.create_task(link.standstill("hold", SOON_S, after=10**6))
    link.speeds.clear()
    with pytest.raises(LinkError, match="silent"):
        await waiting
    for read in (lambda: link.last, lambda: link.link):
        with pytest.raises(LinkError, match="silent"):
            read()
    await link.close()
    link.speeds = [0.0]
    await link.open()
    assert link.last == 0.0
    await link.close()


async def test_a_link_that_brings_no_two_snapshots_is_closed_again() -> None:
    link = Counting([])
    with pytest.raises(LinkError, match="silent"):
        await link.open()
    assert link.closed == 1
    with pytest.raises(LinkError, match="not open"):
        _ = link.last


@pytest.mark.parametrize(
    ("positions", "rests", "asked"),
    [
        ("00000", True, 5),
        ("011111", True, 6),
        ("0111122222", True, 10),  # stood for 94 ms, as across an exact stop
        ("0123456789a", False, 11),
    ],
)
async def test_it_rests_once_it_has_stood_for_a_time(
    positions: str, rests: bool, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read each 31.25 ms, for 0.3 s at most."""
    clock = SimpleNamespace(now_s=0.0)
    left = list(positions)

    async def pause(seconds: float) -> None:
        clock.now_s += seconds

    monkeypatch.setattr(program_tracker, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    monkeypatch.setattr(program_tracker, "asyncio", SimpleNamespace(sleep=pause))

    async def read() -> str:
        return left.pop(0)

    assert await comes_to_rest(read, ne, 0.03125, 0.3) is rests
    assert len(positions) - len(left) == asked
