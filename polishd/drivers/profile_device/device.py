"""Common base of profile devices: opening, closing, reading, and making safe."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Sequence
from typing import Generic, Protocol, TypeVar

from polishd.api import DeviceIdentity, DeviceRefused, LinkError, ProtocolError
from polishd.config.device_profile import DeviceProfile
from polishd.drivers.profile_device.codec import Values, identity, state_of
from polishd.drivers.transport.background import RequestQueue

# Requests and commands of a profile's device, independent of its link.


class ProfileTransport(Protocol):
    """Link to a profile's device, one request at a time. A call raises LinkError or ProtocolError; none is repeated."""

    profile: DeviceProfile

    @property
    def connected(self) -> bool:
        """False before ``connect``, and once answers can no longer be trusted."""
        ...

    @property
    def name(self) -> str:
        """Address, for messages."""
        ...

    async def connect(self) -> None:
        """Open the link; waits until no late answer to an earlier request can arrive."""
        ...

    async def disconnect(self) -> None:
        """Idempotent."""
        ...

    async def read(self, names: Sequence[str]) -> Values:
        """Read these values, in N, mm, rpm or ms; the result may contain others of the same answers."""
        ...

    async def order(self, name: str, asked: float = 0.0) -> None:
        """Write the steps of a command in order; a command that the profile does not have has no steps."""
        ...


# A device's link between open and close: one request at a time, and the rule for reopening a lost link.

T = TypeVar("T")


class RequestChannel:
    """Requests to a profile's device.

    The next request reopens a lost link only while the device is known to be at rest. Otherwise all requests raise
    LinkError until ``open``; only urgent ones, which bring the device to rest, reconnect.
    """

    def __init__(self, wire: ProfileTransport, watchdog_s: float | None, at_rest: str) -> None:
        """``watchdog_s`` is written to the device after each opening; ``at_rest`` says how to reopen the link."""
        self.wire = wire
        self.exposed = False
        """The device may act: by the last reading, or by a command with unknown outcome."""
        self._watchdog_s = watchdog_s
        self._at_rest = at_rest
        self._queue = RequestQueue(wire.name)
        self._lost = f"{wire.name}: the link was lost"
        """Reason of the last link loss, for the next request's error."""

    @property
    def running(self) -> bool:
        """Between ``open`` and ``close``."""
        return self._queue.running

    async def start(self) -> None:
        """Serve requests; the first one opens the link."""
        await self.close()
        await self._queue.start()

    async def open(self, first: Callable[[], Awaitable[object]]) -> None:
        """Serve requests, and send ``first`` to check that the device answers."""
        await self.start()
        self.exposed = False
        try:
            await self.ask(first)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Idempotent."""
        await self._queue.stop()
        await self.wire.disconnect()

    async def identify(self) -> DeviceIdentity:
        """Who is there."""
        return identity(self.wire.profile, await self.ask(lambda: self.wire.read(self.wire.profile.identifying)))

    async def ask(self, work: Callable[[], Awaitable[T]], *, urgent: bool = False) -> T:
        """Run ``work`` in its turn, on an open link."""

        async def connected() -> T:
            if not self.wire.connected:
                if self.exposed and not urgent:
                    raise LinkError(f"{self._lost}; {self._at_rest}")
                await self.wire.connect()
                if not urgent:
                    await self._greet()
            try:
                return await work()
            except LinkError as error:
                self._lost = str(error)
                raise

        return await self._queue.ask(connected, urgent=urgent)

    async def _greet(self) -> None:
        """Check that this is the expected device before any write; then write its watchdog time."""
        try:
            await self._recognise()
        except BaseException:
            await self.wire.disconnect()
            raise
        if self._watchdog_s is not None:
            await self.wire.order("watchdog", round(1000 * self._watchdog_s))

    async def _recognise(self) -> None:
        """Raise ProtocolError if another device answers: by its expected values, or by an unknown state."""
        profile = self.wire.profile
        try:
            values = await self.wire.read(profile.with_signs([*profile.polled, *(one.when for one in profile.expects)]))
        except DeviceRefused as error:
            hint = "is it another device?"
            raise (error if hint in str(error) else DeviceRefused(f"{error}; {hint}")) from None
        for one in profile.expects:
            if not one.holds(values[one.when]):
                said = f"{self.wire.name}: another device answers: its {one.when} reads {values[one.when]!r}"
                raise ProtocolError(f"{said}, which is not what profile {profile.name!r} expects")
        if profile.states and profile.kind != "force_sensor":
            try:
                state_of(profile, values)
            except ProtocolError as error:
                raise ProtocolError(f"{self.wire.name}: {error}") from None


ANSWERS_S = 2.0
"""Time of ``make_safe`` beyond the action: a link that is lost meanwhile is opened again once."""

R = TypeVar("R")


class ProfiledDevice(ABC, Generic[R, T]):
    """A device on a link: R is its reading, T are its times."""

    def __init__(self, wire: ProfileTransport, times: T, watchdog_s: float | None, at_rest: str) -> None:
        """See RequestChannel for ``watchdog_s`` and ``at_rest``."""
        self._wire = wire
        self._times = times
        self._link = RequestChannel(wire, watchdog_s, at_rest)

    @abstractmethod
    def _reading(self, values: Values) -> R:
        """Return the reading; ProtocolError for values that the profile does not have."""

    @property
    def times(self) -> T:
        """See the device's port."""
        return self._times

    async def open(self) -> None:
        """See Device. Also writes the watchdog time, if the profile has one."""
        await self._link.open(self._read)

    async def close(self) -> None:
        """See Device."""
        await self._link.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        return await self._link.identify()

    async def _rest(self, go: Callable[[], Awaitable[None]], within_s: float, what: str) -> None:
        """Bring the device to rest and confirm it; a link that is lost meanwhile is opened again once.

        ``what`` names the unconfirmed state in the LinkError after ``within_s``.
        """
        opened = self._link.running
        if not opened:
            await self._link.start()
        try:
            async with asyncio.timeout(within_s + ANSWERS_S):
                with contextlib.suppress(LinkError, ProtocolError):
                    return await go()
                return await go()
        except TimeoutError:
            raise LinkError(f"{self._wire.name}: could not confirm that {what}") from None
        finally:
            if not opened:
                await self.close()

    async def _read(self) -> R:
        values = await self._wire.read(self._wire.profile.polled)
        try:
            return self._reading(values)
        except ProtocolError as error:
            raise ProtocolError(f"{self._wire.name}: {error}") from None

    async def _beat(self) -> R:
        """Feed the device's watchdog, and read the device."""
        await self._wire.order("heartbeat")
        return await self._read()

    async def _clear(self, fault: int) -> None:
        """Clear a fault that the profile allows to clear; leave any other."""
        faults = self._wire.profile.faults
        if faults and fault and fault in faults.clears:
            await self._link.ask(lambda: self._wire.order("clear"), urgent=True)
