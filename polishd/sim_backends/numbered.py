"""A device on numbered lines: the framing of docs/protocols/loader.md, for those that only answer."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from polishd.sim_backends.actuator.ascii import MAX_LINE, body, line


@dataclass(slots=True)
class NumberedSlave:
    """Answers each intact line by one line."""

    answer: Callable[[str], str]
    _buffer: bytes = b""

    def feed(self, data: bytes) -> Iterable[bytes]:
        """The answer to each whole request."""
        self._buffer += data
        while b"\n" in self._buffer:
            raw, self._buffer = self._buffer.split(b"\n", 1)
            number, _, request = (body(raw.rstrip(b"\r")) or "").partition(",")
            if number.isdigit() and int(number) <= 65535:
                yield line(f"{number},{self.answer(request)}")
        self._buffer = self._buffer[-MAX_LINE:]
