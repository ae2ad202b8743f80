"""The robot whose controller loads files, whatever its variables are called."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import replace

from polishd.api import (
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    LinkError,
    Plan,
    ProtocolError,
    RobotTimes,
)
from polishd.config.controller_profile import ControllerProfile
from polishd.drivers.handover.delivery import Delivery
from polishd.drivers.handover.following import PlcPoller
from polishd.drivers.handover.program_file import PlcProgramFile
from polishd.drivers.handover.proof import MORE_S, LineCheck, dwells_s
from polishd.drivers.handover.report import ControllerReport
from polishd.drivers.handover.variables import Variables
from polishd.drivers.handover.watch import PlcProgramTracker
from polishd.drivers.transport.background import Background
from polishd.drivers.transport.file_robot import FileRobot, Goes
from polishd.drivers.transport.file_watch import START_S

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
