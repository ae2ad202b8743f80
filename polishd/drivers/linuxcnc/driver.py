"""The robot behind LinuxCNC, over linuxcncrsh."""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path, PurePosixPath

from polishd.api import (
    DeviceFault,
    DeviceRefused,
    DeviceStatus,
    Executed,
    Identity,
    LinkError,
    Plan,
    ProtocolError,
    RobotProgress,
    RobotTimes,
    Segment,
)
from polishd.drivers.linuxcnc.connection import Connection
from polishd.drivers.linuxcnc.dialogue import Snapshot
from polishd.drivers.linuxcnc.following import Following, abort, obstacle
from polishd.drivers.linuxcnc.program_file import ProgramFile
from polishd.drivers.linuxcnc.watch import Watch
from polishd.drivers.transport.address import Tcp

VERIFY_S, VERIFY_LINE_S = 2.0, 5e-5
"""Interpreting without moving answers when it is through: 100,000 lines take half a second."""
BLOCK_S = 0.01
"""What a block costs beyond its dwell, about."""
LONGEST_LINE = 252
"""Measured: the interpreter refuses a longer one."""
FILE_NAME = "polishd.ngc"


class LinuxCnc:
    """A Robot over linuxcncrsh. A lost link stays lost until ``open``; nothing but ``make_safe`` connects by itself.

    Never switches the machine on and never homes it: that is for the operator, who sees it move.
    """

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
        self._address = address
        self._folder = program_dir
        self._times = times or RobotTimes(watchdog_s=math.inf, stop_s=2.0, lifts=False)
        self._controller_dir = controller_dir or str(program_dir)
        self._passwords = passwords
        self._following = Following(address, passwords, self._seen, self._times.stop_s)
        self._plan: Plan | None = None
        self._lines: list[bytes] = []
        self._watch: Watch | None = None
        self._target: int | None = None
        """Blocks below it are to be run; None for all."""
        self._pending = False
        """Told to run before the program was complete."""
        self._stays = 0
        """How often it was told to stay: a start from before counts no more."""

    @property
    def times(self) -> RobotTimes:
        """See Robot."""
        return self._times

    @property
    def buffer_s(self) -> float:
        """See Robot. All that is left, once the controller has the file. 0 before, and while the link is down."""
        watch, plan = self._watch, self._plan
        if watch is None or plan is None or len(self._lines) < watch.blocks or not self._following.alive:
            return 0.0
        left_s = float(plan.expected_time_s[plan.program.block >= len(watch)].sum())
        return left_s + BLOCK_S * (watch.blocks - len(watch))

    async def open(self) -> None:
        """See Device. Takes no control of LinuxCNC. What ran when the link was lost is followed further."""
        await self.close()
        self._stay()
        await self._following.open()

    async def close(self) -> None:
        """See Device."""
        await self._following.close()

    async def identify(self) -> Identity:
        """See Device. LinuxCNC has no serial number and no boot id; its configuration stands for the machine."""
        connection = self._following.connection
        name, _, version = connection.server.partition(" ")
        return Identity("LinuxCNC", name, await connection.get("inifile"), version)

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
        connection = Connection(self._address, self._passwords)
        await connection.open()
        try:
            await abort(connection, self._times.stop_s)
        finally:
            await connection.close()

    async def prepare(self, plan: Plan) -> None:
        """See Robot. DeviceRefused while LinuxCNC runs a program, or is not ready to."""
        connection = self._following.connection
        if why := await obstacle(connection):
            raise DeviceRefused(f"{self._address}: {why}. To do: switch LinuxCNC on and home it, then try again")
        if self._running():
            raise DeviceRefused(f"{self._address}: a program is running; hold it first")
        await connection.control()
        await connection.set("set abort")
        self._plan, self._lines, self._target, self._pending = plan, [], None, False
        self._watch = Watch(plan, len(plan.segments) or len(plan.program.blocks))

    async def send(self, segments: Sequence[Segment]) -> None:
        """See Robot. With the last block the file is written and interpreted without motion.

        DeviceRefused where LinuxCNC cannot read it.
        """
        plan, watch = self._loaded()
        if any(segment.seq != segments[0].seq + at for at, segment in enumerate(segments)):
            raise DeviceRefused(f"{self._address}: blocks are not numbered one by one")
        new = [segment for segment in segments if segment.seq >= len(self._lines)]
        if not new:
            return
        if new[0].seq > len(self._lines):
            raise DeviceRefused(f"{self._address}: the robot expects block {len(self._lines)}, not {new[0].seq}")
        for segment in new:
            if b"\n" in segment.text or len(segment.text) > LONGEST_LINE:
                raise DeviceRefused(f"{self._address}: block {segment.seq} is no single line of {LONGEST_LINE} bytes")
        self._lines += [segment.text for segment in new]
        if len(self._lines) >= watch.blocks:
            await self._load(plan, watch)
            if self._pending:
                await self._start(plan, watch)

    async def progress(self) -> RobotProgress:
        """See Robot."""
        _ = self._following.connection
        if self._watch is None:
            return RobotProgress("running" if self._running() else "idle", "", 0, 0, 0.0)
        return self._watch.progress(len(self._lines), self.buffer_s)

    async def executed(self, from_seq: int = 0) -> AsyncIterator[Executed]:
        """See Robot. DeviceFault when LinuxCNC ends the program before its end."""
        _ = self._following.connection
        watch, seq = self._watch, from_seq
        while watch is not None:
            while seq < len(watch):
                yield watch[seq]
                seq += 1
            if watch is not self._watch or watch.ended:
                if watch.state == "fault":
                    raise DeviceFault(f"{self._address}: {watch.detail}")
                return
            await self._following.until(_news(watch))

    async def hold(self) -> None:
        """See Robot. A pause: it decelerates along the path. Inside G4 it stands anyway, and the dwell runs out."""
        connection = self._following.connection
        self._stay()
        if self._running():
            await connection.control()
            await connection.set("set pause", urgent=True)
        await self._following.standstill("pause")

    async def resume(self, until: int | None = None) -> None:
        """See Robot. Stops only where the file has a pause: at the plan's own stops, and the first ``until``."""
        plan, watch = self._loaded()
        if watch.ended:
            raise DeviceRefused(f"{self._address}: the program is over ({watch.state}: {watch.detail}); prepare one")
        _ = self._following.connection
        if until is not None and until <= len(watch):
            return
        if watch.started and watch.file is not None and until not in (None, *watch.file.stops, watch.blocks):
            stops = ", ".join(map(str, watch.file.stops))
            raise DeviceRefused(f"{self._address}: can stop at {stops}, not at block {until}: prepare it anew")
        self._target = until
        if len(self._lines) < watch.blocks:
            self._pending = True
            watch.state, watch.detail = "running", "waits for the rest of the program"
        elif watch.state != "running":
            await self._start(plan, watch)

    async def lift(self, distance_mm: float) -> None:
        """See Robot. Refused: LinuxCNC would have to stop first, with the tool on the part.

        It has the whole program, so that motion goes on along that until the actuator has let go by itself.
        """
        raise DeviceRefused(f"{self._address}: LinuxCNC cannot lift by {distance_mm:g} mm out of a running program")

    async def _load(self, plan: Plan, watch: Watch) -> None:
        """Write the file, open it, and have it interpreted without motion."""
        connection = self._following.connection
        stops = {plan.approach_blocks, plan.contact_blocks, self._target or 0}
        file = ProgramFile(self._lines, stops, secrets.token_hex(4))
        path = await asyncio.to_thread(file.write, self._folder, FILE_NAME)
        await connection.errors()
        await connection.set("set mode auto")
        await connection.set(f"set open {PurePosixPath(self._controller_dir) / path.name}")
        await connection.set("set run -1", within_s=VERIFY_S + VERIFY_LINE_S * watch.blocks)
        if errors := await connection.errors():
            raise DeviceRefused(f"{self._address}: LinuxCNC does not take the program: {errors}")
        watch.file = file

    async def _start(self, plan: Plan, watch: Watch) -> None:
        """From the beginning, or on from where it stands."""
        connection, stays = self._following.connection, self._stays
        self._pending = False
        if watch.file is None or (not watch.started and self._target not in (None, *watch.file.stops)):
            await self._load(plan, watch)
        await connection.control()
        now = await connection.look()

        def goes() -> bool:
            if stays == self._stays:
                watch.go(now.time_s)
            return stays == self._stays

        await connection.set_if(goes, "set resume" if watch.started else "set run")

    async def _seen(self, look: Snapshot) -> bool:
        """What LinuxCNC does is booked; a stop that nobody asked for is passed."""
        plan, watch = self._plan, self._watch
        if plan is None or watch is None:
            return False
        was = watch.state
        watch.update(look)
        if watch.state == "fault" != was:
            watch.detail = await self._following.connection.errors() or watch.detail
        at = watch.held_at
        if at is not None and not watch.dropped and (self._target is None or self._target > at):
            await self._start(plan, watch)
        return watch.state == "running"

    def _running(self) -> bool:
        return self._following.last.status == "running" or (self._watch is not None and self._watch.state == "running")

    def _stay(self) -> None:
        """Nothing is asked of it any more."""
        if self._pending and self._watch is not None:
            self._watch.state, self._watch.detail = "held", ""
        self._pending, self._target = False, 0
        self._stays += 1

    def _drop(self) -> None:
        if self._watch is not None and not self._watch.ended:
            self._watch.drop("aborted")
        self._following.fire()

    def _loaded(self) -> tuple[Plan, Watch]:
        if self._plan is None or self._watch is None:
            raise DeviceRefused(f"{self._address}: no program: prepare one first")
        return self._plan, self._watch


def _news(watch: Watch) -> Callable[[], bool]:
    """Tells whether anything was executed since now, or the program is over."""
    count = len(watch)
    return lambda: len(watch) > count or watch.ended
