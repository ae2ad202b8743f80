"""RTDE packages, protocol version 2. Sans-IO: bytes in, packages out; malformed data never becomes a value."""

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
"""Big-endian format of each type."""

Value = tuple[float, ...]


class PackageType(IntEnum):
    """Type of a package."""

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
    """One package. Its type may be unknown."""

    kind: int
    payload: bytes


def encode(kind: PackageType, payload: bytes = b"") -> bytes:
    """Return the bytes of a package."""
    return _HEAD.pack(_HEAD.size + len(payload), kind) + payload


def ask_outputs(rate_hz: float, names: Sequence[str]) -> bytes:
    """Return the request for these outputs at that rate."""
    return encode(PackageType.OUTPUTS, struct.pack(">d", rate_hz) + ",".join(names).encode("ascii"))


def ask_inputs(names: Sequence[str]) -> bytes:
    """Return the request to write these inputs."""
    return encode(PackageType.INPUTS, ",".join(names).encode("ascii"))


class PackageReader:
    """Splits a stream into packages.

    Packages have no checksum and no start mark: an impossible length ends the link.
    """

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> Iterator[Package]:
        """Add bytes; yield the complete packages. ProtocolError if a length is shorter than the header."""
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
    """Content of a data package: the requested names, and their types."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    @classmethod
    def answered(cls, names: Sequence[str], payload: bytes, what: str) -> RtdeRecipe:
        """Parse the answer to a setup.

        DeviceRefused for an unknown name, DeviceBusy if another client writes one, ProtocolError for invalid data.
        """
        types = _text(payload[1:]).rstrip(",").split(",")
        if not payload or len(types) != len(names):
            raise ProtocolError(f"RTDE: {len(names)} {what} were requested, {len(types)} answered")
        for name, kind in zip(names, types, strict=True):
            if kind == "IN_USE":
                raise DeviceBusy(f"RTDE: {name} is written by another client. Stop it, or set first_register.")
            if kind == "NOT_FOUND":
                raise DeviceRefused(f"RTDE: the controller has no {name}. Update its software.")
            if kind not in FORMATS:
                raise ProtocolError(f"RTDE: {name} is of the unknown type {kind!r}")
        if payload[0] == 0:
            raise DeviceRefused(f"RTDE: the controller refuses a setup of {what}")
        return cls(payload[0], tuple(names), tuple(types))

    def pack(self, values: Mapping[str, int]) -> bytes:
        """Return a data package with a number for each name."""
        body = struct.pack(">" + self._format, *(values[name] for name in self.names))
        return encode(PackageType.DATA, bytes([self.number]) + body)

    def unpack(self, payload: bytes) -> dict[str, Value] | None:
        """Return the values of a data package by name; None for another recipe's.

        ProtocolError for a wrong length, or a NaN.
        """
        if payload[:1] != bytes([self.number]):
            return None
        form = struct.Struct(">" + self._format)
        if len(payload) != 1 + form.size:
            raise ProtocolError(f"RTDE: a data package of {len(payload)} bytes, not {1 + form.size}")
        flat = form.unpack(payload[1:])
        if not all(map(math.isfinite, flat)):
            raise ProtocolError("RTDE: a value is not a number")
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
    """Parse the answer to a version, a start or a pause. ProtocolError for invalid data."""
    if payload not in (b"\0", b"\1"):
        raise ProtocolError(f"RTDE: an answer of {payload[:8]!r}")
    return payload == b"\1"


def controller_of(payload: bytes) -> str:
    """Parse the controller's software version, ``5.11.0.0``. ProtocolError for invalid data."""
    if len(payload) != 16:
        raise ProtocolError(f"RTDE: a version of {len(payload)} bytes")
    return ".".join(map(str, struct.unpack(">4I", payload)))


def _text(data: bytes) -> str:
    return data.decode("ascii", "replace")


# State of the controller in one RTDE sample, and obstacles to a program. Sans-IO.

STILL_M_S = 1e-5
"""Speed limit of standstill: the commanded speed of a standing tool is 0."""
FULL, MOST = 0.999, 1.001
"""Tolerance of the speed slider's value 1."""


class UrRuntimeState(IntEnum):
    """``runtime_state``."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class ScriptPhase(IntEnum):
    """Phase that our program reports."""

    NONE = 0
    WAITS = 1
    RUNS = 2
    HELD = 3
    LIFTED = 4
    DONE = 5
    ENDS = 6
    """The program brakes or lifts."""


ROBOT_MODES = {
    -1: "the controller is not up", 0: "it is disconnected", 1: "its safety configuration waits to be confirmed",
    2: "it is booting", 3: "it is switched off", 4: "it is on, its brakes are not released",
    5: "its brakes are not released", 6: "it is moved by hand (backdrive)", 8: "its firmware is being updated",
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
    """polishd's integer registers in the controller: five inputs and four outputs from ``first`` on."""

    first: int = 24

    def inputs(self) -> tuple[str, ...]:
        """Beat, token, until, order, lift in um."""
        return tuple(f"input_int_register_{self.first + at}" for at in range(5))

    def outputs(self) -> tuple[str, ...]:
        """Token, block, phase, turns."""
        return tuple(f"output_int_register_{self.first + at}" for at in range(4))


@dataclass(frozen=True, slots=True)
class RtdeSample:
    """One sample. Times are on the controller's clock, since it was switched on."""

    time_s: float
    runtime: int
    robot_mode: int
    safety_mode: int
    slider: float
    """Speed slider, 1: full speed."""
    scaling: float
    """Scaling of the trajectory limiter, 1: none."""
    speed_m_s: float
    """Commanded speed of the tool, without encoder noise."""
    token: int
    """Token of the program that reported last."""
    block: int
    """Its present block."""
    phase: int
    turns: int
    """Counts the periods in which our program runs."""

    @classmethod
    def of(cls, values: Mapping[str, Value], registers: UrRegisters) -> RtdeSample:
        """Build a sample from a data package. ProtocolError if speed slider or scaling is out of range."""
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
        """Fraction of the programmed speed: the speed slider times the trajectory limiter's scaling in motion."""
        return self.slider * (self.scaling if self.runtime == UrRuntimeState.PLAYING else 1.0)

    @property
    def plays(self) -> bool:
        """Whether any program runs, or the robot moves."""
        return self.runtime not in (UrRuntimeState.STOPPED, UrRuntimeState.PAUSED) or self.speed_m_s > STILL_M_S

    def obstacle(self) -> str:
        """Return why the controller would not run a program as written; empty if it would."""
        if self.robot_mode != RUNNING:
            return ROBOT_MODES.get(self.robot_mode, f"robot mode {self.robot_mode}")
        if self.safety_mode != NORMAL:
            return SAFETY_MODES.get(self.safety_mode, f"safety mode {self.safety_mode}")
        if self.slider < FULL:
            return f"its speed slider is at {100.0 * self.slider:.5g} % (set it to 100 %)"
        return ""


# The RTDE connection: samples in, commands and heartbeats out.

CONNECT_S = 0.8
OPEN_S = 2.0
BEAT_S = 0.1


class ScriptCommand(IntEnum):
    """Command to a running program."""

    GO = 0
    STOP = 1
    LIFT = 2


@dataclass(frozen=True, slots=True)
class ScriptInputs:
    """Inputs of a running program. A program with another token ignores them."""

    token: int = 0
    until: int = 0
    """Blocks below this one may begin."""
    order: ScriptCommand = ScriptCommand.GO
    lift_um: int = 0


class RtdeConnection(PollingConnection[ByteStream, RtdeSample]):
    """RTDE connection of one controller: receives samples, and sends commands with each heartbeat."""

    def __init__(
        self,
        address: Tcp,
        rate_hz: float,
        registers: UrRegisters,
        silence_s: float,
        on_sample: Callable[[RtdeSample], Awaitable[None]],
        *,
        has_inputs: bool = True,
    ) -> None:
        """``has_inputs``: it writes the registers, which only one client may do. Without, it only receives samples."""
        super().__init__(str(address), OPEN_S, on_sample)
        self._address = address
        self._rate_hz = rate_hz
        self._registers = registers
        self._silence_s = silence_s
        self._has_inputs = has_inputs
        self._inputs: RtdeRecipe | None = None
        self._outputs: RtdeRecipe | None = None
        self._beat = 0
        self.orders: ScriptInputs | None = None
        """Sent with each heartbeat; None: no heartbeat is sent, and the program stops."""
        self.controller = ""
        """Software version of the controller."""

    async def _connect(self) -> ByteStream:
        return await open_stream(self._address, CONNECT_S)

    async def _disconnect(self, link: ByteStream) -> None:
        await link.close()

    def _stands(self, recent: Sequence[RtdeSample]) -> bool:
        return not any(sample.plays for sample in recent)

    async def tell(self, orders: ScriptInputs | None) -> None:
        """Send the inputs now, and with each later heartbeat."""
        self.orders = orders
        await self._say()

    async def _follow(self, ready: Ready) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(super()._follow(ready), name=f"{self._address}: samples")
            group.create_task(self._feed(), name=f"{self._address}: heartbeats")

    async def _set_up(self, packages: AsyncIterator[Package]) -> None:
        version = await self._ask(packages, encode(PackageType.VERSION, PROTOCOL.to_bytes(2)))
        if not accepted(version):
            raise DeviceRefused(f"{self._address}: RTDE does not support version {PROTOCOL}. Update the controller.")
        self.controller = controller_of(await self._ask(packages, encode(PackageType.CONTROLLER)))
        outputs, inputs = (*OUTPUTS, *self._registers.outputs()), self._registers.inputs()
        answer = await self._ask(packages, ask_outputs(self._rate_hz, outputs))
        self._outputs = RtdeRecipe.answered(outputs, answer, "outputs")
        if self._has_inputs:
            self._inputs = RtdeRecipe.answered(inputs, await self._ask(packages, ask_inputs(inputs)), "inputs")
        if not accepted(await self._ask(packages, encode(PackageType.START))):
            raise DeviceRefused(f"{self._address}: RTDE does not start")

    async def _ask(self, packages: AsyncIterator[Package], question: bytes) -> bytes:
        """Send a request; return the payload of the answer of the same type."""
        await self._write(question)
        async for package in packages:
            if package.kind == question[2]:
                return package.payload
        raise LinkError(f"{self._address}: has ended")

    async def _packages(self, link: ByteStream) -> AsyncIterator[Package]:
        """Yield packages except texts; LinkError after silence."""
        reader, heard_s = PackageReader(), time.monotonic()
        while True:
            for package in reader.feed(await link.read(1 << 16, self._silence_s)):
                heard_s = time.monotonic()
                if package.kind != PackageType.TEXT:
                    yield package
            if time.monotonic() - heard_s > self._silence_s:  # a wrong length would wait without end
                raise LinkError(f"{self._address}: no complete package for {self._silence_s:.2g} s")

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
                raise ProtocolError(f"{self._address}: the controller's clock went backward")
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
