"""Which files of a folder have come to rest. Events are not needed: a full scan at each poll is the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from polishd.plugins.interferometer.files import Identity


@dataclass(slots=True)
class Watched:
    """A file since it last changed."""

    identity: Identity
    since_s: float
    polls: int = 1


class Settled:
    """Follows files over polls: at rest means same size, mtime and inode for so many polls and seconds."""

    def __init__(self, polls: int, seconds: float) -> None:
        self._polls = polls
        self._seconds = seconds
        self._watched: dict[Path, Watched] = {}

    def poll(self, found: Mapping[Path, Identity], now_s: float) -> list[Path]:
        """Take in what a scan found; the files at rest, in its order."""
        watched = {}
        for path, identity in found.items():
            before = self._watched.get(path)
            if before is None or before.identity != identity:
                watched[path] = Watched(identity, now_s)
            else:
                before.polls += 1
                watched[path] = before
        self._watched = watched
        return [path for path, one in watched.items() if one.polls >= self._polls and self._rested(one, now_s)]

    def quiet_s(self, path: Path, now_s: float) -> float:
        """Seconds since the file last changed."""
        one = self._watched.get(path)
        return now_s - one.since_s if one else 0.0

    def _rested(self, one: Watched, now_s: float) -> bool:
        return now_s - one.since_s >= self._seconds
