"""A device's wire between open and close: one request at a time, and when a lost link may be opened again."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeVar

from polishd.api import DeviceIdentity, LinkError, ProtocolError
from polishd.drivers.profiled.meaning import identity, state_of
from polishd.drivers.profiled.wire import ProfileTransport
from polishd.drivers.transport.requests import RequestQueue

T = TypeVar("T")


class RequestChannel:
    """Requests to a profile's device.

    A lost link is opened again by the next request only while the device is known to be at rest. Else all requests
    raise LinkError until ``open``; only urgent ones, which take it to rest, try to reach it again.
    """

    def __init__(self, wire: ProfileTransport, watchdog_s: float | None, at_rest: str) -> None:
        """``watchdog_s`` is told to the device after each opening; ``at_rest`` says what opens the link again."""
        self.wire = wire
        self.exposed = False
        """It may act: by the last reading, or by a command whose outcome is not known."""
        self._watchdog_s = watchdog_s
        self._at_rest = at_rest
        self._queue = RequestQueue(wire.name)
        self._lost = f"{wire.name}: the link was lost"
        """How the link was lost last: whoever asks next is told that, too."""

    @property
    def running(self) -> bool:
        """Between ``open`` and ``close``."""
        return self._queue.running

    async def start(self) -> None:
        """Serve requests; the wire is opened by the first of them."""
        await self.close()
        await self._queue.start()

    async def open(self, first: Callable[[], Awaitable[object]]) -> None:
        """Serve requests; the first of them shows that somebody answers."""
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
        return identity(self.wire.profile, await self.ask(lambda: self.wire.read(self.wire.profile.told)))

    async def ask(self, work: Callable[[], Awaitable[T]], *, urgent: bool = False) -> T:
        """Run ``work`` when it is its turn, on an open wire."""

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
        """See that it is this device before anything is written to it; then tell it how long it may hear nothing."""
        try:
            await self._recognise()
        except BaseException:
            await self.wire.disconnect()
            raise
        if self._watchdog_s is not None:
            await self.wire.order("watchdog", round(1000 * self._watchdog_s))

    async def _recognise(self) -> None:
        """ProtocolError where another device answers, by what is expected of it, or by a state that nobody knows."""
        profile = self.wire.profile
        values = await self.wire.read(profile.with_signs([*profile.polled, *(one.when for one in profile.expects)]))
        for one in profile.expects:
            if not one.holds(values[one.when]):
                said = f"{self.wire.name}: another device answers: its {one.when} reads {values[one.when]!r}"
                raise ProtocolError(f"{said}, which is not what profile {profile.name!r} expects")
        if profile.states and profile.kind != "force_sensor":
            try:
                state_of(profile, values)
            except ProtocolError as error:
                raise ProtocolError(f"{self.wire.name}: {error}") from None
