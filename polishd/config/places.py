"""Where a key stands in a TOML text, and what is wrong with it: ``FILE:LINE: section.key: ...``."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

from pydantic import BaseModel, Tag, ValidationError, create_model

Location = tuple[str, ...]

_STRINGS = re.compile(r"'''.*?'''|\"\"\"(?:\\.|[^\\])*?\"\"\"|'[^'\n]*'|\"(?:\\.|[^\"\\\n])*\"", re.DOTALL)
_COMMENT = re.compile(r"#[^\n]*")
_HEADER = re.compile(r"^\s*\[\[?([^\[\]=]+)\]\]?\s*$")
_KEY = re.compile(r"^\s*([^=\[\]{},]+?)\s*=")
_TYPES = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "string_type": 'a string in "quotes"',
    "bool_type": "true or false",
    "tuple_type": "a list [...]",
    "list_type": "a list [...]",
    "dict_type": "a table",
    "model_type": "a section of its own, [{key}]",
}
_RANGES = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "less than"),
    "less_than_equal": ("le", "at most"),
}


@dataclass(frozen=True, slots=True)
class Source:
    """The text that a configuration came from, kept to say where something stands."""

    file: str
    text: str = field(repr=False)
    overrides: frozenset[str] = frozenset()
    """Dotted keys that came from the command line instead."""
    included: tuple[Source, ...] = ()
    """Fragments that the text includes; a key that one of them has comes from the last of those."""

    def where(self, key: Location) -> str:
        """``FILE:LINE`` of the key, of its section where it is missing, or ``override`` for one from outside."""
        dotted = ".".join(key)
        if any(dotted == name or name.startswith(f"{dotted}.") for name in self.overrides):
            return f"{self.file} (override)"
        for fragment in reversed(self.included):
            if len(key) > 1 and key in key_lines(fragment.text):
                return fragment.where(key)
        lines = key_lines(self.text)
        for size in range(len(key), 0, -1):
            if key[:size] in lines:
                return f"{self.file}:{lines[key[:size]]}"
        return f"{self.file}:1"

    def error(self, key: Location, problem: str) -> str:
        """One line: where, which key, what."""
        return f"{self.where(key)}: {'.'.join(key)}: {problem}"


def key_lines(text: str) -> dict[Location, int]:
    """1-based line of each table header and key of a TOML text (keys of inline tables: their table's line)."""
    found: dict[Location, int] = {}
    table: Location = ()
    depth = 0
    names: list[str] = []
    blanked = _blank_strings(text, names)
    for number, line in enumerate(blanked.split("\n"), start=1):
        if depth == 0 and (header := _HEADER.match(line)):
            table = _split(header[1], names)
            found.setdefault(table, number)
            continue
        if depth == 0 and (key := _KEY.match(line)):
            found.setdefault((*table, *_split(key[1], names)), number)
        depth = max(0, depth + sum(line.count(c) for c in "[{") - sum(line.count(c) for c in "]}"))
    return found


def _blank_strings(text: str, names: list[str]) -> str:
    """The text without comments, each string replaced by its place in ``names`` between NULs, lines kept."""

    def replace(match: re.Match[str]) -> str:
        token = match[0]
        if token.startswith("#"):
            return ""
        names.append(token.strip("'\""))
        return f"\x00{len(names) - 1}\x00" + "\n" * token.count("\n")

    return re.sub(f"{_STRINGS.pattern}|{_COMMENT.pattern}", replace, text, flags=re.DOTALL)


def _split(dotted: str, names: Sequence[str]) -> Location:
    """``a."b c".d`` to its parts."""
    return tuple(re.sub(r"\x00(\d+)\x00", lambda m: names[int(m[1])], part).strip() for part in dotted.split("."))


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``; did you mean 'x'?`` or a full stop."""
    close = difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else "."


def listed(names: Iterable[str]) -> str:
    """``'a', 'b'``, or ``none`` for nothing."""
    return ", ".join(repr(name) for name in sorted(names)) or "none"


def problems(error: ValidationError, model: type[BaseModel], source: Source, section: Location = ()) -> list[str]:
    """One line per finding of pydantic, in the order of the file."""
    lines = []
    for found in error.errors(include_url=False):
        path, owner = _location(found["loc"], found["msg"]), model
        if len(path) > 1 and (chosen := _variants(model, path[0]).get(path[1])):
            path, owner = path[:1] + path[2:], _as_section(path[0], chosen)  # a union's tag is no key of the file
        line = source.error((*section, *path), _say(found, owner, path))
        if line not in lines:
            lines.append(line)
    return lines


def _location(loc: Sequence[int | str], message: str) -> Location:
    """Names of the path; list positions are dropped, and ``key: ...`` of a section's own check is added."""
    names = tuple(part for part in loc if isinstance(part, str))
    own = re.match(r"Value error, ([a-z_]+): ", message)
    return (*names, own[1]) if own else names


def _say(found: Mapping[str, Any], model: type[BaseModel], key: Location) -> str:
    kind, given, context = found["type"], found.get("input"), found.get("ctx", {})
    if kind == "missing" and isinstance(found["loc"][-1], int):
        return f"has too few entries: {list(given or ())}; add the others"
    if kind == "missing":
        return f"is missing; add it{_example(model, key)}"
    if kind == "extra_forbidden":
        known = _fields(model, key[:-1])
        return f"unknown key{did_you_mean(key[-1], known)} Known here: {listed(known)}"
    if kind == "literal_error":
        return f"{given!r} is not allowed; must be {context['expected']}{_near(given, context['expected'])}"
    if kind in _RANGES:
        name, words = _RANGES[kind]
        return f"{given!r} is out of range; must be {words} {context[name]}"
    if kind in _TYPES:
        return f"must be {_TYPES[kind].format(key=key[-1])}, not {_kind(given)}; mend it"
    return _say_more(kind, found["msg"], given, context)


def _say_more(kind: str, message: str, given: Any, context: Mapping[str, Any]) -> str:
    if kind == "value_error":
        return re.sub(r"^Value error, (?:[a-z_]+: )?", "", message)
    if kind == "finite_number":
        return f"{given!r} is not allowed; must be a finite number"
    if kind == "string_pattern_mismatch":
        return f"{given!r} is not allowed; use letters, digits, '.', '_' and '-' only, a letter or digit first"
    if kind in {"too_long", "too_short"}:
        needed = context.get("max_length") or context["min_length"]
        return f"has {context['actual_length']} entries; must have {needed}"
    return f"{message[:1].lower()}{message[1:]}; mend it"


def _example(model: type[BaseModel], key: Location) -> str:
    fields = _model_at(model, key[:-1])
    if fields is None or key[-1] not in fields.model_fields:
        return ""
    is_section = _model_at(model, key) is not None
    return f": a section [{'.'.join(key)}]" if is_section else f": {key[-1]} = ..."


def _fields(model: type[BaseModel], section: Location) -> list[str]:
    found = _model_at(model, section)
    return [] if found is None else list(found.model_fields)


def _model_at(model: type[BaseModel], section: Location) -> type[BaseModel] | None:
    found: type[BaseModel] | None = model
    for name in section:
        kind = found.model_fields[name].annotation if found is not None and name in found.model_fields else None
        found = kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None
    return found


def _variants(model: type[BaseModel], name: str) -> dict[str, type[BaseModel]]:
    """The models of a section that is one of several kinds, by tag."""
    found: dict[str, type[BaseModel]] = {}
    kinds = get_args(model.model_fields[name].annotation) if name in model.model_fields else ()
    for kind in kinds:
        tags = [item.tag for item in getattr(kind, "__metadata__", ()) if isinstance(item, Tag)]
        found.update((tag, get_args(kind)[0]) for tag in tags)
    return found


def _as_section(name: str, kind: type[BaseModel]) -> type[BaseModel]:
    """A model whose only section is of that kind."""
    return create_model("Chosen", **{name: (kind, ...)})  # type: ignore[call-overload, no-any-return]


def _near(given: Any, expected: str) -> str:
    return did_you_mean(given, re.findall(r"'([^']*)'", expected)) if isinstance(given, str) else "."


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return f"the truth value {str(value).lower()}"
    if isinstance(value, str):
        return f"the string {value!r}"
    if isinstance(value, (list, tuple)):
        return "a list"
    return "a table" if isinstance(value, Mapping) else repr(value)
