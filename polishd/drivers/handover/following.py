"""A link through which the controller is looked at all the time: what it does is known, orders are taken back."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Literal

from polishd.api import DeviceFault, LinkError
from polishd.config.controller_profile import CommandVariable, ControllerProfile, Value, Variable
from polishd.drivers.handover.report import ControllerReport, report_of
from polishd.drivers.handover.variables import Variables
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.pace import PeriodicTimer

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
