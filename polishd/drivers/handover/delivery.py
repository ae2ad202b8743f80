"""How a file gets to the controller, whole: under another name first, then renamed. FTP and SFTP: ``remote.py``."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Protocol

from polishd.api import DeviceRefused
from polishd.files import write_atomic


class Delivery(Protocol):
    """A place that the controller reads files from."""

    async def put(self, name: str, text: bytes) -> None:
        """The file is there, whole, or what was there before still is. DeviceRefused where it cannot be put there."""
        ...


class Folder:
    """A folder that the controller can read: its own share, or one that it mounts."""

    def __init__(self, path: Path) -> None:
        self._path = path

    async def put(self, name: str, text: bytes) -> None:
        """See Delivery."""
        path = self._path / name
        try:
            await asyncio.to_thread(write_atomic, path, text)  # readable by all: the controller is another user
        except OSError as error:
            raise DeviceRefused(f"{path}: {error.strerror or error}. To do: look at [robot] delivery") from error
