"""Driver of an ABB robot by Robot Web Services 1.0 (IRC5) and 2.0 (OmniCore)."""

from __future__ import annotations

import asyncio
import contextlib
import re
import secrets
import ssl
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from polishd.api import (
    ConfigError,
    DeviceContext,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    DeviceType,
    LinkError,
    Plan,
    ProtocolError,
    RobotTimes,
    read_secret,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.abb_rws.program_tracker import AbbProgramTracker, RwsReport
from polishd.drivers.abb_rws.rapid_module import LONGEST_LINE, MODULE, assemble, rapid_lines
from polishd.drivers.abb_rws.services import CTRL_STATE, MODE, SPEED, Account, RwsServices, Symbol, Version
from polishd.drivers.transport.address import tcp_address
from polishd.drivers.transport.claims import claim_address
from polishd.drivers.transport.program_robot import IsWanted, ProgramRobot
from polishd.drivers.transport.program_tracker import PollingConnection
from polishd.util.address_claims import Claim
from polishd.util.files import SecretPlace, named_path

# The polled link to the controller.

OPEN_S = 5.0
SUBSCRIBED_S, POLLED_S = 0.2, 0.1
"""Period of the driver's requests: with a subscription, and without."""
HEARTBEATS = 4
"""Heartbeats in the time of the controller's watchdog."""
MOST_HEARTBEAT_S = 1.0
BEATS = 1 << 15
FULL = 0.005
"""Tolerance of the speed ratio's full value, share."""
STILL_DEG = 0.01
"""Change of a joint angle between two readings below which the robot stands."""
CLEAR_S = 2.0
"""Longest time for the background task to act."""
WATCH_MODULE = "polishd_watch"
_POS = re.compile(r"\[([^,\]]+),([^,\]]+),([^,\]]+)\]")


@dataclass(frozen=True, slots=True)
class Tasks:
    """Names in the controller."""

    motion: str = "T_ROB1"
    watch: str = "T_POLISHD"
    unit: str = "ROB_1"
    """Mechanical unit that the motion task moves."""

    def watched(self, name: str) -> Symbol:
        """Return a variable of the background task."""
        return Symbol(self.watch, WATCH_MODULE, name)

    def moved(self, name: str) -> Symbol:
        """Return a variable of the module that polishd loads."""
        return Symbol(self.motion, MODULE, name)


class RwsConnection(PollingConnection[RwsServices, RwsReport]):
    """One session with the controller: its reports, by events and requests, and polishd's heartbeat."""

    def __init__(
        self,
        account: Account,
        tasks: Tasks,
        times: RobotTimes,
        on_snapshot: Callable[[RwsReport], Awaitable[None]],
        *,
        subscribes: bool,
    ) -> None:
        super().__init__(str(account.address), OPEN_S, on_snapshot)
        self._account = account
        self._tasks = tasks
        self._times = times
        self._subscribes = subscribes
        self._period_s = SUBSCRIBED_S if subscribes else POLLED_S
        self._beat_s = min(times.watchdog_s / HEARTBEATS, MOST_HEARTBEAT_S)
        self._report = RwsReport(running=True)
        self._has_module = False
        self._beats = 0
        self._beaten_s = self._echoed_s = 0.0
        self._panel = 0
        self._joints: tuple[float, ...] | None = None
        """Of the last reading; None while a program runs."""
        self._orders = 0
        """Number of commands to run."""

    @property
    def has_watch(self) -> bool:
        """Whether the background task answers."""
        return self._echoed_s > 0.0

    async def follow_module(self, token: int) -> None:
        """Read the reports of the module that was loaded. DeviceRefused if the controller has another one."""
        self._has_module = True
        await self._read_counts(self.link)
        if self._report.token != token:
            raise DeviceRefused(f"{self.name}: the controller has not loaded the module. Check its event log.")
        if self._subscribes and self.link.events is None:
            await self.link.subscribe((self._tasks.moved("polishd_seen"),))

    def ordered(self) -> None:
        """Take the controller as running from now on, until it reports otherwise."""
        self._orders += 1
        self._report = replace(self._report, running=True, moved=True)

    async def _connect(self) -> RwsServices:
        services = RwsServices(self._account, self._times.silence_s)
        try:
            await services.open()
            self._report = RwsReport(
                running=await services.execution(),
                state=await services.panel(CTRL_STATE[services.version]),
                mode=await services.panel(MODE),
                speed=float(await services.panel(SPEED)) / 100.0,
            )
            self._joints = await services.joints(self._tasks.unit)
            self._echoed_s = self._beaten_s = 0.0
            self._has_module = False
            with contextlib.suppress(DeviceRefused):  # no such variable: ``prepare`` refuses
                await self._read_watch(services)
            with contextlib.suppress(DeviceRefused):  # no module of polishd yet
                await self._read_counts(services)
                self._has_module = True
                if self._subscribes:
                    await services.subscribe((self._tasks.moved("polishd_seen"),))
        except BaseException:
            await services.close()
            raise
        return services

    async def _disconnect(self, link: RwsServices) -> None:
        await link.close()

    def _stands(self, recent: Sequence[RwsReport]) -> bool:
        return not any(report.running for report in recent) and not recent[-1].moved

    async def _snapshots(self, link: RwsServices) -> AsyncIterator[RwsReport]:
        due_s = time.monotonic()
        while True:
            events = link.events
            if events is not None:
                events.check()
                for resource, value in events.take():
                    await self._event(link, resource, value)
                    yield self._report
            if time.monotonic() >= due_s:
                due_s = max(due_s + self._period_s, time.monotonic())
                await self._poll(link)
                yield self._report
            left_s = max(due_s - time.monotonic(), 0.0)
            events = link.events
            if events is None:
                await asyncio.sleep(left_s)
            else:
                await events.until(lambda events=events: bool(events.events), left_s)  # type: ignore[misc]

    async def _event(self, link: RwsServices, resource: str, value: str) -> None:
        """Take a report by its value. Any other event is a reason to read: events and answers have no common order."""
        if "polishd_seen" in resource:
            if value:
                self._take_count(value, is_event=True)
            else:
                self._take_count(await link.value(self._tasks.moved("polishd_seen")))
        elif "ctrlexecstate" in resource:
            await self._read_execution(link)
        else:
            await self._read_panel(link, resource)

    async def _poll(self, link: RwsServices) -> None:
        await self._read_execution(link)
        await self._read_motion(link)
        if self._has_module and link.events is None and self._report.running:
            await self._read_counts(link)
        await self._read_panel(link, (CTRL_STATE[link.version], MODE, SPEED)[self._panel])
        self._panel = (self._panel + 1) % 3
        if self.has_watch:
            await self._read_watch(link)
            await self._beat(link)

    async def _read_execution(self, link: RwsServices) -> None:
        """Read whether it runs. What a program that stands has reported, and why it may stand, is read after that."""
        orders = self._orders
        running = await link.execution()
        if not running and self._has_module:
            await self._read_counts(link)
        if not running and self._report.running:
            for resource in (CTRL_STATE[link.version], MODE):
                await self._read_panel(link, resource)
        if orders == self._orders:  # else it was read before the command to run
            self._report = replace(self._report, running=running)

    async def _read_motion(self, link: RwsServices) -> None:
        """Read whether the robot moves although no program runs: the execution state is not the motion's."""
        if self._report.running:
            self._joints = None
            self._report = replace(self._report, moved=True)
            return
        orders, before, self._joints = self._orders, self._joints, await link.joints(self._tasks.unit)
        moved = before is None or any(abs(a - b) > STILL_DEG for a, b in zip(before, self._joints, strict=True))
        if orders == self._orders:  # else it was read before the command to run
            self._report = replace(self._report, moved=moved)

    async def _read_panel(self, link: RwsServices, resource: str) -> None:
        if "opmode" in resource:
            mode = await link.panel(MODE)
            self._report = replace(self._report, mode=mode)
        elif "speedratio" in resource:
            speed = _number(await link.panel(SPEED)) / 100.0
            self._report = replace(self._report, speed=speed)
        else:
            state = await link.panel(CTRL_STATE[link.version])
            self._report = replace(self._report, state=state)

    async def _read_counts(self, link: RwsServices) -> None:
        stop = await link.value(self._tasks.moved("polishd_stop"))
        self._take_count(await link.value(self._tasks.moved("polishd_seen")))
        self._report = replace(self._report, stop=int(_number(stop)))

    def _take_count(self, text: str, *, is_event: bool = False) -> None:
        """Take the program's last report. An event counts only if it goes on from that: requests overtake it."""
        count, count_s, token = _pos(text)
        known = self._report
        if is_event and (int(token) != known.token or (count, count_s) <= (known.count, known.count_s)):
            return
        self._report = replace(known, count=int(count), count_s=count_s, token=int(token))

    async def _read_watch(self, link: RwsServices) -> None:
        """Read the background task's state. LinkError when it no longer follows the heartbeat."""
        echo, tripped, limit_s = _pos(await link.value(self._tasks.watched("polishd_state")))
        now_s = time.monotonic()
        if not self.has_watch or int(echo) == self._beats:
            self._echoed_s = now_s
        if now_s - self._echoed_s > self._times.silence_s + self._beat_s:
            raise LinkError(f"{self.name}: the background task {self._tasks.watch} does not follow the heartbeat")
        self._report = replace(self._report, tripped=bool(tripped), limit_s=limit_s)

    async def _beat(self, link: RwsServices) -> None:
        if time.monotonic() - self._beaten_s < self._beat_s:
            return
        self._beaten_s = time.monotonic()
        self._beats = self._beats % BEATS + 1
        await link.write(self._tasks.watched("polishd_heart"), str(self._beats))


def _pos(text: str) -> tuple[float, float, float]:
    match = _POS.fullmatch(text.replace(" ", ""))
    if match is None:
        raise ProtocolError(f"the value {text!r} is no RAPID pos")
    return _number(match[1]), _number(match[2]), _number(match[3])


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ProtocolError(f"the value {text!r} is no number") from None


class AbbRobot(ProgramRobot[AbbProgramTracker]):
    """A Robot whose controller runs RAPID. A lost link stays lost until ``open``; only ``make_safe`` reconnects.

    It never switches motors on or changes the mode: the operator does that at the robot.
    """

    longest_line = LONGEST_LINE

    def __init__(
        self,
        account: Account,
        times: RobotTimes,
        tasks: Tasks | None = None,
        *,
        home: str = "$HOME",
        subscribes: bool = True,
    ) -> None:
        super().__init__(str(account.address), times)
        self._account = account
        self._tasks = tasks or Tasks()
        self._file = f"{home}/{MODULE}.mod"
        self._subscribes = subscribes
        self._link = self._make_connection()
        self._claim = Claim()

    @property
    def _connection(self) -> RwsConnection:
        return self._link

    def _make_connection(self) -> RwsConnection:
        return RwsConnection(self._account, self._tasks, self._times, self._seen, subscribes=self._subscribes)

    async def open(self) -> None:
        """See Device. Writes nothing. Continues to track a program that ran when the link was lost."""
        await self.close()
        self._stay()
        self._claim = await claim_address(self._account.address)
        try:
            await self._link.open()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Device."""
        await self._link.close()
        self._claim.release()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        state = await self._link.link.get("/rw/system")
        name, version = str(state.get("name", "ABB")), str(state.get("rwversion", ""))
        return DeviceIdentity("ABB", name, str(state.get("sysid", "unknown")), f"RobotWare {version}")

    async def status(self) -> DeviceStatus:
        """See Device. Ready: it would run a program as written. Safe: no program runs, and standstill."""
        count = self._link.count + 1
        await self._link.until(lambda: self._link.count >= count)
        report, why = self._link.last, self._unready()
        state = f"{report.mode}/{report.state}/{'running' if report.running else 'stopped'}"
        return DeviceStatus(ready=not why, safe=self._link.stands, state=state, detail=why)

    async def hold(self) -> None:
        """See Robot. The robot stops on its path; ``resume`` continues from there."""
        self._link.check()
        self._stay()
        if self._tracker is not None:
            self._tracker.stays = True
        await self._stop()

    async def _clear(self) -> None:
        """Allow motion again after the background task stopped it; refuse if anything else prevents it."""
        link, services = self._link, self._link.link
        if not link.has_watch:
            raise DeviceRefused(
                f"{self._name}: the background task {self._tasks.watch} does not answer: the robot would run on when "
                "the link is lost. Install polishd_watch.mod (docs/protocols/abb_rws.md)."
            )
        if link.last.tripped:
            await services.write(self._tasks.watched("polishd_clear"), "1")
            await link.until(lambda: not link.last.tripped, CLEAR_S)
            await services.write(self._tasks.watched("polishd_clear"), "0")
        if why := self._unready():
            raise DeviceRefused(f"{self._name}: {why}. Correct it at the robot, then try again.")

    def _track(self, plan: Plan, blocks: int) -> AbbProgramTracker:
        return AbbProgramTracker(plan, blocks)

    async def _load(self, plan: Plan, tracker: AbbProgramTracker) -> None:
        """Upload the module, load it and arm the watchdog. DeviceRefused if the controller cannot read it."""
        services = self._link.link
        module = assemble(rapid_lines(self._lines), self._stops(plan), secrets.randbelow(1 << 20) + 1)
        content = module.text
        await services.upload(self._file, content)
        try:
            await services.load(self._tasks.motion, self._file, len(content))
        except DeviceRefused as refusal:
            raise DeviceRefused(f"{refusal}{_place(str(refusal), module.block_of)}. Check the program.") from None
        await self._arm(services)
        await self._link.follow_module(module.token)
        tracker.file, tracker.limit_s = module, self._times.watchdog_s

    async def _arm(self, services: RwsServices) -> None:
        """Write the watchdog's limit, and see that the background task uses it. DeviceRefused if it does not."""
        limit_s, link = self._times.watchdog_s, self._link
        await services.write(self._tasks.watched("polishd_limit"), f"{limit_s:g}")
        await link.until(lambda: not link.last.other_limit(limit_s), CLEAR_S)
        if why := link.last.other_limit(limit_s):
            raise DeviceRefused(f"{self._name}: {why}.")

    async def _run(self, tracker: AbbProgramTracker, wanted: IsWanted) -> None:
        del tracker  # one command starts and continues
        link = self._link

        def is_wanted() -> bool:
            is_so = wanted(link.last.count_s)
            if is_so:
                link.ordered()
            return is_so

        await link.link.start(is_wanted)

    async def _stop(self) -> None:
        await self._link.link.stop()
        await self._link.standstill("stop", self._times.stop_s)

    async def _stop_anew(self) -> None:
        connection = self._make_connection()
        await connection.open()
        try:
            await connection.link.stop()
            await connection.standstill("stop", self._times.stop_s)
        finally:
            await connection.close()

    async def _seen(self, report: RwsReport) -> None:
        """Record the controller's state; continue from a stop that is not wanted."""
        if self._tracker is None:
            return
        self._tracker.update(report)
        await self._pass_stops()

    def _obstacle(self) -> str:
        tracker = self._tracker
        is_armed = tracker is not None and tracker.file is not None
        return self._unready() or (self._link.last.other_limit(self._times.watchdog_s) if is_armed else "")

    def _unready(self) -> str:
        """Return why the controller would not run a program, before the watchdog is armed for one."""
        report = self._link.last
        if why := report.obstacle():
            return why
        if report.tripped:
            return "its background task has stopped the motion (prepare the program again)"
        if abs(report.speed - 1.0) > FULL:
            return f"the speed ratio is {100 * report.speed:.5g} %, it must be 100 %"
        return ""

    def _override(self) -> float:
        return self._link.last.speed

    def _moves(self) -> bool:
        return self._link.last.running


_LINE = re.compile(r"line (\d+)")


def _place(message: str, block_of: Sequence[int]) -> str:
    """Return the block of the line that the controller's message names."""
    match = _LINE.search(message)
    line = int(match[1]) if match is not None else 0
    block = block_of[line - 1] if 0 < line <= len(block_of) else -1
    return f" (block {block})" if block >= 0 else ""


# The device type ``abb_rws``: docs/protocols/abb_rws.md.

EVENT_S, REQUEST_S = 0.1, 0.05
"""Longest way of an event of high priority, and of an answer."""
FACTORY_PASSWORD = "robotics"  # noqa: S105 -- ABB publishes it as the default of every controller


class AbbRwsOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "abb_rws"``."""

    address: str
    """Address of the controller's Robot Web Services: ``tcp://host:80`` for 1.0, ``tcp://host:443`` for 2.0."""
    version: Version = "1.0"
    """Version of Robot Web Services: 1.0 of RobotWare 6 (IRC5), 2.0 of RobotWare 7 (OmniCore), which is encrypted."""
    user: str = "Default User"
    """User of the controller; it needs the grants to load modules, write variables, and start and stop."""
    password: SecretPlace | None = None
    """Password of that user; left out: the controller's default."""
    certificate: str = ""
    """Of 2.0: PEM file with the controller's certificate, or its issuer's; empty: any certificate is accepted."""
    task: str = "T_ROB1"
    """Motion task of the robot."""
    mechanical_unit: str = "ROB_1"
    """Mechanical unit that this task moves: its joint angles show whether the robot stands."""
    watch_task: str = "T_POLISHD"
    """Background task that runs ``polishd_watch.mod``."""
    home: str = "$HOME"
    """Folder of the controller for the module."""
    progress: Literal["subscription", "polling"] = "subscription"
    """How the controller's reports arrive: as events, or by a request every 0.1 s."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = 8.0
    """The controller's watchdog: after this time without a heartbeat its background task stops the motion."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 1.5
    """Longest time without an answer; then the link is lost and contact is left."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 5.0
    """Longest time to stop."""


def _build(options: AbbRwsOptions, context: DeviceContext) -> AbbRobot:
    address = tcp_address(options.address, context.base_dir, "abb_rws")
    password = FACTORY_PASSWORD if options.password is None else read_secret(options.password, context.base_dir)
    tls = tls_context(options.certificate, context.base_dir) if options.version == "2.0" else None
    subscribes = options.progress == "subscription"
    report_s = EVENT_S if subscribes else POLLED_S + 6 * REQUEST_S
    times = RobotTimes(options.silence_s, options.watchdog_s, options.stop_s, lifts=False, report_s=report_s)
    account = Account(address, options.version, options.user, password, tls)
    tasks = Tasks(options.task, options.watch_task, options.mechanical_unit)
    return AbbRobot(account, times, tasks, home=options.home, subscribes=subscribes)


def tls_context(certificate: str, base_dir: Path) -> ssl.SSLContext:
    """Return the settings of an encrypted link; without a certificate file any certificate is accepted."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False  # a controller's certificate names no address of the shop's network
    if not certificate:
        context.verify_mode = ssl.CERT_NONE
        return context
    path = named_path(base_dir, certificate)
    try:
        context.load_verify_locations(path)
    except OSError as error:  # ssl.SSLError too
        raise ConfigError(f"certificate {certificate!r} is no PEM certificate: {error}. Correct it.") from error
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


def _takes(blocks: Sequence[bytes]) -> str:
    """Return why the controller cannot run the blocks: it runs only RAPID."""
    try:
        rapid_lines(blocks)
    except DeviceRefused as refusal:
        return str(refusal)
    return ""


DEVICE_TYPES = [
    DeviceType(
        "abb_rws",
        "robot",
        AbbRwsOptions,
        _build,
        _takes,
        program_format="rapid",
        simulated_by="abb_rws",
        simulation_speed=4.0,
        usual_address="tcp://robot-controller:80",
    )
]
