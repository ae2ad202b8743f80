"""Secrets: a config says where one is kept, and never what it is; what is read is used at once, and told to nobody."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator

from polishd.model.errors import ConfigError

HIDDEN = "***"


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
        if stat.S_IMODE(path.stat().st_mode) & stat.S_IROTH:
            raise ConfigError(f"{place!r}: everybody may read {path}; take that away: chmod 600 {path}")
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{place!r}: cannot be read: {path}: {error.strerror}; write the secret there") from error
    except UnicodeDecodeError:
        raise ConfigError(f"{place!r}: {path} is no UTF-8 text; write the secret there") from None


def hide(text: str, *secrets: str) -> str:
    """The text without the secrets, for a log."""
    for secret in filter(None, secrets):
        text = text.replace(secret, HIDDEN)
    return text
