"""Simulated device of a profile: a force drive, an inverter or a force sensor, on lines of text or Modbus registers.

The behavior is the same for every protocol, and pure of I/O.
"""

from __future__ import annotations

import asyncio
import re
import struct
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from string import Formatter
from typing import Any, Protocol

from polishd.config.simulator_devices import SimSpindleSection
from polishd.config.simulator_faults import FaultSection
from polishd.sim_backends.common import framing as numbered
from polishd.sim_backends.common.device_profile import SimDeviceProfile
from polishd.sim_backends.common.framing import RtuSlave, TcpSlave
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.voice_coil import VoiceCoil
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire

Refusal = str
"""Empty, ``range`` or ``fault``."""


class ProfileDeviceModel(Protocol):
    """Physical values by name, in N, mm, rpm and ms; a state by its name; commands by name."""

    def values(self) -> Mapping[str, float | str]:
        """Measured values and identity."""
        ...

    def state(self) -> str:
        """Return the state by its name in profiles."""
        ...

    def watchdog_fault(self) -> bool:
        """True if its own watchdog has run out and the fault is not reset."""
        ...

    def order(self, name: str, value: float) -> Refusal:
        """Execute a command of the profile."""
        ...

    def on_request(self) -> None:
        """Take the heartbeat of a request."""
        ...

    def step(self, now_s: float) -> None:
        """Advance to the present."""
        ...


@dataclass(slots=True)
class ForceDrive:
    """A voice coil behind a profile."""

    coil: VoiceCoil
    identity: Mapping[str, str]
    engages: bool
    """There is a command that lands it; else any force does."""
    beats: bool
    """There is a command that feeds its watchdog; else any request does."""
    STATES = ("retracted", "extending", "contact", "retracting", "fault")

    def values(self) -> Mapping[str, float | str]:
        """See ProfileDeviceModel."""
        coil = self.coil
        set_point = coil.setpoint_n if coil.engaged else 0.0
        found: dict[str, float | str] = {**self.identity}
        return found | {"force": coil.measured_n, "set_point": set_point, "position": coil.position_um / 1000.0}

    def state(self) -> str:
        """See ProfileDeviceModel."""
        return self.STATES[self.coil.state]

    def watchdog_fault(self) -> bool:
        """See ProfileDeviceModel."""
        return bool(self.coil.faults & 1)

    def order(self, name: str, value: float) -> Refusal:
        """See ProfileDeviceModel."""
        coil = self.coil
        if name in {"force", "rest"}:
            lands = not self.engages and value > 0.0
            return ("fault" if lands and coil.faults else coil.set_force(value)) or (coil.engage() if lands else "")
        if name == "watchdog":
            return coil.set_watchdog(round(value))
        if name == "heartbeat":
            return coil.feed(round(value))
        orders: dict[str, Callable[[], str]] = {"engage": coil.engage, "retract": coil.retract, "clear": coil.retract}
        return orders[name]()

    def on_request(self) -> None:
        """See ProfileDeviceModel."""
        if not self.beats:
            self.coil.feed(self.coil.heartbeat + 1)

    def step(self, now_s: float) -> None:
        """See ProfileDeviceModel."""
        self.coil.step(now_s)


@dataclass(slots=True)
class Inverter:
    """A motor on a ramp. It stops when requests cease, and then reports a fault."""

    report: Callable[..., None]
    now_s: float
    max_rpm: float
    ramp_rpm_s: float
    stop_rpm_s: float
    watchdog_s: float
    identity: Mapping[str, str]
    way: int = 1
    """-1: two phases are exchanged, and the rotor turns the other way round. It has no encoder to detect that."""
    rpm: float = 0.0
    target_rpm: float = 0.0
    silent: bool = False
    """Its watchdog has run out."""
    samples: list[tuple[float, float]] = field(default_factory=list)
    """(time, rpm) since the samples were last taken."""
    _request_s: float = 0.0
    _reported: str = "stopped"

    def suffer(self, _fault: FaultSection, on: bool) -> None:
        """Exchange two phases, or restore them."""
        self.way = -1 if on else 1
        self.samples.append((self.now_s, self.way * self.rpm))

    def values(self) -> Mapping[str, float | str]:
        """See ProfileDeviceModel."""
        found: dict[str, float | str] = {**self.identity}
        return found | {"speed": self.rpm, "commanded": abs(self.target_rpm)}

    def state(self) -> str:
        """See ProfileDeviceModel."""
        if self.silent:
            return "fault"
        return "running" if self.rpm or self.target_rpm else "stopped"

    def watchdog_fault(self) -> bool:
        """See ProfileDeviceModel."""
        return self.silent

    def order(self, name: str, value: float) -> Refusal:
        """See ProfileDeviceModel."""
        if name in {"forward", "reverse"}:
            if self.silent:
                return "fault"
            if value > self.max_rpm:
                return "range"
            self.target_rpm = value if name == "forward" else -value
        elif name == "stop":
            self.target_rpm = 0.0
        elif name == "clear" and self.rpm == 0.0:
            self.silent = False
        elif name == "watchdog":
            self.watchdog_s = value / 1000.0
        return ""

    def on_request(self) -> None:
        """See ProfileDeviceModel."""
        self._request_s = self.now_s

    def step(self, now_s: float) -> None:
        """See ProfileDeviceModel."""
        if self.target_rpm and now_s - self._request_s > self.watchdog_s:
            self.target_rpm, self.silent = 0.0, True
            self.report("watchdog", now_s)
        faster = abs(self.target_rpm) > abs(self.rpm) and self.rpm * self.target_rpm >= 0.0
        room = (self.ramp_rpm_s if faster else self.stop_rpm_s) * max(now_s - self.now_s, 0.0)
        before = self.rpm
        self.rpm += min(max(self.target_rpm - self.rpm, -room), room)
        if self.rpm != before:
            self.samples += [(self.now_s, self.way * before), (now_s, self.way * self.rpm)]
        self.now_s = max(now_s, self.now_s)
        self._report_motion(now_s)

    def _report_motion(self, now_s: float) -> None:
        moving = "ramping" if self.rpm != self.target_rpm else "at_speed" if self.rpm else "stopped"
        if moving != self._reported:
            self._reported = moving
            self.report(f"spindle_{moving}", now_s, rpm=round(self.rpm, 1))


@dataclass(slots=True)
class Gauge:
    """A force sensor: the force on it, less its tare."""

    pressed_n: Callable[[], float]
    identity: Mapping[str, str]
    zero_n: float = 0.0

    def values(self) -> Mapping[str, float | str]:
        """See ProfileDeviceModel."""
        return {**self.identity, "force": self.pressed_n() - self.zero_n}

    def state(self) -> str:
        """See ProfileDeviceModel."""
        return "measuring"

    def watchdog_fault(self) -> bool:
        """See ProfileDeviceModel."""
        return False

    def order(self, name: str, value: float) -> Refusal:  # noqa: ARG002 -- a gauge has no set point
        """See ProfileDeviceModel."""
        if name == "tare":
            self.zero_n = self.pressed_n()
        return ""

    def on_request(self) -> None:
        """See ProfileDeviceModel."""

    def step(self, now_s: float) -> None:
        """See ProfileDeviceModel."""


# Requests and answers of a profile, from a device on lines of text.

FORMATS = ("{:.3f}", "{:.2f}", "{:.1f}", "{:.0f}", "{:+.3f}", "{:+.2f}", "{:+.1f}")
NUMBER = r"([-+]?\d+(?:\.\d+)?)"
TEXTS = {"range": "value out of range", "fault": "a fault is set", "unknown": "no such request"}


@dataclass(slots=True)
class LineSlave:
    """Answer each line by one line, or by none where the profile defines none."""

    sheet: SimDeviceProfile
    machine: ProfileDeviceModel
    _buffer: bytes = b""
    _asked: dict[str, float] = field(default_factory=dict)

    @property
    def table(self) -> Mapping[str, Any]:
        """Table ``[lines]``."""
        table: Mapping[str, Any] = self.sheet.raw["lines"]
        return table

    def feed(self, data: bytes, _now_s: float) -> Iterable[tuple[int, bytes]]:
        """Return (bytes of the request, answer) for each whole request."""
        end = self.table.get("ending", "\r\n").encode()[-1:]
        self._buffer += data
        while end in self._buffer:
            raw, self._buffer = self._buffer.split(end, 1)
            answer = self._framed(raw.strip(b"\r\n"))
            if answer is not None:
                yield len(raw) + 1, answer
        self._buffer = self._buffer[-numbered.MAX_LINE :]

    def _framed(self, raw: bytes) -> bytes | None:
        if self.table.get("framing") != "numbered":
            answer = self._answer(raw.decode("latin-1"))
            return None if answer is None else answer.encode() + self.table.get("answer_ending", "\r\n").encode()
        number, _, request = (numbered.body(raw) or "").partition(",")
        answer = self._answer(request) if number.isdigit() else None
        return None if answer is None else numbered.line(f"{number},{answer}")

    def _answer(self, request: str) -> str | None:
        machine = self.machine
        machine.on_request()
        for query in self.sheet.raw["asks"].values():
            if query["send"] == request:
                values = self.sheet.words(machine.values(), machine.state(), silent=machine.watchdog_fault())
                return matching_text(query["answer"], values)
        refusal = self._order(request)
        if refusal:
            why = TEXTS[refusal]
            refused = self.table.get("refused", "")
            return matching_text(refused, {"why": f"{refusal},{why}"}) if refused else f"?{why}"
        accepted = self.table.get("accepted", "OK")
        return matching_text(accepted, {}) if accepted else None

    def _order(self, request: str) -> str:
        """Execute the command of the request; return the refusal, or empty."""
        for name, steps in sorted(self.sheet.orders(), key=lambda one: "{" in one[1][-1]):
            for at, step in enumerate(steps):
                match = re.fullmatch(pattern(step), request)
                if match is None:
                    continue
                if match.groups():
                    self._asked[name] = float(match[1])
                if at == len(steps) - 1:
                    return self.machine.order(name, self._asked.get(name, 0.0))
                return ""
        return "unknown"


def pattern(step: str) -> str:
    """Return a regular expression for the text of a step."""
    parts = Formatter().parse(step)
    return "".join(re.escape(text) + (NUMBER if slot is not None else "") for text, slot, _, _ in parts)


def matching_text(regex: str, values: Mapping[str, float | str]) -> str:
    """Return a text that matches the expression, with these values in its named groups; the rest must be plain."""
    text, at = "", 0
    while at < len(regex):
        if regex.startswith("(?P<", at):
            end = _closed(regex, at)
            name, inner = regex[at + 4 : end].split(">", 1)
            text += _formatted(values.get(name, 0), inner)
            at = end + 1
        elif regex[at] == "\\":
            text += regex[at + 1]
            at += 2
        elif regex[at] in "([{*+?|.":
            raise ValueError(f"the simulator cannot generate a text for {regex!r}")
        else:
            text += regex[at]
            at += 1
    return text


def _closed(regex: str, start: int) -> int:
    """Return the position at which that bracket closes."""
    depth, at = 0, start
    while True:
        if regex[at] == "\\":
            at += 1
        elif regex[at] in "()":
            depth += 1 if regex[at] == "(" else -1
            if depth == 0:
                return at
        at += 1


def _formatted(value: float | str, inner: str) -> str:
    texts = [value] if isinstance(value, str) else [form.format(value) for form in FORMATS]
    fitting = [text for text in texts if re.fullmatch(inner, text)]
    if not fitting:
        raise ValueError(f"the simulator cannot format {value!r} as {inner!r}")
    return fitting[0]


# The registers of a profile, on the side of the Modbus slave.

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4
CODES = {"range": ILLEGAL_VALUE, "fault": DEVICE_FAILURE}
TABLES = {1: "coil", 2: "discrete", 3: "holding", 4: "input", 5: "coil", 6: "holding", 15: "coil", 16: "holding"}
FORMAT = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}
WORDS = {"u32": 2, "i32": 2, "f32": 2}


@dataclass(slots=True)
class ProfileRegisters:
    """Answer requests from the machine's state, and turn writes into its commands."""

    sheet: SimDeviceProfile
    machine: ProfileDeviceModel
    stored: dict[str, float] = field(default_factory=dict)
    """Last written value, by register."""

    def answer(self, pdu: bytes) -> bytes:
        """Return the answer to a request PDU."""
        self.machine.on_request()
        function = pdu[0]
        if function in {1, 2, 3, 4} and len(pdu) == 5:
            result = self._read(function, *struct.unpack(">HH", pdu[1:]))
        elif function in {5, 6} and len(pdu) == 5:
            address, value = struct.unpack(">HH", pdu[1:])
            result = self._write(TABLES[function], address, [value != 0 if function == 5 else value]) or pdu
        elif function in {15, 16} and len(pdu) == 6 + pdu[5]:
            address, count = struct.unpack(">HH", pdu[1:5])
            many = _bits(pdu[6:], count) if function == 15 else list(struct.unpack(f">{count}H", pdu[6:]))
            result = self._write(TABLES[function], address, many) or pdu[:5]
        else:
            result = ILLEGAL_FUNCTION
        return bytes([function | 0x80, result]) if isinstance(result, int) else result

    @property
    def _map(self) -> Mapping[str, Mapping[str, Any]]:
        registers: Mapping[str, Mapping[str, Any]] = self.sheet.raw["registers"]
        return registers

    def _read(self, function: int, address: int, count: int) -> bytes | int:
        table = self._cells(TABLES[function])
        values = [table.get(address + at) for at in range(count)]
        if not 1 <= count <= self.sheet.raw["modbus"].get("max_registers", 125) or None in values:
            return ILLEGAL_ADDRESS
        words = [value or 0 for value in values]
        if function > 2:
            return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)
        packed = sum(bool(word) << at for at, word in enumerate(words)).to_bytes(-(-count // 8), "little")
        return bytes([function, len(packed)]) + packed

    def _cells(self, table: str) -> dict[int, int]:
        """Return word (or bit) by address."""
        machine = self.machine
        values = self.stored | self.sheet.words(machine.values(), machine.state(), silent=machine.watchdog_fault())
        cells: dict[int, int] = {}
        for name, register in self._map.items():
            if register.get("table", "holding") == table:
                for at, word in enumerate(self._words(register, values.get(name, 0))):
                    cells[register["address"] + at] = word
        return cells

    def _words(self, register: Mapping[str, Any], value: float | str) -> list[int]:
        kind = register.get("type", "u16")
        if kind == "bit":
            return [int(bool(value))]
        if kind == "text":
            size = 2 * register.get("words", 1)
            data = str(value).encode()[:size].ljust(size, b"\0")
        else:
            number = float(value)
            data = struct.pack(FORMAT[kind], number if kind == "f32" else round(number))
        words = list(struct.unpack(f">{len(data) // 2}H", data))
        return words[::-1] if self._low_first(register) and kind != "text" else words

    def _write(self, table: str, address: int, values: list[int]) -> int:
        """Return 0, or the exception code of the first refusal."""
        while values:
            found = [
                (name, register)
                for name, register in self._map.items()
                if (register.get("table", "holding"), register["address"]) == (table, address)
            ]
            if not found or len(values) < (size := WORDS.get(found[0][1].get("type", ""), 1)):
                return ILLEGAL_ADDRESS
            code = self._store(*found[0], values[:size])
            if code:
                return code
            values, address = values[size:], address + size
        return 0

    def _store(self, name: str, register: Mapping[str, Any], words: list[int]) -> int:
        kind = register.get("type", "u16")
        if kind == "bit":
            number = float(words[0])
        else:
            ordered = words[::-1] if self._low_first(register) else words
            data = struct.pack(f">{len(ordered)}H", *ordered)
            number = float(struct.unpack(FORMAT[kind], data)[0])
        before = self.stored.get(name)
        self.stored[name] = number
        order = self.sheet.written(name, self.stored)
        refusal = self.machine.order(*order) if order else self._foreign(name)
        if refusal and before is not None:
            self.stored[name] = before
        if order and order[0] == "heartbeat":
            self.stored["beat_echo"] = number
        return CODES[refusal] if refusal else 0

    def _foreign(self, name: str) -> str:
        """True if a value that completes no command is valid: part of a command, 0, or a register without commands."""
        steps = [step for _, all_steps in self.sheet.orders() for step in all_steps]
        values = [step.split("=")[1].strip() for step in steps if step.split("=")[0].strip() == name]
        known = not values or self.stored[name] == 0.0
        known = known or any(
            value in {"asked", "count"} or float(int(value, 0)) == self.stored[name] for value in values
        )
        return "" if known else "range"

    def _low_first(self, register: Mapping[str, Any]) -> bool:
        order = register.get("word_order", self.sheet.raw["modbus"].get("word_order", "high_first"))
        return bool(order == "low_first")


def _bits(data: bytes, count: int) -> list[int]:
    whole = int.from_bytes(data, "little")
    return [whole >> at & 1 for at in range(count)]


# The receiver of a profile's device, by its link.


class Slave(Protocol):
    """Take bytes, return answers."""

    def feed(self, data: bytes, now_s: float, /) -> Iterable[tuple[int, bytes]]:
        """Return (bytes of the request, answer) for each whole request."""
        ...


def by_profile(sheet: SimDeviceProfile, machine: ProfileDeviceModel, unit: int, *, tcp: bool) -> Slave:
    """Make it for one connection."""
    if "lines" in sheet.raw:
        return LineSlave(sheet, machine)
    answer = ProfileRegisters(sheet, machine).answer
    return TcpSlave(unit, answer) if tcp else RtuSlave(unit, answer)


# The process of a spindle with the protocol of a profile.

TICK_S = 0.01


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    whole, speed = runtime.start.config, runtime.start.speed
    config = whole.spindle
    sheet = SimDeviceProfile.read(whole.resolve(config.profile), config.pole_pairs)
    drive = Inverter(
        report=runtime.link.event,
        now_s=time.monotonic(),
        max_rpm=float(config.max_rpm),
        ramp_rpm_s=1000.0 / config.spin_s * speed,
        stop_rpm_s=1000.0 / config.stop_s * speed,
        watchdog_s=config.watchdog_s,
        identity={"vendor": "polishd", "model": "simulated inverter", "boot": str(runtime.boot_count)},
    )
    runtime.script.suffer = drive.suffer
    tcp = config.kind == "profile_tcp"
    line = sheet.raw.get("serial", {})
    baud, parity = int(line.get("baud", 115200)), str(line.get("parity", "none"))
    byte_s = 0.0 if tcp else 10.0 / baud

    unit = int(sheet.raw.get("modbus", {}).get("unit", 1)) if config.unit is None else config.unit

    def connected(outlet: FaultyLink) -> Feed:
        slave = by_profile(sheet, drive, unit, tcp=tcp)

        def feed(data: bytes) -> None:
            now = time.monotonic()
            drive.step(now)
            for size, answer in slave.feed(data, now):
                outlet.send(answer, size * byte_s)

        return feed

    wire = SimWire(runtime, connected)
    if tcp:
        wire.ready(f"tcp://{await wire.open_tcp(config.port)}")
    else:
        wire.open_pty(baud)
        wire.ready(f"serial:{runtime.start.state / runtime.name}?baud={baud}&parity={parity}")
    await _tick(runtime, drive)


async def _tick(runtime: SimRuntime, drive: Inverter) -> None:
    while True:
        drive.step(time.monotonic())
        runtime.link.samples(drive.samples, drive.now_s)
        drive.samples = []
        await asyncio.sleep(TICK_S)


SIM_DEVICES = [
    SimDevice(
        name="profile_device",
        device="spindle",
        section=SimSpindleSection,
        links={"profile": {"": "profile"}, "profile_tcp": {"": "profile_tcp"}},
        main=main,
        faults=("reverse",),
    )
]
