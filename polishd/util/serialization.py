"""Values as text: conversion to JSON types, and values as TOML."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from typing import Any

from polishd.model.errors import ConfigError


def plain(value: object) -> object:
    """For ``json.dumps(..., default=plain)``: numbers stay numbers, records become objects, the rest its text."""
    import numpy as np  # late, because `polishd status` need not load numpy

    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)
    return str(value)


def toml(value: Any) -> str:
    """A value as TOML writes it on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value) if isinstance(value, bool | str) else repr(value)


# JSON as it comes from outside and as browsers can read it: it has no NaN, no infinity, and no half characters.


def finite(value: Any) -> Any:
    """Return the values with null in place of each non-finite number."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): finite(one) for key, one in value.items()}
    return [finite(one) for one in value] if isinstance(value, list | tuple) else value


def json_object(body: bytes) -> dict[str, Any]:
    """Return the object of a request's body, empty for an empty body. ConfigError where it is none."""
    try:
        found = json.loads(body.decode()) if body else {}
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise ConfigError("the body is no JSON object")
    return found


def require_unicode(text: str, what: str) -> None:
    """ConfigError where the text has a lone surrogate, which no file and no database takes."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ConfigError(f"{what} holds half a character (a lone surrogate): send Unicode text") from None
