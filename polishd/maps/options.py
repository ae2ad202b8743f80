"""Options that several verbs of ``polishd map`` take."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from typer import Option

from polishd.util.command_line import Picture

# readable=False, here and in cli.py: what cannot be read is exit code 8, as what is broken is; typer would make it 2
Profile = Annotated[
    Path | None,
    Option(metavar="P.toml", help="The instrument's profile: apply it first, and its system map.", readable=False),
]
OfCell = Annotated[
    Path | None,
    Option("--cell", metavar="CELL.toml", help="Read as this cell does: plugins, profile, system map.", readable=False),
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
Units = Annotated[
    str | None,
    Option(
        "--units",
        metavar="XY,Z",
        help="Units of a file that does not say them: of places and heights, as mm,nm; one alone is of heights.",
    ),
]
BANDS = "33,0.12"
Trim = Annotated[int, Option(min=0, max=1000, metavar="N", help="Pixels to take off every edge of the data.")]
Bands = Annotated[str, Option(metavar="MM,...", help="Periods between the bands, falling.")]
MapsPicture = Annotated[
    Path | None, Option("--picture", metavar="PNG", help="Draw the maps, and what was made of them.")
]
Json = Annotated[bool, Option("--json", help="One JSON object a file on stdout, for programs.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOptions:
    """How a verb reads its maps."""

    profile: Profile = None
    cell: OfCell = None
    as_format: AsFormat = None
    units: Units = None
    masks: Masks = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WriteOptions(ReadOptions):
    """What a verb that writes maps is asked for besides."""

    force: Annotated[bool, Option("--force", help="Replace what is written where it is there.")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class NewMapOptions(WriteOptions):
    """What a verb is asked for that makes a map of several: ``subtract``."""

    out: Annotated[Path | None, Option(metavar="C", help="The new map; its ending says the format.")] = None
    picture: MapsPicture = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AverageOptions(NewMapOptions):
    """What ``average`` is asked for."""

    system: Annotated[
        Path | None, Option(metavar="MAP", help="The instrument's own error: off each.", readable=False)
    ] = None
    mixed: Annotated[
        bool, Option("--mixed", help="Also maps of unknown pitch, or of several instruments: to look at.")
    ] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StitchOptions(NewMapOptions):
    """What ``stitch`` is asked for."""

    at: Annotated[Path, Option(metavar="CSV", help="Where each map's centre lies: file,x_mm,y_mm.", readable=False)]
    uncertainty: Annotated[
        Path | None, Option(metavar="U", help="A map of the standard deviation of each sample of C.")
    ] = None
    free: Annotated[str, Option(metavar="power,shift", help="What else may differ from map to map.")] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureOptions(ReadOptions):
    """What ``figures`` and ``compare`` are asked for."""

    out: Picture = None
    trim: Trim = 0
    bands: Bands = BANDS


class ZernikeOrder(StrEnum):
    """Orderings of Zernike terms."""

    fringe = "fringe"
    noll = "noll"
    ansi = "ansi"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportOptions(ReadOptions):
    """What ``report`` is asked for."""

    out: Annotated[Path, Option("--out", metavar="REPORT", help="The report: *.html or *.pdf.")]
    tolerance: Annotated[
        Path | None,
        Option(
            metavar="T.toml",
            help="The drawing's lines, as [[tolerance]] of a cell has them; else those of --cell.",
            readable=False,
        ),
    ] = None
    wavelength: Annotated[
        float, Option(min=100.0, max=20000.0, metavar="NM", help="Of the waves: ISO's e line, or 632.8.")
    ] = 546.07
    zernike: Annotated[ZernikeOrder, Option(help="Ordering of the Zernike terms.")] = ZernikeOrder.fringe
    terms: Annotated[int, Option(min=15, max=120, metavar="N", help="Zernike terms of the fit.")] = 36
    by: Annotated[str, Option(metavar="NAME", help="Who answers for the report.")] = ""
    trim: Trim = 0
    bands: Bands = BANDS


@dataclass(frozen=True, slots=True, kw_only=True)
class AbsoluteOptions(WriteOptions):
    """What ``absolute`` is asked for."""

    angles: Annotated[
        str | None,
        Option(metavar="DEG,...", help="How far the part is turned in each map, counter-clockwise as displayed."),
    ] = None
    shifts: Annotated[
        str | None, Option(metavar="X,Y:...", help="By which it is shifted in each, mm right and up; 0,0 where not.")
    ] = None
    at: Annotated[
        Path | None,
        Option(metavar="CSV", help="Both from a list: file,angle_deg and, where shifted, x_mm,y_mm.", readable=False),
    ] = None
    out_instrument: Annotated[
        Path | None, Option(metavar="S", help="The instrument's own error; its ending says the format.")
    ] = None
    out_part: Annotated[Path | None, Option(metavar="P", help="The part, without that error.")] = None
    axis: Annotated[
        str | None, Option(metavar="X,Y", help="Where the part is turned about, mm from the map's centre.")
    ] = None
    order: Annotated[int, Option(min=4, max=14, metavar="N", help="Radial order of the Zernike terms.")] = 10
    noise: Annotated[
        float | None, Option(min=0.0, metavar="NM", help="White noise of a sample; found from the maps unless given.")
    ] = None
    angle_error: Annotated[float, Option(min=0.0, metavar="DEG", help="How well angles are known, 1 sigma.")] = 0.0
    shift_error: Annotated[float, Option(min=0.0, metavar="MM", help="How well places are known, 1 sigma.")] = 0.0
    picture: MapsPicture = None
