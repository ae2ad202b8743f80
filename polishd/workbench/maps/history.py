"""The history that ``polishd map`` writes into its results, and shows of any map."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from polishd import __version__
from polishd.model.map_history import MapInput, MapStep
from polishd.model.surface import SurfaceMap
from polishd.workbench.maps.files import MapSource, printable

SHORT = 12
"""Digits of a hash that are shown to people."""


def history_step(
    surface: SurfaceMap,
    verb: str,
    inputs: Sequence[tuple[str, SurfaceMap]],
    source: MapSource,
    known_nm: float | None = None,
    **options: Any,
) -> SurfaceMap:
    """The map with its last step added.

    Args:
        surface: the result.
        verb: of ``polishd map``.
        inputs: what each map that was read was to the verb, and the map: "map", "system error", ...
        source: how they were read: masks and profile are options, too.
        known_nm: how sure a sample of the result is, one standard deviation; None: not known.
        options: what else was asked for, values of JSON; those that are None or False were not.
    """
    everything = source.options | options
    asked = {key: value for key, value in everything.items() if value is not None and value is not False}
    parts = tuple(
        MapInput(role, one.path.name if one.path is not None else "", one.sha256, one.history) for role, one in inputs
    )
    return replace(surface, history=MapStep(verb, __version__, asked, parts, known_nm))


def uncertainty_nm(surface: SurfaceMap) -> float | None:
    """How sure a sample of a map is by its history: one standard deviation; None where that does not say."""
    return None if surface.history is None else surface.history.uncertainty_nm


def known_lines(known_nm: float | None) -> list[str]:
    """The same for people, of what was made of several maps."""
    if known_nm is None:
        return ["how sure a sample is nobody knows: not each map says it of itself, as means of repeats do"]
    return [f"a sample is known to {known_nm:.4f} nm (one standard deviation), if the maps' errors are independent"]


def history_record(surface: SurfaceMap) -> dict[str, Any] | None:
    """For ``--json``: the last step, the histories of its inputs within it."""
    return None if surface.history is None else asdict(surface.history)


def history_rows(step: Mapping[str, Any] | None) -> Iterator[tuple[str, str]]:
    """The same for people: a row each step, the last one first, and a row each of its inputs."""
    if step is None:
        return
    options = ", ".join(f"{key} {_words(value)}" for key, value in step["options"].items())
    known = "" if step["uncertainty_nm"] is None else f"; a sample known to {step['uncertainty_nm']:.4g} nm"
    yield f"made by {step['verb']}", printable(f"polishd {step['version']}{f'; {options}' if options else ''}{known}")
    for one in step["inputs"]:
        yield f"  {one['role']}", printable(f"{one['name']}, sha256 {one['sha256'][:SHORT]}")
        for word, text in history_rows(one["history"]):
            yield f"    {word}", text


def _words(value: Any) -> str:
    if isinstance(value, Mapping):  # for programs: of the instrument's terms a matrix
        return f"({', '.join(value)})"
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
