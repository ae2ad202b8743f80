"""Variables over ADS. The only file that imports pyads. Its calls block, so they run in a thread, one at a time.

AdsLib keeps one route per controller for the whole process, always on TCP port 48898.
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
"""TCP port of every AMS router, shared by several programs for different machines."""
NOT_FOUND = (0x6, 0x7, 0x710, 0x716)
"""ADS errors for a missing port, machine, symbol or version."""
UNREADABLE = (LookupError, ValueError, struct.error)
"""Exceptions of pyads for an invalid answer: an unknown error number, undecodable text."""


class Ads:
    """Variables of the ADS device ``netid:port`` on ``host``. This computer's clock times the readings."""

    def __init__(self, host: str, netid: str, port: int, table: VariablesTable, silence_s: float) -> None:
        self._name = f"ads://{host}/{netid}:{port}"
        self._target = (netid, port, host)
        self._watched = watched(table)
        self._written = written(table)
        self._silence_s = silence_s
        self._thread: ThreadPoolExecutor | None = None
        self._connection: Any = None  # pyads is untyped
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
        """See Variables. ADS reports no serial number and no start time."""
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
        """Return the answer of a call. A call that is cancelled continues in its thread."""
        thread, connection = self._thread, self._connection
        if thread is None:
            raise LinkError(f"{self._name}: is not open")
        library = importlib.import_module("pyads")
        try:
            return await asyncio.wrap_future(thread.submit(work, connection))
        except library.ADSError as error:
            if error.err_code in NOT_FOUND:
                raise ProtocolError(f"{self._name}: {error}. Check the addresses in the profile.") from error
            raise LinkError(f"{self._name}: does not answer: {error}") from error
        except UNREADABLE as error:
            reason = f"{type(error).__name__}: {error}"
            raise ProtocolError(
                f"{self._name}: invalid answer ({reason}). Check which device has this address."
            ) from error
