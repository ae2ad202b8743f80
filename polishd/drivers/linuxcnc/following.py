"""A connection that is looked through all the time, so that what LinuxCNC does is known, and standstill seen."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

from polishd.api import DeviceFault, DeviceRefused, LinkError, RobotTimes
from polishd.drivers.linuxcnc.connection import RshConnection
from polishd.drivers.linuxcnc.dialogue import RshSnapshot
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background, Ready

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
