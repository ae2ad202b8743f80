"""Driver of a robot on LinuxCNC, over linuxcncrsh."""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
from pydantic import Field

from polishd.api import (
    DeviceContext,
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    DeviceType,
    OwnLines,
    Plan,
    RobotTimes,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.linuxcnc.protocol import SILENCE_S, RshConnection, RshSnapshot
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.program_robot import IsWanted, ProgramRobot
from polishd.drivers.transport.program_tracker import (
    PollingConnection,
    ProgramFile,
    ProgramTracker,
    comes_to_rest,
    time_shares,
)
from polishd.util.files import named_path, write_atomic

# The polled connection: it reports LinuxCNC's state and detects standstill.

LOOK_S = 0.005
"""Pause between polls while a program runs: LinuxCNC updates its state every [TASK] CYCLE_TIME, 1 to 10 ms."""
IDLE_LOOK_S = 0.02
REPORT_S = 0.05
"""Greatest age of a snapshot: LinuxCNC's CYCLE_TIME, the pause between polls, and the six answers of one poll."""
OPEN_S = 2.0


class RshPoller(PollingConnection[RshConnection, RshSnapshot]):
    """Polled connection to linuxcncrsh."""

    def __init__(
        self,
        address: Tcp,
        passwords: tuple[str, str],
        on_snapshot: Callable[[RshSnapshot], Awaitable[None]],
        times: RobotTimes,
    ) -> None:
        super().__init__(str(address), OPEN_S, on_snapshot)
        self._address, self._passwords, self._silence_s = address, passwords, times.silence_s
        self.is_program_running = False
        """Poll at the fast rate."""

    async def _connect(self) -> RshConnection:
        """Connect, take control and confirm it. DeviceBusy if another client has control."""
        connection = RshConnection(self._address, self._passwords, self._silence_s)
        await connection.open()
        try:
            await connection.control()
        except BaseException:
            await connection.close()
            raise
        return connection

    async def _disconnect(self, link: RshConnection) -> None:
        await link.close()

    async def _snapshots(self, link: RshConnection) -> AsyncIterator[RshSnapshot]:
        while True:
            yield await link.look()
            await asyncio.sleep(LOOK_S if self.is_program_running else IDLE_LOOK_S)

    def _stands(self, recent: Sequence[RshSnapshot]) -> bool:
        return not recent[-1].moved_since(recent[0]) and all(look.status != "running" for look in recent)


async def abort(connection: RshConnection, stop_s: float) -> None:
    """Abort. A machine that is off refuses the command, and stands still: DeviceRefused otherwise, after ``stop_s``.

    A client that took control meanwhile loses it; the gateway returns it after the end of this link.
    """
    deadline = time.monotonic() + stop_s
    while True:
        if await _aborted(connection, last_try=time.monotonic() > deadline):
            return
        await asyncio.sleep(LOOK_S)


async def _aborted(connection: RshConnection, *, last_try: bool) -> bool:
    """Whether the command was accepted, or is not needed."""
    try:
        await connection.control(anew=True)
        await connection.set("set abort", urgent=True)
    except DeviceRefused:
        if await obstacle(connection):
            return True
        if last_try:
            raise
        return False
    return True


def _moves(before: RshSnapshot, last: RshSnapshot) -> bool:
    return last.status != "idle" or last.moved_since(before)


async def obstacle(connection: RshConnection) -> str:
    """Return why LinuxCNC would not run a program; empty if it would."""
    if await connection.get("estop") != "OFF":
        return "LinuxCNC is in e-stop"
    if await connection.get("machine") != "ON":
        return "LinuxCNC is switched off"
    return ""


# The program file for LinuxCNC: the blocks, with pauses and messages that report progress.


class LinuxCncProgramFile(ProgramFile):
    """Blocks with a pause (``M0``) before each of ``stops``, and a message before each pause and the program's end.

    *Run from line* would lose G61/G64 and other queued state; a pause keeps all modal state. linuxcncrsh reports no
    line for a block without motion, and the same state for our pause and an operator's. The messages distinguish them.
    """

    def __init__(self, blocks: Sequence[bytes], stops: Iterable[int], token: str) -> None:
        self._token = token
        super().__init__(
            blocks, stops, lambda stop: [self._message(stop) + b" M0"], lambda _: [self._message(len(blocks))]
        )

    def reached(self, message: str) -> int | None:
        """Return the number of executed blocks in this operator message; None if it is not one of ours."""
        words = message.split()
        if len(words) == 3 and words[:2] == ["polishd", self._token] and words[2].isdecimal():
            return int(words[2])
        return None

    def write(self, folder: Path, name: str) -> Path:
        """Write the file atomically: temporary file, fsync, rename. DeviceRefused if that fails."""
        path = folder / name
        try:
            write_atomic(path, self.text)  # readable by all: LinuxCNC may be another user
        except OSError as error:
            raise DeviceRefused(f"{path}: {error.strerror or error}. Check [robot] program_dir.") from error
        return path

    def _message(self, executed: int) -> bytes:
        return f"(MSG,polishd {self._token} {executed})".encode()


# Progress of LinuxCNC in its file. Sans-IO: snapshots in, records of executed blocks out.

FASTEST = 2.5
"""Upper limit of the feed override's effect on the planned speed."""
SLACK_S = 0.25
"""Tolerance for the plan's times and for polls of a busy controller."""


class LinuxCncProgramTracker(ProgramTracker):
    """Tracker of one program from its load to its end.

    The end of a moving block is known to one poll. The blocks of one poll share its time: dwells share the time at
    rest in proportion to their programmed times. In a program that times its feed, the other blocks get no time.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        super().__init__(plan, blocks)
        self.file: LinuxCncProgramFile | None = None
        self._asked_s = np.zeros(blocks)
        timed = plan.program.block[plan.program.block < blocks]
        self._asked_s[timed] = plan.program.time_s[: len(timed)]
        self._dwells = plan.program.encoding == "dwell"
        self._rest_s = 0.0
        """Time of the last motion."""
        self._reached: int | None = None
        self._last: RshSnapshot | None = None

    def go(self, time_s: float, detail: str = "") -> None:
        """See ProgramTracker."""
        super().go(time_s, detail)
        self._reached = None

    def update(self, look: RshSnapshot) -> None:
        """Process a snapshot of LinuxCNC."""
        moved = self._last is not None and look.moved_since(self._last)
        self._last = look
        if self.file is None or self.ended:
            return
        if self.state != "running":
            self._update_while_held(look)
            return
        self.tick(look.time_s)
        if moved:
            self._rest_s = self.clock_s
        self._hear(self.file, look)
        if look.status == "idle":
            self._idle()
            return
        block = self.file.block_at(look.line)
        if self._can_be_at(block):
            self._advance(block)
        if look.status == "running":
            self.runs = True
        elif not moved:
            self._paused()

    def _can_be_at(self, block: int) -> bool:
        """Whether the motion can have reached this block: at its start LinuxCNC reports the line that it read last."""
        return self.expected_s(block) <= FASTEST * (self.clock_s - self.began_s) + SLACK_S

    def _update_while_held(self, look: RshSnapshot) -> None:
        """Handle a start by another client, or our message after the pause, when others were queued before it."""
        if not self.started or self.file is None:
            return
        if look.status == "running":
            self.go(look.time_s, "started at the controller")
        if self._hear(self.file, look) and look.status == "paused":
            self._paused()

    def _hear(self, file: LinuxCncProgramFile, look: RshSnapshot) -> bool:
        reached = file.reached(look.display)
        self._reached = self._reached if reached is None else reached
        return reached is not None

    def _idle(self) -> None:
        """The program has ended or not begun. The reported line is the last one read, far ahead of the motion."""
        if self._reached == self.blocks:
            self._advance(self.blocks)
            self.state, self.detail = "done", ""
        elif self.is_start_over:
            self.state, self.detail = "fault", "the program was ended at the controller"

    def _paused(self) -> None:
        if self._reached is not None:
            self._advance(self._reached)
            self.state, self.detail, self.held_at = "held", "", self._reached
        elif self.is_start_over:
            self.state, self.detail = "held", "paused"

    def _advance(self, to: int) -> None:
        """Record all blocks below ``to`` as executed."""
        first = len(self)
        if to <= first:
            return
        asked_s, took_s = self._asked_s[first:to], self.clock_s - self.began_s
        resting_s = self.clock_s - min(max(self._rest_s, self.began_s), self.clock_s)
        self.stretch(time_shares(took_s, asked_s, resting_s if self._dwells else took_s, asked_s <= 0.0))


VERIFY_S, VERIFY_LINE_S = 2.0, 5e-5
"""Time to interpret a line without motion: 100,000 lines take half a second."""
FILE_NAME = "polishd.ngc"
TIMES = RobotTimes(
    SILENCE_S,
    math.inf,
    2.0,
    lifts=False,
    block_end_s=REPORT_S / math.sqrt(12.0),  # the end is uniform within the age of a snapshot
    report_s=REPORT_S,
    reports_dwells=False,
)


class LinuxCnc(ProgramRobot[LinuxCncProgramTracker]):
    """A Robot over linuxcncrsh. A lost link stays lost until ``open``; only ``make_safe`` reconnects.

    It never switches the machine on and never homes it: the operator does that and watches it move.
    """

    longest_line = 252
    """Measured: the interpreter refuses a longer line."""

    def __init__(
        self,
        address: Tcp,
        program_dir: Path,
        times: RobotTimes | None = None,
        *,
        controller_dir: str = "",
        passwords: tuple[str, str] = ("EMC", "EMCTOO"),
    ) -> None:
        """``program_dir`` is the folder of the file; ``controller_dir`` is the controller's path of that folder."""
        super().__init__(str(address), times or TIMES)
        self._address = address
        self._folder = program_dir
        self._controller_dir = controller_dir or str(program_dir)
        self._passwords = passwords
        self._poller = RshPoller(address, passwords, self._seen, self._times)

    @property
    def _connection(self) -> RshPoller:
        return self._poller

    async def open(self) -> None:
        """See Device. Confirms control of LinuxCNC. Continues to track a program that ran when the link was lost."""
        await self.close()
        self._stay()
        await self._poller.open()

    async def close(self) -> None:
        """See Device."""
        await self._poller.close()

    async def identify(self) -> DeviceIdentity:
        """See Device. LinuxCNC has no serial number and no boot id; its configuration identifies the machine."""
        connection = self._poller.link
        name, _, version = connection.server.partition(" ")
        return DeviceIdentity("LinuxCNC", name, await connection.get("inifile"), version)

    async def status(self) -> DeviceStatus:
        """See Device. Ready: switched on. Safe: no program runs, and standstill."""
        why = await obstacle(self._poller.link)
        return DeviceStatus(ready=not why, safe=self._poller.stands, state=self._poller.last.status, detail=why)

    async def _stop(self) -> None:
        poller, stop_s = self._poller, self._times.stop_s
        await abort(poller.link, stop_s)
        if not await poller.until(lambda: poller.last.status == "idle", stop_s):  # a paused program stands, too
            raise DeviceFault(f"{self._name}: the program still runs {stop_s:g} s after abort. Stop it at LinuxCNC.")
        await poller.standstill("abort", stop_s)

    async def _stop_anew(self) -> None:
        connection = RshConnection(self._address, self._passwords, self._times.silence_s)
        await connection.open()
        try:
            await abort(connection, self._times.stop_s)
            if not await comes_to_rest(connection.look, _moves, LOOK_S, self._times.stop_s):
                raise DeviceFault(
                    f"{self._name}: still moving {self._times.stop_s:g} s after abort. Stop it at LinuxCNC."
                )
        finally:
            await connection.close()

    async def hold(self) -> None:
        """See Robot. A pause decelerates along the path. During G4 the robot stands still, and the dwell continues."""
        connection = self._poller.link
        self._stay()
        if self._running():
            await connection.control()
            await connection.set("set pause", urgent=True)
        await self._poller.standstill("pause", self._times.stop_s)

    def _override(self) -> float:
        return self._poller.last.override

    def _moves(self) -> bool:
        return self._poller.last.status == "running"

    async def _clear(self) -> None:
        connection = self._poller.link
        if why := await obstacle(connection):
            raise DeviceRefused(f"{self._address}: {why}. Switch LinuxCNC on and home it, then try again.")
        await connection.control()
        await connection.set("set abort")

    def _track(self, plan: Plan, blocks: int) -> LinuxCncProgramTracker:
        return LinuxCncProgramTracker(plan, blocks)

    async def _load(self, plan: Plan, tracker: LinuxCncProgramTracker) -> None:
        """Write the file, open it, and let LinuxCNC interpret it without motion."""
        connection = self._poller.link
        file = LinuxCncProgramFile(self._lines, self._stops(plan), secrets.token_hex(4))
        path = await asyncio.to_thread(file.write, self._folder, FILE_NAME)
        await connection.errors()
        await connection.set("set mode auto")
        await connection.set(f"set open {PurePosixPath(self._controller_dir) / path.name}")
        await connection.set("set run -1", within_s=VERIFY_S + VERIFY_LINE_S * tracker.blocks)
        await self._poller.standstill("interpreting the program", self._times.stop_s)  # until then no run
        if errors := await connection.errors():
            raise DeviceRefused(f"{self._address}: LinuxCNC refuses the program: {errors}")
        tracker.file = file

    async def _run(self, tracker: LinuxCncProgramTracker, wanted: IsWanted) -> None:
        connection = self._poller.link
        await connection.control()
        now = await connection.look()
        await connection.set_if(lambda: wanted(now.time_s), "set resume" if tracker.started else "set run")

    async def _seen(self, look: RshSnapshot) -> None:
        """Record what LinuxCNC does, and continue from a stop that is not wanted."""
        tracker = self._tracker
        if tracker is not None:
            was = tracker.state
            tracker.update(look)
            if tracker.state == "fault" != was:
                tracker.detail = await self._poller.link.errors() or tracker.detail
            await self._pass_stops()
        self._poller.is_program_running = tracker is not None and tracker.state == "running"


# The device type ``linuxcnc``: a robot behind LinuxCNC's linuxcncrsh (docs/protocols/linuxcnc.md).


class LinuxCncOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "linuxcnc"``."""

    address: str
    """``tcp://host:port`` of linuxcncrsh."""
    program_dir: str
    """Folder for programs that LinuxCNC can read."""
    controller_dir: str = ""
    """LinuxCNC's path of that folder, if LinuxCNC runs on another computer."""
    password: str = Field("EMC", pattern=r"^\S+$")
    """`--connectpw` of linuxcncrsh; no blanks."""
    enable_password: str = Field("EMCTOO", pattern=r"^\S+$")
    """`--enablepw` of linuxcncrsh; no blanks."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 0.6
    """Longest time without an answer; then the link is lost and contact is left. An idle computer answers in 0.1 s."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] | None = None
    """Time of a watchdog in HAL that pauses the program when the link is silent. Without one the program runs on."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 2.0
    """Longest time to stop."""


def _build(options: LinuxCncOptions, context: DeviceContext) -> LinuxCnc:
    address = tcp_address(options.address, context.base_dir, "linuxcnc")
    watchdog_s = options.watchdog_s or math.inf
    return LinuxCnc(
        address,
        named_path(context.base_dir, options.program_dir).absolute(),
        replace(TIMES, silence_s=options.silence_s, watchdog_s=watchdog_s, stop_s=options.stop_s),
        controller_dir=options.controller_dir,
        passwords=(options.password, options.enable_password),
    )


def _own_lines(_options: LinuxCncOptions, _context: DeviceContext) -> OwnLines:
    """The pauses before landings, and the end that the driver adds."""
    return OwnLines("LinuxCNC, which runs RS274", {}, ("M0", "M2"))


DEVICE_TYPES = [
    DeviceType(
        "linuxcnc",
        "robot",
        LinuxCncOptions,
        _build,
        own_lines=_own_lines,
        simulated_by="linuxcnc",
        simulation_speed=1.0,
        usual_address="tcp://robot-controller:5007",
    )
]
