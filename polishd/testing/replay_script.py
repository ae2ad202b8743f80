"""A recorded link as requests and what came upon them. What is asked again is answered as it was last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from polishd.drivers.transport import numbered
from polishd.ports.tap import WireMessage

OWN_ENDS = ("the connection is closed", "the line is closed", "the bus is closed")
"""The driver closed it; whatever else ended a link is done again."""
SHOWN = 48
"""Bytes of a message in a mismatch."""


@dataclass
class RecordedExchange:
    """A request, or nothing where a link was opened, and what came until the next one."""

    line: int
    """Of the recording's file."""
    at_s: float
    out: bytes
    came: list[tuple[float, bytes]] = field(default_factory=list)
    """Seconds since the request, bytes."""
    cut: bool = False
    """The link was lost upon it."""


class ReplayDialect(Protocol):
    """What of a message is its number, which is another one each time."""

    def cut(self, data: bytes) -> int | None:
        """Length of the first message; None where it is not whole yet."""
        ...

    def key(self, message: bytes) -> bytes:
        """The message without its number."""
        ...

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """What came, with the number of ``now`` in the place of that of ``asked``."""
        ...


class ModbusTcp:
    """Its number is the transaction's."""

    def cut(self, data: bytes) -> int | None:
        """See Dialect."""
        end = 6 + int.from_bytes(data[4:6]) if len(data) >= 6 else len(data) + 1
        return end if len(data) >= end else None

    def key(self, message: bytes) -> bytes:
        """See Dialect."""
        return message[2:]

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """See Dialect."""
        done = b""
        while (end := self.cut(recorded)) is not None:
            frame, recorded = recorded[:end], recorded[end:]
            done += now[:2] + frame[2:] if frame[:2] == asked[:2] else frame
        return done + recorded


class NumberedLinesDialect:
    """``$number,body*checksum``."""

    def cut(self, data: bytes) -> int | None:
        """See Dialect."""
        return data.find(b"\n") + 1 or None

    def key(self, message: bytes) -> bytes:
        """See Dialect."""
        found = numbered.decode(message.removesuffix(b"\n"))
        return message if found is None else found[1].encode()

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """See Dialect."""
        numbers = [numbered.decode(one.removesuffix(b"\n")) for one in (asked, now)]
        lines = []
        for line in recorded.splitlines(keepends=True):
            found = numbered.decode(line.removesuffix(b"\n"))
            ours = found and numbers[0] and numbers[1] and found[0] == numbers[0][0]
            lines.append(numbered.encode(numbers[1][0], found[1]) if ours and found and numbers[1] else line)
        return b"".join(lines)


class UnnumberedDialect:
    """No numbers. Where a message ends only the recording knows."""

    def __init__(self, outs: Sequence[bytes]) -> None:
        self._outs = sorted(set(outs), key=len, reverse=True)

    def cut(self, data: bytes) -> int | None:
        """See Dialect."""
        found = next((len(out) for out in self._outs if data.startswith(out)), None)
        if found is None and not any(out.startswith(data) for out in self._outs):
            return len(data)
        return found

    def key(self, message: bytes) -> bytes:
        """See Dialect."""
        return message

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:  # noqa: ARG002 -- there is no number
        """See Dialect."""
        return recorded


def exchanges(passed: Sequence[tuple[int, WireMessage]]) -> list[RecordedExchange]:
    """Of one link, with the lines of its records."""
    found: list[RecordedExchange] = []
    for line, one in passed:
        if one.way in ("open", "out") or not found:
            found.append(RecordedExchange(line, one.at_s, one.data if one.way == "out" else b""))
        if one.way == "in":
            found[-1].came.append((one.at_s - found[-1].at_s, one.data))
        elif one.way == "end":
            found[-1].cut = one.why not in OWN_ENDS
    return found


class ReplayScript:
    """Where in its recording a link is."""

    def __init__(
        self,
        name: str,
        found: Sequence[RecordedExchange],
        dialect: ReplayDialect | None = None,
        polls: frozenset[bytes] | None = None,
    ) -> None:
        """``name`` for messages. ``polls``: keys of what may come more or less often; without them, what does so."""
        self._name, self._found, self._next = name, found, 0
        outs = [one.out for one in found if one.out]
        self.dialect = dialect or _dialect(outs)
        self._keys = [self.dialect.key(one.out) if one.out else b"" for one in found]
        self._again = polls
        self._polls = polls or {key for key, times in Counter(self._keys).items() if times > 1}

    def opened(self) -> RecordedExchange | None:
        """What came when the link was opened, before anything was asked."""
        ahead = self._ahead(b"")
        if ahead is None:
            ahead = self._behind(b"")
        return None if ahead is None else self._at(ahead)

    def asked(self, message: bytes) -> RecordedExchange:
        """The exchange that a whole message of the driver is of; AssertionError where there is none."""
        key = self.dialect.key(message)
        found = self._ahead(key)
        if found is None and (self._again is None or key in self._again):
            found = self._behind(key)
        if found is None:
            raise AssertionError(f"{self._name}: the driver sent {_shown(message)}; {self._expected()}")
        return self._at(found)

    def has(self, message: bytes) -> bool:
        """Whether it comes next, or came before."""
        key = self.dialect.key(message)
        return self._ahead(key) is not None or self._behind(key) is not None

    def _at(self, found: int) -> RecordedExchange:
        self._next = max(self._next, found + 1)
        return self._found[found]

    def _ahead(self, key: bytes) -> int | None:
        """The next of that content; only what occurs again and again is passed over on the way."""
        for at in range(self._next, len(self._found)):
            if self._keys[at] == key:
                return at
            if self._keys[at] and self._keys[at] not in self._polls:
                return None
        return None

    def _behind(self, key: bytes) -> int | None:
        return next((at for at in reversed(range(self._next)) if self._keys[at] == key), None)

    def _expected(self) -> str:
        left = [one for one in self._found[self._next :] if one.out]
        return f"the recording has {_shown(left[0].out)} (line {left[0].line})" if left else "the recording ends here"


def _dialect(outs: Sequence[bytes]) -> ReplayDialect:
    if outs and all(len(out) > 7 and out[2:4] == b"\0\0" and ModbusTcp().cut(out) == len(out) for out in outs):
        return ModbusTcp()
    if outs and all(numbered.decode(out.removesuffix(b"\n")) is not None for out in outs):
        return NumberedLinesDialect()
    return UnnumberedDialect(outs)


def _shown(message: bytes) -> str:
    """Text as text, other bytes as hexadecimal ones."""
    cut = message[:SHOWN]
    text = repr(cut)[1:] if all(32 <= byte < 127 or byte in b"\r\n\t" for byte in cut) else cut.hex(" ")
    return text + (" ..." if len(message) > SHOWN else "")
