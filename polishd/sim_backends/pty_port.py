"""A serial port for others to open: a pseudo-terminal behind a stable name."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(slots=True)
class PtyPort:
    """The device's end. ``link`` is a symbolic link to the end that the controller opens."""

    link: Path
    on_bytes: Callable[[bytes], None]
    _master: int = field(default=-1, init=False)
    _slave: int = field(default=-1, init=False)

    def open(self) -> None:
        """Make the terminal, raw, and move the link to it in one step."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        asyncio.get_running_loop().add_reader(self._master, self._readable)
        beside = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        beside.unlink(missing_ok=True)
        beside.symlink_to(os.ttyname(self._slave))
        beside.replace(self.link)

    def close(self) -> None:
        """Pull the plug: whoever has it open reads an error."""
        if self._master < 0:
            return
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    def write(self, data: bytes) -> None:
        """Send; what nobody reads is lost once the line is full."""
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)

    def _readable(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return
        if data:
            self.on_bytes(data)
