"""The request queue: one at a time, urgent first, and the answer to a cancelled caller is dropped."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from polishd.api import DeviceRefused, LinkError
from polishd.drivers.transport.background import RequestQueue


class Wire:
    """Answers when it is let."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.gate = asyncio.Event()
        self.busy = 0

    async def ask(self, name: str) -> str:
        self.busy += 1
        assert self.busy == 1
        self.asked.append(name)
        await self.gate.wait()
        self.busy -= 1
        return f"answer to {name}"


@pytest.fixture
async def queue() -> AsyncIterator[RequestQueue]:
    queue = RequestQueue("wire")
    await queue.start()
    yield queue
    await queue.stop()


async def until_asked(wire: Wire, count: int) -> None:
    while len(wire.asked) < count:  # noqa: ASYNC110
        await asyncio.sleep(0)


async def test_urgent_ones_wait_for_one_at_most(queue: RequestQueue) -> None:
    wire = Wire()
    polls = [asyncio.create_task(queue.ask(lambda n=n: wire.ask(f"poll {n}"))) for n in range(5)]
    await until_asked(wire, 1)
    retract = asyncio.create_task(queue.ask(lambda: wire.ask("retract"), urgent=True))
    await asyncio.sleep(0)
    wire.gate.set()
    assert await retract == "answer to retract"
    assert await asyncio.gather(*polls) == [f"answer to poll {n}" for n in range(5)]
    assert wire.asked[:3] == ["poll 0", "retract", "poll 1"]


async def test_a_cancelled_request_is_answered_before_the_next(queue: RequestQueue) -> None:
    wire = Wire()
    first = asyncio.create_task(queue.ask(lambda: wire.ask("first")))
    await until_asked(wire, 1)
    first.cancel()
    second = asyncio.create_task(queue.ask(lambda: wire.ask("second")))
    await asyncio.wait({first})
    assert wire.asked == ["first"]
    wire.gate.set()
    assert await second == "answer to second"


async def test_a_request_cancelled_while_it_waits_is_not_made(queue: RequestQueue) -> None:
    wire = Wire()
    first = asyncio.create_task(queue.ask(lambda: wire.ask("first")))
    second = asyncio.create_task(queue.ask(lambda: wire.ask("second")))
    await until_asked(wire, 1)
    second.cancel()
    await asyncio.wait({second})
    wire.gate.set()
    await first
    await queue.ask(lambda: wire.ask("third"))
    assert wire.asked == ["first", "third"]


async def test_an_error_is_its_askers(queue: RequestQueue) -> None:
    async def refused() -> None:
        raise DeviceRefused("no")

    with pytest.raises(DeviceRefused, match="no"):
        await queue.ask(refused)
    assert queue.running
    wire = Wire()
    wire.gate.set()
    assert await queue.ask(lambda: wire.ask("next")) == "answer to next"


async def test_a_bug_ends_the_queue(queue: RequestQueue) -> None:
    async def bug() -> None:
        raise KeyError("bug")

    with pytest.raises(KeyError):
        await queue.ask(bug)
    assert not queue.running
    with pytest.raises(KeyError):
        await queue.ask(bug)


async def test_stopping_ends_all_who_wait() -> None:
    queue, wire = RequestQueue("wire"), Wire()
    await queue.start()
    asking = [asyncio.create_task(queue.ask(lambda: wire.ask("one"))) for _ in range(3)]
    await until_asked(wire, 1)
    await queue.stop()
    errors = await asyncio.gather(*asking, return_exceptions=True)
    assert [type(error) for error in errors] == [LinkError] * 3
    with pytest.raises(LinkError):
        await queue.ask(lambda: wire.ask("late"))
