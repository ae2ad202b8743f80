"""One daemon per state folder: an flock that the kernel drops when its holder ends, however it ends."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from polishd.files import make_folder
from polishd.model.errors import ConfigError

LOCK_NAME = "lock"


@contextmanager
def locked(state_dir: Path) -> Iterator[None]:
    """Exclusive use of a cell's state folder (made, 0700) inside this block; ConfigError names the pid that has it.

    The file stays: removing it would let two daemons lock two files of one name.
    """
    try:
        make_folder(state_dir, mode=0o700)
        handle = os.open(state_dir / LOCK_NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise unusable(state_dir, error) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            pid = os.pread(handle, 32, 0).decode("ascii", "replace").strip() or "unknown"
            raise ConfigError(
                f"{state_dir}: another polishd runs this cell (pid {pid}); "
                "stop it first (polishd stop), or give this cell a state_dir of its own"
            ) from error
        try:
            os.ftruncate(handle, 0)
            os.pwrite(handle, f"{os.getpid()}\n".encode(), 0)
        except OSError as error:
            raise unusable(state_dir, error) from error
        yield
        os.ftruncate(handle, 0)
    finally:
        os.close(handle)


def unusable(state_dir: Path, error: OSError) -> ConfigError:
    """What the system says of a state folder that is full, read-only, or somebody else's."""
    where = error.filename or state_dir
    return ConfigError(f"{where}: the state folder cannot be used: {error.strerror}; mend it, or change cell.state_dir")
