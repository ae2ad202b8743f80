"""Options of ``polishd program``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

EncodingOption = Literal["feed", "inverse", "dwell", "time", "wait"]
"""As model.program has it, which would import numpy; ``wait`` is another name of ``dwell``."""


@dataclass(frozen=True, slots=True)
class MakeOptions:
    """A path and how it is written; None: as the cell has it, or what the option says."""

    shape: Annotated[Literal["raster", "spiral"], Argument(help="Lines to and fro, or an Archimedean spiral.")]
    out: Annotated[Path, Option(metavar="FILE", help="The program to write.")]
    aperture: Annotated[
        str | None,
        Option(
            metavar="SHAPE",
            help="circle:D, annulus:D,d, ellipse:A,B, rectangle:W,H, hexagon:W in mm, polygon:FILE (CSV: "
            "x_mm,y_mm), or mask:MAP; default: the cell's.",
        ),
    ] = None
    optic: Annotated[
        str | None,
        Option(
            metavar="OPTIC",
            help="flat, sphere:R, conic:R,K, or asphere:R,K,A4,A6,...; R above 0 is concave. "
            "Default: the cell's, or flat.",
        ),
    ] = None
    offset_mm: Annotated[
        tuple[float, float] | None,
        Option("--offset", metavar="X Y", help="Off axis: the part's centre from the parent's vertex, mm."),
    ] = None
    cell: Annotated[
        Path | None,
        Option(
            metavar="CELL.toml",
            help="Its aperture, optic, dip, dialect and frame are taken, and what its plan would refuse is refused.",
        ),
    ] = None
    pitch_mm: Annotated[float, Option("--pitch", metavar="MM", help="Distance of the lines or turns.")] = 1.0
    step_mm: Annotated[float, Option("--step", metavar="MM", help="Way from point to point.")] = 1.0
    direction_deg: Annotated[
        float, Option("--direction", metavar="DEG", help="Raster: where the first line runs, from x.")
    ] = 0.0
    inwards: Annotated[bool, Option("--inwards", help="Spiral: the turns from outside to the centre.")] = False
    overrun_mm: Annotated[float, Option("--overrun", metavar="MM", help="How far it goes beyond the aperture.")] = 1.0
    landing_mm: Annotated[float, Option("--landing", metavar="MM", help="How far outside the tool lands.")] = 5.0
    dip_deg: Annotated[
        float | None, Option("--dip", metavar="DEG", help="The tool's dip from the normal; default: the cell's, or 0.")
    ] = None
    azimuth_deg: Annotated[
        float | None,
        Option("--azimuth", metavar="DEG", help="Where it leans, from x; default: as the cell dips, or 0."),
    ] = None
    turn_limit_deg: Annotated[
        float, Option("--turn-limit", metavar="DEG", help="Most turn of the wrist in a move.")
    ] = 95.0
    feed_mm_min: Annotated[float, Option("--feed", metavar="MM/MIN", help="Feed of the moves.")] = 900.0
    dwell_s: Annotated[float | None, Option("--dwell", metavar="S", help="Time at each point, instead of a feed.")] = (
        None
    )
    encoding: Annotated[
        EncodingOption | None, Option(help="Where the time is written; default: dwell with --dwell, else feed.")
    ] = None
    dialect: Annotated[
        str | None, Option(metavar="NAME|D.toml", help="The dialect to write; default: the cell's, or rs274.")
    ] = None
    picture: Annotated[Path | None, Option(metavar="PNG", help="Draw it, too.")] = None
