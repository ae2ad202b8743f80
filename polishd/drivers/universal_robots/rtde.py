"""RTDE packages, protocol version 2. Sans-IO: bytes in, packages out; what is malformed is never taken for a value."""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from polishd.api import ByteStream, DeviceBusy, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Ready
from polishd.drivers.transport.program_tracker import PollingConnection
from polishd.drivers.transport.streams import open_stream

PROTOCOL = 2
_HEAD = struct.Struct(">HB")
FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
"""How the values of each type are packed, big endian."""

Value = tuple[float, ...]


class PackageType(IntEnum):
    """What a package is."""

    VERSION = ord("V")
    CONTROLLER = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


@dataclass(frozen=True, slots=True)
class Package:
    """One package. Its kind may be one that we do not know."""

    kind: int
    payload: bytes


def encode(kind: PackageType, payload: bytes = b"") -> bytes:
    """A package's bytes."""
    return _HEAD.pack(_HEAD.size + len(payload), kind) + payload


def ask_outputs(rate_hz: float, names: Sequence[str]) -> bytes:
    """Ask for these outputs, so often."""
    return encode(PackageType.OUTPUTS, struct.pack(">d", rate_hz) + ",".join(names).encode("ascii"))


def ask_inputs(names: Sequence[str]) -> bytes:
    """Ask to write these inputs."""
    return encode(PackageType.INPUTS, ",".join(names).encode("ascii"))


class PackageReader:
    """Cuts a stream into packages, however it is dribbled.

    There is no check and no mark to begin again at: a length that cannot be is the end of the link.
    """

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[Package]:
        """The packages that are complete. ProtocolError where a length is shorter than its own header."""
        self._bytes += data
        while len(self._bytes) >= _HEAD.size:
            size, kind = _HEAD.unpack_from(self._bytes)
            if size < _HEAD.size:
                raise ProtocolError(f"RTDE: a package of {size} bytes")
            if len(self._bytes) < size:
                return
            payload = bytes(self._bytes[_HEAD.size : size])
            del self._bytes[:size]
            yield Package(kind, payload)


@dataclass(frozen=True, slots=True)
class RtdeRecipe:
    """What a data package holds: the names that were asked for, and their types."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @classmethod
    def answered(cls, names: Sequence[str], payload: bytes, what: str) -> RtdeRecipe:
        """Read the answer to a setup.

        DeviceRefused where a name is not known, DeviceBusy where somebody else writes one, ProtocolError for nonsense.
        """
        types = _text(payload[1:]).rstrip(",").split(",")
        if not payload or len(types) != len(names):
            raise ProtocolError(f"RTDE: {len(names)} {what} were asked for, {len(types)} answered")
        for name, kind in zip(names, types, strict=True):
            if kind == "IN_USE":
                raise DeviceBusy(f"RTDE: {name} is written by another client. To do: stop that, or set first_register")
            if kind == "NOT_FOUND":
                raise DeviceRefused(f"RTDE: the controller has no {name}. To do: update its software")
            if kind not in FORMATS:
                raise ProtocolError(f"RTDE: {name} is of the unknown type {kind!r}")
        if payload[0] == 0:
            raise DeviceRefused(f"RTDE: the controller takes no setup of {what}")
        return cls(payload[0], tuple(names), tuple(types))

    def pack(self, values: Mapping[str, int]) -> bytes:
        """A data package with a number for each name."""
        body = struct.pack(">" + self._format, *(values[name] for name in self.names))
        return encode(PackageType.DATA, bytes([self.number]) + body)

    def unpack(self, payload: bytes) -> dict[str, Value] | None:
        """The values of a data package by name; None for another recipe's.

        ProtocolError for one of another length, or with a number that is none.
        """
        if payload[:1] != bytes([self.number]):
            return None
        form = struct.Struct(">" + self._format)
        if len(payload) != 1 + form.size:
            raise ProtocolError(f"RTDE: a data package of {len(payload)} bytes, not {1 + form.size}")
        flat = form.unpack(payload[1:])
        if not all(map(math.isfinite, flat)):
            raise ProtocolError("RTDE: a value that is no number")
        values, at = {}, 0
        for name, kind in zip(self.names, self.types, strict=True):
            count = int(FORMATS[kind][:-1] or 1)
            values[name] = flat[at : at + count]
            at += count
        return values

    @property
    def _format(self) -> str:
        return "".join(FORMATS[kind] for kind in self.types)


def accepted(payload: bytes) -> bool:
    """The answer to a version, a start or a pause. ProtocolError for nonsense."""
    if payload not in (b"\0", b"\1"):
        raise ProtocolError(f"RTDE: an answer of {payload[:8]!r}")
    return payload == b"\1"


def controller_of(payload: bytes) -> str:
    """The controller's software, ``5.11.0.0``. ProtocolError for nonsense."""
    if len(payload) != 16:
        raise ProtocolError(f"RTDE: a version of {len(payload)} bytes")
    return ".".join(map(str, struct.unpack(">4I", payload)))


def _text(data: bytes) -> str:
    return data.decode("ascii", "replace")


# What a controller tells of itself in one RTDE sample, and why it would run nothing. Sans-IO.

STILL_M_S = 1e-5
"""A tool that stands is meant to have no speed at all."""
FULL, MOST = 0.999, 1.001
"""Of the speed slider: 1, but for rounding."""


class UrRuntimeState(IntEnum):
    """``runtime_state``."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class ScriptPhase(IntEnum):
    """What our own program does, by its own word."""

    NONE = 0
    WAITS = 1
    RUNS = 2
    HELD = 3
    LIFTED = 4
    DONE = 5
    ENDS = 6
    """It brakes, or lifts."""


ROBOT_MODES = {
    -1: "the controller is not up", 0: "it is disconnected", 1: "its safety configuration waits to be confirmed",
    2: "it is booting", 3: "it is switched off", 4: "it is on, its brakes are not released",
    5: "its brakes are not released", 6: "somebody moves it by hand (backdrive)", 8: "its firmware is being updated",
}  # fmt: skip
"""``robot_mode`` other than 7, running."""
SAFETY_MODES = {
    2: "the safety system limits its speed (reduced mode)", 3: "protective stop", 4: "recovery mode",
    5: "safeguard stop", 6: "emergency stop of the system", 7: "emergency stop of the robot",
    8: "safety violation", 9: "safety fault", 10: "a joint is being validated", 11: "unknown safety mode",
}  # fmt: skip
"""``safety_mode`` other than 1, normal."""
OUTPUTS = (
    "timestamp", "runtime_state", "robot_mode", "safety_mode", "target_speed_fraction", "speed_scaling",
    "target_TCP_speed",
)  # fmt: skip
RUNNING, NORMAL = 7, 1


@dataclass(frozen=True, slots=True)
class UrRegisters:
    """Which of the controller's integer registers are ours: five inputs and four outputs from ``first`` on."""

    first: int = 24

    def inputs(self) -> tuple[str, ...]:
        """Beat, token, until, order, lift in um."""
        return tuple(f"input_int_register_{self.first + at}" for at in range(5))

    def outputs(self) -> tuple[str, ...]:
        """Token, block, phase, turns."""
        return tuple(f"output_int_register_{self.first + at}" for at in range(4))


@dataclass(frozen=True, slots=True)
class RtdeSample:
    """One sample. Times are the controller's own clock, since it was switched on."""

    time_s: float
    runtime: int
    robot_mode: int
    safety_mode: int
    slider: float
    """Speed slider, 1 is all."""
    scaling: float
    """Scaling of the trajectory limiter, 1: none."""
    speed_m_s: float
    """Of the tool, as it is meant to be: without the noise of encoders."""
    token: int
    """Of the program that spoke last."""
    block: int
    """Block of it that is under way."""
    phase: int
    turns: int
    """Grows with each period in which our program runs."""

    @classmethod
    def of(cls, values: Mapping[str, Value], registers: UrRegisters) -> RtdeSample:
        """From a data package's values. ProtocolError where the speed slider or the scaling is where it cannot be."""
        one = {name: value[0] for name, value in values.items()}
        if not 0.0 <= one["target_speed_fraction"] <= MOST:
            raise ProtocolError(f"RTDE: a speed slider at {100.0 * one['target_speed_fraction']:.3g} %, of 0 to 100 %")
        if not 0.0 <= one["speed_scaling"] <= MOST:
            raise ProtocolError(f"RTDE: speed_scaling is {one['speed_scaling']:.3g}, of 0 to 1")
        token, block, phase, turns = (int(one[name]) for name in registers.outputs())
        return cls(
            time_s=one["timestamp"],
            runtime=int(one["runtime_state"]),
            robot_mode=int(one["robot_mode"]),
            safety_mode=int(one["safety_mode"]),
            slider=one["target_speed_fraction"],
            scaling=one["speed_scaling"],
            speed_m_s=max(abs(part) for part in values["target_TCP_speed"][:6]),
            token=token,
            block=block,
            phase=phase,
            turns=turns,
        )

    @property
    def override(self) -> float:
        """Fraction of the programmed speed: the speed slider, times the trajectory limiter's scaling in motion."""
        return self.slider * (self.scaling if self.runtime == UrRuntimeState.PLAYING else 1.0)

    @property
    def plays(self) -> bool:
        """A program of anybody's is under way, or the robot moves."""
        return self.runtime not in (UrRuntimeState.STOPPED, UrRuntimeState.PAUSED) or self.speed_m_s > STILL_M_S

    def obstacle(self) -> str:
        """Why it would not run a program as it is written; empty where it would."""
        if self.robot_mode != RUNNING:
            return ROBOT_MODES.get(self.robot_mode, f"robot mode {self.robot_mode}")
        if self.safety_mode != NORMAL:
            return SAFETY_MODES.get(self.safety_mode, f"safety mode {self.safety_mode}")
        if self.slider < FULL:
            return f"its speed slider is at {100.0 * self.slider:.5g} %: set it to 100 %"
        return ""


# The RTDE connection: samples in, orders and heartbeats out.

CONNECT_S = 0.8
OPEN_S = 2.0
BEAT_S = 0.1


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


class RtdeConnection(PollingConnection[ByteStream, RtdeSample]):
    """RTDE of one controller: it sends the samples, and gets the commands with each heartbeat."""

    def __init__(
        self,
        address: Tcp,
        rate_hz: float,
        registers: UrRegisters,
        silence_s: float,
        on_sample: Callable[[RtdeSample], Awaitable[None]],
    ) -> None:
        super().__init__(str(address), OPEN_S, on_sample)
        self._address = address
        self._rate_hz = rate_hz
        self._registers = registers
        self._silence_s = silence_s
        self._inputs: RtdeRecipe | None = None
        self._outputs: RtdeRecipe | None = None
        self._beat = 0
        self.orders: ScriptInputs | None = None
        """Sent with each heartbeat; None: no heartbeat is sent, and the program stops."""
        self.controller = ""
        """Its software."""

    async def _connect(self) -> ByteStream:
        return await open_stream(self._address, CONNECT_S)

    async def _disconnect(self, link: ByteStream) -> None:
        await link.close()

    def _stands(self, recent: Sequence[RtdeSample]) -> bool:
        return not any(sample.plays for sample in recent)

    async def tell(self, orders: ScriptInputs | None) -> None:
        """Send it now, and with each heartbeat from now on."""
        self.orders = orders
        await self._say()

    async def _follow(self, ready: Ready) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(super()._follow(ready), name=f"{self._address}: samples")
            group.create_task(self._feed(), name=f"{self._address}: heartbeats")

    async def _set_up(self, packages: AsyncIterator[Package]) -> None:
        version = await self._ask(packages, encode(PackageType.VERSION, PROTOCOL.to_bytes(2)))
        if not accepted(version):
            raise DeviceRefused(f"{self._address}: RTDE does not speak version {PROTOCOL}. To do: update it")
        self.controller = controller_of(await self._ask(packages, encode(PackageType.CONTROLLER)))
        outputs, inputs = (*OUTPUTS, *self._registers.outputs()), self._registers.inputs()
        answer = await self._ask(packages, ask_outputs(self._rate_hz, outputs))
        self._outputs = RtdeRecipe.answered(outputs, answer, "outputs")
        self._inputs = RtdeRecipe.answered(inputs, await self._ask(packages, ask_inputs(inputs)), "inputs")
        if not accepted(await self._ask(packages, encode(PackageType.START))):
            raise DeviceRefused(f"{self._address}: RTDE does not start")

    async def _ask(self, packages: AsyncIterator[Package], question: bytes) -> bytes:
        """The payload of the answer, which is of the question's own kind."""
        await self._write(question)
        async for package in packages:
            if package.kind == question[2]:
                return package.payload
        raise LinkError(f"{self._address}: has ended")

    async def _packages(self, link: ByteStream) -> AsyncIterator[Package]:
        """Packages as they come, texts left out; LinkError after silence."""
        reader, heard_s = PackageReader(), time.monotonic()
        while True:
            for package in reader.feed(await link.read(1 << 16, self._silence_s)):
                heard_s = time.monotonic()
                if package.kind != PackageType.TEXT:
                    yield package
            if time.monotonic() - heard_s > self._silence_s:  # a wrong length waits for what never comes
                raise LinkError(f"{self._address}: no whole package for {self._silence_s:.2g} s")

    async def _snapshots(self, link: ByteStream) -> AsyncIterator[RtdeSample]:
        packages = self._packages(link)
        await self._set_up(packages)
        heard_s = time.monotonic()
        async for package in packages:
            values = self._outputs and package.kind == PackageType.DATA and self._outputs.unpack(package.payload)
            if not values:
                if time.monotonic() - heard_s > self._silence_s:
                    raise LinkError(f"{self._address}: no sample for {self._silence_s:.2g} s")
                continue
            heard_s = time.monotonic()
            sample = RtdeSample.of(values, self._registers)
            if self._recent and sample.time_s <= self._recent[-1].time_s:
                raise ProtocolError(f"{self._address}: its clock goes back")
            yield sample

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
        if self._link is None:
            raise LinkError(f"{self._address}: is not open")
        await self._link.write(data)
