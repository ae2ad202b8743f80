"""Files that are read, files written whole, and secrets.

A reader, or a power cut, sees the old content or the new, never half of one. A config names the location of a secret,
never its value, which is used at once and never logged.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shlex
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping
from io import BufferedReader
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, BinaryIO

from polishd.model.errors import ConfigError

PROBE_BYTES = 4096
MOST_BYTES = 1 << 30
"""No file that is read whole is larger."""
MOST_TOML_BYTES = 1 << 24
_PIECE = 1 << 20


def open_input(path: Path) -> BufferedReader:
    """Open a file that a user names, to be read. OSError; for a device, too: it may have no end (``/dev/zero``).

    A pipe is opened as a file is: ``polishd check <(...)``, ``/dev/stdin``.
    """
    mode = path.stat().st_mode
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        raise OSError(errno.EINVAL, "it is a device, not a file", str(path))
    return path.open("rb")


def read_input(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the content of a file that a user names. OSError; for a device or a larger file, too."""
    with open_input(path) as file:
        return read_all(file, most_bytes)


def read_all(file: BinaryIO, most_bytes: int = MOST_BYTES) -> bytes:
    """Return what is left of a file or a pipe; OSError where that is larger."""
    # what is asked for is allocated first: no more than there is; the size of a pipe is 0
    pieces = [file.read(min(os.fstat(file.fileno()).st_size, most_bytes) + 1)]
    size = len(pieces[0])
    while size <= most_bytes and (piece := file.read(_PIECE)):
        pieces.append(piece)
        size += len(piece)
    if size > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes >> 20} MiB", str(file.name))
    return b"".join(pieces)


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
    except BaseException as error:
        if isinstance(error, OSError):
            error.filename = str(path)  # write(2) names none, the rest the temporary one
        with contextlib.suppress(FileNotFoundError):
            Path(name).unlink()
        raise
    sync_folder(path.parent)


def write_atomic(path: Path, content: bytes, mode: int = 0o644) -> None:
    """Write ``content`` to ``path``, whole."""
    with whole_file(path, mode) as file:
        file.write(content)


def write_together(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files by name into ``folder``, each whole; on an error before all are complete, none."""
    with contextlib.ExitStack() as stack:
        for name, content in files.items():
            file = stack.enter_context(whole_file(folder / name))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # a full disk shows here, before the first file gets its name


def named_path(base: Path, named: str | Path) -> Path:
    """Return a path that a file or an operator names, from ``base``, with ``~`` as a home folder.

    ``~name`` of no user stays as it is: no such file is found then. ConfigError for a NUL character.
    """
    text = str(named)
    if "\0" in text:
        raise ConfigError(f"{base}: the path {text!r} contains a NUL character, as no file's name does; correct it")
    return base / os.path.expanduser(text)  # noqa: PTH111 - Path.expanduser raises RuntimeError where no such user is


def toml_text(path: Path) -> str:
    """A TOML file's text, without the byte-order mark and the line ends of other systems. ConfigError."""
    try:
        return read_input(path, MOST_TOML_BYTES).decode("utf-8-sig").replace("\r\n", "\n")
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


def require_writable_file(path: Path) -> None:
    """ConfigError unless a file of that name can be written: for what is computed for long, or one file of several."""
    if path.exists() and not path.is_file():
        raise ConfigError(f"{path}: is there, and is no regular file; name another")
    if not path.parent.is_dir():
        raise ConfigError(f"{path.parent}: is not a folder; make it, or name a file in another")
    require_writable(path.parent)


def require_new_file(path: Path, *, force: bool) -> None:
    """ConfigError where a file of that name exists and may not be replaced."""
    if path.is_file() and not force:
        raise ConfigError(f"{path}: exists already; name another file, or say --force")


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


# Secrets: read from a private file or the environment, and hidden in texts.

HIDDEN = "***"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def _secret_place(value: Any) -> Any:
    """The value is not repeated in the refusal: it may be the secret itself."""
    kind, _, name = value.partition(":") if isinstance(value, str) else ("", "", "")
    if kind not in {"file", "env"} or not name.strip():
        raise ValueError(
            'a secret does not stand in a config; say where it is kept: "file:NAME" (only its owner may read it) or '
            '"env:VARIABLE"'
        )
    return value


class _BeforeString:
    """Validates by ``_secret_place`` in a pydantic model; pydantic itself takes 0.1 s of a command's start."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(_secret_place, handler(source))


SecretPlace = Annotated[str, _BeforeString()]
"""A key of a pydantic model: ``file:NAME`` (relative to the cell's file) or ``env:VARIABLE``."""


def require_private(path: Path, where: str = "") -> None:
    """Refuse a file with a secret that its group or others may read, change or run. ConfigError; OSError as it comes.

    ``where``: what begins the message.
    """
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & _OTHERS:
        raise ConfigError(
            f"{where}mode {mode:04o} of {path} gives its secret to others than its owner. Run: "
            f"chmod {mode & stat.S_IRWXU & ~stat.S_IXUSR | stat.S_IRUSR:o} {shlex.quote(str(path))}"
        )


def read_secret(place: str, base_dir: Path) -> str:
    """The secret, without blanks around it. ConfigError, which quotes the place, where there is none to be read."""
    kind, _, name = place.partition(":")
    found = (os.environ.get(name, "") if kind == "env" else _from_file(place, named_path(base_dir, name))).strip()
    if not found or not found.isprintable():
        raise ConfigError(f"{place!r}: holds no secret (one line of text); write it there")
    return found


def _from_file(place: str, path: Path) -> str:
    try:
        require_private(path, f"{place!r}: ")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{place!r}: cannot be read: {path}: {error.strerror}; write the secret there") from error
    except UnicodeDecodeError:
        raise ConfigError(f"{place!r}: {path} is no UTF-8 text; write the secret there") from None


_WORKERS_NAMES = frozenset(
    {
        "HOME", "LANG", "LANGUAGE", "LD_LIBRARY_PATH", "LOGNAME", "MPLBACKEND", "MPLCONFIGDIR", "PATH", "SHELL", "TEMP",
        "TERM", "TMP", "TMPDIR", "TZ", "USER", "VIRTUAL_ENV",
    }
)  # fmt: skip
_WORKERS_PREFIXES = (
    "COVERAGE_", "CUDA_", "EMC2_", "HDF5_", "JAX_", "LC_", "LINUXCNC", "MKL_", "NUMBA_", "NUMEXPR_", "OMP_",
    "OPENBLAS_", "PYTHON", "XDG_", "XLA_",
)  # fmt: skip


def environment_without_secrets(more: Mapping[str, str] = MappingProxyType({})) -> dict[str, str]:
    """Return the environment for a worker that reads foreign files: what Python and its libraries need, and ``more``.

    Everything else may be a secret that a config keeps in ``env:VARIABLE``.
    """
    kept = {
        name: value
        for name, value in os.environ.items()
        if name in _WORKERS_NAMES or name.startswith(_WORKERS_PREFIXES)
    }
    return kept | dict(more)


def redact_secrets(text: str, *secrets: str) -> str:
    """The text without the secrets, for a log."""
    for secret in filter(None, secrets):
        text = text.replace(secret, HIDDEN)
    return text
