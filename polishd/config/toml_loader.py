"""A whole file: one TOML loader for a cell, a study, an instrument's profile and the simulator."""

from __future__ import annotations

import ast
import difflib
import functools
import inspect
import itertools
import os
import re
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Self, get_args, get_origin

from pydantic import BaseModel, PrivateAttr, Tag, ValidationError

from polishd.config.fields import ConfigSection
from polishd.config.renamed_keys import renamed_key
from polishd.model.errors import ConfigError, PolishdError
from polishd.util.files import toml_text

# Where a key stands in a TOML text, and what is wrong with it: ``FILE:LINE: section.key: ...``.

Location = tuple[str | int, ...]
"""Names from the outermost table to the key; the place in the list, from 0, where one is a list of tables."""

_FAULTS = {
    "extra_forbidden": "unknown key",
    "literal_error": "{given!r} is not allowed; must be {expected}",
    "finite_number": "{given!r} is not allowed; must be a finite number",
    "string_pattern_mismatch": "{given!r} is not allowed; use letters, digits, '.', '_' and '-' only, "
    "a letter or digit first",
    "greater_than": "{given!r} is out of range; must be greater than {gt}",
    "greater_than_equal": "{given!r} is out of range; must be at least {ge}",
    "less_than": "{given!r} is out of range; must be less than {lt}",
    "less_than_equal": "{given!r} is out of range; must be at most {le}",
    "too_long": "has {actual_length} entries; must have {max_length}",
    "too_short": "has {actual_length} entries; must have {min_length}",
    "float_type": "must be a number, not {kind}; mend it",
    "int_type": "must be a whole number, not {kind}; mend it",
    "int_from_float": "must be a whole number, not {kind}; mend it",
    "string_type": 'must be a string in "quotes", not {kind}; mend it',
    "bool_type": "must be true or false, not {kind}; mend it",
    "tuple_type": "must be a list [...], not {kind}; mend it",
    "list_type": "must be a list [...], not {kind}; mend it",
    "dict_type": "must be a table, not {kind}; mend it",
    "model_type": "must be a section of its own, [{key}], not {kind}; mend it",
}
"""What to say of a finding of pydantic, by its type; of any other, its own message."""


@dataclass(frozen=True, slots=True)
class TomlSource:
    """The text that a configuration came from, kept to say where something stands."""

    file: str
    text: str = field(repr=False)
    overrides: frozenset[str] = frozenset()
    """Dotted keys that came from the command line instead."""
    included: tuple[TomlSource, ...] = ()
    """Fragments that the text includes; a key that one of them has comes from the last of those."""
    stands_for: tuple[tuple[Location, Location], ...] = ()
    """Keys whose values were written elsewhere, and where: a tool's table stands for some of other sections."""

    def where(self, key: Location) -> str:
        """``FILE:LINE`` of the key, of its section where it is missing, or ``override`` for one from outside."""
        key = self._written(key)
        dotted = _dotted(key)
        if any(dotted == name or name.startswith(f"{dotted}.") for name in self.overrides):
            return f"{self.file} (override)"
        fragments = tuple(reversed(self.included))
        for size in range(len(key), 0, -1):
            for part in (*fragments, self) if size > 1 else (self, *fragments):
                if line := key_lines(part.text).get(key[:size]):
                    return f"{part.file}:{line}"
        return f"{self.file}:1"

    def error(self, key: Location, problem: str) -> str:
        """One line: where, which key, what."""
        return f"{self.where(key)}: {_dotted(self._written(key))}: {problem}"

    def _written(self, key: Location) -> Location:
        """The key as its writer knows it."""
        return next((there + key[len(here) :] for here, there in self.stands_for if key[: len(here)] == here), key)


def _dotted(key: Location) -> str:
    return ".".join(part for part in key if isinstance(part, str))


@functools.lru_cache(maxsize=16)
def key_lines(text: str) -> Mapping[Location, int]:
    """1-based line of each table header and key of a TOML text (inside a value: the line on which its key stands).

    A header or a value cannot be read before its last line is there: what tomllib can read alone is one of them.
    """
    found: dict[Location, int] = {}
    table: Location = ()
    lines, start = text.split("\n"), 0
    for end in range(1, len(lines) + 1):
        statement = "\n".join(lines[start:end])
        try:
            value = tomllib.loads(statement)
        except tomllib.TOMLDecodeError:
            continue
        if statement.lstrip().startswith("["):
            table = _header(value, found)
            found.setdefault(table[:-1] if isinstance(table[-1], int) else table, start + 1)
            found[table] = start + 1
        else:
            _note(value, table, start + 1, found)
        start = end
    return found


def _header(value: Any, found: Mapping[Location, int]) -> Location:
    """The table that a header opens; in a list of tables the last one, or with ``[[...]]`` the next."""
    table: Location = ()
    while value:
        (name, value), is_next = next(iter(value.items())), False
        table = (*table, name)
        if isinstance(value, list):
            value, is_next = value[0], True
        count = sum(key[:-1] == table and isinstance(key[-1], int) for key in found)
        if is_next or count:
            table = (*table, count - (not is_next))
    return table


def _note(value: Mapping[str, Any], table: Location, line: int, found: dict[Location, int]) -> None:
    for name, inner in value.items():
        found.setdefault((*table, name), line)
        if isinstance(inner, dict):
            _note(inner, (*table, name), line, found)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` or a full stop."""
    close = difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else "."


def join_words(names: Iterable[str]) -> str:
    """``'a', 'b'``, or ``none`` for nothing."""
    return ", ".join(repr(name) for name in sorted(names)) or "none"


def validation_problems(
    error: ValidationError, model: type[BaseModel], source: TomlSource, section: Location = ()
) -> list[str]:
    """One line per finding of pydantic, in the order of the file."""
    lines = []
    for found in error.errors(include_url=False):
        key, kind, owner = _follow(model, found["loc"])
        own = re.match(
            r"Value error, ([a-z][a-z0-9_]*): ", found["msg"]
        )  # a section's own check names the key at fault
        key = (*section, *key, *(own.groups() if own else ()))
        lines.append(source.error(key, _say(found, key, kind, owner)))
    return sorted(dict.fromkeys(lines), key=_line)


def _line(said: str) -> int:
    """Of what was said; 0 for an override."""
    place = re.search(r":(\d+): ", said)
    return int(place[1]) if place else 0


def toml_type(kind: Any) -> Any:
    """The type without what Annotated adds, and without None."""
    if get_origin(kind) is Annotated:
        return toml_type(get_args(kind)[0])
    kinds = [item for item in get_args(kind) if item is not NoneType]
    return toml_type(kinds[0]) if NoneType in get_args(kind) and len(kinds) == 1 else kind


def variants(kind: Any) -> dict[str, type[BaseModel]]:
    """The models of a section that is one of several kinds, by tag."""
    kinds = [(get_args(item)[0], tag) for item in get_args(kind) for tag in getattr(item, "__metadata__", ())]
    return {tag.tag: model for model, tag in kinds if isinstance(tag, Tag)}


def section_of(kind: Any) -> type[BaseModel] | None:
    """The model where the type is one of a section."""
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def _follow(model: type[BaseModel], loc: Sequence[int | str]) -> tuple[Location, Any, type[BaseModel] | None]:
    """The key of the file that pydantic means, the type of its value, and the section that it stands in."""
    key: Location = ()
    kind: Any = model
    owner: type[BaseModel] | None = None
    for part in loc:
        if part in variants(kind):
            kind = variants(kind)[str(part)]
        elif part != "[key]":  # which pydantic adds where a name is wrong
            key, owner = (*key, part), section_of(kind)
            fields = owner.model_fields if owner else {}
            inner = [item for item in get_args(kind) if item is not ...]  # of a list or a table of names
            kind = toml_type(fields[str(part)].annotation if part in fields else inner[-1] if inner else None)
    return key, kind, owner


def _say(found: Mapping[str, Any], key: Location, kind: Any, owner: type[BaseModel] | None) -> str:
    fault, message, given, context = found["type"], found["msg"], found.get("input"), found.get("ctx", {})
    if fault == "missing" and isinstance(key[-1], int):
        return f"has too few entries: {list(given or ())}; add the others"
    if fault == "missing":
        return (
            f"is missing; add it: {f'{key[-1]} = ...' if section_of(kind) is None else f'a section [{_dotted(key)}]'}"
        )
    if fault == "value_error":
        return re.sub(r"^Value error, (?:[a-z][a-z0-9_]*: )?", "", message)
    if fault not in _FAULTS:
        return f"{message[:1].lower()}{message[1:]}; mend it"
    said = _FAULTS[fault].format(given=given, kind=_kind(given), key=_dotted(key[-1:]), **context)
    if fault == "extra_forbidden":
        if new := renamed_key(_dotted(key)):
            return f"was renamed: write {new}"
        known = owner.model_fields if owner else ()
        return f"{said}{did_you_mean(str(key[-1]), known)} Known here: {join_words(known)}"
    if fault == "literal_error":
        near = re.findall(r"'([^']*)'", context["expected"]) if isinstance(given, str) else []
        return said + did_you_mean(str(given), near)
    return said


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return f"the truth value {str(value).lower()}"
    if isinstance(value, str):
        return f"the string {value!r}"
    if isinstance(value, (list, tuple)):
        return "a list"
    return "a table" if isinstance(value, Mapping) else repr(value)


MOST_LEVELS = 32
"""Of lists and tables inside one another, in a file."""


class TomlDocument(ConfigSection):
    """What all files share: where they lie, and where each of their keys stands."""

    _path: Path = PrivateAttr(default=Path("none.toml"))
    _source: TomlSource = PrivateAttr(default=TomlSource("none.toml", ""))
    _raw: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def of(cls, raw: Mapping[str, Any], source: TomlSource) -> Self:
        """The values of a file; ConfigError, a line each: ``FILE:LINE: section.key: what is wrong; what to do``."""
        try:
            made = cls.model_validate(raw)
        except ValidationError as error:
            raise ConfigError("\n".join(validation_problems(error, cls, source))) from error
        made._path, made._source, made._raw = Path(source.file).absolute(), source, raw
        return made

    @property
    def source(self) -> TomlSource:
        """The text it came from: says where a key stands, for errors."""
        return self._source

    @property
    def base_dir(self) -> Path:
        """Folder that relative paths start from."""
        return self._path.parent

    def resolve(self, path: str) -> Path:
        """A path of the file, absolute."""
        return self.base_dir / Path(path).expanduser()

    def relative(self, path: Path) -> str:
        """A path as the file would name it: from its own folder."""
        return Path(os.path.relpath(path.absolute(), self.base_dir)).as_posix()

    def error(self, key: str, problem: str) -> ConfigError:
        """A ConfigError about a dotted key, with its place: for checks that need more than this file."""
        return ConfigError(self._source.error(tuple(key.split(".")), problem))

    @contextmanager
    def blame(self, key: str) -> Iterator[None]:
        """What cannot be computed in this block is the file's fault, and is said with the place of this dotted key."""
        try:
            yield
        except ConfigError:
            raise
        except PolishdError as error:
            raise self.error(key, str(error)) from error


def load_toml(path: Path) -> tuple[dict[str, Any], TomlSource]:
    """A TOML file's values, and the text that says where they stand; ConfigError with file and line."""
    return loads_toml(toml_text(path), path)


def loads_toml(text: str, path: Path) -> tuple[dict[str, Any], TomlSource]:
    """The same of a text that stood in that file."""
    try:
        raw = tomllib.loads(text)
        if deep := _too_deep(raw):
            raise ConfigError(f"{path}: {deep} is nested more than {MOST_LEVELS} levels deep; no key of polishd is")
        return raw, TomlSource(str(path), text)
    except RecursionError:
        raise ConfigError(
            f"{path}: lists or tables are nested more than {MOST_LEVELS} levels deep; no key of polishd is"
        ) from None
    except tomllib.TOMLDecodeError as error:  # which says "... (at line 3, column 5)" or "(at end of document)"
        what, _, place = str(error).partition(" (at ")
        line = place.split()[1].rstrip(",") if place.startswith("line") else str(text.count("\n") + 1)
        raise ConfigError(f"{path}:{line}: this is not TOML: {what}; mend that line") from error
    except ValueError as error:  # a whole number of more than 4300 digits, which Python does not read
        raise ConfigError(f"{path}: a value cannot be read: {error}; write a shorter one") from error


def _too_deep(raw: Mapping[str, Any]) -> str:
    """The key of the first level below which there are too many; empty where there is none."""
    level: list[tuple[str, Any]] = list(raw.items())
    for _ in range(MOST_LEVELS):
        inner = [(key, value) for key, value in level if isinstance(value, (dict, list))]
        level = [(key, item) for key, value in inner for item in (value.values() if isinstance(value, dict) else value)]
    return next((key for key, value in level if isinstance(value, (dict, list))), "")


# What keys mean, as their models say it: for the reference, and for the cells that ``polishd init`` writes.


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """The docstring below each field of the model and of those that it is made from."""
    told: dict[str, str] = {}
    for made_of in reversed(model.__mro__):
        if issubclass(made_of, BaseModel) and made_of is not BaseModel:
            body = ast.parse(textwrap.dedent(inspect.getsource(made_of))).body[0].body  # type: ignore[attr-defined]
            for field, below in itertools.pairwise(body):
                match field, below:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                        told[name] = " ".join(text.split())
    return told


def in_words(meaning: str) -> str:
    """Without the unit at its end, which the reference has in a column, and without the marks of its text."""
    return re.sub(r" \[[^]]+\]$", "", meaning).replace("``", "`")
