"""The reference of all keys, written from the models that read them: ``python -m docs.reference.write``."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from docs.reference import ports
from polishd.config.cell import CellConfig
from polishd.config.cell_sections import DeviceSection
from polishd.config.controller_profile import ControllerProfile
from polishd.config.device_profile import DeviceProfile
from polishd.config.fields import ConfigSection
from polishd.config.instrument_profile import ProfileFile
from polishd.config.server_sections import ShopFile
from polishd.config.simulator import SimConfig
from polishd.config.study import KINDS
from polishd.config.sweep import SweepSection
from polishd.config.toml_loader import meanings, section_of, toml_type, variants
from polishd.plugin_loader import load_own
from polishd.reports.certificate.model import schema
from polishd.sim_backends.common.registry import sim_devices


class Swept(ConfigSection):
    """Section that a study of any kind may have."""

    sweep: SweepSection | None = None


Table = tuple[str, type[BaseModel]]
"""A header, and the model of the table."""
FOLDER = Path(__file__).parent
UNITS = {
    "n_mm_per_rad": "N mm/rad", "n_per_mm": "N/mm", "n_mm2": "N mm^2", "nm2_s2": "nm^2/s^2", "mpa_s": "MPa s",
    "mm_s2": "mm/s^2", "mm_s": "mm/s", "mpa": "MPa", "percent": "%", "deg": "deg", "rpm": "rpm", "mm": "mm", "nm": "nm",
    "ms": "ms", "s": "s", "n": "N",
}  # fmt: skip
"""Unit of a key by its name's ending. Without one there, the description ends with the unit in brackets; 1: none."""
BOUNDS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
TYPES = {
    "number": "number",
    "integer": "whole number",
    "boolean": "true or false",
    "string": "text",
    "path": "path",
    "date-time": "date and time",
    "object": "table",
    "any": "value",
}
PLURAL = {"number": "s", "integer": "s", "string": "s", "any": "s"}
COLUMNS = "| key | type | unit | default | range | meaning |\n|---|---|---|---|---|---|"
CERTIFICATE = "certificate.schema.json"
HEAD = "<!-- Written by `make reference` from the models; a test fails where it is not what they give. -->"
TITLES = {
    "cell": "A cell",
    "study": "A study",
    "profile": "An instrument's profile",
    "device": "A device's profile",
    "controller": "A robot controller's profile",
    "simulator": "The simulator",
    "shop": "A shop",
}
INTRODUCTIONS = {
    "cell": """This page lists the keys of a cell's file; [examples/cell.toml](../../examples/cell.toml) shows them with
comments. Relative paths start from the file's folder. The options of `[robot]`, `[actuator]`, `[spindle]`,
`[metrology]`, `[loader]`, `[force_sensor]`, `[monitor]` and `[notify.NAME]` depend on `type`. This page has polishd's
own types; other plugins may add more.

Editors complete and check keys with the JSON Schemas in `polishd/config/schemas` (cell, study, instrument, device). VS
Code (Even Better TOML) and taplo read the path from the first line of a file, as in the examples:
`#:schema PATH/cell.json`. `python -c "import polishd.config as c; print(c.__path__[0])"` prints the folder of an
installed polishd in which `schemas` lies.""",
    "study": """This page lists the keys of a study's file; [studies.md](../how-to/studies.md) describes what they
compute. The keys depend on `kind`. `[part]`, `[kinematics]`, `[compliance]` and `[process]` are those of
[a cell](cell.md), with their defaults.""",
    "profile": """This page lists the keys of an instrument's profile;
[examples/instrument.toml](../../examples/instrument.toml) shows them with comments, and
[instruments.md](../how-to/instruments.md) describes how to prove the profile.""",
    "device": """This page lists the keys of a profile of a drive or a sensor; [devices.md](../how-to/devices.md) says
how to make and try one. A profile has one of `[actuator]`, `[spindle]`, `[force_sensor]`, and one of `[modbus]`,
`[lines]`.""",
    "controller": """This page lists the keys of the profile of a robot controller that loads files
(`[robot] type = "plc_robot"`); the shipped ones are in `polishd/config/controller_profiles`.
[protocols/plc_robot.md](../protocols/plc_robot.md) describes each variable.""",
    "simulator": """This page lists the keys of sim.toml: what only a simulator knows of a cell.
[examples/sim.toml](../../examples/sim.toml) shows them with comments. Every key may be left out: the value is then that
of the file in `cell`, else the default of this page.""",
    "shop": """This page lists the keys of the file of a shop; [shop.md](../how-to/shop.md) says how to set one up.""",
}


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a file."""

    name: str
    schema: dict[str, Any]
    """Schema of its values by pydantic: type and range."""
    given: tuple[Any, ...]
    """Its default; empty where it must be written."""
    meaning: str

    @property
    def type(self) -> str:
        """Type of its values, as text."""
        return _type(_plain(self.schema))

    @property
    def unit(self) -> str:
        """Unit of its numbers; empty where it has none."""
        stated = re.search(r" \[([^]]+)\]$", self.meaning)
        ending = next((unit for end, unit in UNITS.items() if re.search(rf"(^|_){end}$", self.name)), "")
        return stated[1] if stated else ending if "number" in self.type else ""

    @property
    def default(self) -> str:
        """Its default, as the file would have it."""
        if not self.given:
            return "required"
        return "none" if self.given[0] is None else f"`{_toml(self.given[0])}`"

    @property
    def range(self) -> str:
        """Values that are allowed of the type."""
        return _range(_plain(self.schema))

    def row(self) -> str:
        """Return its line of the table."""
        meaning = re.sub(r" \[[^]]+\]$", "", self.meaning).replace("``", "`").replace("|", "\\|")
        return f"| `{self.name}` | {self.type} | {self.unit} | {self.default} | {self.range} | {meaning} |"


def keys(model: type[BaseModel]) -> list[Key]:
    """Return the keys of a table, without those that are tables themselves, and without the kind in its header."""
    found = model.model_json_schema(mode="serialization")["properties"]
    described, given = meanings(model), model.model_construct().model_dump(mode="json")
    own = [name for name in model.model_fields if not _tables(model, name) and "const" not in found[name]]
    return [Key(name, found[name], (given[name],) if name in given else (), described.get(name, "")) for name in own]


def tables(model: type[BaseModel], above: str = "") -> Iterator[Table]:
    """Each table below a model: its header, with ``type = ...`` where there are several kinds, and its model."""
    for name in model.model_fields:
        for header, inner in _tables(model, name):
            yield header.format(above + name), inner
            yield from tables(inner, f"{above}{name}{'.NAME' if '.NAME' in header else ''}.")


def _tables(model: type[BaseModel], name: str) -> list[Table]:
    """Headers and models of a key that is a table, a list of tables, or a table of them by name; none of any other."""
    kind = toml_type(model.model_fields[name].annotation)
    if inner := section_of(kind):
        return [("[{}]", inner)]
    found = [(f'[{{}}] type = "{tag}"', inner) for tag, inner in variants(kind).items()]
    listed = "[[{}]]" if get_origin(kind) is tuple else "[{}.NAME]"
    return found or [(listed, inner) for inner in map(section_of, get_args(kind)) if inner]


def cell() -> list[Table]:
    """The tables of a cell's file in the order of the example; devices and notifiers are polishd's own types.

    What few cells need stands there as a comment, or comes last.
    """
    written = re.findall(r"^(?:# )?\[+(\w+)", (FOLDER / "../../examples/cell.toml").read_text(), re.MULTILINE)
    own = load_own()
    found = [table for table in tables(CellConfig) if table[1] is not DeviceSection]
    found += [(f'[{kind.port}] type = "{kind.name}"', kind.options) for kind in own.device_types().values()]
    found += [(f'[notify.NAME] type = "{kind.name}"', kind.options) for kind in own.notifiers().values()]
    order = {name: place for place, name in reversed(list(enumerate(written)))}
    last = len(written)
    return [("", CellConfig), *sorted(found, key=lambda table: order.get(re.findall(r"\w+", table[0])[0], last))]


def files() -> dict[str, list[Table]]:
    """Each kind of file with its tables; the first of them is the file's own keys, or those of each kind of study."""
    of_cell = cell()
    kinds = {f'kind = "{name}"': model for name, model in KINDS.items()}
    below = dict.fromkeys(table for model in KINDS.values() for table in tables(model))
    return {
        "cell": of_cell,
        "study": [*kinds.items(), *(table for table in below if table not in of_cell), *tables(Swept)],
        "profile": [("", ProfileFile), *tables(ProfileFile)],
        "device": [("", DeviceProfile), *tables(DeviceProfile)],
        "simulator": simulator(),
        "shop": list(tables(ShopFile)),
        "controller": _each_once([("", ControllerProfile), *tables(ControllerProfile)]),
    }


def simulator() -> list[Table]:
    """The tables of SIM.toml: those that simulated devices share, and those that a device declares."""
    shared: list[Table] = [("", SimConfig), *tables(SimConfig)]
    known = {model for _, model in shared}
    declared = [(f'[{one.device}] kind = "{one.name}"', one.section) for one in sim_devices()]
    return shared + [table for table in declared if table[1] not in known]


def _each_once(found: list[Table]) -> list[Table]:
    """Of tables alike, one, with the headers of all."""
    headers: dict[type[BaseModel], list[str]] = {}
    for header, model in found:
        headers.setdefault(model, []).append(header)
    return [(" ".join(all_), model) for model, all_ in headers.items()]


def pages() -> dict[str, str]:
    """The reference: the text of each page by its file's name."""
    return {f"{name}.md": _page(name, content) for name, content in files().items()}


def certificate() -> str:
    """The JSON Schema of a certificate's twin."""
    return json.dumps(schema(), indent=2) + "\n"


def _page(name: str, content: list[Table]) -> str:
    text = [HEAD, f"# {TITLES[name]}", INTRODUCTIONS[name]]
    for header, model in content:
        text += [f"## `{header}`", (inspect.getdoc(model) or "").replace("``", "`")] if header else []
        rows = [key.row() for key in keys(model)]
        text += ["\n".join([COLUMNS, *rows])] if rows else []
    return "\n\n".join(text) + "\n"


def _plain(schema: dict[str, Any]) -> dict[str, Any]:
    """Of a key that may be left out, what it is where it is given."""
    kinds = [kind for kind in schema.get("anyOf", ()) if kind.get("type") != "null"]
    return kinds[0] if len(kinds) == 1 else schema


def _inner(schema: dict[str, Any]) -> dict[str, Any]:
    """Of a list's entries."""
    first: dict[str, Any] = next(iter(schema.get("prefixItems", ())), schema.get("items", {}))
    return first


def _counts(schema: dict[str, Any]) -> tuple[int, int]:
    """Fewest and most entries of a list; 0: any."""
    least, most = (schema.get(f"{end}Items") or schema.get(f"{end}Length", 0) for end in ("min", "max"))
    return least, most


def _type(schema: dict[str, Any]) -> str:
    if kinds := schema.get("anyOf"):
        return " or ".join(dict.fromkeys(_type(kind) for kind in kinds if kind.get("type") != "null"))
    if schema.get("type") == "array":
        least, most = _counts(schema)
        count = f"{most} " if least == most != 0 else ""
        inner = _inner(schema)
        kinds = [kind for kind in inner.get("anyOf", [inner]) if kind.get("type") != "null"]
        named = (_type(kind).replace("list", "lists") + PLURAL.get(kind.get("type", "any"), "") for kind in kinds)
        return f"list of {count}{' or '.join(dict.fromkeys(named))}"
    return TYPES[schema.get("format", schema.get("type", "any"))]


def _range(schema: dict[str, Any]) -> str:
    """What is allowed of the type, entries of a list included."""
    if values := schema.get("enum"):
        return ", ".join(f"`{_toml(value)}`" for value in values)
    found = [f"{sign} {_toml(schema[name])}" for name, sign in BOUNDS.items() if name in schema]
    if schema.get("type") == "array" and _counts(schema)[0] and not _counts(schema)[1]:
        found.append(f"{_counts(schema)[0]} or more")
    inner = _range(_inner(schema)) if schema.get("type") == "array" else ""
    return ", ".join(filter(None, [*found, schema.get("range", ""), inner]))


def _toml(value: Any) -> str:
    short = f"{value:g}" if isinstance(value, float) else ""
    return short if short and float(short) == value else json.dumps(value, ensure_ascii=False)


if __name__ == "__main__":
    for name, text in pages().items():
        (FOLDER / name).write_text(text)
    (FOLDER / CERTIFICATE).write_text(certificate())
    ports.PAGE.write_text(ports.laid_into(ports.PAGE.read_text()))
