"""A device that never answers, or does not let go: the daemon ends all the same, in times that are stated."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from polishd.daemon.cell import cell, device_polling
from polishd.daemon.cell.device_polling import with_deadline
from polishd.daemon.contact import safety
from polishd.model.errors import DeviceFault, LinkError
from tests.unit.daemon.small_job import Bench, open_journal
from tests.unit.daemon.test_app import CLOSED, Running

SOON_S = 0.02


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(cell, "CLOSE_S", SOON_S)
    monkeypatch.setattr(cell, "LET_GO_S", SOON_S)
    monkeypatch.setattr(device_polling, "LET_GO_S", SOON_S)
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


class Hole:
    """Swallows what it is asked, and cancellations, until it is let go."""

    def __init__(self) -> None:
        self.let_go = asyncio.Event()
        self.requests = 0

    async def __call__(self) -> None:
        self.requests += 1
        while not self.let_go.is_set():
            try:
                await self.let_go.wait()
            except asyncio.CancelledError:
                continue


@pytest.fixture
async def hole() -> AsyncIterator[Hole]:
    made = Hole()
    yield made
    made.let_go.set()
    await asyncio.sleep(0)


async def nothing() -> None:
    """Done at once."""


async def test_what_takes_longer_is_cancelled_and_may_tidy_up() -> None:
    tidied = []

    async def work() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            tidied.append(True)

    with pytest.raises(TimeoutError):
        await with_deadline(SOON_S, work())
    assert tidied


async def test_what_does_not_let_go_is_left_behind(bench: Bench, hole: Hole, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(TimeoutError):
        await with_deadline(SOON_S, hole())
    assert "is abandoned" in caplog.text
    caller = asyncio.ensure_future(with_deadline(3600.0, hole()))
    await asyncio.sleep(0)
    caller.cancel()
    with pytest.raises(asyncio.CancelledError):
        await caller
    assert hole.requests == 2


async def test_what_it_raises_is_reported() -> None:
    async def work() -> None:
        raise DeviceFault("no")

    with pytest.raises(DeviceFault, match="no"):
        await with_deadline(3600.0, work())


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", ["robot", "actuator"])
async def test_a_stop_ends_the_daemon_whatever_a_device_does(
    bench: Bench, hole: Hole, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    device = bench.fake.devices[name]
    async with Running(bench) as running:
        await running.in_contact()
        monkeypatch.setattr(safety, "safe_within_s", lambda _: SOON_S)
        monkeypatch.setattr(device, "make_safe", hole)
        monkeypatch.setattr(device, "close", hole)
        running.daemon.stop()
        while not bench.fake.of("make_safe")[3:]:  # noqa: ASYNC110
            await asyncio.sleep(0)
        ended = asyncio.ensure_future(running.outcome())
        while not ended.done():
            bench.fake.clock.advance(0.5)  # an actuator that lifts, or lets go, takes its time
            await asyncio.sleep(0)
        with pytest.raises(LinkError, match=rf"^{name}: was not closed within 0\.02 s and is abandoned"):
            await ended
    assert hole.requests >= 3, "contact was left, the cell was made safe and closed"
    (unsafe,) = bench.fake.cell.unsafe
    assert unsafe.startswith(f"{name}: no answer within 0.02 s")
    assert bench.fake.of("close") == [call for call in CLOSED if not call.startswith(name)]


def test_how_long_the_end_may_take_is_known_beforehand(bench: Bench) -> None:
    """What systemd waits for (docs/how-to/host.md): with the shipped times, four devices that swallow all."""
    assert bench.fake.cell.end_s == 2 * (bench.fake.cell.limits.safe_s + SOON_S) + 4 * SOON_S


async def test_what_did_not_open_is_reported_before_what_did_not_close(bench: Bench, hole: Hole) -> None:
    bench.fake.spindle.acts.fails["open"] = LinkError("spindle: no answer")
    bench.fake.robot.acts.fails["close"] = OSError("stuck")
    with pytest.raises(LinkError, match=r"^spindle: no answer") as raised:
        await bench.fake.cell.open()
    assert raised.value.__notes__ == ["and then: stuck"]


async def test_a_stop_is_obeyed_while_a_link_is_opened_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon does not wait for a controller that accepts requests and never answers."""
    bench.fake.spindle.acts.fails["make_safe"] = LinkError("deaf")
    async with Running(bench) as running:
        await running.held()
        bench.fake.robot.acts.hangs.add("status")
        resume = asyncio.ensure_future(running.daemon.handlers["resume"]())
        while not bench.fake.of("robot.status"):  # noqa: ASYNC110
            await asyncio.sleep(0)
        running.daemon.stop()
        with pytest.raises(DeviceFault, match="spindle: deaf"):  # what it was held over
            await running.outcome()
        resume.cancel()
