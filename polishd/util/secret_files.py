"""Secrets: a config names the location of a secret, never its value, which is used at once and never logged."""

from __future__ import annotations

import os
import shlex
import stat
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

from pydantic import BeforeValidator

from polishd.model.errors import ConfigError

HIDDEN = "***"
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def _place(value: Any) -> Any:
    """The value is not repeated in the refusal: it may be the secret itself."""
    kind, _, name = value.partition(":") if isinstance(value, str) else ("", "", "")
    if kind not in {"file", "env"} or not name.strip():
        raise ValueError(
            'a secret does not stand in a config; say where it is kept: "file:NAME" (only its owner may read it) or '
            '"env:VARIABLE"'
        )
    return value


SecretPlace = Annotated[str, BeforeValidator(_place)]
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
    found = (
        os.environ.get(name, "") if kind == "env" else _from_file(place, base_dir / Path(name).expanduser())
    ).strip()
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
