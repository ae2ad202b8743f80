"""Files of a maps folder: wait until they are stable, read them, and move them out of the folder.

Each poll scans the whole folder; file system events are not needed.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import stat
import tempfile
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from heapq import nlargest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from polishd.api import DeviceFault, MapError, SurfaceMap, SurfaceReader
from polishd.hookspecs import looks_like
from polishd.util.files import sync_folder, write_atomic

SNIFFED_BYTES = 4096
LEAST_LOOKS = 100
"""Least number of the newest files, and of the others, that a poll checks, however slow the folder is."""
UNFINISHED = (".tmp", ".part", ".partial", ".filepart", ".crdownload", ".swp", "~")
"""Names that writers use for unfinished files."""

ZERO_TAIL_BYTES = 4096
"""More zeros at the end mean a preallocated file: FITS pads with at most 2880, and each reader checks more closely."""
HDF5, HDF5_ZERO_TAIL = b"\x89HDF\r\n\x1a\n", 1 / 16
"""HDF5 may leave room at its end: 3478 bytes of 131,672 in a sound ``.datx``."""


class FileIdentity(NamedTuple):
    """Properties that must not change while a file is trusted."""

    size: int
    mtime_ns: int
    inode: int


def identity(path: Path) -> FileIdentity | None:
    """Identity of a regular file; None where there is none (gone, folder, link)."""
    try:
        found = path.lstat()
    except OSError:
        return None
    if not stat.S_ISREG(found.st_mode):
        return None
    return FileIdentity(found.st_size, found.st_mtime_ns, found.st_ino)


def _names(folder: Path, but: Iterable[Path]) -> list[str]:
    """Names that may be maps: none hidden, unfinished, or in ``but``. OSError as it comes."""
    left_out = {path.name for path in but if path.parent == folder}
    with os.scandir(folder) as entries:
        names = [entry.name for entry in entries]
    return [
        name
        for name in names
        if not name.startswith(".") and not name.lower().endswith(UNFINISHED) and name not in left_out
    ]


def candidates(folder: Path, but: Iterable[Path]) -> dict[Path, FileIdentity]:
    """Files that may be maps, by name: none hidden, unfinished, or in ``but``. OSError as it comes."""
    paths = [folder / name for name in sorted(_names(folder, but))]
    return {path: seen for path in paths if (seen := identity(path)) is not None}


class FolderListing:
    """Files of a folder that may be maps, over polls. However many there are, a poll takes bounded time.

    Names that were not there at the poll before come first, then the newest files, then names that were never looked
    at, then the files that were not looked at for longest.
    """

    def __init__(self, folder: Path, but: Sequence[Path]) -> None:
        self._folder, self._but = folder, but
        self._known: dict[str, FileIdentity | None] = {}
        """In the order in which they were looked at; None: no regular file."""
        self._before: set[str] | None = None
        """Names of the last poll."""

    def __len__(self) -> int:
        """Return the number of names that are there."""
        return len(self._before or ())

    def look(self, within_s: float) -> tuple[dict[Path, FileIdentity], set[Path]]:
        """Return the files that were looked at now, the newest first, and the others that are there still.

        OSError as it comes.
        """
        end_s = time.monotonic() + within_s
        least = 2 * LEAST_LOOKS
        names = _names(self._folder, self._but)
        there = set(names)
        self._known = {name: seen for name, seen in self._known.items() if name in there}
        found: dict[Path, FileIdentity] = {}
        looked: set[str] = set()
        dated = ((seen.mtime_ns, name) for name, seen in self._known.items() if seen is not None)
        newest = [name for _, name in nlargest(LEAST_LOOKS, dated)]
        came = there - self._before if self._before is not None else ()
        unknown = (name for name in names if name not in self._known)
        self._before = there
        for name in dict.fromkeys([*came, *newest, *unknown, *self._known]):
            if len(looked) >= least and time.monotonic() > end_s:
                break
            path = self._folder / name
            seen = identity(path)
            self._known.pop(name, None)
            self._known[name] = seen
            looked.add(name)
            if seen is not None:
                found[path] = seen
        others = {self._folder / name for name, seen in self._known.items() if seen is not None and name not in looked}
        return dict(sorted(found.items(), key=lambda one: (-one[1].mtime_ns, one[0].name))), others


@dataclass(slots=True)
class FileStability:
    """A file since it last changed. All times are monotonic, so setting the clock has no effect."""

    identity: FileIdentity
    since_s: float
    not_before_s: float
    polls: int = 1
    reads: int = 0
    """How often it was read and left where it is."""


class SettledFiles:
    """Follow files over polls: at rest means same size, mtime and inode for so many polls and seconds."""

    def __init__(self, polls: int, seconds: float) -> None:
        self._polls = polls
        self._seconds = seconds
        self._watched: dict[Path, FileStability] = {}

    def poll(self, found: Mapping[Path, FileIdentity], now_s: float, others: Collection[Path] = ()) -> list[Path]:
        """Take the result of a scan and return the files at rest, except postponed ones.

        ``others`` exist but were not checked. Files that were read least often come first, then the scan's order.
        """
        watched = {path: self._watched[path] for path in others if path in self._watched}
        for path, identity in found.items():
            before = self._watched.get(path)
            if before is None or before.identity != identity:
                watched[path] = FileStability(identity, now_s, now_s + self._seconds)
            else:
                before.polls += 1
                watched[path] = before
        self._watched = watched
        rested = [path for path in found if self._is_at_rest(watched[path], now_s)]
        return sorted(rested, key=lambda path: watched[path].reads)

    def _is_at_rest(self, one: FileStability, now_s: float) -> bool:
        return one.polls >= self._polls and now_s >= one.not_before_s

    def rest_s(self, now_s: float, most_s: float) -> float:
        """Seconds until the next file will have rested long enough; at most ``most_s``."""
        left = [one.not_before_s - now_s for one in self._watched.values() if one.not_before_s > now_s]
        return min([most_s, *left])

    def put_off(self, path: Path, now_s: float) -> None:
        """Postpone an incomplete file: check it again after the same rest, or when it changes."""
        if path in self._watched:
            self._watched[path].not_before_s = now_s + self._seconds
            self._watched[path].reads += 1

    def quiet_s(self, path: Path, now_s: float) -> float:
        """Seconds since the file last changed."""
        one = self._watched.get(path)
        return now_s - one.since_s if one else 0.0


def clock_of(folder: Path) -> datetime:
    """Time of the clock that dates new files in ``folder``: on a share the server's clock."""
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".clock.", suffix=".tmp") as probe:
        probe.write(b"\n")
        probe.flush()
        return datetime.fromtimestamp(os.fstat(probe.fileno()).st_mtime, UTC)


def sha256_of(path: Path) -> str:
    """Hash of a file's whole content. OSError as it comes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_map(path: Path, readers: Sequence[SurfaceReader]) -> SurfaceMap:
    """Read with the first reader that knows the format; the map's ``sha256`` is of the file as it was read.

    MapError where the format is unknown, the reader refuses, or the file was written to meanwhile. OSError where the
    file cannot be opened; the map may still be good.
    """
    sha256 = sha256_of(path)
    surface = _read(path, readers)
    if surface.sha256 not in ("", sha256):
        raise MapError(f"{path}: it was written to while it was read")
    return replace(surface, sha256=sha256, path=path)


def _read(path: Path, readers: Sequence[SurfaceReader]) -> SurfaceMap:
    with path.open("rb") as file:
        head = file.read(SNIFFED_BYTES)
        size, zeros = file.seek(0, os.SEEK_END), _zeros_at_end(file.fileno())
    allowed = max(ZERO_TAIL_BYTES, HDF5_ZERO_TAIL * size) if head.startswith(HDF5) else ZERO_TAIL_BYTES
    if zeros > allowed or (size and zeros == size):
        raise MapError(
            f"{path}: ends in a tail of zeros, {zeros} of {size} bytes: preallocated, not written to its end"
        )
    for reader in readers:
        try:
            surface = reader.surface_of(head, path)
        except MapError as error:
            if isinstance(error.__cause__, OSError) and error.__cause__.errno:
                raise error.__cause__ from None  # the share, not the map
            raise
        if surface is not None:
            return surface
    state = "is empty" if not head else "is in no format that is known"
    known = ", ".join(reader.name for reader in readers) or "no reader is loaded"
    raise MapError(f"{path}: {state} (known: {known}){looks_like(readers, head, path)}")


def _zeros_at_end(handle: int, block: int = 1 << 16) -> int:
    """How many bytes of exact zero a file ends with."""
    zeros, end = 0, os.fstat(handle).st_size
    while end > 0:
        start = max(0, end - block)
        content = os.pread(handle, end - start, start)
        kept = len(content.rstrip(b"\0"))
        zeros += len(content) - kept
        if kept or not content:
            break
        end = start
    return zeros


def claim_file(path: Path, seen: FileIdentity, target: Path, sha256: str) -> bool:
    """Move a file atomically if it is still the file that was read; False where it changed (it stays watched).

    OSError is passed on; the presence of ``target`` then shows whether the file was moved.
    """
    target.parent.mkdir(exist_ok=True)
    if identity(path) != seen or os.path.lexists(target):
        return False
    path.rename(target)
    _settle(path.parent, target.parent)
    return identity(target) == seen and is_unchanged(target, sha256, path)


def is_unchanged(target: Path, sha256: str, path: Path) -> bool:
    """Check a claimed file against the hash in its name; return a file that was changed to the folder."""
    if sha256_of(target) == sha256:
        return True
    target.rename(release_file(path))
    return False


def quarantine_file(path: Path, folder: Path, reason: str) -> Path | None:
    """Write the reason into ``folder``, then move the refused file there; None where the file is gone."""
    folder.mkdir(exist_ok=True)
    if not os.path.lexists(path):
        return None
    target = release_file(folder / path.name)
    write_atomic(target.with_name(target.name + ".reason.txt"), (reason + "\n").encode())
    path.rename(target)
    _settle(path.parent, folder)
    return target


def release_file(path: Path) -> Path:
    """The path, or the first free one of ``name-1``, ``name-2``, … where it exists."""
    number = 0
    found = path
    while os.path.lexists(found):
        number += 1
        found = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return found


def _settle(*folders: Path) -> None:
    """Make a move durable. Where a share cannot, the record holds the intended state."""
    for folder in folders:
        with suppress(OSError):
            sync_folder(folder)


# Record of requested, claimed, delivered and taken maps, by content; it survives restarts and lost renames.

SHA256_DIGITS = 64


def heights_digest(surface: SurfaceMap) -> str:
    """Hash of shape and heights to 0.01 nm, without the rest of the file: noise makes each measurement unique."""
    hundredths = np.nan_to_num(np.round(surface.height_nm * 100.0), nan=-(2.0**60)) + 0.0  # no negative zero
    return hashlib.sha256(f"{surface.height_nm.shape}".encode() + hundredths.astype("<f8").tobytes()).hexdigest()


class DeliveredMap(BaseModel):
    """A file to be delivered, recorded before it is moved."""

    model_config = ConfigDict(frozen=True, defer_build=True)

    sha256: str
    name: str
    """Its name in the folder."""
    claimed: str
    """Its name among the claimed files."""
    source: str
    """Part and instrument; ``measured`` is comparable only within one source."""
    measured: datetime | None
    """By the instrument's clock."""
    heights: str = ""
    """``heights_digest`` of the map."""
    times: int = 0
    """Number of deliveries."""


class MapRequest(BaseModel):
    """The request for a map; it is kept until another map is taken, also across restarts."""

    model_config = ConfigDict(defer_build=True)

    after: str | None
    token: str
    """A file with this token in its name answers the request, independent of the clocks."""
    since: datetime | None
    """By the folder's clock: maps measured earlier are stale; None: any map will do."""
    present: dict[str, FileIdentity] = Field(default_factory=dict)
    """What lay in the folder when it was asked."""
    given: dict[str, DeliveredMap] = Field(default_factory=dict)
    """By sha256: what was claimed for it."""
    part: str = ""
    """Whose map is asked for; empty in a record of an earlier version."""


class Record(BaseModel):
    """The content of the file."""

    model_config = ConfigDict(defer_build=True)

    ask: MapRequest | None = None
    taken: list[str] = Field(default_factory=list)
    last: dict[str, datetime] = Field(default_factory=dict)
    """By source: when the last map that was taken was measured, by the instrument's clock."""
    heights: dict[str, str] = Field(default_factory=dict)
    """By ``heights_digest``: the part that a map was taken for."""


class TakenMaps:
    """The sha256 of every map ever taken, in a file of the state folder and in the names of the claimed files."""

    def __init__(self, path: Path, claimed: Path) -> None:
        self._path = path
        self._claimed = claimed
        self._record = Record()
        self._taken: set[str] = set()
        self._handed: set[str] = set()
        self._handed_before: set[str] = set()
        """By an earlier process, as far as the record knows."""

    def load(self) -> None:
        """Read the record, and the names of the claimed files. DeviceFault where the record cannot be read."""
        try:
            self._record = Record.model_validate_json(self._path.read_bytes())
        except FileNotFoundError:
            self._record = Record()
        except (OSError, ValidationError) as error:
            raise DeviceFault(
                f"{self._path}: the record of the maps taken cannot be read ({error}). "
                "To do: mend it, or remove it and empty the maps folder of old maps."
            ) from error
        self._taken = set(self._record.taken)
        given = self._record.ask.given if self._record.ask else {}
        self._handed_before = {one.sha256 for one in given.values() if one.times}
        if self._claimed.is_dir():
            names = (path.name[:SHA256_DIGITS] for path in self._claimed.iterdir() if not path.name.startswith("."))
            self._taken |= {name for name in names if len(name) == SHA256_DIGITS and name not in given}

    def __contains__(self, sha256: str) -> bool:
        return sha256 in self._taken or sha256 in self._handed

    def last(self, source: str) -> datetime | None:
        """When the last map that was taken of this part with this instrument was measured; None: not known."""
        return self._record.last.get(source)

    @property
    def any(self) -> bool:
        """Whether a map was ever taken, as far as record and folder tell."""
        return bool(self._taken or self._record.heights or self._record.last)

    def other_part(self, heights: str, part: str) -> str:
        """Another part that a map with these heights was taken for; empty where there is none."""
        found = self._record.heights.get(heights, part)
        return "" if found == part else found

    def ask(self, after: str | None, part: str) -> MapRequest | None:
        """What is asked already for that part's map after ``after``; None: nothing.

        A map that was asked for before this part was in may show the last one: another part is another ask.
        """
        ask = self._record.ask
        return ask if ask is not None and ask.after == after and ask.part in ("", part) else None

    def asked_for_other(self, part: str) -> MapRequest | None:
        """What is asked for another part; None: nothing."""
        ask = self._record.ask
        return ask if ask is not None and ask.part not in ("", part) else None

    def begin(
        self, after: str | None, since: datetime | None, present: dict[str, FileIdentity], part: str
    ) -> MapRequest:
        """Ask anew, durably: what was claimed for the ask before is taken for good."""
        ask = MapRequest(after=after, token=secrets.token_hex(4), since=since, present=present, part=part)
        before = self._record.ask.given.values() if self._record.ask else ()
        done = [one.sha256 for one in before if one.sha256 in (*self._handed, after) or self._lies(one)]
        self._taken.update(done)
        taken = [*dict.fromkeys([*self._record.taken, *done])]
        self._save(self._record.model_copy(update={"ask": ask, "taken": taken}))
        return ask

    def pending(self, ask: MapRequest) -> list[DeliveredMap]:
        """Files claimed for this request that the daemon has not received. OSError where the folder cannot be read.

        One that an earlier process handed on counts, for the journal does not name it; not so where the journal names
        no map at all: it may be a new one.
        """
        but = self._handed if ask.after is not None else self._handed | self._handed_before
        return [one for one in ask.given.values() if one.sha256 not in but and self._lies(one)]

    def give(self, ask: MapRequest, given: DeliveredMap) -> None:
        """Record, durably, that a file is about to be claimed."""
        self._update(ask, given)

    def hand_on(self, ask: MapRequest, given: DeliveredMap) -> None:
        """Record, durably, that a claimed map is handed on now."""
        last, heights = dict(self._record.last), dict(self._record.heights)
        if given.measured is not None:
            last[given.source] = given.measured
        if given.heights:
            heights.setdefault(given.heights, ask.part)
        self._update(ask, given.model_copy(update={"times": given.times + 1}), last=last, heights=heights)

    def handed(self, sha256: str) -> None:
        """The map is in the daemon's hands."""
        self._handed.add(sha256)

    def _lies(self, given: DeliveredMap) -> bool:
        try:
            (self._claimed / given.claimed).lstat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        return True

    def _update(self, ask: MapRequest, given: DeliveredMap, **also: Any) -> None:
        kept = {**ask.given, given.sha256: given}
        new = ask.model_copy(update={"given": kept})
        self._save(self._record.model_copy(update={"ask": new, **also}))
        ask.given = kept

    def _save(self, record: Record) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self._path, record.model_dump_json(indent=1).encode() + b"\n")
        self._record = record
