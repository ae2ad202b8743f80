"""CAN bus over python-can, read by our loop (its Notifier fails silently). The only file that imports python-can."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
from typing import Any

import can
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcand import SocketCanDaemonBus

from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress, Tcp
from polishd.drivers.transport.background import open_blocking
from polishd.drivers.transport.can_frames import CanFrame, OnFrame
from polishd.drivers.transport.claims import claim_address
from polishd.drivers.transport.streams import connect_unclaimed, why_closed
from polishd.model.errors import LinkError
from polishd.util.address_claims import Claim
from polishd.util.wire_recording import tap

OPEN_S = 2.0
OPEN_TRIES = 3
GREETING_S = 1.0
SLCAN_SETTLE_S = 0.05
POLL_S = 0.05
SEND_S = 0.3
EMPTY_READS = 3
"""Empty reads in a row of a readable serial line: a loaded computer has one, a dead line has them without end."""

BUS_OFF = 0x40
"""Error frame class: the adapter has left the bus."""


async def open_bus(address: SlcanAddress | SocketcandAddress, node: int) -> CanBus:
    """Connect to the bus for that node; LinkError if that fails.

    DeviceClaimed if another program on this computer uses the adapter, or that node of a bus behind a server.
    """
    claimed = await claim_address(address, part=str(node))
    try:
        return CanBus(str(address), await _connected(address), claimed)
    except BaseException:
        claimed.release()
        raise


async def _connected(address: SlcanAddress | SocketcandAddress) -> can.BusABC:
    logging.getLogger("can").setLevel(logging.CRITICAL)  # errors are raised here once
    if isinstance(address, SocketcandAddress):
        await _greeted(address)
    try:
        return await open_blocking(lambda: _make(address), lambda bus: bus.shutdown(), OPEN_S, str(address))
    except (can.CanError, OSError, ValueError) as error:
        port = isinstance(address, SlcanAddress) and error.__cause__
        raise LinkError(f"{address}: {why_closed(port, 'such baud rate') if port else error}") from error


async def _greeted(address: SocketcandAddress) -> None:
    """Check that a socketcand server answers: python-can would spin for 10 s, or wait for its greeting without end."""
    server = Tcp(address.host, address.port)
    try:
        stream = await connect_unclaimed(server, GREETING_S)
    except LinkError as error:
        raise LinkError(str(error).replace(str(server), str(address), 1)) from error
    greeting = b""
    try:
        async with asyncio.timeout(GREETING_S):
            while b"< hi >" not in greeting:
                greeting += await stream.read(64, GREETING_S)
                if len(greeting) > 64:
                    raise LinkError(f"{address}: no socketcand server, it answered {greeting!r}")
    except TimeoutError:
        raise LinkError(f"{address}: no greeting within {GREETING_S:g} s; is it a socketcand server?") from None
    finally:
        await stream.close()


def _make(address: SlcanAddress | SocketcandAddress) -> can.BusABC:
    if isinstance(address, SocketcandAddress):
        return _socketcand(address)
    return PromptSlcan(
        str(address.path),
        tty_baudrate=address.baud,
        bitrate=address.bitrate,
        sleep_after_open=SLCAN_SETTLE_S,
        timeout=0.0,
    )


def _socketcand(address: SocketcandAddress) -> can.BusABC:
    """Connect, with retries: python-can takes a frame that arrives with the server's last ok for a refusal."""
    for left in reversed(range(OPEN_TRIES)):
        try:
            return TidySocketcand(channel=address.channel, host=address.host, port=address.port)
        except can.CanError as error:
            if not left or "< ok >< frame" not in str(error):
                raise
    raise LinkError(f"{address}: did not open")


class TidySocketcand(SocketCanDaemonBus):
    """Socketcand bus with timeouts that closes its socket: python-can waits without end, and leaks it on refusal."""

    def __init__(self, **where: Any) -> None:
        try:
            super().__init__(**where)  # type: ignore[no-untyped-call]
        except (can.CanError, OSError):
            if (left_open := self._own_socket()) is not None:
                left_open.close()
            raise

    def _expect_msg(self, msg: str) -> None:
        if (connected := self._own_socket()) is not None:
            connected.settimeout(SEND_S)  # permanent: sending on the event loop would wait without end, too
            # Else a request that follows a heartbeat waits 40 ms for the server's delayed acknowledgement of that.
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        super()._expect_msg(msg)  # type: ignore[no-untyped-call]

    def _own_socket(self) -> socket.socket | None:
        return getattr(self, "_SocketCanDaemonBus__socket", None)


class PromptSlcan(slcanBus):
    """Slcan bus that never blocks: python-can waits on the event loop until the line has accepted each frame.

    It also opens the port exclusively, and closes it even if the adapter accepts no more data.
    """

    def __init__(self, channel: str, **settings: Any) -> None:
        try:
            super().__init__(channel, **settings)
        except (can.CanError, OSError):
            if (port := getattr(self, "serialPortOrig", None)) is not None:
                port.close()
            self._is_shutdown = True
            raise

    def set_bitrate(self, bitrate: int, data_bitrate: int | None = None) -> None:
        """Called before the first byte is sent: no data goes to an adapter that another program uses."""
        self.serialPortOrig.exclusive = True
        super().set_bitrate(bitrate, data_bitrate)

    def shutdown(self) -> None:
        """Leave the bus, and always close the port."""
        try:
            super().shutdown()
        finally:
            self.serialPortOrig.close()

    def _write(self, string: str) -> None:
        line = string.encode() + self.LINE_TERMINATOR
        try:
            taken = os.write(self.serialPortOrig.fileno(), line)
        except OSError as error:
            raise can.CanOperationError(f"the adapter takes no frame: {error.strerror}") from error
        if taken != len(line):
            raise can.CanOperationError("the adapter takes no more frames")


class CanBus:
    """An open bus. Received frames go to a callback; errors end ``receive`` with LinkError."""

    def __init__(self, name: str, bus: can.BusABC, claimed: Claim | None = None) -> None:
        """``claimed`` is released when the bus is closed."""
        self._name = name
        self._claimed = claimed or Claim()
        self._bus = bus
        self._empty = 0
        self._tap = tap(name)

    def send(self, frame: CanFrame) -> None:
        """Send a frame; LinkError if the adapter accepts none."""
        message = can.Message(arbitration_id=frame.identifier, data=frame.data, is_extended_id=False)
        try:
            self._bus.send(message, timeout=SEND_S)
        except (can.CanError, OSError) as error:
            raise LinkError(f"{self._name}: {error}") from error
        if self._tap is not None:
            self._tap("out", frame.data, frame.identifier)

    async def receive(self, on_frame: OnFrame) -> None:
        """Pass frames to the callback until cancelled, or LinkError."""
        try:
            fileno = self._bus.fileno()
        except NotImplementedError:
            await self._receive_in_thread(on_frame)
        else:
            await self._receive_when_ready(fileno, on_frame)

    async def close(self) -> None:
        """Leave the bus; errors of a dead bus are ignored."""
        if self._tap is not None:
            self._tap("end", why="the bus is closed")
        try:
            with contextlib.suppress(can.CanError, OSError):
                await asyncio.to_thread(self._bus.shutdown)
        finally:
            self._claimed.release()

    async def _receive_when_ready(self, fileno: int, on_frame: OnFrame) -> None:
        loop = asyncio.get_running_loop()
        failed: asyncio.Future[None] = loop.create_future()

        def ready() -> None:
            try:
                while (frame := self._next(0.0)) is not None:
                    on_frame(frame)
            except Exception as error:  # noqa: BLE001 -- raised where it is awaited
                if not failed.done():
                    failed.set_exception(error)
                loop.remove_reader(fileno)

        loop.add_reader(fileno, ready)
        try:
            await failed
        finally:
            loop.remove_reader(fileno)

    async def _receive_in_thread(self, on_frame: OnFrame) -> None:
        loop = asyncio.get_running_loop()
        while True:
            received = loop.run_in_executor(None, self._next, POLL_S)
            try:
                await asyncio.wait({received})
            finally:
                # The thread must have left the bus before it is shut down; it stays for POLL_S at most.
                await asyncio.wait({received})
            frame = received.result()
            while frame is not None:
                on_frame(frame)
                frame = self._next(0.0)

    def _was_nothing(self, error: Exception) -> bool:
        """Whether a read found no data, a few times in a row at most."""
        self._empty += 1
        return "returned no data" in str(error.__cause__) and self._empty <= EMPTY_READS

    def _next(self, within_s: float) -> CanFrame | None:
        try:
            message = self._bus.recv(within_s)
        except (ValueError, IndexError):
            return None  # slcan: a line that is not a frame
        except (can.CanError, OSError) as error:
            if self._was_nothing(error):
                return None
            if not (isinstance(self._bus, slcanBus) and isinstance(error.__cause__, UnicodeDecodeError)):
                raise LinkError(f"{self._name}: {_said(error)}; see the adapter and its wire") from error
            self._flush(self._bus)
            return None
        if message is not None and message.is_error_frame and message.arbitration_id & BUS_OFF:
            raise LinkError(f"{self._name}: the adapter is off the bus. Check wiring, termination and bit rate.")
        if message is None or message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return None
        self._empty = 0
        frame = CanFrame(message.arbitration_id, bytes(message.data))
        if self._tap is not None:
            self._tap("in", frame.data, frame.identifier)
        return frame

    def _flush(self, bus: slcanBus) -> None:
        """Drop buffered bytes: one byte above 0x7F would corrupt all later frames."""
        try:
            bus.flush()
        except can.CanError as error:
            raise LinkError(f"{self._name}: {error}") from error


def _said(error: Exception) -> str:
    """Return the error in one line: python-can puts whole tracebacks into its messages."""
    message, cause = str(error).partition("Traceback (")[0].strip(), str(error.__cause__ or "")
    return message if cause in message else f"{message} ({cause})"
