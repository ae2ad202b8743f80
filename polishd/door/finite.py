"""JSON as it comes from outside and as browsers can read it: it has no NaN, no infinity, and no half characters."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from polishd.model.errors import ConfigError


def finite(value: Any) -> Any:
    """The same, with null in the place of each."""
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
