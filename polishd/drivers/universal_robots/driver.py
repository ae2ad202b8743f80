"""The robot behind a Universal Robots controller: script up, RTDE for progress and orders, dashboard for the rest."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import Sequence
from dataclasses import dataclass

from polishd.api import (
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    LinkError,
    Plan,
    ProtocolError,
    RobotProgress,
    RobotTimes,
    Segment,
)
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background
from polishd.drivers.transport.claims import claim_address
from polishd.drivers.transport.program_robot import ProgramRobot
from polishd.drivers.universal_robots import dashboard
from polishd.drivers.universal_robots.link import RtdeConnection, ScriptCommand, ScriptInputs
from polishd.drivers.universal_robots.primary import ScriptUpload
from polishd.drivers.universal_robots.sample import RtdeSample, ScriptPhase, UrRuntimeState
from polishd.drivers.universal_robots.script import LONGEST_LINE, ScriptLine, Settings, assemble, blocks_of
from polishd.drivers.universal_robots.watch import LIVE, UrProgramTracker
from polishd.ports.address_claims import Claim

LOAD_S, LOAD_LINE_S = 5.0, 5e-4
"""A script begins so long after it was sent, at most."""
SOFT_SHARE = 0.5
"""Of the time for a stop, for the program to stop itself; then the dashboard stops it."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """The three servers of one controller that are used."""

    rtde: Tcp
    dashboard: Tcp
    primary: Tcp

    @classmethod
    def of(cls, host: str, rtde: int = 30004, dashboard: int = 29999, primary: int = 30001) -> Addresses:
        """On one host."""
        return cls(Tcp(host, rtde), Tcp(host, dashboard), Tcp(host, primary))


class UniversalRobot(ProgramRobot[UrProgramTracker]):
    """A Robot over RTDE. A lost link stays lost until ``open``; nothing but ``make_safe`` connects by itself.

    Never switches the robot on, releases no brake and unlocks no stop: that is for the operator, who stands there.
    """

    longest_line = LONGEST_LINE

    def __init__(self, addresses: Addresses, settings: Settings, times: RobotTimes, rate_hz: float = 125.0) -> None:
        super().__init__(addresses.rtde.host, times)
        self._addresses = addresses
        self._settings = settings
        self._link = RtdeConnection(addresses.rtde, rate_hz, settings.registers, times.silence_s)
        self._link.on_sample = self._seen
        self._blocks: list[ScriptLine] = []
        self._claimed: list[Claim] = []
        """On all of the controller's servers: those that are asked once are connected for that alone."""

    @property
    def _background(self) -> Background:
        return self._link

    @property
    def buffer_s(self) -> float:
        """See ProgramRobot. The program counts as there from when its script is sent."""
        return super().buffer_s if self._watch is not None and self._watch.token else 0.0

    async def open(self) -> None:
        """See Device. Gives no new order. What ran when the link was lost is followed further."""
        await self.close()
        self._stay()
        try:
            for address in (self._addresses.rtde, self._addresses.dashboard, self._addresses.primary):
                self._claimed.append(await claim_address(address))
            await self._link.open()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device."""
        await self._link.close()
        claimed, self._claimed = self._claimed, []
        for one in claimed:
            one.release()

    async def identify(self) -> DeviceIdentity:
        """See Device. Controllers from before 3.12 know neither model nor serial number."""
        self._link.check()
        model = await dashboard.ask(self._addresses.dashboard, "get robot model")
        serial = await dashboard.ask(self._addresses.dashboard, "get serial number")
        return DeviceIdentity("Universal Robots", model or "UR", serial or "unknown", self._link.controller)

    async def status(self) -> DeviceStatus:
        """See Device. Ready: it would take a program and run it as written. Safe: nothing runs and it stands."""
        sample = self._link.last
        why = sample.obstacle() or await self._not_remote()
        state = (
            UrRuntimeState(sample.runtime).name.lower()
            if sample.runtime in tuple(UrRuntimeState)
            else str(sample.runtime)
        )
        return DeviceStatus(ready=not why, safe=self._link.stands, state=state, detail=why)

    async def make_safe(self) -> None:
        """See Device. Ends whatever runs: what was under way is not gone on with. Connects for it if it has to."""
        self._stay()
        try:
            stopped = False
            if self._link.alive:
                with contextlib.suppress(LinkError, ProtocolError):
                    await self._stop_program()
                    stopped = True
            if not stopped:
                await dashboard.stop(self._addresses.dashboard, self._times.stop_s)
        finally:
            self._drop()

    async def prepare(self, plan: Plan) -> None:
        """See Robot. DeviceRefused while a program runs, or the robot would not run one as it is written."""
        why = self._link.last.obstacle() or await self._not_remote()
        if why:
            raise DeviceRefused(f"{self._name}: {why}. To do: see to it at the robot, then try again")
        if self._running():
            raise DeviceRefused(f"{self._name}: a program is running; hold it first")
        await self._stop_program()
        self._blocks = []
        self._announce(plan, UrProgramTracker)

    async def send(self, segments: Sequence[Segment]) -> None:
        """See Robot. With the last block the script is sent; it then waits before its first.

        DeviceRefused where it cannot be followed, or the controller cannot read it.
        """
        _, watch = self._loaded()
        if self._collect(segments):
            self._blocks = blocks_of(self._lines)
            await self._upload(watch)
            if self._pending:
                await self._go(watch)

    async def progress(self) -> RobotProgress:
        """See Robot."""
        _ = self._link.last
        return await super().progress()

    async def hold(self) -> None:
        """See Robot. The program brakes along the path and ends; it can be gone on with from where it stands."""
        _ = self._link.last
        self._stay()
        await self._stop_program()

    async def resume(self, until: int | None = None) -> None:
        """See Robot. Stops before any block; behind a hold what is left is sent anew."""
        _, watch = self._loaded()
        if watch.ended:
            raise DeviceRefused(f"{self._name}: the program is over ({watch.state}: {watch.detail}); prepare one")
        sample = self._link.last
        if until is not None and until <= len(watch):
            return
        if why := sample.obstacle():
            raise DeviceRefused(f"{self._name}: {why}")
        if self._waits(until):
            return
        if watch.live and sample.runtime in (UrRuntimeState.PAUSING, UrRuntimeState.PAUSED):
            raise DeviceRefused(f"{self._name}: it is paused at the controller: go on there, or prepare it anew")
        if not watch.live:
            await self._upload(watch)
        await self._go(watch)

    async def lift(self, distance_mm: float) -> None:
        """See Robot. Out of the motion, by a branch of our own program: so there must be one under way."""
        link, watch = self._link, self._watch
        if watch is None or not self._hears(link.last):
            raise DeviceRefused(f"{self._name}: no program of ours is under way that could lift")
        self._stay()
        await link.tell(ScriptInputs(watch.token, watch.until, ScriptCommand.LIFT, round(distance_mm * 1000.0)))
        await link.until(lambda: not self._hears(link.last) and link.last.phase != ScriptPhase.ENDS, self._times.stop_s)
        watch.drop("lifted off the path")
        if link.last.phase != ScriptPhase.LIFTED:
            raise DeviceFault(f"{self._name}: the robot does not lift: {link.last.obstacle() or 'no reason is told'}")
        await link.standstill("the lift", self._times.stop_s)

    async def _upload(self, watch: UrProgramTracker) -> None:
        """Send what is left of the program, and hear that it waits."""
        start = len(watch)
        token = secrets.randbelow((1 << 31) - 1) + 1
        script = assemble(self._blocks, start, watch.spent_s, token, self._settings)
        watch.sent(token, self._blocks)
        await self._link.tell(ScriptInputs(token))
        within_s = LOAD_S + LOAD_LINE_S * len(script.block_of)
        async with ScriptUpload(self._addresses.primary, script.text) as upload:

            def settled() -> bool:
                upload.check()
                return watch.live or upload.complaint is not None

            taken = await self._link.until(settled, within_s)
        if upload.complaint is not None:
            where, text = script.names(upload.complaint.line), upload.complaint.text
            raise DeviceRefused(f"{self._name}: the controller does not take {where}: {text}")
        if not taken:
            raise DeviceRefused(f"{self._name}: the controller did not start the script within {within_s:g} s")

    async def _go(self, watch: UrProgramTracker) -> None:
        """To the target."""
        self._pending = False
        watch.ordered(watch.blocks if self._target is None else self._target)
        await self._link.tell(ScriptInputs(watch.token, watch.until))

    async def _stop_program(self) -> None:
        """Ours by its own order, any other by the dashboard. Returns when nothing runs and the robot stands."""
        link, watch, stop_s = self._link, self._watch, self._times.stop_s
        if watch is not None and self._hears(link.last):
            await link.tell(ScriptInputs(watch.token, 0, ScriptCommand.STOP))
            await link.until(lambda: link.stands, SOFT_SHARE * stop_s)
        if link.last.runtime != UrRuntimeState.STOPPED:
            await dashboard.stop(self._addresses.dashboard, stop_s)
        await link.standstill("stop", stop_s)

    def _seen(self, sample: RtdeSample) -> None:
        """What the controller does is booked; a program that is over is fed no more."""
        watch = self._watch
        if watch is None:
            return
        watch.update(sample)
        if watch.heard and not (sample.token == watch.token and sample.phase in (*LIVE, ScriptPhase.ENDS)):
            self._link.orders = None

    def _hears(self, sample: RtdeSample) -> bool:
        """Our program is there to take orders."""
        ours = self._watch is not None and sample.token == self._watch.token and sample.phase in LIVE
        return ours and sample.runtime == UrRuntimeState.PLAYING

    async def _not_remote(self) -> str:
        remote = await dashboard.in_remote_control(self._addresses.dashboard)
        return "" if remote else "it is in local control: switch it to remote control at the pendant"

    def _override(self) -> float:
        return self._link.last.override

    def _running(self) -> bool:
        watch, sample = self._watch, self._link.last
        if watch is not None and watch.live:
            return watch.state == "running"
        return sample.plays

    def _drop(self) -> None:
        self._link.orders = None
        super()._drop()
