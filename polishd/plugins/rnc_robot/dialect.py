"""Dialect profiles: what a controller's NC text means, as data. The shipped ones are ``dialects/*.toml``."""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from polishd.api import ConfigError
from polishd.files import toml_text
from polishd.plugins.rnc_robot.languages.profile import Profile, parse

FOLDER = Path(__file__).with_name("dialects")
DIALECTS = (
    "rs274", "fanuc", "haas", "siemens", "siemens-iso", "twincat-nci", "twincat-cnc", "grbl", "weihong", "codesys",
    "rapid", "krl", "fanuc-tp", "urscript",
)  # fmt: skip
DEFAULT = "rs274"

Unit = Literal["s", "ms", "refuse"]
Codes = dict[str, list[float]]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DwellWord(_Strict):
    """The unit of a dwell's number, as it is written."""

    whole: Unit
    """Without a decimal point."""
    decimal: Unit
    """With one."""


class DwellRules(_Strict):
    """How a dwell is written."""

    codes: list[float]
    words: dict[str, DwellWord]
    """By letter, by name as it stands in the text (``TIME=``), or ``number`` for a bare one."""
    refused: dict[str, str]
    """Letters that mean something else beside the dwell code, and what."""
    decimals: Annotated[int, Field(ge=0, le=9)]
    """Of new numbers in seconds, where the program's own have fewer."""
    most_decimals: Annotated[int, Field(ge=0, le=12)]
    resolution_s: Annotated[float, Field(ge=0)] = 0.0
    """What the controller really resolves, where that is coarser than what can be written."""
    longest_s: Annotated[float, Field(gt=0)]
    written: str
    """How a new dwell block begins; the number follows."""
    own_block: bool


class FeedRules(_Strict):
    """What F means."""

    unit: Literal["mm/min", "mm/s"]
    g93: Literal["1/min", "s", "refuse"]
    whole: Literal["as_is", "unsure"]
    """F without a decimal point: as it stands, or up to a machine parameter. In inches it always is."""
    most_decimals: Annotated[int, Field(ge=0, le=12)]


class TextRules(_Strict):
    """How text becomes words."""

    comments: list[Literal["()", ";"]]
    end_of_block: bool
    blanks_in_numbers: bool
    assign: bool
    block_delete: Literal["refuse", "run", "skip"]
    whole_positions: Literal["mm", "um", "unsure"]
    commands: list[str]
    """What comments begin with that the controller runs, before a comma."""
    realtime: str
    """Characters that the controller acts on wherever they stand; with any, bytes beyond ASCII are such, too."""
    longest_line: Annotated[int, Field(ge=20, le=4096)]
    tape: Literal["percent", "name"]
    program_number: bool
    end: Literal["required", "optional"]


class AxisRules(_Strict):
    """Which words turn the tool."""

    rotary: list[Literal["CA", "CB", "AB", "BA", "AC", "BC"]]
    """Pairs that a program may use, outermost rotation first: CA is Rz(C) Rx(A)."""
    vector: list[str]
    """Three words of a tool vector from the tip into the spindle; empty: none."""


class WordRules(_Strict):
    """Words that change neither time nor place."""

    neutral: list[str]
    keywords: list[str]


class Dialect(_Strict):
    """A profile of ISO-like NC text (``kind = "nc"``)."""

    kind: Literal["nc"]
    name: str
    title: str
    dwell: DwellRules
    feed: FeedRules
    text: TextRules
    axes: AxisRules
    words: WordRules
    g: Codes
    """G codes by what they do; what stands nowhere is refused."""
    m: Codes
    refused_g: dict[str, str]
    """Why a G code is refused."""
    refused_words: dict[str, str]


AnyDialect = Dialect | Profile


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
    from polishd.plugins.rnc_robot.nc.tables import tables  # which knows what a dialect is

    try:
        found = Dialect.model_validate(content)
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
