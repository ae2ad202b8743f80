"""The robot behind LinuxCNC, over linuxcncrsh."""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
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
    LinkError,
    OwnLines,
    Plan,
    ProtocolError,
    RobotTimes,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.linuxcnc.protocol import SILENCE_S, RshConnection, RshSnapshot
from polishd.drivers.transport import program_tracker
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.program_robot import FileRobot, Goes
from polishd.drivers.transport.program_tracker import FileProgramTracker
from polishd.model.surface import FloatArray
from polishd.util.files import write_atomic

# A connection that is looked through all the time, so that what LinuxCNC does is known, and standstill seen.

LOOK_S = 0.005
"""Between two looks while a program runs: LinuxCNC renews its own word every [TASK] CYCLE_TIME, 1 to 10 ms."""
IDLE_LOOK_S = 0.02
REPORT_S = 0.05
"""Greatest age of what a look tells: LinuxCNC's own CYCLE_TIME, the pause between looks, and the six answers of one."""
OPEN_S = 2.0

OnLook = Callable[[RshSnapshot], Awaitable[bool]]
"""Takes a look; tells whether the next one is urgent."""


class RshPoller(Background):
    """From ``open`` to ``close``; may be opened again. Whoever waits hears of the link's end by LinkError."""

    def __init__(self, address: Tcp, passwords: tuple[str, str], on_look: OnLook, times: RobotTimes) -> None:
        super().__init__(str(address))
        self._address = address
        self._passwords = passwords
        self._on_look = on_look
        self._silence_s, self._stop_s = times.silence_s, times.stop_s
        self._connection: RshConnection | None = None
        self._looks: tuple[RshSnapshot, ...] = ()
        """The last two."""
        self._count = 0

    @property
    def connection(self) -> RshConnection:
        """LinkError while it is not open, or once it is lost."""
        if self._connection is None:
            raise LinkError(f"{self._address}: is not open")
        self.check()
        return self._connection

    @property
    def last(self) -> RshSnapshot:
        """What LinuxCNC was doing last."""
        return self._looks[-1]

    async def open(self) -> None:
        """Connect, take control and prove it, and look twice. DeviceBusy where another client has control."""
        connection = RshConnection(self._address, self._passwords, self._silence_s)
        await connection.open()
        self._connection = connection
        try:
            await connection.control()
            await self.start(self._follow, OPEN_S)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Hang up; idempotent."""
        await self.stop()
        connection, self._connection = self._connection, None
        self._looks = ()
        if connection is not None:
            await connection.close()

    def stands(self) -> bool:
        """Two looks in a row at one place, and no program under way."""
        return (
            len(self._looks) > 1
            and not self._looks[1].moved_since(self._looks[0])
            and all(look.status != "running" for look in self._looks)
        )

    async def standstill(self, order: str) -> None:
        """Seen by two looks that are later than the order; DeviceFault otherwise."""
        count = self._count
        if not await self.until(lambda: self._count >= count + 2 and self.stands(), self._stop_s):
            raise DeviceFault(f"{self._address}: LinuxCNC goes on moving after {order}")

    async def _follow(self, ready: Ready) -> None:
        connection = self.connection
        while True:
            look = await connection.look()
            self._looks = (*self._looks[-1:], look)
            self._count += 1
            if len(self._looks) > 1:
                ready()
            urgent = await self._on_look(look)
            self.fire()
            await asyncio.sleep(LOOK_S if urgent else IDLE_LOOK_S)


async def abort(connection: RshConnection, stop_s: float) -> None:
    """Abort and see that it stands. A machine that is off refuses the order, and stands.

    A client that took control meanwhile loses it; the gate gives it back once the link that had it has ended.
    """
    deadline = time.monotonic() + stop_s
    while True:
        if await _aborted(connection, last_try=time.monotonic() > deadline):
            break
        await asyncio.sleep(LOOK_S)
    deadline = time.monotonic() + stop_s
    last = await connection.look()
    while time.monotonic() < deadline:
        await asyncio.sleep(LOOK_S)
        look = await connection.look()
        if look.status == "idle" and not look.moved_since(last):
            return
        last = look
    raise DeviceFault("LinuxCNC goes on moving after abort")


async def _aborted(connection: RshConnection, *, last_try: bool) -> bool:
    """Whether the order was taken, or is not needed."""
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


async def obstacle(connection: RshConnection) -> str:
    """Why LinuxCNC would run nothing; empty where it would."""
    if await connection.get("estop") != "OFF":
        return "LinuxCNC is in e-stop"
    if await connection.get("machine") != "ON":
        return "LinuxCNC is switched off"
    return ""


# The file that LinuxCNC runs: the program's blocks, with places to stand and words that tell how far it is.


class LinuxCncProgramFile(program_tracker.ProgramFile):
    """Blocks with a pause (``M0``) before each of ``stops``, and a message before each pause and the program's end.

    Run from line would lose G61/G64 and what else is queued; behind a pause all modal state is kept. linuxcncrsh shows
    no line of a block that does not move, and the same state for our pause and an operator's: hence the messages.
    """

    def __init__(self, blocks: Sequence[bytes], stops: Iterable[int], token: str) -> None:
        self._token = token
        super().__init__(
            blocks, stops, lambda stop: [self._message(stop) + b" M0"], lambda _: [self._message(len(blocks))]
        )

    def reached(self, message: str) -> int | None:
        """Number of blocks that are executed by this operator message; None where it is none of ours."""
        words = message.split()
        if len(words) == 3 and words[:2] == ["polishd", self._token] and words[2].isdecimal():
            return int(words[2])
        return None

    def write(self, folder: Path, name: str) -> Path:
        """Put it there whole: temp, fsync, rename. DeviceRefused where that fails."""
        path = folder / name
        try:
            write_atomic(path, self.text)  # readable by all: LinuxCNC may be another user
        except OSError as error:
            raise DeviceRefused(f"{path}: {error.strerror or error}. To do: look at [robot] program_dir") from error
        return path

    def _message(self, executed: int) -> bytes:
        return f"(MSG,polishd {self._token} {executed})".encode()


# How far LinuxCNC is in its file, and when it did what. Sans-IO: snapshots in, records out.

FASTEST = 2.5
"""More than any feed override makes of the planned speed."""
SLACK_S = 0.25
"""Of the plan, and of looks at a busy controller."""


class LinuxCncProgramTracker(FileProgramTracker):
    """One program from its load to its end.

    A block that moves is timed to one look. The blocks of one look share its time: those that dwell get what passed
    at rest, by the time they ask for; in a program that times its feed, the others get nothing.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        super().__init__(plan, blocks)
        self.file: LinuxCncProgramFile | None = None
        self._asked_s = np.zeros(blocks)
        timed = plan.program.block[plan.program.block < blocks]
        self._asked_s[timed] = plan.program.time_s[: len(timed)]
        self._dwells = plan.program.encoding == "dwell"
        self._rest_s = 0.0
        """When it last moved."""
        self._reached: int | None = None
        self._last: RshSnapshot | None = None

    def go(self, time_s: float, detail: str = "") -> None:
        """It runs, from that time of its own clock."""
        super().go(time_s, detail)
        self._reached = None

    def update(self, look: RshSnapshot) -> None:
        """Take what LinuxCNC was doing just now."""
        moved = self._last is not None and look.moved_since(self._last)
        self._last = look
        if self.file is None or self.ended:
            return
        if self.state != "running":
            self._told_while_held(look)
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
        """Whether its motion can be there by now: while it begins to move it reports the line that it has read last."""
        return self.expected_s(block) <= FASTEST * (self.clock_s - self.began_s) + SLACK_S

    def _told_while_held(self, look: RshSnapshot) -> None:
        """Somebody else starts it; or our message comes after the pause, since others stood before it."""
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
        """It ended, or has not begun. The line that it tells now is the one last read, far ahead of the motion."""
        if self._reached == self.blocks:
            self._advance(self.blocks)
            self.state, self.detail = "done", ""
        elif self.refuses:
            self.state, self.detail = "fault", "the program was ended at the controller"

    def _paused(self) -> None:
        if self._reached is not None:
            self._advance(self._reached)
            self.state, self.detail, self.held_at = "held", "", self._reached
        elif self.refuses:
            self.state, self.detail = "held", "paused"

    def _advance(self, to: int) -> None:
        """All blocks below ``to`` are executed by now."""
        first = len(self)
        if to <= first:
            return
        rest_s = min(max(self._rest_s, self.began_s), self.clock_s)
        shares = _shares(self._asked_s[first:to], self._dwells, rest_s - self.began_s, self.clock_s - rest_s)
        ends = np.minimum(self.began_s + np.cumsum(shares), self.clock_s)
        ends[-1] = self.clock_s
        self.record(ends.tolist())


def _shares(asked_s: FloatArray, dwells: bool, moving_s: float, resting_s: float) -> FloatArray:
    """What of the time in motion and at rest is each block's, (n,) s."""
    timed = asked_s > 0.0
    if timed.all() or not timed.any():
        weights = asked_s if timed.all() else np.ones(len(asked_s))
        return np.asarray((moving_s + resting_s) * weights / weights.sum())
    on_timed = resting_s if dwells else moving_s + resting_s
    shares = on_timed * asked_s / asked_s.sum()
    shares[~timed] = (moving_s + resting_s - on_timed) / np.count_nonzero(~timed)
    return np.asarray(shares)


VERIFY_S, VERIFY_LINE_S = 2.0, 5e-5
"""Interpreting without moving answers when it is through: 100,000 lines take half a second."""
FILE_NAME = "polishd.ngc"
TIMES = RobotTimes(
    SILENCE_S,
    math.inf,
    2.0,
    lifts=False,
    block_end_s=REPORT_S / math.sqrt(12.0),  # it ended at any time within the age of a look
    report_s=REPORT_S,
    reports_dwells=False,
)


class LinuxCnc(FileRobot[LinuxCncProgramTracker]):
    """A Robot over linuxcncrsh. A lost link stays lost until ``open``; nothing but ``make_safe`` connects by itself.

    Never switches the machine on and never homes it: that is for the operator, who sees it move.
    """

    longest_line = 252
    """Measured: the interpreter refuses a longer one."""

    def __init__(
        self,
        address: Tcp,
        program_dir: Path,
        times: RobotTimes | None = None,
        *,
        controller_dir: str = "",
        passwords: tuple[str, str] = ("EMC", "EMCTOO"),
    ) -> None:
        """``program_dir`` is where the file is written; ``controller_dir`` how the controller calls that folder."""
        super().__init__(str(address), times or TIMES)
        self._address = address
        self._folder = program_dir
        self._controller_dir = controller_dir or str(program_dir)
        self._passwords = passwords
        self._following = RshPoller(address, passwords, self._seen, self._times)

    @property
    def _background(self) -> Background:
        return self._following

    async def open(self) -> None:
        """See Device. Proves that it controls LinuxCNC. What ran when the link was lost is followed further."""
        await self.close()
        self._stay()
        await self._following.open()

    async def close(self) -> None:
        """See Device."""
        await self._following.close()

    async def identify(self) -> DeviceIdentity:
        """See Device. LinuxCNC has no serial number and no boot id; its configuration stands for the machine."""
        connection = self._following.connection
        name, _, version = connection.server.partition(" ")
        return DeviceIdentity("LinuxCNC", name, await connection.get("inifile"), version)

    async def status(self) -> DeviceStatus:
        """See Device. Ready: switched on. Safe: no program runs and it stands still."""
        why = await obstacle(self._following.connection)
        following = self._following
        return DeviceStatus(ready=not why, safe=following.stands(), state=following.last.status, detail=why)

    async def make_safe(self) -> None:
        """See Device. Aborts whatever runs: what was under way is not gone on with. Connects for it if it has to."""
        self._stay()
        self._drop()
        if self._following.alive:
            with contextlib.suppress(LinkError, ProtocolError):
                await abort(self._following.connection, self._times.stop_s)
                return await self._following.standstill("abort")
        connection = RshConnection(self._address, self._passwords, self._times.silence_s)
        await connection.open()
        try:
            await abort(connection, self._times.stop_s)
        finally:
            await connection.close()

    async def hold(self) -> None:
        """See Robot. A pause: it decelerates along the path. Inside G4 it stands anyway, and the dwell runs out."""
        connection = self._following.connection
        self._stay()
        if self._running():
            await connection.control()
            await connection.set("set pause", urgent=True)
        await self._following.standstill("pause")

    def _override(self) -> float:
        return self._following.last.override

    def _moves(self) -> bool:
        return self._following.last.status == "running"

    async def _empty(self) -> None:
        connection = self._following.connection
        if why := await obstacle(connection):
            raise DeviceRefused(f"{self._address}: {why}. To do: switch LinuxCNC on and home it, then try again")
        await connection.control()
        await connection.set("set abort")

    def _watched(self, plan: Plan, blocks: int) -> LinuxCncProgramTracker:
        return LinuxCncProgramTracker(plan, blocks)

    async def _load(self, plan: Plan, watch: LinuxCncProgramTracker) -> None:
        """Write the file, open it, and have it interpreted without motion."""
        connection = self._following.connection
        file = LinuxCncProgramFile(self._lines, self._stops(plan), secrets.token_hex(4))
        path = await asyncio.to_thread(file.write, self._folder, FILE_NAME)
        await connection.errors()
        await connection.set("set mode auto")
        await connection.set(f"set open {PurePosixPath(self._controller_dir) / path.name}")
        await connection.set("set run -1", within_s=VERIFY_S + VERIFY_LINE_S * watch.blocks)
        await self._following.standstill("interpreting the program")  # until then it refuses to run
        if errors := await connection.errors():
            raise DeviceRefused(f"{self._address}: LinuxCNC does not take the program: {errors}")
        watch.file = file

    async def _run(self, watch: LinuxCncProgramTracker, goes: Goes) -> None:
        connection = self._following.connection
        await connection.control()
        now = await connection.look()
        await connection.set_if(lambda: goes(now.time_s), "set resume" if watch.started else "set run")

    async def _seen(self, look: RshSnapshot) -> bool:
        """What LinuxCNC does is booked; a stop that nobody asked for is passed."""
        watch = self._watch
        if watch is None:
            return False
        was = watch.state
        watch.update(look)
        if watch.state == "fault" != was:
            watch.detail = await self._following.connection.errors() or watch.detail
        await self._pass_stops()
        return watch.state == "running"


# The device type ``linuxcnc``: a robot behind LinuxCNC's linuxcncrsh (docs/protocols/linuxcnc.md).


class LinuxCncOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "linuxcnc"``."""

    address: str
    """``tcp://host:port`` of linuxcncrsh."""
    program_dir: str
    """Folder that programs are written to, and that LinuxCNC can read."""
    controller_dir: str = ""
    """How LinuxCNC calls that folder, where it lies on another machine."""
    password: str = Field("EMC", pattern=r"^\S+$")
    """linuxcncrsh's `--connectpw`; no blanks."""
    enable_password: str = Field("EMCTOO", pattern=r"^\S+$")
    """linuxcncrsh's `--enablepw`; no blanks."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = 0.6
    """No answer for so long: the link is lost, and contact is left. On an idle computer it answers within 0.1 s."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] | None = None
    """Of a watchdog in HAL that pauses the program when nobody talks to it; without one it runs to the end."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 2.0
    """Longest that it takes to stop."""


def _build(options: LinuxCncOptions, context: DeviceContext) -> LinuxCnc:
    address = tcp_address(options.address, context.base_dir, "linuxcnc")
    watchdog_s = options.watchdog_s or math.inf
    return LinuxCnc(
        address,
        (context.base_dir / options.program_dir).absolute(),
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
