"""What a program did to its files, as its system calls tell: strace's account of it, in the order of time."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from polishd.sim_backends.common import framing
from tests.campaigns.crash.recorded_process import WEAK

ROOT = Path(__file__).resolve().parents[3]
MARKS = "marks"
STATE = "state"
LEFT_OUT = ("-shm", ".log", "/lock", ".sock")
"""Made anew at each start, or read by no start."""
CALLS = (
    "open,openat,creat,write,writev,pwrite64,pwritev,pwritev2,lseek,truncate,ftruncate,fallocate,fsync,fdatasync,"
    "rename,renameat,renameat2,link,linkat,unlink,unlinkat,mkdir,mkdirat,rmdir,sendto"
)
STRACE = ("strace", "-f", "-qq", "--seccomp-bpf", "-y", "-xx", "-s", "8000000", "-e", f"trace={CALLS}")
_LINE = re.compile(r"(\d+) +(?:<\.\.\. (\w+) resumed>|(\w+)\()(.*)$")
_HEX = re.compile(r"\\x([0-9a-f]{2})")
_RESULT = re.compile(r"\) += (-?\d+)(?:<.*>)?(?: \w+ \(.*\))?$")
_STRING = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
_FD = re.compile(r"^(\d+)<([^>]*)>")


@dataclass(frozen=True, slots=True)
class Op:
    """One act. Paths are relative to the watched folder; times count lines of the account."""

    kind: str
    """``create``, ``write``, ``truncate``, ``sync``, ``rename``, ``unlink``, ``mkdir``, ``mark``."""
    path: str = ""
    began: int = 0
    at: int = 0
    """When it was over; of a mark, when it began."""
    offset: int = 0
    data: bytes = b""
    to: str = ""
    what: Mapping[str, Any] = field(default_factory=dict)


def marked(marks: Path, *command: object) -> list[str]:
    """The command line of ``crash.recorded_process``."""
    return [sys.executable, "-m", "tests.campaigns.crash.recorded_process", str(marks), *map(str, command)]


def traced(account: Path, command: Sequence[str]) -> list[str]:
    """The command under strace."""
    return [*STRACE, "-o", str(account), *command]


def recorded(folder: Path, what: str = "script", weak: str = "") -> list[Op]:
    """The journal's own methods, on ``folder/state``: see ``crash.recorded_process``."""
    marks, account = folder / MARKS, folder / "account"
    command = traced(account, marked(marks, what, folder / "state"))
    sizes = {name: len(data) for name, data in files_in(folder).items()}
    environment = {**os.environ, WEAK: weak, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    subprocess.run(command, check=True, cwd=ROOT, env=environment)
    return ops(folder, marks, account, sizes=sizes)


def files_in(folder: Path) -> dict[str, bytes]:
    """What is in the state folder in it, but for what is left out."""
    there = (path for path in (folder / STATE).rglob("*") if path.is_file() and not str(path).endswith(LEFT_OUT))
    return {str(path.relative_to(folder)): path.read_bytes() for path in there}


def ops(watched: Path, marks: Path, *accounts: Path, sizes: Mapping[str, int] = MappingProxyType({})) -> list[Op]:
    """What of these, one after the other, concerns files below ``watched``, marks, and the robot's wire; by time.

    ``sizes``: of the files that were there before.
    """
    reader = _Reader(watched, marks, sizes)
    found = [op for account in accounts for op in reader.read(account)]
    return sorted(found, key=lambda op: op.at)


def _text(raw: str) -> str:
    return os.fsdecode(_bytes(raw))


def _bytes(raw: str) -> bytes:
    return bytes.fromhex(raw.replace("\\x", ""))


class _Reader:
    """Takes strace's lines apart."""

    def __init__(self, watched: Path, marks: Path, sizes: Mapping[str, int]) -> None:
        self._watched = str(watched)
        self._marks = str(marks)
        self._open: dict[str, tuple[int, str]] = {}
        """By thread: what has begun, and when."""
        self._position: dict[tuple[str, str], int] = {}
        """By process-wide file number and path."""
        self._sizes = dict(sizes)
        """Of files that are there."""
        self._appending: set[tuple[str, str]] = set()
        self._lines = 0

    def read(self, account: Path) -> Iterator[Op]:
        """What one process and its threads did; first the mark of its start."""
        yield Op("mark", began=self._lines, at=self._lines, what={"starts": True})
        with account.open(encoding="ascii", errors="replace") as lines:
            for number, line in enumerate(lines, self._lines):
                self._lines = number + 1
                found = _LINE.match(line)
                if found is None:
                    continue
                thread, resumed, name, rest = found.groups()
                began = number
                if resumed:
                    began, head = self._open.pop(thread, (number, ""))
                    name, rest = resumed, head + rest
                elif rest.endswith("<unfinished ...>"):
                    self._open[thread] = number, rest.removesuffix("<unfinished ...>").rstrip()
                    continue
                result = _RESULT.search(rest)
                if result is not None and int(result[1]) >= 0:
                    yield from self._told(name, rest[: result.start()], int(result[1]), began, number)

    def _told(self, name: str, text: str, result: int, began: int, at: int) -> Iterator[Op]:
        if name == "sendto":
            yield from _wire(text, began)
        elif name in {"open", "openat", "creat"}:
            yield from self._opened(text, result, began, at)
        elif (found := _FD.match(text)) is not None and name not in {"unlinkat", "renameat", "renameat2", "mkdirat"}:
            yield from self._on_file(name, found[1], _text(found[2]), text[found.end() :], result, began, at)
        else:
            paths = [path for path in map(self._within, map(_text, _STRING.findall(text))) if path is not None]
            if name.startswith("rename") and len(paths) == 2:
                self._sizes[paths[1]] = self._sizes.pop(paths[0])
                yield Op("rename", paths[0], began, at, to=paths[1])
            elif name.startswith("unlink") and paths:
                self._sizes.pop(paths[0], None)
                yield Op("unlink", paths[0], began, at)
            elif name.startswith("mkdir") and paths:
                yield Op("mkdir", paths[0], began, at)
            elif paths:
                raise AssertionError(f"the recorder does not know {name}({text[:200]}")

    def _within(self, path: str) -> str | None:
        """Relative to the watched folder; None of all but the state folder in it, and of what no start looks at."""
        if not path.startswith(f"{self._watched}/{STATE}") or path.endswith(LEFT_OUT):
            return None
        return path[len(self._watched) + 1 :]

    def _opened(self, text: str, handle: int, began: int, at: int) -> Iterator[Op]:
        path = _text(_STRING.findall(text)[0])
        self._position[str(handle), path] = 0
        self._appending.discard((str(handle), path))
        if "O_APPEND" in text:
            self._appending.add((str(handle), path))
        if (within := self._within(path)) is None:
            return
        if "O_CREAT" in text and within not in self._sizes:
            self._sizes[within] = 0
            yield Op("create", within, began, at)
        if "O_TRUNC" in text:
            self._sizes[within] = 0
            yield Op("truncate", within, began, at)

    def _on_file(self, name: str, handle: str, path: str, text: str, result: int, began: int, at: int) -> Iterator[Op]:
        if name == "write" and path == self._marks:
            yield Op("mark", began=began, at=began, what=json.loads(_bytes(_STRING.findall(text)[0])))
        elif (within := self._within(path)) is None and path != self._watched:
            return
        elif name in {"fsync", "fdatasync"}:
            yield Op("sync", within or "", began, at)
        elif name == "lseek":
            self._position[handle, path] = result
        elif name in {"write", "pwrite64"} and within is not None:
            data = _bytes(_STRING.findall(text)[0])[:result]
            offset = int(text.rpartition(",")[2]) if name == "pwrite64" else self._next(handle, path, within)
            if name == "write":
                self._position[handle, path] = offset + result
            self._sizes[within] = max(self._sizes.get(within, 0), offset + result)
            yield Op("write", within, began, at, offset, data)
        elif name == "ftruncate" and within is not None:
            self._sizes[within] = int(text.rpartition(",")[2])
            yield Op("truncate", within, began, at, self._sizes[within])
        else:
            raise AssertionError(f"the recorder does not know {name} of {path}")

    def _next(self, handle: str, path: str, within: str) -> int:
        if (handle, path) in self._appending:
            return self._sizes.get(within, 0)
        return self._position.get((handle, path), 0)


def _wire(text: str, began: int) -> Iterator[Op]:
    """Whether this sends the robot a program, or off."""
    for raw in _STRING.findall(text):
        for kind, payload in framing.Splitter().feed(_bytes(raw)):
            if kind == framing.LOAD:
                yield Op("mark", began=began, at=began, what={"loads": json.loads(payload)["program_sha256"]})
            elif kind == framing.RESUME:
                yield Op("mark", began=began, at=began, what={"resumes": True})
