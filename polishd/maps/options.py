"""Options of the commands of ``polishd map``."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from typer import Option

from polishd.util.command_line import Picture

# readable=False: an unreadable map has exit code 8, as a broken one; typer would use 2
Profile = Annotated[
    Path | None,
    Option(
        metavar="P.toml", help="Profile of the instrument; it is applied first, with its system map", readable=False
    ),
]
OfCell = Annotated[
    Path | None,
    Option(
        "--cell", metavar="CELL.toml", help="Read with the plugins, profile and system map of this cell", readable=False
    ),
]
AsFormat = Annotated[
    str | None, Option("--format", metavar="NAME", help="Read as this format or ending, independent of the file's name")
]
Masks = Annotated[
    list[str] | None,
    Option(
        "--mask",
        metavar="MASK",
        help="Use samples inside this shape only; repeat for their intersection: circle:X,Y,R, annulus:X,Y,R,r, "
        "rectangle:X,Y,W,H or hexagon:X,Y,W in mm from the map's center, polygon:FILE, or map:FILE (its valid "
        "samples); not:SHAPE takes the outside, px:SHAPE is in pixels",
    ),
]
Units = Annotated[
    str | None,
    Option(
        "--units",
        metavar="XY,Z",
        help="Units of positions and heights for a file without units, such as mm,nm; a single one is of heights",
    ),
]
BANDS = "33,0.12"
Trim = Annotated[int, Option(min=0, max=1000, metavar="N", help="Pixels to remove at each edge of the data")]
Bands = Annotated[str, Option(metavar="MM,...", help="Periods between the bands, in descending order")]
MapsPicture = Annotated[Path | None, Option("--picture", metavar="PNG", help="Draw the maps and the result")]
Json = Annotated[bool, Option("--json", help="Print one JSON object for each file on stdout")]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOptions:
    """Options for reading maps."""

    profile: Profile = None
    cell: OfCell = None
    as_format: AsFormat = None
    units: Units = None
    masks: Masks = None


@dataclass(frozen=True, slots=True, kw_only=True)
class WriteOptions(ReadOptions):
    """Options of a command that writes maps."""

    force: Annotated[bool, Option("--force", help="Overwrite existing files")] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class NewMapOptions(WriteOptions):
    """Options of a command that makes one map from several: ``subtract``."""

    out: Annotated[Path | None, Option(metavar="C", help="New map; its ending sets the format")] = None
    picture: MapsPicture = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AverageOptions(NewMapOptions):
    """Options of ``average``."""

    system: Annotated[
        Path | None, Option(metavar="MAP", help="Error of the instrument, to subtract from each map", readable=False)
    ] = None
    mixed: Annotated[
        bool, Option("--mixed", help="Allow maps of unknown pitch or of several instruments, for inspection only")
    ] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StitchOptions(NewMapOptions):
    """Options of ``stitch``."""

    at: Annotated[Path, Option(metavar="CSV", help="Center of each map: file,x_mm,y_mm", readable=False)]
    uncertainty: Annotated[
        Path | None, Option(metavar="U", help="New map of the standard deviation of each sample")
    ] = None
    free: Annotated[str, Option(metavar="power,shift", help="Other terms that may differ between maps")] = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureOptions(ReadOptions):
    """Options of ``figures`` and ``compare``."""

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
    """Options of ``report``."""

    out: Annotated[Path, Option("--out", metavar="REPORT", help="New report, *.html or *.pdf")]
    tolerance: Annotated[
        Path | None,
        Option(
            metavar="T.toml",
            help="Lines of the drawing, as [[tolerance]] of a cell (default: those of --cell)",
            readable=False,
        ),
    ] = None
    wavelength: Annotated[
        float, Option(min=100.0, max=20000.0, metavar="NM", help="Wavelength of a wave, such as 632.8")
    ] = 546.07
    zernike: Annotated[ZernikeOrder, Option(help="Ordering of the Zernike terms")] = ZernikeOrder.fringe
    terms: Annotated[int, Option(min=15, max=120, metavar="N", help="Zernike terms of the fit")] = 36
    by: Annotated[str, Option(metavar="NAME", help="Person responsible for the report")] = ""
    trim: Trim = 0
    bands: Bands = BANDS


@dataclass(frozen=True, slots=True, kw_only=True)
class AbsoluteOptions(WriteOptions):
    """Options of ``absolute``."""

    angles: Annotated[
        str | None,
        Option(metavar="DEG,...", help="Rotation of the part in each map, counterclockwise as displayed"),
    ] = None
    shifts: Annotated[
        str | None,
        Option(metavar="X,Y:...", help="Shift of the part in each map, mm right and up; 0,0 without a shift"),
    ] = None
    at: Annotated[
        Path | None,
        Option(metavar="CSV", help="Read both from a list: file,angle_deg and, with shifts, x_mm,y_mm", readable=False),
    ] = None
    out_instrument: Annotated[
        Path | None, Option(metavar="S", help="New map of the instrument's error; its ending sets the format")
    ] = None
    out_part: Annotated[Path | None, Option(metavar="P", help="New map of the part without that error")] = None
    axis: Annotated[str | None, Option(metavar="X,Y", help="Axis of the rotation, mm from the map's center")] = None
    order: Annotated[int, Option(min=4, max=14, metavar="N", help="Radial order of the Zernike terms")] = 10
    noise: Annotated[
        float | None, Option(min=0.0, metavar="NM", help="White noise of a sample (default: estimated from the maps)")
    ] = None
    angle_error: Annotated[float, Option(min=0.0, metavar="DEG", help="Standard error of the angles")] = 0.0
    shift_error: Annotated[float, Option(min=0.0, metavar="MM", help="Standard error of the shifts")] = 0.0
    picture: MapsPicture = None
