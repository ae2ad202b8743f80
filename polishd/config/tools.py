"""Several tools over one part: what of the cell's file is another one for each."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

from pydantic import Field

from polishd.config.places import Location, TomlSource
from polishd.config.process import Poisson, Preston
from polishd.config.values import ConfigSection, Dip, Force, NotNegative, Pair, Positive, Speed, Text


class ToolSection(ConfigSection):
    """A tool, `[tools.NAME]`: in the order of the file they polish one part (docs/tools.md).

    What it leaves out is as `[process]`, `[kinematics]` and `[touch_off]` say.
    """

    program: Text | None = None
    """The part program of its passes; left out: `program.path`."""
    passes: Annotated[int, Field(ge=1, le=100)] = 1
    """Its passes, each with a measurement after it, before the next tool has its turn; the last one goes on to the
    job's end. [1]"""
    change_s: NotNegative = 0.0
    """Machine time that it takes to change to it: counted in a plan's total."""
    position_mm: Positive | None = None
    """`touch_off.position_mm` with this tool."""
    tool_length_mm: Positive | None = None
    """`kinematics.tool_length_mm` with this tool."""
    removal_model: Text | None = None
    """`process.removal_model`, and so on to the end: of this tool."""
    tif: Text | None = None
    """File of its measured TIF."""
    tool_radius_mm: Positive | None = None
    """Radius of its sphere."""
    force_n: Force | None = None
    """Force on it."""
    force_max_n: Force | None = None
    """`process.force_max_n` with this tool."""
    rpm: Speed | None = None
    """Speed of the spindle."""
    dip_deg: Dip | None = None
    """Angle between the spindle and the surface's normal."""
    preston: Preston | None = None
    """Its Preston constant with unit. [as written]"""
    depth_exponent: Annotated[float, Field(gt=0, le=4)] | None = None
    """m of the correction `power`. [1]"""
    spot_offset_mm: Pair | None = None
    """Where its spot's centre lies from the programmed point."""
    tool_modulus_mpa: Positive | None = None
    """Its Young's modulus."""
    tool_poisson: Poisson | None = None
    """Its Poisson's ratio. [1]"""


ELSEWHERE = {
    "program": ("program", "path"),
    "position_mm": ("touch_off", "position_mm"),
    "tool_length_mm": ("kinematics", "tool_length_mm"),
}
"""Keys that are no key of ``[process]``, and what they stand for."""
OF_THE_TURN = ("passes", "change_s")


def tool_overlay(raw: Mapping[str, Any], source: TomlSource, name: str) -> tuple[dict[str, Any], TomlSource]:
    """The cell's values, as they were written, with that tool on its spindle and no other; and where each stands."""
    values = copy.deepcopy(dict(raw))
    written = list[tuple[Location, Location]]()
    for key, value in values.pop("tools")[name].items():
        if key not in OF_THE_TURN:
            section, stands_for = ELSEWHERE.get(key, ("process", key))
            values.setdefault(section, {})[stands_for] = value
            written.append(((section, stands_for), ("tools", name, key)))
    values.setdefault("memory", {})["tool"] = name
    return values, replace(source, stands_for=tuple(written))
