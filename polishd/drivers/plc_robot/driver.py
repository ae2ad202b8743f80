"""The robot whose controller loads files, whatever its variables are called."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Literal

from polishd.api import (
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    LinkError,
    Plan,
    ProtocolError,
    RobotTimes,
)
from polishd.config.controller_profile import CommandVariable, ControllerProfile, Value, Variable
from polishd.drivers.plc_robot.file_delivery import Delivery
from polishd.drivers.plc_robot.program_tracker import (
    MORE_S,
    ControllerReport,
    LineCheck,
    PlcProgramFile,
    PlcProgramTracker,
    dwells_s,
    report_of,
)
from polishd.drivers.plc_robot.variables import Variables
from polishd.drivers.transport.background import Background, PeriodicTimer, Ready
from polishd.drivers.transport.program_robot import FileRobot, Goes
from polishd.drivers.transport.program_tracker import START_S

# A link through which the controller is looked at all the time: what it does is known, orders are taken back.

OPEN_S = 10.0
"""A library is loaded, certificates are looked at."""
BEATS = 1 << 15

OrderName = Literal["start", "reset", "load"]
OnReport = Callable[[ControllerReport], Awaitable[None]]


class PlcPoller(Background):
    """From ``open`` to ``close``; may be opened again. Whoever waits hears of the link's end by LinkError."""

    def __init__(
        self, name: str, make: Callable[[], Variables], profile: ControllerProfile, on_report: OnReport
    ) -> None:
        super().__init__(name)
        self._make = make
        self._profile = profile
        self._on_report = on_report
        self._look_s = profile.look_ms / 1e3
        self._variables: Variables | None = None
        self._reports: tuple[ControllerReport, ...] = ()
        """The last two."""
        self._began: tuple[float, float] | None = None
        """The first look: when by the controller's clock, and when by ours."""
        self._looked_s = 0.0
        self.count = 0
        self._pulses: dict[OrderName, float] = {}
        """Orders that stand, and since when."""
        self._taken_back: dict[OrderName, int] = {}
        """At which look an order was taken back."""
        self._beaten_s = self._changed_s = 0.0
        self._beats = 0

    @property
    def variables(self) -> Variables:
        """LinkError while it is not open, or once it is lost."""
        if self._variables is None:
            raise LinkError(f"{self.name}: is not open")
        self.check()
        return self._variables

    @property
    def last(self) -> ControllerReport:
        """What the controller was doing last."""
        return self._reports[-1]

    @property
    def pace(self) -> float:
        """Seconds of the controller's clock in one of ours, since the first look: 1, but for a simulated controller.

        Two looks in a row tell it badly: the controller may have renewed its clock twice in between, or not at all.
        """
        if self._began is None or len(self._reports) < 2:
            return 1.0
        return (self.last.time_s - self._began[0]) / max(self._looked_s - self._began[1], 1e-3)

    async def open(self) -> None:
        """Connect, and look twice. Gives no order, but for the heartbeat."""
        variables = self._make()
        self._variables = variables
        try:
            await variables.open()
            self._beaten_s = self._changed_s = time.monotonic()
            await self.start(self._follow, OPEN_S)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Hang up; idempotent."""
        await self.stop()
        variables, self._variables = self._variables, None
        self._reports, self._began = (), None
        self._pulses.clear()
        self._taken_back.clear()
        if variables is not None:
            await variables.close()

    async def order(self, name: OrderName, still: Callable[[], bool] = lambda: True, *, release: bool = False) -> None:
        """Give an order, if it is ``still`` wanted when its turn comes; ``release``: let hold go with it.

        The controller acts as the order comes up: one that stands yet is waited for, and one that a lost link may have
        left standing is taken back first.
        """
        if name not in self._pulses and name not in self._taken_back:
            await self._take_back(name)
        await self.until(lambda: self.free(name))
        values: dict[str, Value] = {}
        if release and self._profile.variables.hold is not None:
            values["hold"] = self._profile.variables.hold.off
        variables = self.variables
        values[name] = self._point(name).on
        if still():
            self._pulses[name] = time.monotonic()
            await variables.write(values)

    def free(self, name: OrderName) -> bool:
        """The last such order was taken back, and the controller has had the time to see it."""
        taken_back = self._taken_back.get(name)
        return name not in self._pulses and taken_back is not None and self.count >= taken_back + self.renewed

    async def write(self, name: str, value: Value) -> None:
        """Write a variable, if the controller has it."""
        if getattr(self._profile.variables, name) is not None:
            await self.variables.write({name: value})

    async def hold(self) -> None:
        """Hold; it stays so until the next order to run."""
        if self._profile.variables.hold is not None:
            await self.variables.write({"hold": self._profile.variables.hold.on})

    async def standstill(self, within_s: float) -> None:
        """Seen by two reports that are later than now; DeviceFault otherwise."""
        after = self.count + self.renewed
        if not await self.until(lambda: self.count >= after and self.stands(), within_s):
            raise DeviceFault(f"{self.name}: goes on moving after hold")

    @property
    def renewed(self) -> int:
        """After so many looks the controller has renewed its variables for sure."""
        profile = self._profile
        return 2 + int((profile.report_ms + profile.link_ms) / 1e3 / self._look_s)

    def stands(self) -> bool:
        """Two reports in a row of a controller that does not run."""
        return len(self._reports) > 1 and all(report.stands for report in self._reports)

    async def _follow(self, ready: Ready) -> None:
        pace = PeriodicTimer(self._look_s)
        while True:
            report = report_of(self._profile.variables, await self.variables_now().read())
            self._take(report)
            await self._on_report(report)
            if len(self._reports) > 1:
                ready()
            self.fire()
            await self._beat()
            for name, since_s in list(self._pulses.items()):
                if time.monotonic() - since_s > self._profile.pulse_ms / 1e3:
                    await self._take_back(name)
            await pace.next()

    def variables_now(self) -> Variables:
        """Of the loop itself, which is not to look at whether it runs."""
        if self._variables is None:
            raise LinkError(f"{self.name}: is not open")
        return self._variables

    def _take(self, report: ControllerReport) -> None:
        now_s = time.monotonic()
        last = self._reports[-1] if self._reports else report
        if report.session != last.session:
            raise LinkError(f"{self.name}: the controller was started anew (session {report.session})")
        if report.beat is None or report.beat != last.beat:
            self._changed_s = now_s
        if now_s - self._changed_s > self._profile.silence_s:
            raise LinkError(f"{self.name}: the controller's heartbeat stands still")
        self._reports = (*self._reports[-1:], report)
        self._began = self._began or (report.time_s, now_s)
        self._looked_s = now_s
        self.count += 1

    async def _beat(self) -> None:
        now_s = time.monotonic()
        if self._profile.variables.heartbeat is None or now_s - self._beaten_s < self._profile.heartbeat_ms / 1e3:
            return
        self._beaten_s, self._beats = now_s, (self._beats + 1) % BEATS
        await self.variables_now().write({"heartbeat": self._beats})

    async def _take_back(self, name: OrderName) -> None:
        self._pulses.pop(name, None)
        self._taken_back[name] = self.count
        order = self._point(name)
        if not order.takes_back:
            await self.variables_now().write({name: order.off})

    def _point(self, name: OrderName) -> CommandVariable:
        point: Variable | None = getattr(self._profile.variables, name)
        if not isinstance(point, CommandVariable):
            raise DeviceFault(f"{self.name}: its profile has no variable {name}")
        return point


FULL = 0.005
"""How far the feed override may be off its full value, share."""


class PlcRobot(FileRobot[PlcProgramTracker]):
    """A Robot over its controller's variables. A lost link stays lost until ``open``; only ``make_safe`` connects.

    Never switches it on and never moves it but by a program: the rest is for the operator.
    """

    def __init__(
        self,
        name: str,
        profile: ControllerProfile,
        make: Callable[[], Variables],
        delivery: Delivery,
        controller_dir: str = "",
    ) -> None:
        """``make`` gives a new, closed link; the controller finds the file under ``controller_dir`` and its name."""
        super().__init__(name, times_of(profile))
        self.longest_line = profile.program.longest_line
        self._profile = profile
        self._make = make
        self._delivery = delivery
        self._path = controller_dir + profile.program.file
        self._following = self._follow()
        self._session = ""
        """The controller's, when the program was loaded."""

    @property
    def _background(self) -> Background:
        return self._following

    async def open(self) -> None:
        """See Device. Orders nothing. What ran when the link was lost is followed further, if it still can be."""
        await self.close()
        self._stay()
        await self._following.open()
        watch, session = self._watch, await self._current_session()
        if watch is not None and watch.file is not None and session != self._session and not watch.ended:
            watch.drop("the controller was started anew")

    async def close(self) -> None:
        """See Device."""
        await self._following.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        found = await self._following.variables.identify()
        return replace(found, vendor=found.vendor or self._profile.name, boot_id=await self._current_session())

    async def status(self) -> DeviceStatus:
        """See Device. Ready: nothing at the controller stands in the way. Safe: it stands, by its own word."""
        _ = self._following.variables
        why = self._obstacle(self._following.last)
        state = "/".join(sorted(self._following.last.states))
        return DeviceStatus(ready=not why, safe=self._following.stands(), state=state, detail=why)

    async def make_safe(self) -> None:
        """See Device. Holds and resets: what was under way is not gone on with. Connects for it if it has to."""
        self._stay()
        self._drop()
        if self._following.alive:
            with contextlib.suppress(LinkError, ProtocolError):
                return await self._end(self._following)
        following = self._follow()
        await following.open()
        try:
            await self._end(following)
        finally:
            await following.close()

    async def hold(self) -> None:
        """See Robot. Whether a dwell runs out meanwhile is the controller's affair: it stands."""
        _ = self._following.variables
        self._stay()
        if self._watch is not None:
            self._watch.stays = True
        await self._following.hold()
        await self._following.standstill(self._times.stop_s)

    async def resume(self, until: int | None = None) -> None:
        """See Robot. DeviceRefused while somebody at the controller holds it, or has changed its feed."""
        self._loaded()
        _ = self._following.variables
        if why := self._obstacle(self._following.last):
            raise DeviceRefused(f"{self._name}: {why}. To do: see to it at the controller, then try again")
        await super().resume(until)

    def _follow(self) -> PlcPoller:
        return PlcPoller(self._name, self._make, self._profile, self._seen)

    def _override(self) -> float | None:
        return None if self._profile.variables.feed_override is None else self._following.last.override

    def _moves(self) -> bool:
        return self._following.last.running

    def _obstacle(self, report: ControllerReport) -> str:
        """Why it would run nothing, or not as it should; empty where it would."""
        if "fault" in report.states:
            return report.alarm or "the controller is in fault"
        if report.stopped_by:
            return report.stopped_by
        if abs(report.override - 1.0) > FULL:
            return f"the feed override stands at {100 * report.override:.5g} %, and is to stand at 100 %"
        return ""

    async def _empty(self) -> None:
        """A reset also takes alarms back: what is left of them then is a reason to refuse."""
        await self._reset(self._following)
        if why := self._obstacle(self._following.last):
            raise DeviceRefused(f"{self._name}: {why}. To do: see to it at the controller, then try again")

    def _watched(self, plan: Plan, blocks: int) -> PlcProgramTracker:
        return PlcProgramTracker(plan, blocks)

    async def _load(self, plan: Plan, watch: PlcProgramTracker) -> None:
        """Hand the file over, have it loaded, and see that it is."""
        following, variables = self._following, self._profile.variables
        report_s = self._profile.report_ms / 1e3 * max(following.pace, 1e-3)
        seconds = dwells_s(report_s) if plan.approach_blocks else []
        file = PlcProgramFile(
            self._lines,
            self._stops(plan),
            self._profile.program,
            line=variables.line,
            proof_s=seconds,
            pause_at_end=not variables.state.done,
        )
        await self._delivery.put(self._profile.program.file, file.text)
        await following.write("program", self._path)
        if variables.load is not None:
            await following.order("load")
        await self._loads(following)
        watch.file = file
        watch.proof = LineCheck(file.proof, seconds, MORE_S * following.pace)
        watch.start_s = START_S * following.pace
        self._session = await self._current_session()

    async def _loads(self, following: PlcPoller) -> None:
        """It has the file, and waits for its start."""
        after = following.count + following.renewed

        def done() -> bool:
            report = following.last
            has = "ready" in report.states and report.loaded in (None, self._path)
            return following.count >= after and ("fault" in report.states or has)

        seen = await following.until(done, self._profile.load_s)
        if not seen or "fault" in following.last.states:
            why = following.last.alarm or ("no word that it is loaded" if not seen else "the controller is in fault")
            raise DeviceRefused(f"{self._name}: the controller does not take the program: {why}")

    async def _run(self, watch: PlcProgramTracker, goes: Goes) -> None:
        del watch  # one order starts it and lets it go on
        following = self._following
        await following.order("start", lambda: goes(following.last.time_s), release=True)

    async def _seen(self, report: ControllerReport) -> None:
        """What the controller does is booked; a stop that nobody asked for is passed."""
        if self._watch is None:
            return
        self._watch.update(report)
        if self._following.free("start"):
            await self._pass_stops()

    async def _reset(self, following: PlcPoller) -> None:
        if self._profile.variables.reset is None:
            return
        await following.order("reset")
        after = following.count + following.renewed
        await following.until(lambda: following.count >= after)

    async def _end(self, following: PlcPoller) -> None:
        await following.hold()
        await following.standstill(self._times.stop_s)
        await self._reset(following)

    async def _current_session(self) -> str:
        """What tells one run of the controller from another: its own variable, or what the link knows."""
        if self._profile.variables.session is not None:
            return self._following.last.session
        return (await self._following.variables.identify()).boot_id


def times_of(profile: ControllerProfile) -> RobotTimes:
    """What such a controller takes."""
    return RobotTimes(
        lifts=False,
        silence_s=profile.silence_s,
        watchdog_s=profile.watchdog_s or math.inf,
        stop_s=profile.stop_s,
        unseen_stop_s=profile.unseen_stop_s,
        block_end_s=profile.block_end_s,
        report_s=(profile.report_ms + profile.look_ms + profile.link_ms) / 1e3,
        keys=dict.fromkeys(("silence_s", "watchdog_s", "stop_s"), "profile"),
    )
