"""The robot behind LinuxCNC, over linuxcncrsh."""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
from pathlib import Path, PurePosixPath

from polishd.api import (
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    LinkError,
    Plan,
    ProtocolError,
    RobotTimes,
)
from polishd.drivers.linuxcnc.connection import SILENCE_S, RshConnection
from polishd.drivers.linuxcnc.dialogue import RshSnapshot
from polishd.drivers.linuxcnc.following import REPORT_S, RshPoller, abort, obstacle
from polishd.drivers.linuxcnc.program_file import LinuxCncProgramFile
from polishd.drivers.linuxcnc.watch import LinuxCncProgramTracker
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background
from polishd.drivers.transport.file_robot import FileRobot, Goes

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
