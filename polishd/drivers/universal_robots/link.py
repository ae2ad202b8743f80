"""The RTDE connection: samples in, orders and heartbeats out."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from enum import IntEnum

from polishd.api import ByteStream, DeviceFault, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.streams import open_stream
from polishd.drivers.universal_robots import rtde
from polishd.drivers.universal_robots.rtde import Package, PackageReader, PackageType, RtdeRecipe
from polishd.drivers.universal_robots.sample import OUTPUTS, RtdeSample, UrRegisters

CONNECT_S = 0.8
OPEN_S = 2.0
BEAT_S = 0.1
STANDS = 2
"""So many samples in a row are no accident."""


class ScriptCommand(IntEnum):
    """What a program that runs is told."""

    GO = 0
    STOP = 1
    LIFT = 2


@dataclass(frozen=True, slots=True)
class ScriptInputs:
    """All that a running program hears. One whose token it is not acts on none of it."""

    token: int = 0
    until: int = 0
    """Blocks below it may begin."""
    order: ScriptCommand = ScriptCommand.GO
    lift_um: int = 0


class RtdeConnection(Background):
    """From ``open`` to ``close``; may be opened again. Whoever waits hears of the link's end by its error."""

    def __init__(self, address: Tcp, rate_hz: float, registers: UrRegisters, silence_s: float) -> None:
        super().__init__(str(address))
        self._address = address
        self._rate_hz = rate_hz
        self._registers = registers
        self._silence_s = silence_s
        self._stream: ByteStream | None = None
        self._inputs: RtdeRecipe | None = None
        self._outputs: RtdeRecipe | None = None
        self._beat = 0
        self._last: RtdeSample | None = None
        self._stood = 0
        """Samples in a row in which nothing moved."""
        self._count = 0
        self.on_sample: Callable[[RtdeSample], None] = lambda _sample: None
        self.orders: ScriptInputs | None = None
        """What is said with each heartbeat; None: nothing is, and a program that hears nothing stops."""
        self.controller = ""
        """Its software."""

    @property
    def last(self) -> RtdeSample:
        """The last sample. The link's own error once it is lost."""
        self.check()
        if self._last is None:
            raise LinkError(f"{self._address}: is not open")
        return self._last

    @property
    def stands(self) -> bool:
        """No program runs and nothing moves."""
        return self._stood >= STANDS

    async def open(self) -> None:
        """Connect, and hear two samples. Writes no input."""
        self._stream = await open_stream(self._address, CONNECT_S)
        try:
            await self.start(self._run, OPEN_S)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Hang up; idempotent."""
        await self.stop()
        stream, self._stream, self._last = self._stream, None, None
        self._stood = 0
        if stream is not None:
            await stream.close()

    async def tell(self, orders: ScriptInputs | None) -> None:
        """Say it now, and with each heartbeat from now on."""
        self.orders = orders
        await self._say()

    async def standstill(self, after: str, within_s: float) -> None:
        """Seen in two samples that are later than now; DeviceFault otherwise."""
        count = self._count
        if not await self.until(lambda: self._count >= count + STANDS and self.stands, within_s):
            raise DeviceFault(f"{self._address}: the robot goes on after {after}")

    async def _run(self, ready: Ready) -> None:
        packages = self._packages()
        await self._set_up(packages)
        async with asyncio.TaskGroup() as group:
            group.create_task(self._listen(packages, ready), name=f"{self._address}: samples")
            group.create_task(self._feed(), name=f"{self._address}: heartbeats")

    async def _set_up(self, packages: AsyncIterator[Package]) -> None:
        version = await self._ask(packages, rtde.encode(PackageType.VERSION, rtde.PROTOCOL.to_bytes(2)))
        if not rtde.accepted(version):
            raise DeviceRefused(f"{self._address}: RTDE does not speak version {rtde.PROTOCOL}. To do: update it")
        self.controller = rtde.controller_of(await self._ask(packages, rtde.encode(PackageType.CONTROLLER)))
        outputs, inputs = (*OUTPUTS, *self._registers.outputs()), self._registers.inputs()
        answer = await self._ask(packages, rtde.ask_outputs(self._rate_hz, outputs))
        self._outputs = RtdeRecipe.answered(outputs, answer, "outputs")
        self._inputs = RtdeRecipe.answered(inputs, await self._ask(packages, rtde.ask_inputs(inputs)), "inputs")
        if not rtde.accepted(await self._ask(packages, rtde.encode(PackageType.START))):
            raise DeviceRefused(f"{self._address}: RTDE does not start")

    async def _ask(self, packages: AsyncIterator[Package], question: bytes) -> bytes:
        """The payload of the answer, which is of the question's own kind."""
        await self._write(question)
        async for package in packages:
            if package.kind == question[2]:
                return package.payload
        raise LinkError(f"{self._address}: has ended")

    async def _packages(self) -> AsyncIterator[Package]:
        """Packages as they come, texts left out; LinkError after silence."""
        reader, heard_s = PackageReader(), time.monotonic()
        while self._stream is not None:
            for package in reader.feed(await self._stream.read(1 << 16, self._silence_s)):
                heard_s = time.monotonic()
                if package.kind != PackageType.TEXT:
                    yield package
            if time.monotonic() - heard_s > self._silence_s:  # a wrong length waits for what never comes
                raise LinkError(f"{self._address}: no whole package for {self._silence_s:.2g} s")

    async def _listen(self, packages: AsyncIterator[Package], ready: Ready) -> None:
        heard_s = time.monotonic()
        async for package in packages:
            values = self._outputs and package.kind == PackageType.DATA and self._outputs.unpack(package.payload)
            if not values:
                if time.monotonic() - heard_s > self._silence_s:
                    raise LinkError(f"{self._address}: no sample for {self._silence_s:.2g} s")
                continue
            heard_s = time.monotonic()
            sample = RtdeSample.of(values, self._registers)
            if self._last is not None and sample.time_s <= self._last.time_s:
                raise ProtocolError(f"{self._address}: its clock goes back")
            self._last = sample
            self._stood = 0 if sample.plays else self._stood + 1
            self._count += 1
            self.on_sample(sample)
            self.fire()
            if self._count >= STANDS:
                ready()

    async def _feed(self) -> None:
        while True:
            await asyncio.sleep(BEAT_S)
            await self._say()

    async def _say(self) -> None:
        orders = self.orders
        if orders is None or self._inputs is None:
            return
        self._beat = (self._beat + 1) & 0x7FFFFFFF
        numbers = (self._beat, orders.token, orders.until, int(orders.order), orders.lift_um)
        await self._write(self._inputs.pack(dict(zip(self._registers.inputs(), numbers, strict=True))))

    async def _write(self, data: bytes) -> None:
        if self._stream is None:
            raise LinkError(f"{self._address}: is not open")
        await self._stream.write(data)
