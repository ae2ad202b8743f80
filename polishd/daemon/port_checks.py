"""What a device lacks of its port, told from the port's Protocol before anything is opened.

A cell that found it out in use would find it out in contact: an actuator without ``retract`` presses, and cannot lift.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from functools import cached_property
from inspect import Parameter
from typing import Any

MISSING = object()


def missing_members(device: object, port: type) -> list[str]:
    """Each member of the port that the device has not, or has as something else; nothing of it is called."""
    asked = members(port)
    missing = [name for name in asked if _found(device, name) is MISSING]
    found = [f"it has no {', '.join(map(repr, missing))}"] if missing else []
    return found + [why for name in asked if name not in missing and (why := _wrong(device, name, asked[name]))]


def members(port: type) -> dict[str, Any]:
    """What a Protocol asks, by name: functions, properties, and the annotations of plain attributes."""
    found: dict[str, Any] = {}
    for kind in port.__mro__:
        if getattr(kind, "_is_protocol", False):
            asked = {**inspect.get_annotations(kind), **vars(kind)}
            found = {name: member for name, member in asked.items() if not name.startswith("_")} | found
    return found


def _found(device: object, name: str) -> Any:
    """The member: a property itself, for its getter may ask a device that is not open; else as the device gives it."""
    static = inspect.getattr_static(device, name, MISSING)
    return static if isinstance(static, property | cached_property) else getattr(device, name, MISSING)


def _wrong(device: object, name: str, asked: Any) -> str | None:
    has = _found(device, name)
    if not inspect.isfunction(asked):
        return f"its {name!r} is a method; the port asks for a property" if inspect.isroutine(has) else None
    if not callable(has):
        return f"its {name!r} is no method: {type(has).__name__}"
    return _wrong_kind(name, inspect.unwrap(has), asked) or _wrong_arguments(name, has, asked)


def _wrong_kind(name: str, method: Callable[..., Any], asked: Callable[..., Any]) -> str | None:
    """A port's ``def`` that gives an iterator is kept by an async generator, or by a ``def`` that gives one."""
    if inspect.iscoroutinefunction(asked):
        return (
            None if inspect.iscoroutinefunction(method) else f"its {name!r} is no coroutine function: write async def"
        )
    if inspect.iscoroutinefunction(method) or inspect.isgeneratorfunction(method):
        return f"its {name!r} is no async generator: write async def, with yield in it"
    return None


def _wrong_arguments(name: str, method: Callable[..., Any], asked: Callable[..., Any]) -> str | None:
    """The calls that the port allows must bind."""
    signature = inspect.signature(method)
    for positional, keywords in _calls(list(inspect.signature(asked).parameters.values())[1:]):
        try:
            signature.bind(*positional, **keywords)
        except TypeError as error:
            call = ", ".join([*positional, *(f"{key}=..." for key in keywords)])
            return f"its {name!r} cannot be called as {name}({call}): {error}"
    return None


def _calls(parameters: list[Parameter]) -> Iterator[tuple[list[str], dict[str, str]]]:
    names = [one.name for one in parameters]
    yield [one.name for one in parameters if one.default is Parameter.empty], {}
    yield names, {}
    yield [], dict.fromkeys(names, "")
