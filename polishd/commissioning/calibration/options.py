"""Options of ``polishd calibrate instrument``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentOptions:
    """Options of ``calibrate instrument``."""

    angles: Annotated[
        str | None,
        Option(metavar="DEG,...", help="Rotation of the part in each map, counter-clockwise for the tool"),
    ] = None
    shifts: Annotated[str | None, Option(metavar="X,Y:...", help="Shift of the part in each map, mm right and up")] = (
        None
    )
    at: Annotated[Path | None, Option(metavar="CSV", help="Read both from a list: file,angle_deg,x_mm,y_mm")] = None
    noise: Annotated[
        float | None, Option(min=0.0, metavar="NM", help="White noise of a sample (default: estimated)")
    ] = None
    angle_error: Annotated[float, Option(min=0.0, metavar="DEG", help="Standard error of the angles")] = 0.0
    shift_error: Annotated[float, Option(min=0.0, metavar="MM", help="Standard error of the shifts")] = 0.0
    power: Annotated[
        float | None,
        Option(metavar="NM", help="Power of the error from a reference: RMS over the circle, high at the rim"),
    ] = None
    power_sigma: Annotated[float | None, Option(min=0.0, metavar="NM", help="Standard error of --power")] = None
    out: Annotated[Path | None, Option(metavar="S.x3p", help="The system map (default: next to the profile)")] = None
    dry_run: Annotated[bool, Option("--dry-run", help="Show the result; write nothing")] = False
