"""Fake LinuxCNC with linuxcncrsh according to docs/protocols/linuxcnc.md. Each line with a move takes ``block_s``.

Its time advances only when a request arrives.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path

from tests.fakes.wires import Peer

MESSAGE = re.compile(rb"\(MSG,([^)]*)\)")
DWELL = re.compile(rb"G4 ?P([\d.]+)")


class FakeLinuxCnc(Peer):
    """Machine with the axes XYZAC, switched on and homed."""

    def __init__(self, *, block_s: float = 0.005, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self.block_s = block_s
        self.clock = clock
        self.estop, self.machine, self.mode = "OFF", "ON", "MANUAL"
        self.enabled = self.greeted = False
        self.grants = True
        """Whether ``set enable`` gives control, independent of the answer."""
        self.status = "IDLE"
        self.program: Path | None = None
        self.lines: list[bytes] = []
        self.at, self.done_s = 0, 0.0
        """Index of the line under way, and its elapsed time."""
        self.moving = 0
        self.x_mm = 0.0
        self.displays: list[str] = []
        self.errors: list[str] = []
        self.received: list[str] = []
        self.refuses: set[str] = set()
        """Commands that are answered with NAK."""
        self.deaf: set[str] = set()
        """Requests that are not answered."""
        self.feed_override = 100
        """Feed override in percent."""
        self.read_ahead = 0
        """Number of lines after the motion that the idle machine reports as read."""
        self._seen_s = clock()
        self._rest = b""

    def on_connect(self) -> None:
        """Take all rights from a new client."""
        self.enabled = self.greeted = False
        self._rest = b""

    def on_bytes(self, data: bytes) -> None:
        """Process requests, one per line."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self.answer(line.decode().strip())

    def answer(self, request: str) -> None:
        """Answer one request."""
        self.received.append(request)
        self.pass_time()
        verb, _, rest = request.partition(" ")
        if any(request.startswith(word) for word in self.deaf):
            return
        if verb == "hello":
            self.greeted = rest.split()[0] == "EMC"
            self.say("HELLO ACK EMCNETSVR 1.1" if self.greeted else "HELLO NAK")
        elif verb == "get":
            value = self.value(rest)
            self.say(f"{rest.upper()} {value}" if value is not None else f"GET {rest.upper()} NAK\r\n")
        else:
            self._order(rest)

    def say(self, text: str, end: str = "\r\n") -> None:
        """Send one line."""
        self.send(text.encode() + end.encode())

    def value(self, name: str) -> str | None:
        """Return the value of a ``get`` request; None where there is none."""
        if name in ("operator_display", "error"):
            queue = self.displays if name == "operator_display" else self.errors
            return queue.pop(0) if queue else "OK"
        return {
            "time": f"{1.7e9 + self.clock():f}",
            "program_line": str(self.line()),
            "program_status": self.status,
            "abs_cmd_pos": f"{self.x_mm:f} 0.000000 0.000000 0.000000 0.000000 0.000000",
            "operator_text": "OK",
            "feed_override": f"{self.feed_override:d}",
            "enable": "ON" if self.enabled else "OFF",
            "estop": self.estop,
            "machine": self.machine,
            "inifile": "/etc/fake.ini",
        }.get(name)

    def line(self) -> int:
        """Return the line of the motion under way; when idle, the last line that was read."""
        return self.moving if self.status != "IDLE" else self.moving + self.read_ahead

    def pass_time(self) -> None:
        """Advance the machine by the time since the last request."""
        now = self.clock()
        left, self._seen_s = now - self._seen_s, now
        while self.status == "RUNNING" and left > 0.0:
            line = self.lines[self.at]
            takes = self._takes(line)
            if takes and not DWELL.match(line):
                self.moving = self.at + 1
                self.x_mm += min(left, takes - self.done_s)
            if left < takes - self.done_s:
                self.done_s += left
                return
            left -= takes - self.done_s
            self._complete(line)

    def _takes(self, line: bytes) -> float:
        if line.startswith((b"(", b"M", b"%")) or not line.strip():
            return 0.0
        dwell = DWELL.match(line)
        return float(dwell[1]) if dwell else self.block_s

    def _complete(self, line: bytes) -> None:
        self.at, self.done_s = self.at + 1, 0.0
        if message := MESSAGE.match(line):
            self.displays.append(message[1].decode())
        if line.endswith(b"M0"):
            self.status = "PAUSED"
        if line.startswith((b"M2", b"?")) or self.at == len(self.lines):
            self.status = "IDLE"
        if line.startswith(b"?"):
            self.errors.append("Bad character '?' used")

    def _order(self, order: str) -> None:
        name, _, value = order.partition(" ")
        if name == "echo":
            self.say(f"set {order}")
            return
        taken = name not in self.refuses
        if name == "enable":
            taken = taken and value == "EMCTOO"
            self.enabled = taken and self.grants
        elif name not in ("verbose", "set_wait"):
            taken = taken and self.enabled and self.machine == "ON"
            if taken:
                self._obey(name, value)
        self.say(f"SET {name.upper()} {'ACK' if taken else 'NAK'}", "\n\r")

    def _obey(self, name: str, value: str) -> None:
        if name == "open":
            self.program = Path(value)
            self.lines = self.program.read_bytes().split(b"\n")
        elif name == "run":
            self._run(value)
        elif name == "pause" and self.status == "RUNNING":
            self.status = "PAUSED"
        elif name == "resume" and self.status == "PAUSED":
            self.status = "RUNNING"
        elif name == "abort":
            self.status = "IDLE"
        elif name == "mode":
            self.mode = value.upper()

    def _run(self, value: str) -> None:
        if value == "-1":
            self.errors += ["Bad character '?' used" for line in self.lines if line.startswith(b"?")]
        else:
            self.at, self.done_s, self.status = 0, 0.0, "RUNNING"
