"""The primary client interface: scripts as text, one complaint a script, and a word on the state now and then."""

from __future__ import annotations

import re
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field

_DEPTH = re.compile(rb"^[ \t]*(?:def|thread|while|if|sec)\b.*:[ \t]*(?:#.*)?\r?$")
_END = re.compile(rb"^[ \t]*end[ \t]*(?:#.*)?\r?$")
PRIMARY_BYTES = 64 << 20
STATE = 16


def message(kind: int, payload: bytes) -> bytes:
    """A message."""
    return struct.pack(">iB", 5 + len(payload), kind) + payload


def complaint(line: int, text: str) -> bytes:
    """A runtime exception: where in the script, and what."""
    head = struct.pack(">QbBii", time.monotonic_ns() // 1000, -2, 10, line, 0)
    return message(20, head + text.encode())


@dataclass(slots=True)
class ScriptIntake:
    """Collects lines until a ``def`` has its end; single lines are dropped, they are programs of their own."""

    run: Callable[[str], None]
    _rest: bytes = b""
    _depth: int = 0
    _lines: list[bytes] = field(default_factory=list)

    def feed(self, data: bytes) -> None:
        """Hand over each whole script."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._take(line)

    def _take(self, line: bytes) -> None:
        opens, closes = _DEPTH.match(line) is not None, _END.match(line) is not None
        if not self._lines and not opens:
            return
        self._lines.append(line)
        self._depth += opens - closes
        if self._depth == 0:
            lines, self._lines = self._lines, []
            self.run(b"\n".join(lines).decode("utf-8", "replace"))
