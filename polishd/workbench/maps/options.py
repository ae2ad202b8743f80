"""Options that several verbs of ``polishd map`` take."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from polishd.workbench.options import Picture

# readable=False, here and in cli.py: what cannot be read is exit code 8, as what is broken is; typer would make it 2
Profile = Annotated[
    Path | None, Option(metavar="P.toml", help="The instrument's profile: apply it first.", readable=False)
]
OfCell = Annotated[
    Path | None, Option("--cell", metavar="CELL.toml", help="Read as this cell does: with its plugins.", readable=False)
]
AsFormat = Annotated[
    str | None, Option("--format", metavar="NAME", help="Read as this format, or ending, whatever a file is called.")
]
Masks = Annotated[
    list[str] | None,
    Option(
        "--mask",
        metavar="MASK",
        help="Only what lies in it counts; may be repeated: then what lies in all. circle:X,Y,R, annulus:X,Y,R,r, "
        "rectangle:X,Y,W,H, hexagon:X,Y,W in mm from the map's centre; polygon:FILE, map:FILE (where that has data). "
        "not: before it takes what lies outside, px: means pixels.",
    ),
]
BANDS = "33,0.12"
MapsPicture = Annotated[
    Path | None, Option("--picture", metavar="PNG", help="Draw the maps, and what was made of them.")
]
Json = Annotated[bool, Option("--json", help="One JSON object a file on stdout, for programs.")]


@dataclass(frozen=True, slots=True)
class FigureOptions:
    """What ``figures`` and ``compare`` are asked for."""

    out: Picture = None
    trim: Annotated[int, Option(min=0, max=1000, metavar="N", help="Pixels to take off every edge of the data.")] = 0
    profile: Profile = None
    bands: Annotated[str, Option(metavar="MM,...", help="Periods between the bands, falling.")] = BANDS
    cell: OfCell = None
    as_format: AsFormat = None
    masks: Masks = None
