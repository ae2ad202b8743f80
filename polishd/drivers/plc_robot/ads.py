"""Variables over ADS. The only file that knows pyads, whose calls block: they are made in a thread, one at a time.

AdsLib beneath it keeps one route a controller for the whole process, always on TCP port 48898.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import struct
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from polishd.api import DeviceIdentity, LinkError, ProtocolError
from polishd.config.controller_profile import Value, VariablesTable
from polishd.drivers.plc_robot.variables import VariableSnapshot, of_kind, watched, written
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import open_blocking
from polishd.drivers.transport.claims import claim_address
from polishd.util.address_claims import Claim

T = TypeVar("T")
CLOSE_S = 0.5
ROUTER_PORT = 48898
"""TCP port of every AMS router: several programs may reach different machines through one."""
NOT_FOUND = (0x6, 0x7, 0x710, 0x716)
"""Errors of ADS that say that there is nothing: port, machine, symbol, version."""
UNREADABLE = (LookupError, ValueError, struct.error)
"""What pyads raises over an answer that is none: a number of an error that no table has, text that is no text."""


class Ads:
    """A Variables of the ADS device ``netid:port`` behind ``host``. Readings are timed by this computer."""

    def __init__(self, host: str, netid: str, port: int, table: VariablesTable, silence_s: float) -> None:
        self._name = f"ads://{host}/{netid}:{port}"
        self._target = (netid, port, host)
        self._watched = watched(table)
        self._written = written(table)
        self._silence_s = silence_s
        self._thread: ThreadPoolExecutor | None = None
        self._connection: Any = None  # pyads has no types
        self._claimed = Claim()

    async def open(self) -> None:
        """See Variables."""
        await self.close()
        netid, port, host = self._target
        self._claimed = await claim_address(Tcp(host, ROUTER_PORT), part=f"{netid}:{port}")
        try:
            self._connection = await open_blocking(
                self._connect, lambda late: late.close(), self._silence_s, self._name
            )
            self._thread = ThreadPoolExecutor(1, thread_name_prefix="ads")
            points = {**self._watched, **self._written}
            addresses = [point.address for point in points.values()]
            await self._call(lambda plc: plc.read_list_by_name(addresses))
            await self.read()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Variables."""
        thread, self._thread = self._thread, None
        connection, self._connection = self._connection, None
        try:
            if thread is None:
                return
            closing = thread.submit(connection.close)
            thread.shutdown(wait=False)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_S + self._silence_s):
                    await asyncio.wrap_future(closing)
        finally:
            self._claimed.release()

    async def identify(self) -> DeviceIdentity:
        """See Variables. ADS tells no serial number and no start."""
        name, version = await self._call(lambda plc: plc.read_device_info())
        firmware = f"{version.version}.{version.revision}.{version.build}"
        return DeviceIdentity("", str(name), self._target[0], firmware)

    async def read(self) -> VariableSnapshot:
        """See Variables."""
        addresses = [point.address for point in self._watched.values()]
        asked_s = time.monotonic()
        found = await self._call(lambda plc: plc.read_list_by_name(addresses))
        now_s = (asked_s + time.monotonic()) / 2
        return VariableSnapshot(
            now_s,
            {name: of_kind(point.type, found[point.address], name) for name, point in self._watched.items()},
        )

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables."""
        typed = {
            self._written[name].address: of_kind(self._written[name].type, value, name)
            for name, value in values.items()
        }
        errors = await self._call(lambda plc: plc.write_list_by_name(typed))
        for address, error in errors.items():
            if error != "no error":
                raise ProtocolError(f"{self._name}: {address} cannot be written: {error}")

    def _connect(self) -> Any:
        library = importlib.import_module("pyads")
        connection = library.Connection(*self._target)
        try:
            connection.open()
        except (library.ADSError, OSError, RuntimeError) as error:
            raise LinkError(f"{self._name}: cannot be opened: {error}") from error
        connection.set_timeout(int(1e3 * self._silence_s))
        return connection

    async def _call(self, work: Callable[[Any], T]) -> T:
        """One call's answer. What has begun in the thread goes on there when nobody waits for it any more."""
        thread, connection = self._thread, self._connection
        if thread is None:
            raise LinkError(f"{self._name}: is not open")
        library = importlib.import_module("pyads")
        try:
            return await asyncio.wrap_future(thread.submit(work, connection))
        except library.ADSError as error:
            if error.err_code in NOT_FOUND:
                raise ProtocolError(f"{self._name}: {error}: look at the addresses in the profile") from error
            raise LinkError(f"{self._name}: answers no more: {error}") from error
        except UNREADABLE as error:
            told = f"{type(error).__name__}: {error}"
            raise ProtocolError(
                f"{self._name}: an answer that cannot be read ({told}); see what is on that wire"
            ) from error
