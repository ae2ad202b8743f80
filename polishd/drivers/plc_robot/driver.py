"""Driver of a robot whose controller loads files and has variables named in a profile."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import replace
from typing import Literal

from polishd.api import (
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    LinkError,
    Plan,
    RobotTimes,
)
from polishd.config.controller_profile import CommandVariable, ControllerProfile, Value, Variable
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
from polishd.drivers.transport.background import PeriodicTimer
from polishd.drivers.transport.file_delivery import Delivery
from polishd.drivers.transport.program_robot import IsWanted, ProgramRobot
from polishd.drivers.transport.program_tracker import STANDS, START_S, PollingConnection

# The polled link to the controller: reports its state, and resets commands.

OPEN_S = 10.0
"""Longest time to open: imports a library, checks certificates."""
BEATS = 1 << 15

OrderName = Literal["start", "reset", "load"]


class PlcPoller(PollingConnection[Variables, ControllerReport]):
    """Polled variables of a controller. Resets commands and writes heartbeats between two readings."""

    def __init__(
        self,
        name: str,
        make: Callable[[], Variables],
        profile: ControllerProfile,
        on_snapshot: Callable[[ControllerReport], Awaitable[None]],
    ) -> None:
        super().__init__(name, OPEN_S, on_snapshot)
        self._make = make
        self._profile = profile
        self._look_s = profile.look_ms / 1e3
        self._began: tuple[float, float] | None = None
        """Time of the first reading on the controller's clock, and on the daemon's."""
        self._looked_s = 0.0
        self._pulses: dict[OrderName, float] = {}
        """Commands that are set, each with its time."""
        self._taken_back: dict[OrderName, int] = {}
        """Number of the reading at which a command was reset."""
        self._beaten_s = self._changed_s = 0.0
        self._beats = 0

    @property
    def pace(self) -> float:
        """Rate of the controller's clock since the first reading: 1, except for a simulated controller.

        Two successive readings are not enough: the controller may update its clock twice between them, or not at all.
        """
        if self._began is None or len(self._recent) < STANDS:
            return 1.0
        return (self.last.time_s - self._began[0]) / max(self._looked_s - self._began[1], 1e-3)

    async def _connect(self) -> Variables:
        variables = self._make()
        try:
            await variables.open()
        except BaseException:
            await variables.close()
            raise
        self._beaten_s = self._changed_s = time.monotonic()
        return variables

    async def _disconnect(self, link: Variables) -> None:
        self._began = None
        self._pulses.clear()
        self._taken_back.clear()
        await link.close()

    def _stands(self, recent: Sequence[ControllerReport]) -> bool:
        return all(report.stands_still for report in recent)

    async def _snapshots(self, link: Variables) -> AsyncIterator[ControllerReport]:
        timer = PeriodicTimer(self._look_s)
        while True:
            report = report_of(self._profile.variables, await link.read())
            self._check_alive(report)
            yield report
            await self._beat(link)
            for name, since_s in list(self._pulses.items()):
                if time.monotonic() - since_s > self._profile.pulse_ms / 1e3:
                    await self._take_back(link, name)
            await timer.next()

    async def order(self, name: OrderName, still: Callable[[], bool] = lambda: True, *, release: bool = False) -> None:
        """Send a command, if it is ``still`` wanted in its turn; ``release``: reset hold with it.

        The controller acts on the rising edge: a command that is still set is waited for, and one that a lost link may
        have left set is reset first.
        """
        if name not in self._pulses and name not in self._taken_back:
            await self._take_back(self.link, name)
        await self.until(lambda: self.free(name))
        values: dict[str, Value] = {}
        if release and self._profile.variables.hold is not None:
            values["hold"] = self._profile.variables.hold.off
        variables = self.link
        values[name] = self._point(name).on
        if still():
            self._pulses[name] = time.monotonic()
            await variables.write(values)

    def free(self, name: OrderName) -> bool:
        """Whether the last such command was reset, and the controller has had the time to read it."""
        taken_back = self._taken_back.get(name)
        return name not in self._pulses and taken_back is not None and self.count >= taken_back + self.renewed

    async def write(self, name: str, value: Value) -> None:
        """Write a variable if the controller has it."""
        if getattr(self._profile.variables, name) is not None:
            await self.link.write({name: value})

    async def hold(self) -> None:
        """Set hold until the next command to run."""
        if self._profile.variables.hold is not None:
            await self.link.write({"hold": self._profile.variables.hold.on})

    @property
    def renewed(self) -> int:
        """Number of readings after which the controller has certainly updated its variables."""
        profile = self._profile
        return 2 + int((profile.report_ms + profile.link_ms) / 1e3 / self._look_s)

    def _check_alive(self, report: ControllerReport) -> None:
        """Raise LinkError if the controller was restarted, or its heartbeat stopped."""
        now_s = time.monotonic()
        last = self._recent[-1] if self._recent else report
        if report.session != last.session:
            raise LinkError(f"{self.name}: the controller has restarted (session {report.session})")
        if report.beat is None or report.beat != last.beat:
            self._changed_s = now_s
        if now_s - self._changed_s > self._profile.silence_s:
            raise LinkError(f"{self.name}: the controller's heartbeat has stopped")
        began_s, at_s = self._began or (report.time_s, now_s)
        self._began = began_s + min(report.time_s - last.time_s, 0.0), at_s  # a 32-bit clock begins again at its end
        self._looked_s = now_s

    async def _beat(self, link: Variables) -> None:
        now_s = time.monotonic()
        if self._profile.variables.heartbeat is None or now_s - self._beaten_s < self._profile.heartbeat_ms / 1e3:
            return
        self._beaten_s, self._beats = now_s, (self._beats + 1) % BEATS
        await link.write({"heartbeat": self._beats})

    async def _take_back(self, link: Variables, name: OrderName) -> None:
        self._pulses.pop(name, None)
        self._taken_back[name] = self.count
        order = self._point(name)
        if not order.takes_back:
            await link.write({name: order.off})

    def _point(self, name: OrderName) -> CommandVariable:
        point: Variable | None = getattr(self._profile.variables, name)
        if not isinstance(point, CommandVariable):
            raise DeviceFault(f"{self.name}: its profile has no variable {name}")
        return point


FULL = 0.005
"""Tolerance of the feed override's full value, share."""


class PlcRobot(ProgramRobot[PlcProgramTracker]):
    """A Robot over its controller's variables. A lost link stays lost until ``open``; only ``make_safe`` connects.

    It never switches the robot on and moves it only by a program: the operator does the rest.
    """

    def __init__(
        self,
        name: str,
        profile: ControllerProfile,
        make: Callable[[], Variables],
        delivery: Delivery,
        controller_dir: str = "",
    ) -> None:
        """``make`` returns a new, closed link; ``controller_dir`` is the controller's path before the file name."""
        super().__init__(name, times_of(profile))
        self.longest_line = profile.program.longest_line
        self._profile = profile
        self._make = make
        self._delivery = delivery
        self._path = controller_dir + profile.program.file
        self._poller = self._make_poller()
        self._session = ""
        """Session of the controller when the program was loaded."""

    @property
    def _connection(self) -> PlcPoller:
        return self._poller

    async def open(self) -> None:
        """See Device. Sends no command. Continues to track a program that ran when the link was lost, if possible."""
        await self.close()
        self._stay()
        await self._poller.open()
        tracker, session = self._tracker, await self._current_session()
        if tracker is not None and tracker.file is not None and session != self._session and not tracker.ended:
            tracker.drop("the controller has restarted")

    async def close(self) -> None:
        """See Device."""
        await self._poller.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        found = await self._poller.link.identify()
        return replace(found, vendor=found.vendor or self._profile.name, boot_id=await self._current_session())

    async def status(self) -> DeviceStatus:
        """See Device. Ready: no obstacle at the controller. Safe: the controller reports standstill."""
        why = self._obstacle()
        state = "/".join(sorted(self._poller.last.states))
        return DeviceStatus(ready=not why, safe=self._poller.stands, state=state, detail=why)

    async def _stop(self) -> None:
        await self._hold_and_reset(self._poller)

    async def _stop_anew(self) -> None:
        poller = self._make_poller()
        await poller.open()
        try:
            await self._hold_and_reset(poller)
        finally:
            await poller.close()

    async def hold(self) -> None:
        """See Robot. During a dwell the robot stands still; the dwell may continue."""
        self._poller.check()
        self._stay()
        if self._tracker is not None:
            self._tracker.stays = True
        await self._poller.hold()
        await self._poller.standstill("hold", self._times.stop_s, self._poller.renewed)

    def _make_poller(self) -> PlcPoller:
        return PlcPoller(self._name, self._make, self._profile, self._seen)

    def _override(self) -> float | None:
        return None if self._profile.variables.feed_override is None else self._poller.last.override

    def _moves(self) -> bool:
        return self._poller.last.running

    def _obstacle(self) -> str:
        report = self._poller.last
        if "fault" in report.states:
            return report.alarm or "the controller is in fault"
        if report.stopped_by:
            return report.stopped_by
        if abs(report.override - 1.0) > FULL:
            return f"the feed override is {100 * report.override:.5g} %, it must be 100 %"
        return ""

    async def _clear(self) -> None:
        """Reset alarms; refuse if one remains."""
        await self._reset(self._poller)
        if why := self._obstacle():
            raise DeviceRefused(f"{self._name}: {why}. Correct it at the controller, then try again.")

    def _track(self, plan: Plan, blocks: int) -> PlcProgramTracker:
        return PlcProgramTracker(plan, blocks)

    async def _load(self, plan: Plan, tracker: PlcProgramTracker) -> None:
        """Deliver the file, command the controller to load it, and confirm that it is loaded."""
        poller, variables = self._poller, self._profile.variables
        age_ms = self._profile.report_ms + (self._profile.link_ms if variables.clock is None else 0.0)
        report_s = age_ms / 1e3 * max(poller.pace, 1e-3)
        seconds = dwells_s(report_s, self._profile.program.dwell_step_s) if plan.approach_blocks else []
        file = PlcProgramFile(
            self._lines,
            self._stops(plan),
            self._profile.program,
            line=variables.line,
            proof_s=seconds,
            pause_at_end=not variables.state.done,
        )
        await self._delivery.put(self._profile.program.file, file.text)
        await poller.write("program", self._path)
        if variables.load is not None:
            await poller.order("load")
        await self._loads(poller)
        tracker.file = file
        varies_s = report_s if variables.clock is None else 0.0
        tracker.proof = LineCheck(file.proof, seconds, MORE_S * poller.pace, varies_s)
        tracker.start_s = START_S * poller.pace
        self._session = await self._current_session()

    async def _loads(self, poller: PlcPoller) -> None:
        """Wait until the controller has loaded the file."""
        after = poller.count + poller.renewed

        def done() -> bool:
            report = poller.last
            has = "ready" in report.states and report.loaded in (None, self._path)
            return poller.count >= after and ("fault" in report.states or has)

        seen = await poller.until(done, self._profile.load_s)
        if not seen or "fault" in poller.last.states:
            why = poller.last.alarm or ("the controller is in fault" if seen else "it does not report it as loaded")
            raise DeviceRefused(f"{self._name}: the controller refuses the program: {why}")

    async def _run(self, tracker: PlcProgramTracker, wanted: IsWanted) -> None:
        del tracker  # one command starts and continues
        poller = self._poller
        await poller.order("start", lambda: wanted(poller.last.time_s), release=True)

    async def _seen(self, report: ControllerReport) -> None:
        """Record the controller's state; continue from a stop that is not wanted."""
        if self._tracker is None:
            return
        self._tracker.update(report)
        if self._poller.free("start"):
            await self._pass_stops()

    async def _reset(self, poller: PlcPoller) -> None:
        if self._profile.variables.reset is None:
            return
        await poller.order("reset")
        after = poller.count + poller.renewed
        await poller.until(lambda: poller.count >= after)

    async def _hold_and_reset(self, poller: PlcPoller) -> None:
        await poller.hold()
        await poller.standstill("hold", self._times.stop_s, poller.renewed)
        await self._reset(poller)

    async def _current_session(self) -> str:
        """Return the identifier of the controller's run: its session variable, or the boot id of the link."""
        if self._profile.variables.session is not None:
            return self._poller.last.session
        return (await self._poller.link.identify()).boot_id


def times_of(profile: ControllerProfile) -> RobotTimes:
    """Return the times of such a controller."""
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
