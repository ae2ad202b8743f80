"""A map's history in the texts of the files that are written here: a line of JSON behind a mark."""

from __future__ import annotations

from polishd.api import BadMap, SurfaceMap
from polishd.model.map_history import MapStep

MARK = "polishd history: "


def line_of(surface: SurfaceMap) -> str | None:
    """The line that keeps it; None where there is none. BadMap where it has grown beyond what is read back."""
    if surface.history is None:
        return None
    try:
        return MARK + surface.history.to_json()
    except ValueError as error:
        raise BadMap(f"its history is too long: {error}; begin with the measured maps again") from error


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
