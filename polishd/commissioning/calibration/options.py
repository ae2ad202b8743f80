"""Options of ``polishd calibrate instrument``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentOptions:
    """What ``calibrate instrument`` is asked for."""

    angles: Annotated[
        str | None,
        Option(metavar="DEG,...", help="Turn of the part in each map, counter-clockwise for the tool."),
    ] = None
    shifts: Annotated[str | None, Option(metavar="X,Y:...", help="Its shift in each, mm right and up, likewise.")] = (
        None
    )
    at: Annotated[Path | None, Option(metavar="CSV", help="Both from a list: file,angle_deg,x_mm,y_mm.")] = None
    noise: Annotated[float | None, Option(min=0.0, metavar="NM", help="White noise of a sample; else found.")] = None
    angle_error: Annotated[float, Option(min=0.0, metavar="DEG", help="How well angles are known, 1 sigma.")] = 0.0
    shift_error: Annotated[float, Option(min=0.0, metavar="MM", help="How well shifts are known, 1 sigma.")] = 0.0
    power: Annotated[
        float | None,
        Option(metavar="NM", help="Its power as a reference told it: RMS over the circle, high at the rim."),
    ] = None
    power_sigma: Annotated[
        float | None, Option(min=0.0, metavar="NM", help="How well that is known, 1 sigma; goes with --power.")
    ] = None
    out: Annotated[Path | None, Option(metavar="S.x3p", help="The system map; beside the profile unless given.")] = None
    dry_run: Annotated[bool, Option("--dry-run", help="Write nothing: only say what comes out.")] = False
