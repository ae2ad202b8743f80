"""Dialect profiles: what a controller's program text means, as data. The shipped ones are ``dialects/*.toml``."""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from polishd.api import ConfigError
from polishd.plugins.rnc_robot.gcode.dialect import DwellWord, GcodeDialect, tables
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile, parse
from polishd.util.files import toml_text

__all__ = ["DEFAULT", "DIALECTS", "LANGUAGES", "AnyDialect", "DwellWord", "GcodeDialect", "dialect"]

FOLDER = Path(__file__).with_name("dialects")
DIALECTS = (
    "rs274", "fanuc", "haas", "siemens", "siemens-iso", "twincat-nci", "twincat-cnc", "grbl", "weihong", "codesys",
    "rapid", "krl", "fanuc-tp", "urscript",
)  # fmt: skip
LANGUAGES = frozenset({"rapid", "krl", "fanuc-tp", "urscript"})
"""Of those, the robots' own: profiles of templates."""
DEFAULT = "rs274"
AnyDialect = GcodeDialect | LanguageProfile


def dialect(name_or_path: str | Path) -> AnyDialect:
    """The shipped profile of that name, or the one in that TOML file. ConfigError names file and key."""
    text = str(name_or_path)
    if not text.endswith(".toml"):
        if text not in DIALECTS:
            near = difflib.get_close_matches(text, DIALECTS, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(DIALECTS)}, or the path of a .toml"
            raise ConfigError(f"dialect {text!r} is not known: {hint}")
        return dialect(FOLDER / f"{text}.toml")
    path = Path(name_or_path)
    content = _content(path, ())
    if content.get("kind") == "template":
        return parse(content, str(path))
    try:
        found = GcodeDialect.model_validate(content)
        tables(found)
        return found
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{path}: {key}: {first['msg']}. To do: see the shipped profiles for its form.") from error


def _content(path: Path, below: tuple[Path, ...]) -> dict[str, Any]:
    """The file's tables laid over those it ``extends``."""
    try:
        content = tomllib.loads(toml_text(path))
    except ConfigError as error:
        raise ConfigError(f"{error}. To do: check the path of the dialect.") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: {error}. To do: mend the TOML.") from error
    base = content.pop("extends", None)
    if base is None:
        return content
    if not isinstance(base, str):
        raise ConfigError(f"{path}: extends: is no text. To do: name a shipped dialect, or a .toml beside this file.")
    parent = FOLDER / f"{base}.toml" if base in DIALECTS else path.parent / base
    if parent.resolve() in (path.resolve(), *below):
        raise ConfigError(f"{path}: extends: {base!r} comes back to where it began. To do: break the circle.")
    return _laid_over(_content(parent, (*below, path.resolve())), content)


def _laid_over(base: dict[str, Any], top: dict[str, Any]) -> dict[str, Any]:
    """Tables are merged key by key; everything else is replaced."""
    merged = dict(base)
    for key, value in top.items():
        old = merged.get(key)
        merged[key] = _laid_over(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return merged
