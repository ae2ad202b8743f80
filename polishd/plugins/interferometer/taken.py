"""Which maps were asked for, claimed, handed on and taken, by content; outlives restarts and lost renames.

A file is claimed in three steps: the record names it (``given``), it is renamed, it is handed on. Whatever is torn
off in between, the record and the names in the folder of claimed files tell how far it came.
"""

from __future__ import annotations

import hashlib
import secrets
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from polishd.api import DeviceFault, SurfaceMap
from polishd.files import write_atomic
from polishd.plugins.interferometer.files import FileIdentity

SHA256_DIGITS = 64


def heights_digest(surface: SurfaceMap) -> str:
    """Of shape and heights to 0.01 nm, whatever the file says beside them: noise makes each measurement's another."""
    hundredths = np.nan_to_num(np.round(surface.height_nm * 100.0), nan=-(2.0**60)) + 0.0  # no negative zero
    return hashlib.sha256(f"{surface.height_nm.shape}".encode() + hundredths.astype("<f8").tobytes()).hexdigest()


class DeliveredMap(BaseModel):
    """A file that is to be handed on, recorded before it is moved."""

    model_config = ConfigDict(frozen=True)

    sha256: str
    name: str
    """As it lay in the folder."""
    claimed: str
    """Its name among the claimed files."""
    source: str
    """Part and instrument: what ``measured`` may be compared within."""
    measured: datetime | None
    """By the instrument's clock."""
    heights: str = ""
    """``heights_digest`` of the map."""
    times: int = 0
    """How often it was handed on."""


class MapRequest(BaseModel):
    """What is waited for; the same until another map has been taken, also across restarts."""

    after: str | None
    token: str
    """A file with this in its name is an answer, whatever the clocks say."""
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
        """What was claimed for this ask, and has not come into the daemon's hands. OSError where that cannot be told.

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
