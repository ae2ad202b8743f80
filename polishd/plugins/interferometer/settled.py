"""Which files of a folder have come to rest. Events are not needed: a full scan at each poll is the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from polishd.plugins.interferometer.files import Identity


@dataclass(slots=True)
class Watched:
    """A file since it last changed. All times are monotonic: no clock that can be set has a say."""

    identity: Identity
    since_s: float
    not_before_s: float
    polls: int = 1


class Settled:
    """Follows files over polls: at rest means same size, mtime and inode for so many polls and seconds."""

    def __init__(self, polls: int, seconds: float) -> None:
        self._polls = polls
        self._seconds = seconds
        self._watched: dict[Path, Watched] = {}

    def poll(self, found: Mapping[Path, Identity], now_s: float) -> list[Path]:
        """Take in what a scan found; the files at rest, in its order, but those that were put off."""
        watched = {}
        for path, identity in found.items():
            before = self._watched.get(path)
            if before is None or before.identity != identity:
                watched[path] = Watched(identity, now_s, now_s + self._seconds)
            else:
                before.polls += 1
                watched[path] = before
        self._watched = watched
        return [path for path, one in watched.items() if one.polls >= self._polls and now_s >= one.not_before_s]

    def rest_s(self, now_s: float, most_s: float) -> float:
        """Seconds until the next file will have rested long enough; at most ``most_s``."""
        left = [one.not_before_s - now_s for one in self._watched.values() if one.not_before_s > now_s]
        return min([most_s, *left])

    def put_off(self, path: Path, now_s: float) -> None:
        """It was read and is not whole: look again after as long a rest, or when it changes."""
        if path in self._watched:
            self._watched[path].not_before_s = now_s + self._seconds

    def quiet_s(self, path: Path, now_s: float) -> float:
        """Seconds since the file last changed."""
        one = self._watched.get(path)
        return now_s - one.since_s if one else 0.0
