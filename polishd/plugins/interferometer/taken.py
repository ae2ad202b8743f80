"""Which maps have been taken, by content; outlives restarts."""

from __future__ import annotations

import json
from pathlib import Path

from polishd.api import DeviceFault
from polishd.plugins.interferometer.files import write_json


class Taken:
    """The sha256 of every map ever taken, in a file of the state folder and in the names of the claimed files."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._hashes: list[str] = []

    def load(self, claimed: Path) -> None:
        """Read the record, and the names in ``claimed``: a file may be claimed and not yet recorded."""
        hashes: list[str] = []
        if self._path.exists():
            try:
                record = json.loads(self._path.read_bytes())
                hashes = [str(sha256) for sha256 in record["taken"]]
            except (OSError, ValueError, TypeError, KeyError) as error:
                raise DeviceFault(
                    f"{self._path}: the record of the maps taken cannot be read ({error}). "
                    "To do: mend it, or remove it and empty the maps folder of old maps."
                ) from error
        if claimed.is_dir():
            hashes += sorted(path.name[:64] for path in claimed.iterdir() if len(path.stem) >= 64)
        self._hashes = list(dict.fromkeys(hashes))

    def __contains__(self, sha256: str) -> bool:
        return sha256 in self._hashes

    def add(self, sha256: str) -> None:
        """Record one, durably."""
        self._hashes.append(sha256)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_json(self._path, {"taken": self._hashes})
