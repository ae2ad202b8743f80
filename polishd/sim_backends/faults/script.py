"""The faults of one device's process: which of them act now, and what becomes of a frame. Wall times are handed in."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polishd.config.simulator import FRAMES, STATES, FaultSection
from polishd.sim_backends.faults.protocols import PROTOCOLS
from polishd.sim_backends.truth import stream

TICK_S = 0.005


@dataclass(frozen=True, slots=True)
class LinkDirection:
    """One direction of one link."""

    link: str
    protocol: str
    direction: str


@dataclass(slots=True)
class FrameAction:
    """What becomes of a frame."""

    data: bytes
    """Empty: it is lost."""
    delay_s: float = 0.0
    """It comes late, and those behind wait for it."""
    late_s: float = 0.0
    """It alone comes late."""
    copies: int = 1
    byte_s: float = 0.0
    """Pause after each of its bytes."""


@dataclass(slots=True)
class ActiveFault:
    """A fault of the file, and how far it has come."""

    number: int
    """Its place in the file among all faults, from 1."""
    fault: FaultSection
    rng: np.random.Generator
    since_s: float
    """When waiting for it began."""
    begun_s: float | None = None
    over: bool = False
    frames: int = 0
    """That it has seen since."""

    @property
    def acts(self) -> bool:
        """It has begun, and is not over."""
        return self.begun_s is not None and not self.over

    @property
    def lasts(self) -> bool:
        """It is a state, and not a single blow."""
        fault = self.fault
        return bool(fault.for_s) or fault.rate is not None or fault.what in {"hang", *STATES}

    @property
    def always(self) -> bool:
        """While it acts, it acts on every frame: its begin and its end say all."""
        return self.lasts and self.fault.rate in {None, 1.0}

    def meets(self, way: LinkDirection) -> bool:
        """Frames of that way are its own."""
        return self.fault.link in {"", way.link} and self.fault.direction == way.direction

    def due(self, now_s: float, contact_s: float) -> bool:
        """It is time."""
        fault = self.fault
        if fault.contact_s is not None:
            return contact_s > fault.contact_s
        if fault.frame is not None:
            return self.frames >= fault.frame
        return now_s >= self.since_s + (fault.at_s or fault.every_s or 0.0)

    def ended(self, now_s: float) -> bool:
        """Its time is over."""
        return self.begun_s is not None and 0.0 < self.fault.for_s <= now_s - self.begun_s


@dataclass(slots=True)
class FaultScript:
    """All of them, in the order of the file."""

    device: str
    seed: int
    tell: Callable[..., None]
    """The witness: (event, **data)."""
    troubles: list[ActiveFault] = field(default_factory=list)
    suffer: Callable[[FaultSection, bool], None] = lambda _fault, _on: None
    """The device behind gets into that state, or out of it."""
    unplug: list[tuple[str, Callable[[], None], Callable[[], None]]] = field(default_factory=list)
    """(link, pull the plug, put it in again)."""
    reboot: Callable[[], None] = lambda: None
    contact_s: float = 0.0
    """Time in contact so far."""
    _pressed_s: float | None = None
    """Since when the tool presses; None: it does not."""
    _changed: asyncio.Event = field(default_factory=asyncio.Event)

    def set(self, faults: Iterable[FaultSection], now_s: float, *, rebooted: bool = False) -> None:
        """These from now on; a device that was just rebooted by one is not rebooted by it again."""
        self.finish(now_s)
        self.troubles = [
            ActiveFault(number, fault, stream(self.seed, f"{self.device} fault {number}"), now_s)
            for number, fault in enumerate(faults, 1)
            if fault.device == self.device and not (rebooted and fault.what == "reboot" and not fault.every_s)
        ]
        self.contact_s = 0.0
        self._changed.set()

    def finish(self, now_s: float) -> None:
        """Whatever acts ends."""
        for trouble in self.troubles:
            if trouble.acts and trouble.lasts:
                self._end(trouble, now_s)

    def feel(self, acting_n: float) -> None:
        """What acts between tool and part, as the plant says."""
        now_s = time.monotonic()
        self._count(now_s)
        self._pressed_s = now_s if acting_n > 0.0 else None

    async def run(self) -> None:
        """Begin and end what goes by time, for ever."""
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
        """What becomes of a frame that goes now."""
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
        """Nothing passes there."""
        return any(t.acts and t.fault.what == "hang" and t.fault.link in {"", link} for t in self.troubles)

    def _acted(self, trouble: ActiveFault, way: LinkDirection, now_s: float) -> None:
        if not trouble.always:
            self._tell("fault_acts", trouble, link=way.link or way.protocol, direction=way.direction)
        if not trouble.lasts:
            self._end(trouble, now_s)

    def _begin(self, trouble: ActiveFault, now_s: float) -> None:
        fault, trouble.begun_s = trouble.fault, now_s
        if trouble.lasts or fault.what not in FRAMES:
            self._tell("fault_begins", trouble)
        if fault.what in STATES:
            self.suffer(fault, True)
        elif fault.what == "reboot":
            self.reboot()
        elif fault.what == "unplug":
            for pull, _ in self._plugs(fault):
                pull()
            if not fault.for_s:
                self._end(trouble, now_s)

    def _end(self, trouble: ActiveFault, now_s: float) -> None:
        fault, again = trouble.fault, trouble.fault.every_s is not None
        if trouble.lasts:
            self._tell("fault_ends", trouble)
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

    def _tell(self, event: str, trouble: ActiveFault, **data: Any) -> None:
        self.tell(event, fault=trouble.number, what=trouble.fault.what, **data)


def _apply(trouble: ActiveFault, fate: FrameAction, way: LinkDirection) -> bool:
    """Whether it could be done to this frame."""
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
