"""Files written whole: a reader, or a power cut, sees the old content or the new, never half of one."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from polishd.model.errors import ConfigError

PROBE_BYTES = 4096


@contextlib.contextmanager
def whole_file(path: Path, mode: int = 0o644) -> Iterator[BinaryIO]:
    """A file to write, which becomes ``path`` at the end: temporary file beside it, fsync, rename, fsync of the folder.

    It can be read back meanwhile. The folder must exist. On any error ``path`` is what it was, and no temporary file
    stays behind.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is there, and is no file")
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    try:
        with os.fdopen(handle, "w+b") as file:
            os.fchmod(file.fileno(), mode)
            yield file
            file.flush()
            os.fsync(file.fileno())
        Path(name).replace(path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            Path(name).unlink()
        raise
    sync_folder(path.parent)


def write_atomic(path: Path, content: bytes, mode: int = 0o644) -> None:
    """Write ``content`` to ``path``, whole."""
    with whole_file(path, mode) as file:
        file.write(content)


def toml_text(path: Path) -> str:
    """A TOML file's text, without the byte-order mark and the line ends of other systems. ConfigError."""
    try:
        return path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name a TOML file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error


def require_writable(folder: Path) -> None:
    """ConfigError unless files can be written in the folder, or, where it is not there yet, in the one above it.

    For what is computed for long, and written then.
    """
    try:
        nearest = next(path for path in (folder, *folder.parents) if path.exists())
        with tempfile.TemporaryFile(prefix=".polishd.", dir=nearest) as probe:
            probe.write(b"\0" * PROBE_BYTES)
            probe.flush()
    except OSError as error:
        raise unwritable_message(folder, error) from error


def require_new(out: Path) -> None:
    """Raise ConfigError unless the folder does not exist or is empty."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ConfigError(f"{out}: exists already; name a new folder with --out")


def unwritable_message(path: Path, error: OSError) -> ConfigError:
    """Return the message for a file or folder of ``--out`` that cannot be written."""
    todo = "make room, or name another with --out" if error.errno == errno.ENOSPC else "name another with --out"
    return ConfigError(f"{path}: cannot be written: {error.strerror}; {todo}")


def make_folder(folder: Path, mode: int = 0o777) -> None:
    """The folder, and those above it, where they are not there yet; a power cut does not take them away again."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True, mode=mode)
    for path in missing:
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make renames and new names in ``folder`` durable; some network shares cannot, and say so."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)
