"""A validator for the part of JSON Schema draft 7 that polishd's schemas use; an unknown keyword is an error."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

Schema = Mapping[str, Any]
IGNORED = {"$schema", "title", "description", "default", "definitions", "examples", "format", "then", "else"}


def faults(value: Any, schema: Schema, root: Schema | None = None, at: str = "") -> Iterator[str]:
    """Yield ``KEY: what is wrong`` for each rule that a value of a TOML file breaks."""
    root = root or schema
    if "$ref" in schema:
        yield from faults(value, root["definitions"][schema["$ref"].rpartition("/")[2]], root, at)
        return
    for keyword, rule in schema.items():
        if keyword not in IGNORED:
            yield from RULES[keyword](value, rule, schema, root, at)


def good(value: Any, schema: Schema, root: Schema) -> bool:
    return not any(faults(value, schema, root))


Rule = Callable[[Any, Any, Schema, Schema, str], Iterator[str]]
TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str, dt.datetime), "boolean": (bool,), "integer": (int,),
    "number": (int, float), "null": (),
}  # fmt: skip


def _type(value: Any, rule: Any, _schema: Schema, _root: Schema, at: str) -> Iterator[str]:
    is_bool = isinstance(value, bool)
    if not isinstance(value, TYPES[rule]) or (is_bool and rule != "boolean"):
        yield f"{at}: {value!r} is no {rule}"


def _properties(value: Any, rule: Any, schema: Schema, root: Schema, at: str) -> Iterator[str]:
    for name, each in value.items() if isinstance(value, dict) else ():
        if name in rule:
            yield from faults(each, rule[name], root, f"{at}.{name}")


def _patterns(value: Any, rule: Any, _schema: Schema, root: Schema, at: str) -> Iterator[str]:
    for name, each in value.items() if isinstance(value, dict) else ():
        for pattern, one in rule.items():
            if re.search(pattern, name):
                yield from faults(each, one, root, f"{at}.{name}")


def _names(value: Any, rule: Any, _schema: Schema, root: Schema, at: str) -> Iterator[str]:
    for name in value if isinstance(value, dict) else ():
        yield from faults(name, rule, root, f"{at}.{name}")


def _additional(value: Any, rule: Any, schema: Schema, root: Schema, at: str) -> Iterator[str]:
    patterns = schema.get("patternProperties", ())
    for name in set(value) - set(schema.get("properties", ())) if isinstance(value, dict) else ():
        if any(re.search(pattern, name) for pattern in patterns):
            continue
        if rule is False:
            yield f"{at}.{name}: unknown key"
        elif rule is not True:
            yield from faults(value[name], rule, root, f"{at}.{name}")


def _items(value: Any, rule: Any, _schema: Schema, root: Schema, at: str) -> Iterator[str]:
    if isinstance(value, list):
        for number, each in enumerate(value):
            one = rule if isinstance(rule, dict) else rule[number] if number < len(rule) else {}
            yield from faults(each, one, root, f"{at}[{number}]")


def _if(value: Any, rule: Any, schema: Schema, root: Schema, at: str) -> Iterator[str]:
    yield from faults(value, schema.get("then" if good(value, rule, root) else "else", {}), root, at)


def _any_of(value: Any, rule: Any, _schema: Schema, root: Schema, at: str) -> Iterator[str]:
    if not any(good(value, each, root) for each in rule):
        yield f"{at}: {value!r} is none of {len(rule)} kinds"


def _all_of(value: Any, rule: Any, _schema: Schema, root: Schema, at: str) -> Iterator[str]:
    for each in rule:
        yield from faults(value, each, root, at)


def _required(value: Any, rule: Any, _schema: Schema, _root: Schema, at: str) -> Iterator[str]:
    for name in rule if isinstance(value, dict) else ():
        if name not in value:
            yield f"{at}: {name} is missing"


def _check(applies: type | tuple[type, ...], holds: Callable[[Any, Any], bool], words: str) -> Rule:
    def rule(value: Any, limit: Any, _schema: Schema, _root: Schema, at: str) -> Iterator[str]:
        if isinstance(value, applies) and not holds(value, limit):
            yield f"{at}: {value!r} {words} {limit!r}"

    return rule


NUMBER = (int, float)
RULES: dict[str, Rule] = {
    "type": _type,
    "properties": _properties,
    "patternProperties": _patterns,
    "propertyNames": _names,
    "additionalProperties": _additional,
    "items": _items,
    "if": _if,
    "anyOf": _any_of,
    "oneOf": _any_of,
    "allOf": _all_of,
    "required": _required,
    "not": lambda v, rule, _s, root, at: iter([f"{at}: is not allowed"] if good(v, rule, root) else []),
    "enum": _check(object, lambda v, limit: v in limit, "is none of"),
    "const": _check(object, lambda v, limit: v == limit, "is not"),
    "minimum": _check(NUMBER, lambda v, limit: v >= limit, "is below"),
    "maximum": _check(NUMBER, lambda v, limit: v <= limit, "is above"),
    "exclusiveMinimum": _check(NUMBER, lambda v, limit: v > limit, "is not above"),
    "exclusiveMaximum": _check(NUMBER, lambda v, limit: v < limit, "is not below"),
    "minLength": _check(str, lambda v, limit: len(v) >= limit, "is shorter than"),
    "maxLength": _check(str, lambda v, limit: len(v) <= limit, "is longer than"),
    "minItems": _check(list, lambda v, limit: len(v) >= limit, "has fewer entries than"),
    "maxItems": _check(list, lambda v, limit: len(v) <= limit, "has more entries than"),
    "minProperties": _check(dict, lambda v, limit: len(v) >= limit, "has fewer keys than"),
    "uniqueItems": _check(list, lambda v, limit: not limit or len({*map(str, v)}) == len(v), "has repeats"),
    "pattern": _check(str, lambda v, limit: re.search(limit, v) is not None, "does not match"),
}
