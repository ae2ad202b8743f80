"""A HAL component between polishd and linuxcncrsh: it holds motion when polishd falls silent.

    loadusr -Wn polishd-gate /usr/bin/python3 gate.py 0.0.0.0:5008 127.0.0.1:5007 2.0
    net polishd-idle  halui.program.is-idle => polishd-gate.idle
    net polishd-hold  polishd-gate.hold     => motion.feed-hold

Bytes pass unchanged, with one exception: ``set enable`` of a second client is refused while the first is connected and
not silent; linuxcncrsh would let the second take over. ``hold`` rises when a program that ran with a client still runs
and no client has sent anything for the timeout. It falls only when the program is over: a client that reconnects moves
nothing. The component needs only LinuxCNC's own Python.
"""

from __future__ import annotations

import contextlib
import importlib
import selectors
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any

LOOK_S = 0.02
REFUSED = b"SET ENABLE NAK"
LONGEST = 4096
"""Bytes of a request."""


@dataclass
class HalWatchdog:
    """The watchdog behind ``hold``."""

    silent_s: float
    client_s: float = float("-inf")
    armed: bool = False
    hold: bool = False

    def look(self, now_s: float, idle: bool) -> bool:
        """Return ``hold`` from now on."""
        alive = now_s - self.client_s < self.silent_s
        if idle:
            self.armed = self.hold = False
        elif not alive and self.armed:
            self.hold = True
        else:
            self.armed = self.armed or alive
        return self.hold


class Gate:
    """Pass bytes between clients and linuxcncrsh, without a second client's request for control."""

    def __init__(self, listen: tuple[str, int], to: tuple[str, int], watchdog: HalWatchdog) -> None:
        self.watchdog = watchdog
        self._to = to
        self._selector = selectors.DefaultSelector()
        self._listener = socket.create_server(listen)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._clients: dict[socket.socket, bytes] = {}
        """Start of a request whose line has not ended, by client."""
        self._writer: socket.socket | None = None
        """The client that may send commands."""
        self._wrote_s = float("-inf")
        self.port = int(self._listener.getsockname()[1])

    def turn(self, within_s: float) -> None:
        """Serve pending connections, waiting for at most this time."""
        for key, _ in self._selector.select(within_s):
            source = key.fileobj
            if source is self._listener:
                self._accept()
            elif isinstance(source, socket.socket) and isinstance(key.data, socket.socket):
                self._pass(source, key.data)

    def close(self) -> None:
        """Close all connections."""
        for key in list(self._selector.get_map().values()):
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._selector.close()

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        try:
            server = socket.create_connection(self._to, timeout=1.0)
        except OSError:
            client.close()
            return
        for end in (client, server):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            end.settimeout(1.0)
        self._clients[client] = b""
        self._selector.register(client, selectors.EVENT_READ, server)
        self._selector.register(server, selectors.EVENT_READ, client)

    def _pass(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            data = source.recv(1 << 16)
            if data and source in self._clients:
                self.watchdog.client_s = time.monotonic()
                self._from_client(source, sink, data)
            else:
                self._writer = None if sink is self._writer and REFUSED in data else self._writer
                sink.sendall(data)
        except OSError:
            data = b""
        if not data:
            for end in (source, sink):
                self._clients.pop(end, None)
                self._writer = None if end is self._writer else self._writer
                with contextlib.suppress(KeyError, ValueError):
                    self._selector.unregister(end)
                end.close()

    def _from_client(self, client: socket.socket, server: socket.socket, data: bytes) -> None:
        """Pass whole lines on; answer those by which a second client would take control."""
        lines, rest = (self._clients[client] + data).splitlines(keepends=True), b""
        if not lines[-1].endswith((b"\n", b"\r")) and len(lines[-1]) < LONGEST:
            rest = lines.pop()
        self._clients[client] = rest
        passed = [line for line in lines if self._allows(client, line)]
        if len(passed) < len(lines):
            client.sendall((REFUSED + b"\r\n") * (len(lines) - len(passed)))
        server.sendall(b"".join(passed))

    def _allows(self, client: socket.socket, line: bytes) -> bool:
        now_s, words = time.monotonic(), line.lower().split()
        if words[:2] == [b"set", b"enable"]:
            if words[2:] == [b"off"]:
                self._writer = None if client is self._writer else self._writer
                return True
            if self._writer not in (None, client) and now_s - self._wrote_s < self.watchdog.silent_s:
                return False
            self._writer = client
        if client is self._writer:
            self._wrote_s = now_s
        return True


def address(text: str) -> tuple[str, int]:
    """Parse ``host:port``."""
    host, _, port = text.rpartition(":")
    return host, int(port)


def main(listen: str, to: str, silent_s: str) -> None:
    """Run as a HAL component until LinuxCNC ends it."""
    hal: Any = importlib.import_module("hal")  # LinuxCNC supplies it
    component = hal.component("polishd-gate")
    component.newpin("idle", hal.HAL_BIT, hal.HAL_IN)
    component.newpin("hold", hal.HAL_BIT, hal.HAL_OUT)
    gate = Gate(address(listen), address(to), HalWatchdog(float(silent_s)))
    component.ready()
    while True:
        gate.turn(LOOK_S)
        component["hold"] = gate.watchdog.look(time.monotonic(), bool(component["idle"]))


if __name__ == "__main__":
    main(*sys.argv[1:])
