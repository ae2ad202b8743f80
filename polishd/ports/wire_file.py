"""The file of a recording: gzipped JSON lines, a header and then what passed. No option of a device is in it.

{"polishd_wire": 1, "version": "0.9", "cell": "demo", "began": "2026-11-23T00:42:53+00:00", "devices": {...}}
{"t_s": 0.01, "role": "actuator", "link": "tcp://10.0.0.7:502", "way": "out", "hex": "0001..."}
{"t_s": 0.02, "role": "spindle", "link": "slcan:/dev/ttyACM0", "way": "in", "id": 897, "hex": "00ff"}
{"t_s": 0.03, "role": "robot", "link": "opc.tcp://10.0.0.9:4840", "way": "out", "values": {"start": true}}
{"t_s": 0.04, "role": "robot", "link": "opc.tcp://10.0.0.9:4840", "way": "in", "values": {"state": 2}, "clock_s": 5.1}
{"t_s": 9.5, "lost": 12}        so many were dropped since the line before: the disk was slower than the wires
{"t_s": 99.5, "full": 100000000}    the limit of the file, bytes: nothing was recorded from here on
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from polishd.model.errors import ConfigError
from polishd.ports.tap import Way, WireMessage

FORMAT = 1
_BROKEN = (EOFError, zlib.error, gzip.BadGzipFile, UnicodeDecodeError)


@dataclass(frozen=True, slots=True)
class Recording:
    """What a file holds."""

    path: Path
    header: Mapping[str, Any]
    passed: tuple[WireMessage, ...]
    lines: tuple[int, ...]
    """The line of each, from 1."""
    notes: tuple[str, ...]
    """What is missing in it, for people."""

    def of(self, role: str) -> list[tuple[int, WireMessage]]:
        """Line and record of all that passed on that device's links; ConfigError where nothing did."""
        found = [(line, one) for line, one in zip(self.lines, self.passed, strict=True) if one.role == role]
        if not found:
            roles = ", ".join(sorted({one.role for one in self.passed})) or "nobody"
            raise ConfigError(f"{self.path}: nothing of {role!r} is recorded; it has {roles}")
        return found


def header_line(version: str, cell: str, began: str, devices: Mapping[str, Mapping[str, str]]) -> bytes:
    """The first line."""
    return _line({"polishd_wire": FORMAT, "version": version, "cell": cell, "began": began, "devices": devices})


def note_line(t_s: float, key: str, number: int) -> bytes:
    """What is missing: ``lost`` or ``full``."""
    return _line({"t_s": round(t_s, 6), key: number})


def passed_line(one: WireMessage, began_s: float) -> bytes:
    """What passed."""
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
    """ConfigError names file and line. What a power cut left of a file is read up to there, and said in the notes."""
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
    with path.open("rb") as raw:
        packed = raw.read(2) == b"\x1f\x8b"
    at = 0
    with gzip.open(path) if packed else path.open("rb") as file:
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
        why, told = row.get("why", ""), (values, clock_s, changed_s)
        return WireMessage(float(row["t_s"]), str(row["role"]), str(row["link"]), way, data, identifier, why, *told)
    except KeyError as error:
        raise _bad(path, at, f"has no {error.args[0]!r}") from error
    except (TypeError, ValueError) as error:
        raise _bad(path, at, str(error)) from error


def _bad(path: Path, at: int, what: str) -> ConfigError:
    return ConfigError(f"{path}:{at}: {what}; the recording was changed, ask for the file as it was written")
