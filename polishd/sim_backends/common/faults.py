"""Scripted faults: when each acts, its effect on a frame, and the faults that a link can have."""

from __future__ import annotations

import asyncio
import math
import re
import struct
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polishd.config.simulator import SimConfig
from polishd.config.simulator_faults import FRAMES, PANEL, STATES, FaultSection
from polishd.model.errors import ConfigError
from polishd.sim_backends.common import framing as numbered
from polishd.sim_backends.common.device_profile import SimDeviceProfile
from polishd.sim_backends.common.framing import crc16
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import find_device

# Facts of a link's protocol that faults need: where a frame ends, and how a harmful reply looks.

Cut = Callable[[bytes], int]
"""Bytes of the first frame; 0 where it is not complete."""
Forge = Callable[[bytes], bytes]
"""Make a forged reply of one; empty where that is impossible."""

DEVICE_FAILURE = 4
ADS_BUSY = 0x708
SDO_ABORT, HARDWARE = 0x80, 0x06060000
_SLCAN = re.compile(rb"t([0-9A-F]{3})(\d)([0-9A-Fa-f]*)\r")
_SOCKETCAND = re.compile(rb"< frame ([0-9A-F]{3}) (\S+) ([0-9A-F]*) >")


@dataclass(frozen=True, slots=True)
class Protocol:
    """One protocol."""

    cut: Cut = len
    wrong_unit: Forge | None = None
    """As if another unit or another node had answered."""
    exception: Forge | None = None
    """As if the device had refused."""


def _ended(ends: bytes) -> Cut:
    """A frame that ends with one of these bytes."""
    return lambda data: next((place for place, byte in enumerate(data, 1) if byte in ends), 0)


def _sized(form: str, at: int, more: int) -> Cut:
    """A frame with its length at a fixed offset; the length does not count ``more`` bytes."""
    size = struct.Struct(form)

    def cut(data: bytes) -> int:
        if len(data) < at + size.size:
            return 0
        whole = int(size.unpack_from(data, at)[0]) + more
        return whole if at + size.size <= whole <= len(data) else 0 if whole > len(data) else len(data)

    return cut


def _rtu(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + struct.pack("<H", crc16(body))


def _tcp(frame: bytes, unit: int, pdu: bytes) -> bytes:
    return frame[:4] + struct.pack(">HB", 1 + len(pdu), unit) + pdu


def _refused(function: int) -> bytes:
    return bytes([function | 0x80, DEVICE_FAILURE])


def _line_refused(frame: bytes) -> bytes:
    number, _, body = (numbered.body(frame.rstrip(b"\r\n")) or "").partition(",")
    return numbered.line(f"{number},ERR,fault,a fault is set") if body else b""


def _robot_refused(frame: bytes) -> bytes:
    """An ACK becomes a NAK of the same request."""
    kind, payload = next(iter(numbered.Splitter().feed(frame)), (0, b""))
    message = numbered.unpack_json(payload) if kind == numbered.ACK else None
    return (
        numbered.pack_json(numbered.NAK, {"of": message["of"], "code": "fault", "text": "a fault"}) if message else b""
    )


def _ads_refused(frame: bytes) -> bytes:
    return frame[:30] + struct.pack("<I", ADS_BUSY) + frame[34:] if len(frame) >= 38 else b""


def _kvp_refused(frame: bytes) -> bytes:
    return frame[:-3] + bytes(3) if len(frame) >= 8 else b""


def _abort(identifier: int, data: bytes) -> bytes:
    """Replace the data of an SDO answer by an abort; empty for any other frame."""
    answers = 0x580 < identifier < 0x600 and len(data) == 8
    return bytes([SDO_ABORT]) + data[1:4] + struct.pack("<I", HARDWARE) if answers else b""


def _slcan(frame: bytes, *, refused: bool) -> bytes:
    found = _SLCAN.fullmatch(frame)
    if found is None:
        return b""
    identifier, data = int(found[1], 16), bytes.fromhex(found[3].decode())
    if not refused:
        return b"t%03X%b%b\r" % ((identifier + 1) & 0x7FF, found[2], found[3])
    abort = _abort(identifier, data)
    return b"t%b8%b\r" % (found[1], abort.hex().encode()) if abort else b""


def _socketcand(frame: bytes, *, refused: bool) -> bytes:
    found = _SOCKETCAND.fullmatch(frame.strip())
    if found is None:
        return b""
    identifier, data = int(found[1], 16), bytes.fromhex(found[3].decode())
    if not refused:
        return b"< frame %03X %b %b >" % ((identifier + 1) & 0x7FF, found[2], found[3])
    abort = _abort(identifier, data)
    return b"< frame %b %b %b >" % (found[1], found[2], abort.hex().upper().encode()) if abort else b""


PROTOCOLS: Mapping[str, Protocol] = {
    "modbus_rtu": Protocol(
        wrong_unit=lambda frame: _rtu(frame[0] + 1, frame[1:-2]),
        exception=lambda frame: _rtu(frame[0], _refused(frame[1])),
    ),
    "modbus_tcp": Protocol(
        _sized(">H", 4, 6),
        wrong_unit=lambda frame: _tcp(frame, (frame[6] + 1) & 0xFF, frame[7:]),
        exception=lambda frame: _tcp(frame, frame[6], _refused(frame[7])),
    ),
    "numbered lines": Protocol(_ended(b"\n"), exception=_line_refused),
    "lines": Protocol(_ended(b"\n")),
    "slcan": Protocol(
        _ended(b"\r\a"),
        wrong_unit=lambda frame: _slcan(frame, refused=False),
        exception=lambda frame: _slcan(frame, refused=True),
    ),
    "socketcand": Protocol(
        _ended(b">"),
        wrong_unit=lambda frame: _socketcand(frame, refused=False),
        exception=lambda frame: _socketcand(frame, refused=True),
    ),
    "robot_link": Protocol(_sized(">I", 4, 12), exception=_robot_refused),
    "opcua": Protocol(_sized("<I", 4, 0)),
    "ads": Protocol(_sized("<I", 2, 6), exception=_ads_refused),
    "kvp": Protocol(_sized(">H", 2, 4), exception=_kvp_refused),
    "rtde": Protocol(_sized(">H", 0, 0)),
    "dashboard": Protocol(_ended(b"\n")),
    "primary": Protocol(),
    "http": Protocol(),
    "hses": Protocol(),
}
"""By name, as in errors and in the log."""


# The faults of one device's process: which act now, and their effect on a frame. The caller passes wall times.

TICK_S = 0.005


@dataclass(frozen=True, slots=True)
class LinkDirection:
    """One direction of one link."""

    link: str
    protocol: str
    direction: str


@dataclass(slots=True)
class FrameAction:
    """The effect of the faults on a frame."""

    data: bytes
    """Data to send; empty: the frame is lost."""
    delay_s: float = 0.0
    """The frame is delayed, and those behind it wait."""
    late_s: float = 0.0
    """Only this frame is delayed."""
    copies: int = 1
    byte_s: float = 0.0
    """Pause after each of its bytes."""


@dataclass(slots=True)
class ActiveFault:
    """A fault of the file, and its progress."""

    number: int
    """Number of the fault in the file, from 1."""
    fault: FaultSection
    rng: np.random.Generator
    since_s: float
    """Time at which waiting for it began."""
    begun_s: float | None = None
    over: bool = False
    frames: int = 0
    """Frames counted since then."""

    @property
    def acts(self) -> bool:
        """It has begun and has not ended."""
        return self.begun_s is not None and not self.over

    @property
    def lasts(self) -> bool:
        """It is a state, not a single event."""
        fault = self.fault
        return bool(fault.duration_s) or fault.rate is not None or fault.what in {"hang", *STATES}

    @property
    def always(self) -> bool:
        """It acts on every frame; its begin and end are logged, not each frame."""
        return self.lasts and self.fault.rate in {None, 1.0}

    def meets(self, way: LinkDirection) -> bool:
        """It acts on frames of that direction."""
        return self.fault.link in {"", way.link} and self.fault.direction == way.direction

    def due(self, now_s: float, contact_s: float) -> bool:
        """It is due."""
        fault = self.fault
        if fault.contact_s is not None:
            return contact_s > fault.contact_s
        if fault.frame is not None:
            return self.frames >= fault.frame
        return now_s >= self.since_s + (fault.at_s or fault.every_s or 0.0)

    def ended(self, now_s: float) -> bool:
        """Its time is over."""
        return self.begun_s is not None and 0.0 < self.fault.duration_s <= now_s - self.begun_s


@dataclass(slots=True)
class FaultScript:
    """All faults, in the order of the file."""

    device: str
    seed: int
    log_event: Callable[..., None]
    """Write to the event log: (event, **data)."""
    troubles: list[ActiveFault] = field(default_factory=list)
    suffer: Callable[[FaultSection, bool], None] = lambda _fault, _on: None
    """Set or clear that state of the device behind the link."""
    panel: dict[str, Callable[[], object]] = field(default_factory=dict)
    """What the operator does at the device's panel, by the name of the fault."""
    unplug: list[tuple[str, Callable[[], None], Callable[[], None]]] = field(default_factory=list)
    """(link, pull the plug, put it in again)."""
    reboot: Callable[[], None] = lambda: None
    contact_s: float = 0.0
    """Time in contact so far."""
    _pressed_s: float | None = None
    """Time since which the tool presses; None: it does not."""
    _changed: asyncio.Event = field(default_factory=asyncio.Event)

    def set(self, faults: Iterable[FaultSection], now_s: float, *, rebooted: bool = False) -> None:
        """Replace the faults. A device that a fault has just rebooted is not rebooted by it again."""
        self.finish(now_s)
        self.troubles = [
            ActiveFault(number, fault, stream(self.seed, f"{self.device} fault {number}"), now_s)
            for number, fault in enumerate(faults, 1)
            if fault.device == self.device and not (rebooted and fault.what == "reboot" and not fault.every_s)
        ]
        self.contact_s = 0.0
        self._changed.set()

    def finish(self, now_s: float) -> None:
        """End all active faults."""
        for trouble in self.troubles:
            if trouble.acts and trouble.lasts:
                self._end(trouble, now_s)

    def feel(self, acting_n: float) -> None:
        """Take the contact between tool and part from the plant."""
        now_s = time.monotonic()
        self._count(now_s)
        self._pressed_s = now_s if acting_n > 0.0 else None

    async def run(self) -> None:
        """Begin and end timed faults until cancelled."""
        while True:
            if not any(not trouble.over for trouble in self.troubles):
                self._changed.clear()
                await self._changed.wait()
            self.look(time.monotonic())
            await asyncio.sleep(TICK_S)

    def look(self, now_s: float) -> None:
        """Begin what is due, end what has had its time."""
        self._count(now_s)
        for trouble in self.troubles:
            if trouble.over:
                continue
            if trouble.ended(now_s):
                self._end(trouble, now_s)
            if trouble.begun_s is None and trouble.due(now_s, self.contact_s):
                self._begin(trouble, now_s)

    def treat(self, frame: bytes, way: LinkDirection, now_s: float) -> FrameAction:
        """Return the effect of the faults on a frame that goes now."""
        for trouble in self.troubles:
            trouble.frames += trouble.meets(way)
        self.look(now_s)
        fate = FrameAction(frame)
        for trouble in self.troubles:
            fault = trouble.fault
            if not trouble.acts or fault.what not in FRAMES or not trouble.meets(way):
                continue
            if (fault.rate is None or trouble.rng.random() < fault.rate) and _apply(trouble, fate, way):
                self._acted(trouble, way, now_s)
        if self.hangs(way.link):
            fate.data = b""
        return fate

    def hangs(self, link: str) -> bool:
        """Nothing passes on that link."""
        return any(t.acts and t.fault.what == "hang" and t.fault.link in {"", link} for t in self.troubles)

    def _acted(self, trouble: ActiveFault, way: LinkDirection, now_s: float) -> None:
        if not trouble.always:
            self._log("fault_acts", trouble, link=way.link or way.protocol, direction=way.direction)
        if not trouble.lasts:
            self._end(trouble, now_s)

    def _begin(self, trouble: ActiveFault, now_s: float) -> None:
        fault, trouble.begun_s = trouble.fault, now_s
        if trouble.lasts or fault.what not in FRAMES:
            self._log("fault_begins", trouble)
        if fault.what in STATES:
            self.suffer(fault, True)
        elif fault.what in PANEL:
            self.panel[fault.what]()
            self._end(trouble, now_s)
        elif fault.what == "reboot":
            self.reboot()
        elif fault.what == "unplug":
            for pull, _ in self._plugs(fault):
                pull()
            if not fault.duration_s:
                self._end(trouble, now_s)

    def _end(self, trouble: ActiveFault, now_s: float) -> None:
        fault, again = trouble.fault, trouble.fault.every_s is not None
        if trouble.lasts:
            self._log("fault_ends", trouble)
        if fault.what in STATES:
            self.suffer(fault, False)
        elif fault.what == "unplug":
            for _, plug in self._plugs(fault):
                plug()
        trouble.since_s = now_s
        trouble.begun_s, trouble.over = (None, False) if again else (trouble.begun_s, True)

    def _plugs(self, fault: FaultSection) -> list[tuple[Callable[[], None], Callable[[], None]]]:
        return [(pull, plug) for link, pull, plug in self.unplug if fault.link in {"", link}]

    def _count(self, now_s: float) -> None:
        if self._pressed_s is not None:
            self.contact_s += now_s - self._pressed_s
            self._pressed_s = now_s

    def _log(self, event: str, trouble: ActiveFault, **data: Any) -> None:
        self.log_event(event, fault=trouble.number, what=trouble.fault.what, **data)


def _apply(trouble: ActiveFault, fate: FrameAction, way: LinkDirection) -> bool:
    """True if the fault can act on this frame."""
    fault, rng = trouble.fault, trouble.rng
    if fault.what == "drop":
        fate.data = b""
    elif fault.what == "delay":
        fate.delay_s += fault.by_s + fault.jitter_s * rng.random()
    elif fault.what == "duplicate":
        fate.copies += 1
    elif fault.what == "dribble":
        fate.byte_s = max(fate.byte_s, fault.by_s)
    elif fault.what == "late_reply":
        fate.late_s += fault.by_s
    elif fault.what == "garble":
        fate.data = _with_a_bit_turned(fate.data, rng)
    else:
        forge = getattr(PROTOCOLS[way.protocol], fault.what)
        forged = forge(fate.data) if forge and fate.data else b""
        fate.data = forged or fate.data
        return bool(forged)
    return True


def _with_a_bit_turned(frame: bytes, rng: np.random.Generator) -> bytes:
    damaged = bytearray(frame)
    if damaged:
        damaged[int(rng.integers(len(damaged)))] ^= 1 << int(rng.integers(8))
    return bytes(damaged)


# The links of a simulated cell, the protocol of each, and the faults that make no sense there.

PROFILED = {"profile": "modbus_rtu", "profile_tcp": "modbus_tcp"}
"""Protocols that a device profile names, with the protocol of its registers where it has registers."""


def protocols(config: SimConfig, device: str) -> Mapping[str, str]:
    """Return the device's links with the protocol of each; empty: the simulator has none for it.

    The only link of a device is called ``""``. ConfigError where a profile cannot be read.
    """
    links = find_device(config, device).links[getattr(getattr(config, device), "kind", "")]
    return {link: _profiled(config, device, name) if name in PROFILED else name for link, name in links.items()}


def _profiled(config: SimConfig, device: str, kind: str) -> str:
    """Return the protocol that the profile of a device names."""
    raw = SimDeviceProfile.read(config.resolve(getattr(config, device).profile)).raw
    if "lines" in raw:
        return "numbered lines" if raw["lines"].get("framing") == "numbered" else "lines"
    return PROFILED[kind]


def require_possible(config: SimConfig) -> None:
    """ConfigError, one line for each fault that the device or the link of its section cannot have."""
    lines = [
        config.source.error(("fault", number, key), problem)
        for number, fault in enumerate(config.fault)
        for key, problem in _problems(config, fault)
    ]
    if lines:
        raise ConfigError("\n".join(lines))


def _problems(config: SimConfig, fault: FaultSection) -> Iterator[tuple[str, str]]:
    """Return (key, problem)."""
    if getattr(config, fault.device) is None:
        yield "device", f"there is no {fault.device} in this cell; add [{fault.device}], or remove the fault"
        return
    if fault.what in (*STATES, *PANEL):
        can = find_device(config, fault.device).faults
        if fault.what not in can:
            yield "what", f"the {fault.device} cannot {fault.what}; it can {', '.join(can) or 'do none of that kind'}"
        if not fault.reported and config.robot.kind == "linuxcnc":
            yield "reported", "a real LinuxCNC reports its feed override. Remove the key, or use stand"
        return
    links = protocols(config, fault.device)
    if not links:
        yield "device", "a real LinuxCNC has a link without faults. Cut the link outside, or set another kind"
    elif fault.link and fault.link not in links:
        yield "link", f"this {fault.device} has no named links. Remove the key"
    elif fault.what in {"wrong_unit", "exception"}:
        meant = [name for link, name in links.items() if fault.link in {"", link}]
        if not any(getattr(PROTOCOLS[name], fault.what) for name in meant):
            yield "what", f"{' and '.join(meant)} has no {fault.what.replace('_', ' ')}; use garble or drop"


# Speed override of a simulated robot, as the faults of its script set it.


@dataclass(slots=True)
class SpeedOverride:
    """Fraction of the programmed speed at which the tool moves, and the fraction that the controller reports."""

    _acting: list[tuple[FaultSection, float]] = field(default_factory=list)
    """Faults that act, with the time (time.monotonic) of their begin."""

    def suffer(self, fault: FaultSection, on: bool) -> None:
        """Begin or end a fault. After the end the tool continues at the programmed speed."""
        if on:
            self._acting.append((fault, time.monotonic()))
        else:
            self._acting = [(other, begun_s) for other, begun_s in self._acting if other is not fault]

    def actual(self, now_s: float) -> float:
        """Fraction at which the tool moves; 0: it is at standstill."""
        return 0.0 if self.stands else self._product(now_s, [*self._acting])

    def reported(self, now_s: float) -> float:
        """Fraction that the controller reports: unchanged by ``stand`` and by an override with ``reported = false``."""
        return self._product(now_s, [(fault, begun_s) for fault, begun_s in self._acting if fault.reported])

    @property
    def stands(self) -> bool:
        """The tool is at standstill, and the controller reports that it runs."""
        return any(fault.what == "stand" for fault, _ in self._acting)

    def _product(self, now_s: float, acting: list[tuple[FaultSection, float]]) -> float:
        return math.prod(_fraction(fault, now_s - begun_s) for fault, begun_s in acting)


def _fraction(fault: FaultSection, since_s: float) -> float:
    if fault.percent is None:
        return 1.0
    share = min(max(since_s / fault.ramp_s, 0.0), 1.0) if fault.ramp_s else 1.0
    return 1.0 + (fault.percent / 100.0 - 1.0) * share
