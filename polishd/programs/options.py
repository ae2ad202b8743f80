"""Options of ``polishd program``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

EncodingOption = Literal["feed", "inverse", "dwell", "time", "wait"]
"""As model.program has it, which would import numpy; ``wait`` is another name of ``dwell``."""
ForceOption = Annotated[bool, Option("--force", help="Overwrite existing files")]
PathShape = Literal["raster", "spiral", "concentric", "random", "adaptive"]


@dataclass(frozen=True, slots=True)
class MakeOptions:
    """Path and encoding of a new program; None: the default in the option's help."""

    shape: Annotated[
        PathShape,
        Argument(
            help="Parallel lines, an Archimedean spiral, concentric rings, pseudo-random lines, or lines that lie "
            "denser where more is to be removed"
        ),
    ]
    out: Annotated[Path, Option(metavar="FILE", help="New program")]
    aperture: Annotated[
        str | None,
        Option(
            metavar="SHAPE",
            help="Shape: circle:D, annulus:D,d, ellipse:A,B, rectangle:W,H, hexagon:W (mm), polygon:FILE (CSV with "
            "x_mm, y_mm), or mask:MAP (default: the cell's)",
        ),
    ] = None
    optic: Annotated[
        str | None,
        Option(
            metavar="OPTIC",
            help="Surface: flat, sphere:R, conic:R,K, or asphere:R,K,A4,A6,... with R in mm, positive for concave "
            "(default: the cell's, or flat)",
        ),
    ] = None
    offset_mm: Annotated[
        tuple[float, float] | None,
        Option("--offset", metavar="X Y", help="Center of an off-axis part from the vertex of its parent, mm"),
    ] = None
    cell: Annotated[
        Path | None,
        Option(
            metavar="CELL.toml",
            help="Take aperture, optic, dip, dialect and frame from this cell, and check the program for it",
        ),
    ] = None
    pitch_mm: Annotated[
        float | None,
        Option(
            "--pitch",
            metavar="MM",
            help="Distance between lines or turns (default: 1, or with --cell the one near 1 with the least ripple)",
        ),
    ] = None
    time_budget_s: Annotated[
        float | None,
        Option(
            "--time-budget",
            metavar="S",
            help="With --cell: choose the distance with the least ripple whose path lasts no longer at its feed",
        ),
    ] = None
    step_mm: Annotated[float, Option("--step", metavar="MM", help="Distance between points")] = 1.0
    direction_deg: Annotated[
        float, Option("--direction", metavar="DEG", help="Lines: (mean) direction of the first one, from x")
    ] = 0.0
    cross_deg: Annotated[
        float | None, Option("--cross", metavar="DEG", help="Raster: run a second one, turned by this angle")
    ] = None
    phase: Annotated[
        float, Option("--phase", metavar="SHARE", help="Raster, spiral, concentric: shift of all lines, in pitches")
    ] = 0.0
    seed: Annotated[int, Option("--seed", metavar="N", help="Random: another path for another number")] = 0
    radius_mm: Annotated[
        float | None,
        Option(
            "--radius",
            metavar="MM",
            help="Random, adaptive: smallest radius of the path on the part (default: that of the cell's largest feed "
            "and acceleration, or 3)",
        ),
    ] = None
    removal: Annotated[
        Path | None,
        Option("--removal", metavar="MAP", help="Adaptive, random: lie denser where this map is higher"),
    ] = None
    inwards: Annotated[bool, Option("--inwards", help="Spiral, concentric: from outside to the center")] = False
    overrun_mm: Annotated[float, Option("--overrun", metavar="MM", help="Path beyond the aperture")] = 1.0
    landing_mm: Annotated[
        float, Option("--landing", metavar="MM", help="Distance of the landing point outside the aperture")
    ] = 5.0
    dip_deg: Annotated[
        float | None, Option("--dip", metavar="DEG", help="Dip of the tool from the normal (default: the cell's, or 0)")
    ] = None
    azimuth_deg: Annotated[
        float | None,
        Option("--azimuth", metavar="DEG", help="Direction of the dip, from x (default: the cell's, or 0)"),
    ] = None
    turn_limit_deg: Annotated[
        float, Option("--turn-limit", metavar="DEG", help="Largest turn of the wrist in a move")
    ] = 95.0
    feed_mm_min: Annotated[float, Option("--feed", metavar="MM/MIN", help="Feed of the moves")] = 900.0
    dwell_s: Annotated[float | None, Option("--dwell", metavar="S", help="Time at each point, instead of a feed")] = (
        None
    )
    encoding: Annotated[
        EncodingOption | None, Option(help="Encoding of the time (default: dwell with --dwell, else feed)")
    ] = None
    dialect: Annotated[
        str | None, Option(metavar="NAME|D.toml", help="Dialect of the program (default: the cell's, or rs274)")
    ] = None
    picture: Annotated[Path | None, Option(metavar="PNG", help="Draw a picture, too")] = None
    force: ForceOption = False
