"""Load TOML files into config models; each error names file, line and key."""

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
from typing import Annotated, Any, Self, TypeVar, get_args, get_origin

from pydantic import BaseModel, PrivateAttr, Tag, ValidationError

from polishd.config.fields import ConfigSection
from polishd.config.renamed_keys import renamed_key
from polishd.model.errors import ConfigError, PolishdError
from polishd.util.files import named_path, toml_text

Model = TypeVar("Model", bound=BaseModel)

# Location of a key in a TOML text, and its error: ``FILE:LINE: section.key: ...``.

Location = tuple[str | int, ...]
"""Names from the outermost table to the key; in a list of tables the index, from 0."""

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
    "float_type": "must be a number, not {kind}",
    "int_type": "must be a whole number, not {kind}",
    "int_from_float": "must be a whole number, not {kind}",
    "string_type": 'must be a string in "quotes", not {kind}',
    "bool_type": "must be true or false, not {kind}",
    "tuple_type": "must be a list [...], not {kind}",
    "list_type": "must be a list [...], not {kind}",
    "dict_type": "must be a table, not {kind}",
    "model_type": "must be a section, [{key}], not {kind}",
}
"""Messages by pydantic's error type. Any other error keeps pydantic's message."""
_OWN_KEY = r"Value error, ([a-z][a-z0-9_]*(?:\.\w+)*): "
"""Begin of a message of a section's own check: a key of the section, dotted where it is one of an inner table."""


@dataclass(frozen=True, slots=True)
class TomlSource:
    """The text of a configuration, used to locate errors."""

    file: str
    text: str = field(repr=False)
    overrides: frozenset[str] = frozenset()
    """Dotted keys that came from the command line instead."""
    included: tuple[TomlSource, ...] = ()
    """Included fragments. A key comes from the last fragment that has it."""
    written_at: tuple[tuple[Location, Location], ...] = ()
    """Keys whose values are written elsewhere, and where: a tool's table replaces keys of other sections."""

    def where(self, key: Location) -> str:
        """Return ``FILE:LINE`` of the key, or of its section if it is missing; ``override`` for an override."""
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
        """Return one line with location, key and problem."""
        return f"{self.where(key)}: {_dotted(self._written(key))}: {problem}"

    def _written(self, key: Location) -> Location:
        """Return the key as it is written in the file."""
        return next((there + key[len(here) :] for here, there in self.written_at if key[: len(here)] == here), key)


def _dotted(key: Location) -> str:
    return ".".join(part for part in key if isinstance(part, str))


@functools.lru_cache(maxsize=16)
def key_lines(text: str) -> Mapping[Location, int]:
    """Return the 1-based line of each table header and key of a TOML text (inside a value: the line of its key).

    A header or a value can be parsed only when its last line is there: a text that tomllib can parse is one of them.
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
            for size in range(1, len(table)):  # tables that only a header of an inner table names
                found.setdefault(table[:size], start + 1)
        else:
            _note(value, table, start + 1, found)
        start = end
    return found


def _header(value: Any, found: Mapping[Location, int]) -> Location:
    """Return the table that a header opens; in a list of tables the last one, or with ``[[...]]`` the next."""
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
    """Return ``; did you mean 'x'?`` or a full stop."""
    close = difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else "."


def join_words(names: Iterable[str]) -> str:
    """Return ``'a', 'b'``, or ``none`` for nothing."""
    return ", ".join(repr(name) for name in sorted(names)) or "none"


def validation_problems(
    error: ValidationError, model: type[BaseModel], source: TomlSource, section: Location = ()
) -> list[str]:
    """Return one line for each pydantic error, in the order of the file."""
    lines = []
    for found in error.errors(include_url=False):
        key, kind, owner = _follow(model, found["loc"])
        own = re.match(_OWN_KEY, found["msg"])  # a section's own check names the key at fault
        key = (*section, *key, *(own[1].split(".") if own else ()))
        lines.append(source.error(key, _message(found, key, kind, owner)))
    return sorted(dict.fromkeys(lines), key=_line)


def validated(model: type[Model], raw: Mapping[str, Any], source: TomlSource) -> Model:
    """Validate a file's values.

    Raises ConfigError, one line per problem: ``FILE:LINE: section.key: what is wrong; what to do``.
    """
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        raise ConfigError("\n".join(validation_problems(error, model, source))) from error


def _line(message: str) -> int:
    """Return the line number of a message; 0 for an override."""
    place = re.search(r":(\d+): ", message)
    return int(place[1]) if place else 0


def toml_type(kind: Any) -> Any:
    """Return the type without Annotated and without None."""
    if get_origin(kind) is Annotated:
        return toml_type(get_args(kind)[0])
    kinds = [item for item in get_args(kind) if item is not NoneType]
    return toml_type(kinds[0]) if NoneType in get_args(kind) and len(kinds) == 1 else kind


def variants(kind: Any) -> dict[str, type[BaseModel]]:
    """Return the models by tag of a section that has several kinds."""
    kinds = [(get_args(item)[0], tag) for item in get_args(kind) for tag in getattr(item, "__metadata__", ())]
    return {tag.tag: model for model, tag in kinds if isinstance(tag, Tag)}


def section_of(kind: Any) -> type[BaseModel] | None:
    """Return the model if the type is a section."""
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def _follow(model: type[BaseModel], loc: Sequence[int | str]) -> tuple[Location, Any, type[BaseModel] | None]:
    """Return the key of the file for pydantic's location, the type of its value, and its section."""
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


def _message(found: Mapping[str, Any], key: Location, kind: Any, owner: type[BaseModel] | None) -> str:
    fault, message, given, context = found["type"], found["msg"], found.get("input"), found.get("ctx", {})
    if fault == "missing" and isinstance(key[-1], int):
        return f"has too few entries: {list(given or ())}; add the others"
    if fault == "missing":
        return (
            f"is missing; add it: {f'{key[-1]} = ...' if section_of(kind) is None else f'a section [{_dotted(key)}]'}"
        )
    if fault == "value_error":
        return re.sub(f"{_OWN_KEY}|Value error, ", "", message, count=1)
    if fault not in _FAULTS:
        return f"{message[:1].lower()}{message[1:]}; correct it"
    text = _FAULTS[fault].format(given=given, kind=_kind(given), key=_dotted(key[-1:]), **context)
    if fault == "extra_forbidden":
        if new := renamed_key(_dotted(key)):
            return f"was renamed: write {new}"
        known = owner.model_fields if owner else ()
        return f"{text}{did_you_mean(str(key[-1]), known)} Known here: {join_words(known)}. Correct or remove it"
    if fault == "literal_error":
        near = re.findall(r"'([^']*)'", context["expected"]) if isinstance(given, str) else []
        return text + did_you_mean(str(given), near)
    return text


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return f"the truth value {str(value).lower()}"
    if isinstance(value, str):
        return f"the string {value!r}"
    if isinstance(value, (list, tuple)):
        return "a list"
    return "a table" if isinstance(value, Mapping) else repr(value)


MOST_LEVELS = 32
"""Largest nesting depth of lists and tables in a file."""


class TomlDocument(ConfigSection):
    """Base of all files: their path, and the location of each key."""

    _path: Path = PrivateAttr(default=Path("none.toml"))
    _source: TomlSource = PrivateAttr(default=TomlSource("none.toml", ""))
    _raw: Mapping[str, Any] = PrivateAttr(default_factory=dict)

    @classmethod
    def of(cls, raw: Mapping[str, Any], source: TomlSource) -> Self:
        """Validate a file's values, as ``validated``."""
        made = validated(cls, raw, source)
        made._path, made._source, made._raw = Path(source.file).absolute(), source, raw
        return made

    @property
    def source(self) -> TomlSource:
        """The file's text, used to locate errors."""
        return self._source

    @property
    def base_dir(self) -> Path:
        """Base folder of relative paths."""
        return self._path.parent

    def resolve(self, path: str) -> Path:
        """Return a path of the file as an absolute path."""
        return named_path(self.base_dir, path)

    def relative(self, path: Path) -> str:
        """Return a path relative to the file's folder."""
        return Path(os.path.relpath(path.absolute(), self.base_dir)).as_posix()

    def file(self, key: str, path: Path) -> Path:
        """Return a path that this dotted key names; ConfigError at the key where there is no such file."""
        if not path.is_file():  # a pipe is none, either: a reader waits for its writer
            raise self.error(key, f"{path}: no such file; correct the path")
        return path

    def error(self, key: str, problem: str) -> ConfigError:
        """Return a ConfigError about a dotted key, with its location, for checks that need more than this file."""
        return ConfigError(self._source.error(tuple(key.split(".")), problem))

    @contextmanager
    def blame(self, key: str) -> Iterator[None]:
        """Turn errors of the computation in this block into a ConfigError at this dotted key."""
        try:
            yield
        except ConfigError:
            raise
        except PolishdError as error:
            raise self.error(key, str(error)) from error


def load_toml(path: Path) -> tuple[dict[str, Any], TomlSource]:
    """Read a TOML file: its values, and its source for errors. Raise ConfigError with file and line."""
    return loads_toml(toml_text(path), path)


def loads_toml(text: str, path: Path) -> tuple[dict[str, Any], TomlSource]:
    """Read the text of a TOML file, as ``load_toml``."""
    try:
        raw = tomllib.loads(text)
        if deep := _too_deep(raw):
            raise ConfigError(f"{path}: {deep} is nested more than {MOST_LEVELS} levels deep; polishd has no such key")
        return raw, TomlSource(str(path), text)
    except RecursionError:
        raise ConfigError(
            f"{path}: lists or tables are nested more than {MOST_LEVELS} levels deep; polishd has no such key"
        ) from None
    except tomllib.TOMLDecodeError as error:  # its text ends in "(at line 3, column 5)" or "(at end of document)"
        what, _, place = str(error).partition(" (at ")
        line = place.split()[1].rstrip(",") if place.startswith("line") else str(text.count("\n") + 1)
        raise ConfigError(f"{path}:{line}: this is not TOML: {what}; correct that line") from error
    except ValueError as error:  # a whole number of more than 4300 digits
        raise ConfigError(f"{path}: a value cannot be read: {error}; write a shorter one") from error


def _too_deep(raw: Mapping[str, Any]) -> str:
    """Return the key of a value that is nested too deep; empty if there is none."""
    level: list[tuple[str, Any]] = list(raw.items())
    for _ in range(MOST_LEVELS):
        inner = [(key, value) for key, value in level if isinstance(value, (dict, list))]
        level = [(key, item) for key, value in inner for item in (value.values() if isinstance(value, dict) else value)]
    return next((key for key, value in level if isinstance(value, (dict, list))), "")


# Descriptions of keys from the docstrings of their models, for the reference and for ``polishd init``.


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """Return the docstring below each field of the model and of its base models."""
    docs: dict[str, str] = {}
    for made_of in reversed(model.__mro__):
        if issubclass(made_of, BaseModel) and made_of is not BaseModel:
            body = ast.parse(textwrap.dedent(inspect.getsource(made_of))).body[0].body  # type: ignore[attr-defined]
            for field, below in itertools.pairwise(body):
                match field, below:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                        docs[name] = " ".join(text.split())
    return docs


def in_words(meaning: str) -> str:
    """Return the description without its unit at the end, which the reference has in a column, and without markup."""
    return re.sub(r" \[[^]]+\]$", "", meaning).replace("``", "`")
