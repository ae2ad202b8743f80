"""A disk that loses power: what may be on it afterwards of what was written and not yet synced.

Kept for certain is what an fsync of the file, and for its name an fsync of its folder, has covered. Of all else each
act may be there or not, whatever came later is; a write may be there in some of its sectors, or as nothing but length.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from tests.campaigns.crash.recording import STATE, Op, files_in

SECTOR = 512
FOLDER = -1
"""In place of a file's number: the name is a folder's."""
Files = Mapping[str, bytes]


@dataclass(slots=True)
class _File:
    """One file, whatever it is called."""

    kept: bytes = b""
    pending: list[Op] = field(default_factory=list)

    def sync(self, before: int) -> None:
        """What was over before is durable."""
        self.kept = _content(self.kept, ((op, op.data) for op in self.pending if op.at < before))
        self.pending = [op for op in self.pending if op.at >= before]


@dataclass(slots=True)
class Disk:
    """Files and folders below one folder that was there before."""

    files: list[_File] = field(default_factory=list)
    names: dict[str, int] = field(default_factory=dict)
    """As a program sees them: path to the file's number."""
    durable: dict[str, int] = field(default_factory=dict)
    entries: list[tuple[Op, Mapping[str, int | None]]] = field(default_factory=list)
    """Changes of names that are not durable."""

    @classmethod
    def of(cls, files: Files) -> Disk:
        """One with these files in the state folder."""
        names = {path: number for number, path in enumerate(files)} | ({STATE: FOLDER} if files else {})
        return cls([_File(data) for data in files.values()], dict(names), names)

    def apply(self, op: Op) -> bool:
        """The next act; whether it may change what is on the disk after a crash."""
        if op.kind == "mark":
            return False
        if op.kind in {"write", "truncate"}:
            self.files[self.names[op.path]].pending.append(op)
        elif op.kind == "sync":
            self._sync(op)
        else:
            self._rename(op)
        return True

    def pending(self) -> int:
        """How many acts a crash may undo."""
        return len(self.entries) + sum(len(file.pending) for file in self.files)

    def seen(self) -> Files:
        """What a program sees: no crash."""
        return {path: _content(self.files[n].kept, ((op, op.data) for op in self.files[n].pending))
                for path, n in self.names.items() if n != FOLDER}  # fmt: skip

    def require_complete(self, folder: Path) -> None:
        """The recording has all that was done: without a crash it gives the files that are there."""
        assert self.seen() == files_in(folder)

    def crashed(self, variant: int, seed: str) -> Files:
        """What a crash now may leave; the first variants are the plain ones, all others are drawn by the seed."""
        luck = random.Random(f"{seed} {variant}")
        names, data = ((1.0, 1.0), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0))[variant] if variant < 4 else (
            luck.choice((0.1, 0.5, 0.9, 1.0)), luck.choice((0.1, 0.5, 0.9, 1.0)))  # fmt: skip
        torn = luck.choice((0.0, 0.1, 0.5)) if variant >= 4 else 0.0
        found = dict(self.durable)
        for _, change in self.entries:
            if luck.random() < names:
                found.update({path: n for path, n in change.items() if n is not None})
                for path in (path for path, n in change.items() if n is None):
                    found.pop(path, None)
        return {path: self._left(self.files[n], luck, data, torn)
                for path, n in found.items() if n != FOLDER and _there(path, found)}  # fmt: skip

    def _left(self, file: _File, luck: random.Random, data: float, torn: float) -> bytes:
        if not file.pending:
            return file.kept
        kept = [(op, _torn(op, luck) if op.data and luck.random() < torn else op.data)
                for op in file.pending if luck.random() < data]  # fmt: skip
        return _content(file.kept, kept)

    def _sync(self, op: Op) -> None:
        if self.names.get(op.path, FOLDER) != FOLDER:
            self.files[self.names[op.path]].sync(op.began)
            return
        left = []
        for made, change in self.entries:
            if made.at < op.began and all(str(PurePosixPath(path).parent) == (op.path or ".") for path in change):
                _named(self.durable, change)
            else:
                left.append((made, change))
        self.entries = left

    def _rename(self, op: Op) -> None:
        change: dict[str, int | None]
        if op.kind == "create":
            self.files.append(_File())
            change = {op.path: len(self.files) - 1}
        elif op.kind == "rename":
            change = {op.path: None, op.to: self.names[op.path]}
        else:
            change = {op.path: FOLDER if op.kind == "mkdir" else None}
        _named(self.names, change)
        self.entries.append((op, change))


def _named(names: dict[str, int], change: Mapping[str, int | None]) -> None:
    for path, number in change.items():
        if number is None:
            names.pop(path, None)
        else:
            names[path] = number


def _there(path: str, names: Mapping[str, int]) -> bool:
    """Whether its folders are."""
    return all(names.get(str(folder)) == FOLDER for folder in PurePosixPath(path).parents if str(folder) != ".")


def _content(before: bytes, writes: Iterable[tuple[Op, bytes | Mapping[int, bytes]]]) -> bytes:
    content = bytearray(before)
    for op, data in writes:
        if op.kind == "truncate":
            del content[op.offset :]
            content.extend(bytes(op.offset - len(content)))
            continue
        end = op.offset + len(op.data)
        content.extend(bytes(max(0, end - len(content))))
        for offset, piece in {op.offset: data}.items() if isinstance(data, bytes) else data.items():
            content[offset : offset + len(piece)] = piece
    return bytes(content)


def _torn(op: Op, luck: random.Random) -> Mapping[int, bytes]:
    """Some sectors of a write: from its beginning, any, or none (its length alone)."""
    end = op.offset + len(op.data)
    edges = [op.offset, *range((op.offset // SECTOR + 1) * SECTOR, end, SECTOR), end]
    sectors = list(itertools.pairwise(edges))
    kind = luck.randrange(3)
    kept = sectors[: luck.randrange(len(sectors))] if kind == 0 else []
    if kind == 1:
        kept = [sector for sector in sectors if luck.random() < 0.5]
    return {a: op.data[a - op.offset : b - op.offset] for a, b in kept}
