"""Where a cell's recorder listens in: each link tells it what passes, as bytes or frames, before anybody reads them.

Whose link it is nobody hands down: the cell says which device it talks to (``record_sent``), and what that opens
meanwhile is that device's.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal

Way = Literal["open", "out", "in", "end"]


@dataclass(frozen=True, slots=True)
class WireMessage:
    """What passed on a link."""

    at_s: float
    """``time.monotonic``; in a file: since the recording began."""
    role: str
    """The device's name in the cell; empty where nobody said."""
    link: str
    """Its address."""
    way: Way
    """``out``: polishd wrote it. ``in``: it came. ``open``, ``end``: of the link itself."""
    data: bytes = b""
    identifier: int | None = None
    """Of a CAN frame."""
    why: str = ""
    """How a link ended."""
    values: Mapping[str, object] | None = None
    """By name, in place of bytes: of a link that a library hides."""
    clock_s: float | None = None
    """Of values that came: when, on the clock of whoever has them."""
    changed_s: Mapping[str, float] | None = None
    """On that clock, when some came to their values."""


Recorder = Callable[[WireMessage], None]
"""Never blocks, never raises."""


@dataclass(frozen=True, slots=True)
class Tap:
    """That of one link."""

    recorder: Recorder
    role: str
    link: str

    def __call__(
        self,
        way: Way,
        data: bytes = b"",
        identifier: int | None = None,
        why: str = "",
        *,
        values: Mapping[str, object] | None = None,
        clock_s: float | None = None,
        changed_s: Mapping[str, float] | None = None,
    ) -> None:
        """That passes, now."""
        now_s = time.monotonic()
        passed = WireMessage(now_s, self.role, self.link, way, data, identifier, why, values, clock_s, changed_s)
        self.recorder(passed)


_recorder: ContextVar[Recorder | None] = ContextVar("recorder", default=None)
_role: ContextVar[str] = ContextVar("role", default="")


def tap(link: str) -> Tap | None:
    """Of a link that was opened just now; None where nobody records."""
    if (recorder := _recorder.get()) is None:
        return None
    found = Tap(recorder, _role.get(), link)
    found("open")
    return found


@contextmanager
def record_sent(role: str) -> Iterator[None]:
    """Links that this task, and the tasks that it starts, open in the block are of that device."""
    token = _role.set(role)
    try:
        yield
    finally:
        _role.reset(token)


@contextmanager
def record_received(recorder: Recorder) -> Iterator[None]:
    """Links that are opened in the block, and by tasks that begin in it, are recorded."""
    _recorder.set(recorder)
    try:
        yield
    finally:
        _recorder.set(None)
