"""JSON Schemas of a cell's, a study's and two kinds of profile's files, for editors: written by `make reference`.

A schema has the keys with types, ranges, defaults and meanings. It requires no key but ``type`` and ``kind``, because
an included fragment or a sweep may give any other one: `polishd check` and `polishd study` check the rest. The dialect
is draft 7, which the editors' TOML extensions read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from docs.reference import write
from polishd.config.cell import CellConfig
from polishd.config.cell_sections import NotifySection
from polishd.config.device_profile import DeviceProfile
from polishd.config.instrument_profile import ProfileFile
from polishd.config.study import KINDS
from polishd.config.sweep import SweepSection
from polishd.config.toml_loader import meanings
from polishd.plugin_loader import load_own

Schema = dict[str, Any]
FOLDER = Path(__file__).parents[2] / "polishd" / "config" / "schemas"
DRAFT = "http://json-schema.org/draft-07/schema#"


def schemas() -> dict[str, Schema]:
    """Return the schema of each kind of file by the name of the schema's file."""
    return {
        "cell.json": _headed("A cell of polishd", _cell()),
        "study.json": _headed("A study of polishd", _study()),
        "instrument.json": _headed("An instrument's profile of polishd", _of(ProfileFile)),
        "device.json": _headed("A device's profile of polishd", _of(DeviceProfile)),
    }


def text_of(schema: Schema) -> str:
    """Return a schema as its file has it."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _headed(title: str, schema: Schema) -> Schema:
    return {"$schema": DRAFT, **schema, "title": title}


def _cell() -> Schema:
    schema = _of(CellConfig)
    own = load_own()
    by_port: dict[str, dict[str, type[BaseModel]]] = {}
    for kind in own.device_types().values():
        by_port.setdefault(kind.port, {})[kind.name] = kind.options
    for port, kinds in by_port.items():
        schema["properties"][port] = _kinds(schema, CellConfig.model_fields[port].annotation, kinds, several=True)
    notifiers = {kind.name: kind.options for kind in own.notifiers().values()}
    one = _kinds(schema, NotifySection, notifiers, several=False)
    schema["properties"]["notify"] = {"type": "object", "additionalProperties": one}
    return schema


def _kinds(whole: Schema, annotation: Any, kinds: Mapping[str, type[BaseModel]], *, several: bool) -> Schema:
    """Return the schema of a section whose ``type`` decides the other keys; another plugin's type has any keys.

    ``several``: the section may be a table of such sections instead.
    """
    (section,) = [each for each in (annotation, *getattr(annotation, "__args__", ())) if hasattr(each, "model_fields")]
    shared = _of(section)["properties"]
    cases = []
    for name, options in kinds.items():
        found = _of(options)
        whole.setdefault("definitions", {}).update(found.pop("definitions", {}))
        keys = {**shared, **found["properties"], "type": {"const": name}}
        cases.append(
            {
                "if": {"properties": {"type": {"const": name}}, "required": ["type"]},
                "then": {"properties": keys, "additionalProperties": False},
            }
        )
    known = {"examples": sorted(kinds), "type": "string", "description": "Device type of a loaded plugin."}
    one = {"type": "object", "properties": {"type": known}, "allOf": cases}
    if not several:
        return {**one, "required": ["type"]}
    named = {"type": "object", "not": {"required": ["type"]}, "additionalProperties": {**one, "required": ["type"]}}
    return {"if": {"required": ["type"]}, "then": one, "else": named}


def _study() -> Schema:
    cases: list[Schema] = []
    definitions: Schema = {}
    sweep = _of(SweepSection)
    definitions |= sweep.pop("definitions", {})
    for kind, model in KINDS.items():
        found = _of(model)
        definitions |= found.pop("definitions", {})
        keys = {**found["properties"], "kind": {"const": kind}, "sweep": sweep}
        cases.append(
            {
                "if": {"properties": {"kind": {"const": kind}}},
                "then": {"properties": keys, "additionalProperties": False},
            }
        )
    kinds = {"enum": list(KINDS), "description": "What the study computes."}
    return {
        "type": "object",
        "properties": {"kind": kinds},
        "required": ["kind"],
        "allOf": cases,
        "definitions": definitions,
    }


def _of(model: type[BaseModel]) -> Schema:
    """Return the schema of a model: draft 7, meanings from its docstrings, nothing required, no null."""
    found = model.model_json_schema(mode="serialization")
    definitions = found.pop("$defs", {})
    models = {inner.__name__: inner for _, inner in write.tables(model)} | {model.__name__: model}
    for name, one in {**definitions, model.__name__: found}.items():
        if name in models:
            _describe(one, meanings(models[name]))
    found["definitions"] = definitions
    clean: Schema = _draft_7(found)
    return clean


def _describe(schema: Schema, described: Mapping[str, str]) -> None:
    for name, each in schema.get("properties", {}).items():
        if name in described:
            each["description"] = described[name].replace("``", "`")


_LEFT_OUT = ("title", "range", "discriminator", "required")


def _draft_7(node: Any) -> Any:
    if isinstance(node, list):
        return [_draft_7(each) for each in node]
    if not isinstance(node, dict):
        return node
    if "properties" in node and isinstance(node["properties"], dict):
        keys = {name: _draft_7(each) for name, each in node["properties"].items()}
        rest = {name: _draft_7(each) for name, each in node.items() if name not in {"properties", *_LEFT_OUT}}
        return {**rest, "properties": keys}
    made = dict(_pairs(node))
    kinds = [each for each in made.get("anyOf", ()) if each != {"type": "null"}]
    if "anyOf" in made:
        made.pop("anyOf")
        made |= kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    return made


def _pairs(node: Schema) -> Iterator[tuple[str, Any]]:
    for name, value in node.items():
        if name in _LEFT_OUT or (name == "default" and (value is None or isinstance(value, dict))):
            continue
        if name == "$ref":
            yield name, value.replace("#/$defs/", "#/definitions/")
        elif name == "prefixItems":
            yield "items", _draft_7(value)
        else:
            yield name, _draft_7(value)


def write_schemas() -> None:
    """Write all schemas into the package."""
    FOLDER.mkdir(exist_ok=True)
    for name, schema in schemas().items():
        (FOLDER / name).write_text(text_of(schema))


if __name__ == "__main__":
    write_schemas()
