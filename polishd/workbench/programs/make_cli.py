"""``polishd program make``: options only. What it does lives in ``program_make.py``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Optional

import typer


class ShapeChoice(StrEnum):
    """What can be made."""

    raster = "raster"
    spiral = "spiral"


class EncodingChoice(StrEnum):
    """Where the time is written."""

    feed = "feed"
    inverse = "inverse"
    dwell = "dwell"


Aperture = Annotated[
    Optional[str],  # noqa: UP045 - typer reads it
    typer.Option(
        metavar="SHAPE",
        help="circle:D, annulus:D,d, ellipse:A,B, rectangle:W,H in mm, or mask:MAP; default: the cell's.",
        show_default=False,
    ),
]
OpticOption = Annotated[
    Optional[str],  # noqa: UP045 - typer reads it
    typer.Option(
        metavar="OPTIC",
        help="flat, sphere:R, conic:R,K, or asphere:R,K,A4,A6,...; R above 0 is concave. Default: the cell's, or flat.",
        show_default=False,
    ),
]
Offset = Annotated[
    Optional[tuple[float, float]],  # noqa: UP045 - typer reads it
    typer.Option(metavar="X Y", help="Off axis: the part's centre from the parent's vertex, mm.", show_default=False),
]
OfCell = Annotated[
    Optional[Path],  # noqa: UP045 - typer reads it
    typer.Option(
        metavar="CELL.toml",
        help="Its aperture, optic, dip, dialect and frame are taken, and what its plan would refuse is refused.",
        show_default=False,
    ),
]
Dip = Annotated[
    Optional[float],  # noqa: UP045 - typer reads it
    typer.Option(metavar="DEG", help="The tool's dip from the normal; default: the cell's, or 0.", show_default=False),
]
Azimuth = Annotated[
    Optional[float],  # noqa: UP045 - typer reads it
    typer.Option(metavar="DEG", help="Where it leans, from x; default: as the cell dips, or 0.", show_default=False),
]
Dwell = Annotated[
    Optional[float],  # noqa: UP045 - typer reads it
    typer.Option(metavar="S", help="Time at each point, instead of a feed.", show_default=False),
]
Encoding = Annotated[
    Optional[EncodingChoice],  # noqa: UP045 - typer reads it
    typer.Option(help="Where the time is written; default: dwell with --dwell, else feed.", show_default=False),
]
Dialect = Annotated[
    Optional[str],  # noqa: UP045 - typer reads it
    typer.Option(
        metavar="NAME|D.toml", help="The dialect to write; default: the cell's, or rs274.", show_default=False
    ),
]
Picture = Annotated[
    Optional[Path],  # noqa: UP045 - typer reads it
    typer.Option(metavar="PNG", help="Draw it, too.", show_default=False),
]


def make(  # noqa: PLR0917 - typer reads the options off the signature
    shape: Annotated[ShapeChoice, typer.Argument(help="Lines to and fro, or an Archimedean spiral.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The program to write.", show_default=False)],
    aperture: Aperture = None,
    optic: OpticOption = None,
    offset: Offset = None,
    cell: OfCell = None,
    pitch: Annotated[float, typer.Option(metavar="MM", help="Distance of the lines or turns.")] = 1.0,
    step: Annotated[float, typer.Option(metavar="MM", help="Way from point to point.")] = 1.0,
    direction: Annotated[float, typer.Option(metavar="DEG", help="Raster: where the first line runs, from x.")] = 0.0,
    inwards: Annotated[bool, typer.Option("--inwards", help="Spiral: the turns from outside to the centre.")] = False,
    overrun: Annotated[float, typer.Option(metavar="MM", help="How far it goes beyond the aperture.")] = 1.0,
    landing: Annotated[float, typer.Option(metavar="MM", help="How far outside the tool lands.")] = 5.0,
    dip: Dip = None,
    azimuth: Azimuth = None,
    turn_limit: Annotated[float, typer.Option(metavar="DEG", help="Most turn of the wrist in a move.")] = 95.0,
    feed: Annotated[float, typer.Option(metavar="MM/MIN", help="Feed of the moves.")] = 900.0,
    dwell: Dwell = None,
    encoding: Encoding = None,
    dialect: Dialect = None,
    picture: Picture = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout, for programs.")] = False,
) -> None:
    """Make a raster or a spiral over an aperture, on a flat, sphere or asphere, with the tool along its normals."""
    from polishd.workbench.programs.make import MakeOptions, make_verb

    asked = MakeOptions(
        shape=shape.value,
        out=out,
        cell=cell,
        aperture=aperture,
        optic=optic,
        offset_mm=offset,
        pitch_mm=pitch,
        step_mm=step,
        direction_deg=direction,
        inwards=inwards,
        overrun_mm=overrun,
        landing_mm=landing,
        dip_deg=dip,
        azimuth_deg=azimuth,
        turn_limit_deg=turn_limit,
        feed_mm_min=feed,
        dwell_s=dwell,
        encoding=encoding.value if encoding else None,
        dialect=dialect,
        picture=picture,
    )
    make_verb(asked, as_json=as_json)
