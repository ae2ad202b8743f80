"""JSON Schemas for editors: current, valid for every shipped file, and they refuse what polishd refuses."""

from __future__ import annotations

import json
import re
import tomllib
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from docs.reference import schemas
from tests.json_schema import faults

ROOT = Path(__file__).parents[3]
LINE = re.compile(r"\A#:schema (\S+)\n")
EXAMPLES = sorted((ROOT / "examples").glob("*.toml"))
WITHOUT = {"job.toml", "sim.toml"}
"""Examples of kinds of files that have no schema."""


@cache
def schema(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((schemas.FOLDER / name).read_text())
    return found


def test_the_schemas_are_current() -> None:
    made = schemas.schemas()
    assert {path.name for path in schemas.FOLDER.iterdir()} == made.keys()
    for name, each in made.items():
        assert (schemas.FOLDER / name).read_text() == schemas.text_of(each), f"{name}: run `make reference`"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_is_valid_by_the_schema_that_it_names(path: Path) -> None:
    text = path.read_text()
    line = LINE.match(text)
    assert (line is None) == (path.name in WITHOUT)
    if line is not None:
        named = path.parent / line[1]
        assert named.resolve().parent == schemas.FOLDER.resolve()
        assert list(faults(tomllib.loads(text), schema(named.name))) == []


@pytest.mark.parametrize(
    "path", sorted((ROOT / "polishd" / "config" / "device_profiles").glob("*.toml")), ids=lambda path: path.stem
)
def test_a_shipped_device_profile_is_valid(path: Path) -> None:
    assert list(faults(tomllib.loads(path.read_text()), schema("device.json"))) == []


@pytest.mark.parametrize(
    ("example", "of", "key", "value", "fault"),
    [
        ("cell.toml", "cell.json", "robot.adress", "tcp://1", ".robot.adress: unknown key"),
        ("cell.toml", "cell.json", "actuator.landing_s", "soon", ".actuator.landing_s: 'soon' is no number"),
        ("cell.toml", "cell.json", "process.correction", "exakt", "is none of"),
        ("cell.toml", "cell.json", "process.tool_radius_mm", -1.0, "is not above 0"),
        ("cell.toml", "cell.json", "between.settle", 1, ".between: unknown key"),
        ("cell.toml", "cell.json", "notify.mail.severity", "loud", ".notify.mail"),
        ("cell.toml", "cell.json", "dwell.curve", 1, ".dwell.curve: 1 is no boolean"),
        ("table_iv.toml", "study.json", "seed", True, "seed"),
        ("table_iv.toml", "study.json", "kind", "lop", ".kind: 'lop' is none of"),
        ("instrument.toml", "instrument.json", "orientation.mirror", "yes", ".orientation.mirror: 'yes' is no boolean"),
        ("line_drive.toml", "device.json", "nmae", "x", ".nmae: unknown key"),
    ],
)
def test_a_mistake_is_found(example: str, of: str, key: str, value: Any, fault: str) -> None:
    values = deepcopy(tomllib.loads((ROOT / "examples" / example).read_text()))
    *above, last = key.split(".")
    table = values
    for name in above:
        table = table.setdefault(name, {})
    table[last] = value
    found = list(faults(values, schema(of)))
    assert any(fault in each for each in found), found


def test_a_device_of_another_plugin_may_have_any_key() -> None:
    values = tomllib.loads((ROOT / "examples" / "cell.toml").read_text())
    values["spindle"] = {"type": "a_spindle_of_yours", "anything": [1, {"a": 2}]}
    assert list(faults(values, schema("cell.json"))) == []


def test_keys_have_meanings_and_none_is_null() -> None:
    cell = schema("cell.json")
    force = cell["definitions"]["ProcessSection"]["properties"]["force_n"]
    assert force["description"]
    assert '"null"' not in json.dumps(cell)
