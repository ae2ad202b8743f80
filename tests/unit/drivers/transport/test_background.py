"""Owned work: its failure reaches all waiting calls, and nothing outlives its stop."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

import pytest

from polishd.api import LinkError, ProtocolError
from polishd.drivers.transport.background import Background, Ready, cancellable, open_blocking
from tests.time_limits import SOON_S


class Work:
    """Runs until ``fail`` is set."""

    def __init__(self) -> None:
        self.fail = asyncio.Event()
        self.ended = False

    async def main(self, ready: Ready) -> None:
        ready()
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._failing())
                group.create_task(asyncio.sleep(60))
        finally:
            self.ended = True

    async def _failing(self) -> None:
        await self.fail.wait()
        raise ProtocolError("on request")


async def test_all_who_wait_hear_of_the_failure() -> None:
    work, background = Work(), Background("it")
    await background.start(work.main, 1.0)
    future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    waiting = asyncio.gather(
        background.until(lambda: False),
        background.until(lambda: False, 9.0),
        background.result(future),
        return_exceptions=True,
    )
    await asyncio.sleep(0)
    work.fail.set()
    errors = await waiting
    assert [str(error) for error in errors] == ["on request"] * 3
    assert len({id(error) for error in errors}) == 3
    assert all(isinstance(error, ProtocolError) for error in errors)
    assert not background.alive
    with pytest.raises(ProtocolError, match="on request"):
        background.check()
    await background.stop()


async def test_stop_ends_it_and_those_who_wait() -> None:
    work, background = Work(), Background("it")
    await background.start(work.main, 1.0)
    waiting = asyncio.create_task(background.until(lambda: False))
    await asyncio.sleep(0)
    await background.stop()
    await background.stop()
    assert work.ended
    with pytest.raises(LinkError, match="it: is not open"):
        await waiting


async def test_what_was_not_started_is_not_open() -> None:
    with pytest.raises(LinkError, match="not open"):
        Background("it").check()
    with pytest.raises(LinkError, match="not open"):
        await Background("it").until(lambda: False)


async def test_it_starts_once() -> None:
    work, background = Work(), Background("it")
    await background.start(work.main, 1.0)
    with pytest.raises(LinkError, match="open already"):
        await background.start(work.main, 1.0)
    await background.stop()


async def test_start_raises_what_comes_before_ready() -> None:
    async def main(ready: Ready) -> None:
        raise ProtocolError("at once")

    background = Background("it")
    with pytest.raises(ProtocolError, match="at once"):
        await background.start(main, 1.0)
    assert not background.alive


async def test_start_is_bounded() -> None:
    async def main(ready: Ready) -> None:
        await asyncio.sleep(60)

    background = Background("it")
    with pytest.raises(LinkError, match=r"no answer within 0\.01 s"):
        await background.start(main, 0.01)
    assert not background.alive


async def test_a_cancelled_start_leaves_nothing() -> None:
    async def main(ready: Ready) -> None:
        await asyncio.sleep(60)

    background = Background("it")
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await background.start(main, 5.0)
    assert not background.alive


async def test_a_main_that_returns_has_ended() -> None:
    async def main(ready: Ready) -> None:
        ready()

    background = Background("it")
    await background.start(main, 1.0)
    with pytest.raises(LinkError, match="ended"):
        await background.until(lambda: False)
    await background.stop()


async def test_conditions_are_looked_at_after_each_pulse() -> None:
    work, background = Work(), Background("it")
    await background.start(work.main, 1.0)
    looked: list[int] = []

    def third() -> bool:
        looked.append(0)
        return len(looked) == 3

    waiting = asyncio.create_task(background.until(third))
    for _ in range(2):
        await asyncio.sleep(0.005)
        background.fire()
    assert await waiting
    assert not await background.until(lambda: False, 0.01)
    with pytest.raises(LinkError, match=r"no answer within 0\.01"):
        await background.result(asyncio.get_running_loop().create_future(), 0.01)
    await background.stop()


async def blocked(undone: list[str], make: Callable[[], str], within_s: float) -> str:
    return await open_blocking(make, undone.append, within_s, "port")


async def test_a_blocking_open_gives_its_result() -> None:
    undone: list[str] = []
    assert await blocked(undone, lambda: "open", 1.0) == "open"
    assert undone == []


@pytest.mark.parametrize("cancelled", [True, False])
async def test_a_late_open_is_undone(cancelled: bool) -> None:
    undone: list[str] = []
    go = threading.Event()

    def make() -> str:
        go.wait(5)
        return "late"

    with pytest.raises((LinkError, TimeoutError)):
        async with asyncio.timeout(0.02 if cancelled else None):
            await blocked(undone, make, 5.0 if cancelled else 0.02)
    assert undone == []
    go.set()
    async with asyncio.timeout(SOON_S):
        while not undone:  # noqa: ASYNC110 -- a thread ends
            await asyncio.sleep(0.005)
    assert undone == ["late"]


async def test_a_failing_open_raises() -> None:
    def make() -> str:
        raise OSError("no such port")

    with pytest.raises(OSError, match="no such port"):
        await blocked([], make, 1.0)


async def test_what_comes_with_an_answer_is_no_less_a_stop() -> None:
    """Libraries wait with asyncio.wait_for, which in Python 3.11 forgets the stop: the work would go on for ever."""
    asked: list[asyncio.Future[int]] = []

    async def library() -> int:
        asked.append(asyncio.get_running_loop().create_future())
        return await asyncio.wait_for(asked[-1], SOON_S)

    async def main(ready: Ready) -> None:
        ready()
        while True:
            await cancellable(library())

    background = Background("it")
    await background.start(main, 1.0)
    await asyncio.sleep(0)
    asked[-1].set_result(1)
    await asyncio.wait_for(background.stop(), SOON_S)
    assert len(asked) == 1


async def test_an_answer_in_the_clean_up_of_what_was_stopped_is_taken() -> None:
    taken: list[int] = []

    async def main(ready: Ready) -> None:
        ready()
        try:
            await asyncio.sleep(SOON_S)
        finally:
            taken.append(await cancellable(asyncio.sleep(0, 7)))

    background = Background("it")
    await background.start(main, 1.0)
    await background.stop()
    assert taken == [7]
