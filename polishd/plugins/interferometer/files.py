"""Files of a maps folder: what they are, who reads them, and how they leave the folder."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from polishd.api import BadMap, SurfaceMap, SurfaceReader

SNIFFED_BYTES = 4096
UNFINISHED = (".tmp", ".part", ".partial", ".filepart", ".crdownload", ".swp", "~")
"""Names under which writers keep what they have not finished."""

READER_FAULTS = (OSError, ValueError, LookupError, ArithmeticError, TypeError)
"""What a reader of somebody else may raise over a broken file instead of BadMap."""


class Identity(NamedTuple):
    """What must not change while a file is trusted."""

    size: int
    mtime_ns: int
    inode: int


def identity(path: Path) -> Identity | None:
    """Identity of a regular file; None where there is none (gone, folder, link)."""
    try:
        found = path.lstat()
    except OSError:
        return None
    if not stat.S_ISREG(found.st_mode):
        return None
    return Identity(found.st_size, found.st_mtime_ns, found.st_ino)


def candidates(folder: Path, but: Iterable[Path]) -> dict[Path, Identity]:
    """Files that may be maps, oldest first: none hidden, unfinished, or in ``but``. OSError as it comes."""
    left_out = set(but)
    found = {}
    for path in folder.iterdir():
        if path.name.startswith(".") or path.name.lower().endswith(UNFINISHED) or path in left_out:
            continue
        seen = identity(path)
        if seen is not None:
            found[path] = seen
    return dict(sorted(found.items(), key=lambda item: (item[1].mtime_ns, item[0].name)))


def read_map(path: Path, readers: Sequence[SurfaceReader]) -> SurfaceMap:
    """Read with the first reader that knows the format. BadMap where nobody does, or the reader refuses."""
    try:
        with path.open("rb") as file:
            head = file.read(SNIFFED_BYTES)
    except OSError as error:
        raise BadMap(f"{path}: cannot be read: {error.strerror}") from error
    for reader in readers:
        try:
            if reader.sniff(head, path):
                return reader.read(path)
        except READER_FAULTS as error:
            raise BadMap(f"{path}: the reader {reader.name} failed: {type(error).__name__}: {error}") from error
    state = "is empty" if not head else "is in no format that is known"
    known = ", ".join(reader.name for reader in readers) or "no reader is loaded"
    raise BadMap(f"{path}: {state} (known: {known})")


def claim(path: Path, seen: Identity, folder: Path, sha256: str) -> Path | None:
    """Move a file to ``folder`` under its content's name, at one stroke; None where it changed meanwhile."""
    folder.mkdir(exist_ok=True)
    target = free(folder / f"{sha256}{path.suffix}")
    if identity(path) != seen:
        return None
    path.rename(target)
    if identity(target) == seen:
        return target
    target.rename(free(path))
    return None


def quarantine(path: Path, folder: Path, reason: str) -> Path | None:
    """Move a refused file to ``folder`` with its reason beside it; None where it is gone."""
    folder.mkdir(exist_ok=True)
    target = free(folder / path.name)
    try:
        path.rename(target)
    except FileNotFoundError:
        return None
    write_whole(target.with_name(target.name + ".reason.txt"), (reason + "\n").encode())
    return target


def free(path: Path) -> Path:
    """The path, or where it is taken already the first of ``name-1``, ``name-2``, … that is not."""
    number = 0
    found = path
    while os.path.lexists(found):
        number += 1
        found = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return found


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that nobody ever sees a part of it: temp, fsync, rename."""
    temp = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with temp.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    temp.replace(path)
    handle = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_json(path: Path, value: Any) -> None:
    """``write_whole`` of a value as JSON."""
    write_whole(path, json.dumps(value, indent=1).encode() + b"\n")
