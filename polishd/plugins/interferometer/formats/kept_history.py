"""A map's history in the texts of the files that are written here: a line of JSON behind a mark, or a few words."""

from __future__ import annotations

import re
from typing import Any

from polishd.api import MapError, SurfaceMap
from polishd.model.map_history import MapStep

MARK = "polishd history: "
WRITTEN, BRIEF_BYTES = "written by polishd", 82
BRIEF = re.compile(
    rf"{WRITTEN} (?P<version>\S+): (?P<verb>\w+)(?P<mixed>; mixed)?(?:; profile (?P<name>.+))?", re.DOTALL
)


def line_of(surface: SurfaceMap) -> str | None:
    """The line that keeps it; None where there is none. BadMap where it has grown beyond what is read back."""
    if surface.history is None:
        return None
    try:
        return MARK + surface.history.to_json()
    except ValueError as error:
        raise MapError(f"its history is too long: {error}; begin with the measured maps again") from error


def found_in(text: str) -> tuple[MapStep | None, tuple[str, ...]]:
    """The history in a text that may hold other lines, too, and a warning where it is broken: the heights are not."""
    lines = [line.strip() for line in text.splitlines()]
    kept = [line.removeprefix(MARK) for line in lines if line.startswith(MARK)]
    if not kept:
        return None, ()
    try:
        return MapStep.from_json(kept[-1]), ()
    except ValueError as error:
        reason = str(error).splitlines()[0]
        return None, (f"its history cannot be read: {reason}",)


def brief_of(surface: SurfaceMap) -> bytes:
    """What a comment of 82 letters holds of it: the last verb, and what no later reader may overlook, of any step."""
    step = surface.history
    if step is None:
        return WRITTEN.encode()
    options: dict[str, Any] = {}
    for one in step.steps:
        options |= one.options
    mixed = "; mixed" if options.get("mixed") else ""
    profile = f"; profile {options['profile']}" if "profile" in options else ""
    return f"{WRITTEN} {step.version}: {step.verb}{mixed}{profile}".encode("latin-1", "replace")[:BRIEF_BYTES]


def found_in_brief(comment: str) -> MapStep | None:
    """The step, without its inputs; None where the comment is another's, or says nothing."""
    found = BRIEF.fullmatch(comment)
    if found is None:
        return None
    options: dict[str, Any] = {"mixed": True} if found["mixed"] else {}
    return MapStep(found["verb"], found["version"], options | ({"profile": found["name"]} if found["name"] else {}), ())
