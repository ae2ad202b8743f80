"""Replies that are malformed, late, doubled or of another device: none is taken for a value.

The whole link runs, with its queue, its time limits and its reopening; on a virtual clock waiting takes no time.
"""

from __future__ import annotations

import asyncio
import gc
import itertools
import random
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from polishd.api import LinkError, ProtocolError, SpindleTimes
from polishd.drivers.cia402 import drive as links
from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.drive import CanopenConnection
from polishd.drivers.cia402.protocol import Address, read_dictionary
from polishd.drivers.transport import background, can_bus
from polishd.drivers.transport.address import SlcanAddress
from polishd.drivers.transport.can_frames import CanFrame, OnFrame
from tests.campaigns.codecs.virtual_clock import VirtualLoop
from tests.fakes.can_peers import SlcanPeer
from tests.fakes.cia402 import EDS, NODE, Frame, cia402_spindle, sim_motor
from tests.fakes.wires import PtyWire

SILENCE_S = 0.5
ASKED = (protocol.VELOCITY, protocol.TARGET_VELOCITY, protocol.POSITION)
ANSWER = 0x580 + NODE


class NastyDrive:
    """Answers in order, as drives do; each value is its request's number, so that it identifies the request."""

    def __init__(self, seed: int, loop: VirtualLoop) -> None:
        self.rng = random.Random(seed)
        self.loop = loop
        self.on_frame: OnFrame = lambda frame: None
        self.numbers = itertools.count(1)
        self.last = 0
        self.replies = Counter[str]()
        self._free_s = 0.0

    def send(self, frame: CanFrame) -> None:
        """The bus's end: a frame of the controller's."""
        if frame.identifier != 0x600 + NODE:
            return
        address = frame.data[1:4]
        self.last = 0x00020192 if address == b"\x00\x10\x00" else next(self.numbers)
        good = (ANSWER, b"\x43" + address + self.last.to_bytes(4, "little"))
        kind = self.rng.choices(
            ["good", "malformed", "doubled", "late", "lost", "refused", "short"], [60, 29, 7, 1, 1, 1, 1]
        )[0]
        self.replies[kind] += 1
        delay_s = 3 * SILENCE_S * self.rng.random() if kind == "late" else 0.001
        if kind == "malformed":
            for _ in range(3):
                self.replies["malformed frames"] += 1
                self._deliver(self.malformed(*good), 0.0)
        if kind == "refused":
            self._deliver((ANSWER, b"\x80" + address + b"\x00\x00\x00\x08"), 0.001)
        elif kind == "short":
            self._deliver((ANSWER, b"\x4b" + good[1][1:]), 0.001)
        elif kind != "lost":
            for _ in range(2 if kind == "doubled" else 1):
                self._deliver(good, delay_s)

    async def receive(self, on_frame: OnFrame) -> None:
        self.on_frame = on_frame
        await asyncio.get_running_loop().create_future()

    async def close(self) -> None:
        self.on_frame = lambda frame: None

    def _deliver(self, frame: Frame, delay_s: float) -> None:
        self._free_s = max(self._free_s, self.loop.now_s + delay_s)
        self.loop.call_at(self._free_s, lambda: self.on_frame(CanFrame(*frame)))

    def malformed(self, identifier: int, data: bytes) -> Frame:
        """What is no answer to what that answers."""
        rng, at = self.rng, self.rng.randrange(1, 4)
        specifier = rng.choice([0x00, 0x20, 0x40, 0x41, 0x53, 0x63, 0xA0, 0xC2, 0xFF])
        wrong: list[Frame] = [
            (identifier, data[: rng.randrange(8)]),
            (identifier, data + b"\0"),
            (identifier + rng.randrange(1, 16), data),
            (0x180 + NODE, data),
            (identifier, bytes([specifier]) + data[1:]),
            (identifier, data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]),
            (identifier, bytes([data[0]]) + rng.randbytes(2) + b"\xff" + rng.randbytes(4)),
        ]
        return rng.choice(wrong)


async def ask_for_ever(drive: NastyDrive, replies: int) -> Counter[str]:
    """Read one object after the other and reopen after a loss; return the outcomes."""
    dictionary, outcomes = read_dictionary(EDS, NODE), Counter[str]()
    kinds = itertools.cycle(ASKED)
    while sum(drive.replies.values()) < replies:
        link = CanopenConnection(SlcanAddress(Path("bus")), NODE, 0x45, dictionary, SILENCE_S)
        try:
            await link.open()
            while sum(drive.replies.values()) < replies:
                await _ask(link, next(kinds), drive, outcomes)
        except LinkError:
            outcomes["lost"] += 1
        except ProtocolError:
            outcomes["refused"] += 1
        finally:
            await link.close()
    return outcomes


async def _ask(link: CanopenConnection, address: Address, drive: NastyDrive, outcomes: Counter[str]) -> None:
    try:
        value = await link.read(address)
    except ProtocolError:
        outcomes["refused"] += 1
    else:
        outcomes["value"] += 1
        assert value == drive.last, "a value that is not the answer to this request"


def campaign(monkeypatch: pytest.MonkeyPatch, replies: int) -> tuple[Counter[str], Counter[str]]:
    """(what the drive did, what the link made of it)."""
    loop = VirtualLoop()
    drive = NastyDrive(15, loop)

    async def open_bus(_: object, _node: int) -> NastyDrive:
        return drive

    class Clock:
        monotonic = staticmethod(loop.time)

    monkeypatch.setattr(can_bus, "open_bus", open_bus)
    monkeypatch.setattr(links, "time", Clock)
    monkeypatch.setattr(background, "time", Clock)
    try:
        outcomes = loop.run_until_complete(ask_for_ever(drive, replies))
        assert asyncio.all_tasks(loop) == set()
    finally:
        loop.close()
    return drive.replies, outcomes


def require_all_distinguished(replies: Counter[str], outcomes: Counter[str]) -> None:
    assert min(replies.values()) > 0
    assert outcomes["value"] > 0.9 * (replies["good"] + replies["malformed"] + replies["doubled"])
    assert outcomes["refused"] > 0.9 * (replies["refused"] + replies["short"])
    assert outcomes["lost"] >= replies["lost"]


def test_no_reply_is_taken_for_a_value_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    require_all_distinguished(*campaign(monkeypatch, 3_000))


def objects_alive() -> int:
    gc.collect()
    return len(gc.get_objects())


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_of_a_million_replies_none_is_taken_for_a_value_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    campaign(monkeypatch, 10_000)
    before = objects_alive()
    replies, outcomes = campaign(monkeypatch, 1_000_000)
    require_all_distinguished(replies, outcomes)
    assert objects_alive() - before < 1_000


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.fixture
def faulty() -> Iterator[Callable[[Frame], list[Frame]]]:
    """Send three damaged frames before each answer and a copy after it."""
    shuffler = NastyDrive(16, VirtualLoop())

    def broken(frame: Frame) -> list[Frame]:
        if frame[0] != ANSWER:
            return [frame]
        return [*(shuffler.malformed(*frame) for _ in range(3)), frame, frame]

    yield broken
    shuffler.loop.close()


@pytest.mark.full
async def test_two_thousand_broken_replies_on_a_wire(tmp_path: Path, faulty: Callable[[Frame], list[Frame]]) -> None:
    drive, _motor = sim_motor()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = cia402_spindle(SlcanAddress(wire.path), SpindleTimes(silence_s=5.0, watchdog_s=5.0))
    treated_count = 0

    def broken(frame: Frame) -> list[Frame]:
        nonlocal treated_count
        treated = faulty(frame)
        treated_count += len(treated) - 1
        return treated

    drive.treat = broken
    gc.collect()  # what earlier tests left open is closed before it is counted
    opened, tasks, alive = 0, len(asyncio.all_tasks()), 0
    while treated_count < 2_000:
        await device.open()
        await device.set_speed(600.0)
        async for sample in device.samples():
            assert (sample.setpoint_rpm, sample.fault) == (600.0, 0)
            assert sample.rpm == pytest.approx(600.0, rel=0.03)
            break
        await device.make_safe()
        await device.close()
        assert len(asyncio.all_tasks()) == tasks
        opened = opened or descriptors()
        drive.received.clear()
        alive = alive or objects_alive()
    assert descriptors() == opened
    assert objects_alive() - alive < 1_000
    drive.stop()
    await wire.close()


@pytest.mark.full
async def test_links_that_break_leave_nothing_behind(tmp_path: Path) -> None:
    drive, _motor = sim_motor()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = cia402_spindle(SlcanAddress(wire.path), SpindleTimes(silence_s=1.0, watchdog_s=5.0))
    tasks, opened = len(asyncio.all_tasks()), 0
    for _ in range(6):
        drive.treat = lambda frame: [frame]
        await device.open()
        drive.treat = lambda frame: []
        with pytest.raises(LinkError):
            await device.status()
        await device.close()
        assert len(asyncio.all_tasks()) == tasks
        opened = opened or descriptors()
    assert descriptors() == opened
    drive.stop()
    await wire.close()
