"""Cell in memory: test doubles of the ports that record their calls in one list, in time order.

Nothing waits for wall time. The robot executes a block when its reader asks for the next one, and the clock goes on by
the block's time then; readings of actuator and spindle let a little of the same time pass.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from polishd.daemon.cell.cell import Cell, Signals
from polishd.model.devices import (
    ActuatorTimes,
    DeviceIdentity,
    DeviceStatus,
    ExecutedBlock,
    ForceSample,
    LoaderTimes,
    MapRefusal,
    MonitorTimes,
    RobotProgress,
    RobotState,
    RobotTimes,
    SensedForce,
    SensorTimes,
    Signal,
    SignalLimits,
    SpeedSample,
    SpindleTimes,
)
from polishd.model.errors import DeviceRefused, LinkError
from polishd.model.program import Plan, Segment
from polishd.model.surface import SurfaceMap

SAMPLE_S = 0.005
"""Time by which each reading advances the fake clock."""


class ManualClock:
    """Clock that only the test advances."""

    def __init__(self) -> None:
        self.at_s = 0.0
        self._sleepers: list[tuple[float, asyncio.Future[None]]] = []

    def now_s(self) -> float:
        return self.at_s

    async def sleep(self, seconds: float) -> None:
        waiting: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._sleepers.append((self.at_s + seconds, waiting))
        await waiting

    async def until(self, at_s: float) -> None:
        """Advance the time while a caller waits for a motion; monitoring tasks run meanwhile."""
        while self.at_s < at_s:
            self.advance(SAMPLE_S)
            await asyncio.sleep(0)

    def advance(self, seconds: float) -> None:
        self.at_s += seconds
        for due_s, waiting in self._sleepers:
            if due_s <= self.at_s and not waiting.done():
                waiting.set_result(None)
        self._sleepers = [(due_s, waiting) for due_s, waiting in self._sleepers if not waiting.done()]


@dataclass
class Behaviour:
    """Misbehavior of a device by the name of the call: it raises, never answers, or does something first."""

    fails: dict[str, BaseException] = field(default_factory=dict)
    hangs: set[str] = field(default_factory=set)
    before: dict[str, Callable[[], object]] = field(default_factory=dict)


class FakeDevice:
    """Common part of all devices; every call is an event ``"<name>.<call>"``."""

    def __init__(self, name: str, events: list[str], clock: ManualClock) -> None:
        self.name = name
        self.events = events
        self.clock = clock
        self.acts = Behaviour()
        self.is_open = False
        self.status_reply = DeviceStatus(ready=True, safe=True, state="idle")

    async def did(self, call: str, detail: str = "") -> None:
        self.events.append(f"{self.name}.{call}{detail}")
        if call in self.acts.before:
            self.acts.before[call]()
        if call in self.acts.hangs:
            await asyncio.Event().wait()
        if call in self.acts.fails:
            raise self.acts.fails[call]

    async def open(self) -> None:
        await self.did("open")
        self.is_open = True

    async def close(self) -> None:
        self.is_open = False
        await self.did("close")

    async def identify(self) -> DeviceIdentity:
        await self.did("identify")
        return DeviceIdentity("fake", self.name, "1", "0")

    async def status(self) -> DeviceStatus:
        await self.did("status")
        return self.status_reply

    async def make_safe(self) -> None:
        await self.did("make_safe")


class FakeRobot(FakeDevice):
    """Robot that executes each block in ``block_s`` when its reader requests it."""

    def __init__(self, events: list[str], clock: ManualClock) -> None:
        super().__init__("robot", events, clock)
        self.times = RobotTimes()
        self.lifts = True
        self.block_s: float | Callable[[Segment], float] = 0.1
        self.boot_id = "boot-1"
        self.plan_sha256 = ""
        self.loaded: list[Segment] = []
        self.done = 0
        self.until: int | None = 0
        self.ends_at: int | None = None
        """Block at which the robot drops the program."""
        self.takes: int | None = None
        """Number of blocks after which the robot accepts no more."""
        self.stands = False
        """Whether the robot ignores commands to move."""
        self.lies = False
        """Whether the robot reports that it runs although it stands still."""
        self.override: float | None = None
        self.most_buffered_s = 0.0
        self.before_block: Callable[[], Awaitable[None]] = partial(asyncio.sleep, 0)
        """Called before each block; a feeding task can run meanwhile."""
        self._changed = asyncio.Event()

    async def prepare(self, plan: Plan) -> None:
        await self.did("prepare")
        self.plan_sha256, self.loaded, self.done, self.until = plan.program.sha256, [], 0, 0

    async def send(self, segments: Sequence[Segment]) -> None:
        await self.did("send", f" {segments[0].seq}-{segments[-1].seq}")
        if self.takes is not None and len(self.loaded) + len(segments) > self.takes:
            await asyncio.Event().wait()
        self.loaded += segments
        self.most_buffered_s = max(self.most_buffered_s, self.buffer_s)
        self._changed.set()

    async def progress(self) -> RobotProgress:
        if "progress" in self.acts.fails:  # no event: a robot is watched all the time
            raise self.acts.fails["progress"]
        if "progress" in self.acts.hangs:
            await asyncio.Event().wait()
        ended = "done" if self.done == self.ends_at else "running"
        state: RobotState = "held" if self._is_held() and not (self.stands and self.lies) else ended
        state_values = (
            self.plan_sha256,
            len(self.loaded),
            self.done,
            self.buffer_s,
            self.boot_id,
            "fake",
            self.override,
        )
        return RobotProgress(state, *state_values)

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        for seq in range(from_seq, self.done):
            yield ExecutedBlock(seq, float(seq), seq + 1.0)
        while self.done != self.ends_at:
            while self.done >= len(self.loaded) or self._is_held():
                self._changed.clear()
                await self._changed.wait()
            await self.before_block()
            block = self.loaded[self.done]
            seconds = self._seconds(block)
            begun_s = self.clock.at_s
            self.clock.advance(seconds)
            self.done += 1
            yield ExecutedBlock(block.seq, begun_s, begun_s + seconds)

    async def hold(self) -> None:
        await self.did("hold")
        self.until = self.done

    async def resume(self, until: int | None = None) -> None:
        await self.did("resume", f" {until}")
        self.until = until
        self._changed.set()

    async def lift(self, distance_mm: float) -> None:
        await self.did("lift", f" {distance_mm:g}")
        if not self.lifts:
            raise DeviceRefused("robot: cannot lift")
        self.until = self.done

    async def make_safe(self) -> None:
        self.until = self.done
        await super().make_safe()

    def _is_held(self) -> bool:
        return self.stands or (self.until is not None and self.done >= self.until)

    @property
    def buffer_s(self) -> float:
        ahead = self.loaded[self.done :]
        return sum(map(self.block_s, ahead)) if callable(self.block_s) else sum([self.block_s] * len(ahead))

    def _seconds(self, block: Segment) -> float:
        return self.block_s(block) if callable(self.block_s) else self.block_s


class FakeActuator(FakeDevice):
    """Actuator that lands and lifts in the fake clock's time; ``reads`` can replace its readings."""

    def __init__(self, events: list[str], clock: ManualClock) -> None:
        super().__init__("actuator", events, clock)
        self.times = ActuatorTimes()
        self.landing_s = 2.0
        self.lifting_s = 4.0
        self.force_n = 0.0
        self.retracted = True
        self.reads: Callable[[ForceSample], ForceSample] = lambda sample: sample
        self.silent = False
        self.ends = False
        self.touch_mm: Callable[[], float | None] = lambda: 5.0
        """Position at which the tool touches the part; None without a part."""
        self.position_mm = 0.0

    async def set_force(self, force_n: float) -> None:
        await self.did("set_force", f" {force_n:g}")
        if self.retracted and force_n:
            self.retracted = False
            touch_mm, begun_s = self.touch_mm(), self.clock.at_s
            while touch_mm is None or self.position_mm < touch_mm:
                self.position_mm = min(5.0 * (self.clock.at_s - begun_s) / self.landing_s, touch_mm or 10.0)
                await self.clock.until(self.clock.at_s + SAMPLE_S)
        self.force_n = force_n

    async def samples(self) -> AsyncIterator[ForceSample]:
        while not self.ends:
            if self.silent:
                await asyncio.Event().wait()
            touching = not self.retracted and self.force_n > 0
            position_mm = 0.0 if self.retracted else self.position_mm
            sample = ForceSample(self.clock.at_s, self.force_n, self.force_n, touching, self.retracted, 0, position_mm)
            yield self.reads(sample)
            self.clock.advance(SAMPLE_S)
            await asyncio.sleep(0)

    async def retract(self) -> None:
        await self.did("retract")
        await self._lift()

    async def make_safe(self) -> None:
        await super().make_safe()
        await self._lift()

    async def _lift(self) -> None:
        self.force_n = 0.0
        if not self.retracted:
            await self.clock.until(self.clock.at_s + self.lifting_s)
            self.retracted, self.position_mm = True, 0.0
            self.events.append("lifted")


class FakeForceSensor(FakeDevice):
    """Sensor of the actuator's true force; ``reads`` can replace its readings."""

    def __init__(self, events: list[str], clock: ManualClock, actuator: FakeActuator) -> None:
        super().__init__("force_sensor", events, clock)
        self.times = SensorTimes()
        self.reads: Callable[[SensedForce], SensedForce] = lambda reading: reading
        self.silent = False
        self._actuator = actuator

    async def tare(self) -> None:
        await self.did("tare")

    async def samples(self) -> AsyncIterator[SensedForce]:
        while True:
            if self.silent:
                await asyncio.Event().wait()
            acts = self._actuator.position_mm > 0 and not self._actuator.retracted
            yield self.reads(SensedForce(self.clock.at_s, self._actuator.force_n if acts else 0.0))
            await asyncio.sleep(0)


class FakeMonitor(FakeDevice):
    """Monitor that returns the present ``values``; each reading advances its clock."""

    def __init__(self, events: list[str], clock: ManualClock) -> None:
        super().__init__("monitor", events, clock)
        self.times = MonitorTimes()
        self.values: dict[str, float | bool | None] = {}
        self.silent = False
        self.fails: Exception | None = None

    async def signals(self) -> AsyncIterator[Signal]:
        while True:
            if self.silent:
                await asyncio.Event().wait()
            if self.fails is not None:
                raise self.fails
            for name, value in self.values.items():
                yield Signal(self.clock.at_s, name, value)
            await asyncio.sleep(0)


class FakeSpindle(FakeDevice):
    """Spindle that has its speed at once; ``reads`` can replace its readings."""

    def __init__(self, events: list[str], clock: ManualClock) -> None:
        super().__init__("spindle", events, clock)
        self.times = SpindleTimes()
        self.rpm = 0.0
        self.reads: Callable[[SpeedSample], SpeedSample] = lambda sample: sample
        self.silent = False
        self.ends = False

    async def set_speed(self, rpm: float) -> None:
        await self.did("set_speed", f" {rpm:g}")
        self.rpm = rpm

    async def samples(self) -> AsyncIterator[SpeedSample]:
        while not self.ends:
            if self.silent:
                await asyncio.Event().wait()
            yield self.reads(SpeedSample(self.clock.at_s, self.rpm, self.rpm))
            await asyncio.sleep(0)

    async def make_safe(self) -> None:
        await super().make_safe()
        self.rpm = 0.0


class FakeMetrology(FakeDevice):
    """Metrology that returns its maps one after another, or the result of ``measure`` at that moment."""

    def __init__(self, events: list[str], clock: ManualClock) -> None:
        super().__init__("metrology", events, clock)
        self.maps: list[SurfaceMap] = []
        self.measure: Callable[[], SurfaceMap] | None = None
        self.afters: list[str | None] = []
        self.refuses: list[MapRefusal] = []
        """Refusals before the next map."""
        self._listener: Callable[[MapRefusal], None] | None = None

    def on_refusal(self, listener: Callable[[MapRefusal], None] | None) -> None:
        self._listener = listener

    async def next_map(self, after: str | None) -> SurfaceMap:
        self.afters.append(after)
        while self.refuses and self._listener is not None:
            self._listener(self.refuses.pop(0))
        await self.did("next_map")
        if self.measure is not None:
            return self.measure()
        if not self.maps:
            raise LinkError("metrology: the test has no more maps")
        return self.maps.pop(0)


class FakePartLoader(FakeDevice):
    """Loader that changes parts at once; ``brings`` is a wrong part."""

    def __init__(self, events: list[str], clock: ManualClock) -> None:
        super().__init__("loader", events, clock)
        self.times = LoaderTimes()
        self.seat: str | None = None
        self.brings: dict[str, str] = {}

    async def loaded(self) -> str | None:
        return self.seat

    async def unload(self) -> None:
        await self.did("unload", f" {self.seat}")
        self.seat = None

    async def load(self, part_id: str) -> None:
        await self.did("load", f" {part_id}")
        self.seat = self.brings.get(part_id, part_id)


@dataclass
class FakeCell:
    """Devices of a cell with their shared clock and events."""

    events: list[str] = field(default_factory=list)
    clock: ManualClock = field(default_factory=ManualClock)

    def __post_init__(self) -> None:
        self.robot = FakeRobot(self.events, self.clock)
        self.actuator = FakeActuator(self.events, self.clock)
        self.spindle = FakeSpindle(self.events, self.clock)
        self.metrology = FakeMetrology(self.events, self.clock)
        self.loader = FakePartLoader(self.events, self.clock)
        self.force_sensor = FakeForceSensor(self.events, self.clock, self.actuator)
        self.monitor = FakeMonitor(self.events, self.clock)
        self.cell = Cell(self.devices, {name: name for name in self.devices}, self.clock, opened=set(self.devices))

    def with_loader(self) -> FakePartLoader:
        """Add a part loader and return it."""
        self.cell.devices = {**self.devices, "loader": self.loader}
        self.cell.opened.add("loader")
        self.cell.used = {**self.cell.used, "loader": "loader"}
        return self.loader

    def with_force_sensor(self) -> FakeForceSensor:
        """Add an independent force sensor and return it."""
        self.cell.devices = {**self.cell.devices, "force_sensor": self.force_sensor}
        self.cell.opened.add("force_sensor")
        self.cell.used = {**self.cell.used, "force_sensor": "force_sensor"}
        return self.force_sensor

    def with_monitor(
        self, *limits: SignalLimits, silence_s: float = 3600.0, **values: float | bool | None
    ) -> FakeMonitor:
        """Add a monitor with those values and their limits, and return it."""
        self.monitor.values = dict(values)
        self.cell.devices = {**self.cell.devices, "monitor": self.monitor}
        self.cell.opened.add("monitor")
        self.cell.signals = Signals(limits, {"monitor": silence_s})
        return self.monitor

    @property
    def devices(self) -> dict[str, FakeDevice]:
        return {device.name: device for device in (self.actuator, self.robot, self.spindle, self.metrology)}

    def of(self, *calls: str) -> list[str]:
        """Return these calls (``"robot.hold"``, or ``"make_safe"`` for every device's) in time order."""
        return [event for event in self.events if event.split()[0] in calls or event.split(".")[-1] in calls]


def blank(sample: ForceSample) -> ForceSample:
    """Return the reading of a tool that touches nothing."""
    return replace(sample, force_n=0.0, in_contact=False)
