"""Recording of a cell's links: each link passes its bytes or frames to the recorder before they are parsed.

The device of a link is not an argument: the cell states the device that it talks to (``record_sent``), and links that
open meanwhile belong to that device.
"""

from __future__ import annotations

import gzip
import json
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from polishd.model.errors import ConfigError
from polishd.util.files import open_input

Way = Literal["open", "out", "in", "end"]


@dataclass(frozen=True, slots=True)
class WireMessage:
    """A message on a link."""

    at_s: float
    """``time.monotonic``; in a file: since the recording began."""
    role: str
    """The device's name in the cell; empty where unknown."""
    link: str
    """Its address."""
    way: Way
    """``out``: polishd wrote it. ``in``: it came. ``open``, ``end``: of the link itself."""
    data: bytes = b""
    identifier: int | None = None
    """Identifier of a CAN frame."""
    why: str = ""
    """Reason for the end of a link."""
    values: Mapping[str, object] | None = None
    """By name, in place of bytes: of a link that a library hides."""
    clock_s: float | None = None
    """Time of received values on the sender's clock."""
    changed_s: Mapping[str, float] | None = None
    """On that clock, when some came to their values."""


Recorder = Callable[[WireMessage], None]
"""Never blocks, never raises."""


@dataclass(frozen=True, slots=True)
class LinkTap:
    """Recording tap of one link."""

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
        """Record a message that passes now."""
        now_s = time.monotonic()
        passed = WireMessage(now_s, self.role, self.link, way, data, identifier, why, values, clock_s, changed_s)
        self.recorder(passed)


_recorder: ContextVar[Recorder | None] = ContextVar("recorder", default=None)
_role: ContextVar[str] = ContextVar("role", default="")


def tap(link: str) -> LinkTap | None:
    """Return the tap of a link that was just opened; None without a recorder."""
    if (recorder := _recorder.get()) is None:
        return None
    found = LinkTap(recorder, _role.get(), link)
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


# The file of a recording: gzipped JSON lines, a header and then what passed. No option of a device is in it.

FORMAT = 1
_BROKEN = (EOFError, zlib.error, gzip.BadGzipFile, UnicodeDecodeError)


@dataclass(frozen=True, slots=True)
class Recording:
    """Content of a recording file."""

    path: Path
    header: Mapping[str, Any]
    passed: tuple[WireMessage, ...]
    lines: tuple[int, ...]
    """The line of each, from 1."""
    notes: tuple[str, ...]
    """Notes on missing content."""

    def of(self, role: str) -> list[tuple[int, WireMessage]]:
        """Line and record of all that passed on that device's links; ConfigError where nothing did."""
        found = [(line, one) for line, one in zip(self.lines, self.passed, strict=True) if one.role == role]
        if not found:
            roles = ", ".join(sorted({one.role for one in self.passed})) or "no device"
            raise ConfigError(f"{self.path}: no message of {role!r} is recorded; the file holds {roles}")
        return found


def header_line(version: str, cell: str, began: str, devices: Mapping[str, Mapping[str, str]]) -> bytes:
    """The first line."""
    return _line({"polishd_wire": FORMAT, "version": version, "cell": cell, "began": began, "devices": devices})


def note_line(t_s: float, key: str, number: int) -> bytes:
    """Note on missing messages: ``lost`` or ``full``."""
    return _line({"t_s": round(t_s, 6), key: number})


def passed_line(one: WireMessage, began_s: float) -> bytes:
    """Line of a message."""
    line: dict[str, Any] = {"t_s": round(one.at_s - began_s, 6), "role": one.role, "link": one.link, "way": one.way}
    line |= {} if one.identifier is None else {"id": one.identifier}
    if one.values is not None:
        line["values"] = dict(one.values)
        line |= {} if one.clock_s is None else {"clock_s": one.clock_s}
        line |= {"changed_s": dict(one.changed_s)} if one.changed_s else {}
    elif one.way in ("out", "in"):
        line["hex"] = one.data.hex()
    return _line(line | ({"why": one.why} if one.why else {}))


def read_recording(path: Path) -> Recording:
    """ConfigError names file and line. A file truncated by a power cut is read as far as it is valid, with a note."""
    notes: list[str] = []
    passed: list[WireMessage] = []
    lines: list[int] = []
    try:
        rows = _rows(path, notes)
        header = _header(path, next(rows, (1, {})))
        for at, row in rows:
            if "lost" in row or "full" in row:
                said = f"{row['lost']} were dropped" if "lost" in row else "it is full: nothing more was recorded"
                notes.append(f"line {at}, {row['t_s']} s: {said}")
                continue
            passed.append(_passed(path, at, row))
            lines.append(at)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}; name a file of polishd run --record") from error
    return Recording(path, header, tuple(passed), tuple(lines), tuple(notes))


def _line(fields: Mapping[str, Any]) -> bytes:
    return json.dumps(fields, separators=(",", ":")).encode() + b"\n"


def _rows(path: Path, notes: list[str]) -> Iterator[tuple[int, dict[str, Any]]]:
    """Number and content of each line; unpacked by hand or not."""
    at = 0
    with open_input(path) as raw:
        file = gzip.open(raw) if raw.peek(2)[:2] == b"\x1f\x8b" else raw  # noqa: SIM115 - ends with the file in it
        while True:
            try:
                text = file.readline()
            except _BROKEN as error:
                notes.append(f"line {at + 1}: the file breaks off here ({' '.join(str(error).split())})")
                return
            if not text:
                return
            at += 1
            try:
                row = json.loads(text)
            except ValueError:
                if not text.endswith(b"\n"):
                    notes.append(f"line {at}: the file breaks off in it")
                    return
                raise _bad(path, at, f"is no JSON: {text[:40]!r}") from None
            if not isinstance(row, dict):
                raise _bad(path, at, f"is no record: {text[:40]!r}")
            yield at, row


def _header(path: Path, first: tuple[int, Mapping[str, Any]]) -> Mapping[str, Any]:
    if (found := first[1].get("polishd_wire")) != FORMAT:
        said = "has no header" if found is None else f"is of format {found}, this polishd reads {FORMAT}"
        raise _bad(path, 1, f"{said}; name a file of polishd run --record")
    return first[1]


def _passed(path: Path, at: int, row: Mapping[str, Any]) -> WireMessage:
    try:
        way: Way = row["way"]
        if way not in get_args(Way):
            raise ValueError(f"way {way!r} is none of {', '.join(get_args(Way))}")
        values: dict[str, Any] | None = dict(row["values"]) if "values" in row else None
        data = bytes.fromhex(row["hex"]) if way in ("out", "in") and values is None else b""
        identifier = None if row.get("id") is None else int(row["id"])
        clock_s = None if row.get("clock_s") is None else float(row["clock_s"])
        changed_s = {str(name): float(at_s) for name, at_s in dict(row.get("changed_s", {})).items()} or None
        why, received = row.get("why", ""), (values, clock_s, changed_s)
        return WireMessage(float(row["t_s"]), str(row["role"]), str(row["link"]), way, data, identifier, why, *received)
    except KeyError as error:
        raise _bad(path, at, f"has no {error.args[0]!r}") from error
    except (TypeError, ValueError) as error:
        raise _bad(path, at, str(error)) from error


def _bad(path: Path, at: int, what: str) -> ConfigError:
    return ConfigError(f"{path}:{at}: {what}; the recording was changed, ask for the file as it was written")
