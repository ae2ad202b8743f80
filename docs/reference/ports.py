"""Write docs/reference/ports.md from the Protocols, the records and the suites that check drivers."""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, fields
from pathlib import Path
from types import ModuleType
from typing import Any

from polishd.config.cell import PORTS
from polishd.daemon.cell.device_polling import members
from polishd.interfaces import Device
from polishd.model import devices
from polishd.testing.suites import actuator, device, force_sensor, loader, monitor, robot, spindle

PAGE = Path(__file__).with_name("ports.md")
BEGIN, END = "<!-- Written by `make reference` from the code, down to the end of it. -->", "<!-- The end of it. -->"
SUITES = {
    "robot": robot,
    "actuator": actuator,
    "spindle": spindle,
    "loader": loader,
    "force_sensor": force_sensor,
    "monitor": monitor,
}
ASPECTS = ("Time", "Errors", "Cancelled")
COLUMNS = "| member | what it does | time | errors | when the caller is cancelled |\n|---|---|---|---|---|"


def aspects(member: Any) -> dict[str, str]:
    """Split a docstring: "" is what the method does, then come ``Time``, ``Errors``, ``Cancelled``."""
    text = _flat(inspect.getdoc(member) or "")
    found = re.split(rf" ?\b({'|'.join(ASPECTS)}): ", text)
    return {"": found[0], **dict(zip(found[1::2], found[2::2], strict=True))}


def methods(port: type) -> dict[str, Any]:
    """Return the members of a port, without those of all devices."""
    common = {} if port is Device else members(Device)
    return {name: member for name, member in members(port).items() if name not in common and name != "times"}


def laid_into(page: str) -> str:
    """Return the page with the generated text between its two marks."""
    head, _, rest = page.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f"{head}{BEGIN}\n\n{chr(10).join(_sections())}\n{END}{tail}"


def _sections() -> Iterator[str]:
    yield from _port("All devices", Device, device)
    for name, port in PORTS.items():
        title = f"`{port.protocol.__name__}`: `[{name}]`"
        yield from _port(title, port.protocol, SUITES.get(name))
    yield "## Records\n"
    for record in (getattr(devices, name) for name in vars(devices) if inspect.isclass(getattr(devices, name))):
        if record.__module__ == devices.__name__:
            yield from _record(record)


def _port(title: str, port: type, suite: ModuleType | None) -> Iterator[str]:
    yield f"## {title}\n"
    yield f"{_code(_flat(inspect.getdoc(port) or ''))}\n"
    yield COLUMNS
    for name, member in methods(port).items():
        parts = aspects(member)
        cells = [_call(name, member), *(_code(parts.get(aspect, "")) for aspect in ("", *ASPECTS))]
        yield f"| {' | '.join(cells)} |"
    yield ""
    if isinstance(times := members(port).get("times"), property) and times.fget:
        yield from _record(getattr(devices, inspect.get_annotations(times.fget)["return"]))
    if suite is not None:
        yield "The suite demands:\n"
        tests = [test for name, test in vars(suite).items() if name.startswith("test_")]
        yield from (f"- {_code(_flat(inspect.getdoc(test) or ''))}" for test in tests)
        yield ""


def _record(record: Any) -> Iterator[str]:
    found = _meanings(record)
    yield f"`{record.__name__}`: {_code(_flat(inspect.getdoc(record) or ''))}\n"
    yield "| field | type | default | meaning |\n|---|---|---|---|"
    for item in fields(record):
        default = "" if item.default is MISSING else f"`{item.default!r}`"
        kind = str(item.type).replace("|", "\\|")
        yield f"| `{item.name}` | `{kind}` | {default} | {_code(found.get(item.name, ''))} |"
    yield ""


def _call(name: str, member: Any) -> str:
    if isinstance(member, property):
        kind = inspect.get_annotations(member.fget)["return"] if member.fget else ""
        return f"`{name}: {kind}`"
    signature = inspect.signature(member)
    arguments = signature.replace(parameters=list(signature.parameters.values())[1:])
    asynchronous = "await " if inspect.iscoroutinefunction(member) else ""
    return f"`{asynchronous}{name}{arguments}`".replace("'", "").replace("|", "\\|").replace(" -> None", "")


def _meanings(record: type) -> dict[str, str]:
    (body,) = ast.parse(textwrap.dedent(inspect.getsource(record))).body
    found = {}
    for field, below in itertools.pairwise(getattr(body, "body", [])):
        match field, below:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                found[name] = _flat(text)
    return found


def _flat(text: str) -> str:
    return " ".join(text.split())


def _code(text: str) -> str:
    return text.replace("``", "`").replace("|", "\\|")
