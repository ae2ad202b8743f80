"""Commands of ``polishd calibrate``: options only."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.cli.command_group import CommandGroup
from polishd.util.command_line import Json

Fragment = Annotated[Path | None, Option("--out", metavar="FRAGMENT.toml", help="Write a fragment for the cell's file")]
OfCell = Annotated[Path | None, Option("--cell", metavar="CELL.toml", help="The cell (default: shipped values)")]

app = typer.Typer(cls=CommandGroup, help="Fit the cell's values to measurements, and write fragments for its file.")


@app.command()
def stiffness(
    *,
    tests: Annotated[Path, Argument(metavar="TESTS.csv", help="Static loading tests")],
    cell: OfCell = None,
    held_out: Annotated[Path | None, Option(metavar="CSV", help="Other tests, to compare with the prediction")] = None,
    projection: Annotated[
        Literal["normal", "linear", "quadratic"], Option(help="Projection that a test measures")
    ] = "normal",
    out: Fragment = None,
    anyway: Annotated[bool, Option("--anyway", help="Write the fragment also for a doubtful fit")] = False,
    as_json: Json = False,
) -> None:
    """Fit the robot's stiffnesses to loading tests: pose, direction, um/N."""
    from polishd.commissioning.calibration.fits import LoadingFiles, stiffness_verb

    stiffness_verb(LoadingFiles(tests, held_out, projection), cell, out, anyway=anyway, as_json=as_json)


@app.command()
def tif(
    *,
    before: Annotated[Path, Argument(metavar="BEFORE", help="Map before the spot")],
    after: Annotated[Path, Argument(metavar="AFTER", help="Map after the spot")],
    seconds: Annotated[float, Option(metavar="S", help="Time on the spot")],
    cell: OfCell = None,
    profile: Annotated[
        Path | None, Option(metavar="P.toml", help="The instrument's profile (default: the cell's)", readable=False)
    ] = None,
    depth_ratio: Annotated[float, Option(metavar="G", help="Gamma at the spot")] = 1.0,
    azimuth_deg: Annotated[
        float, Option(metavar="DEG", help="Direction of the spindle's inclination, from the map's x")
    ] = 0.0,
    radius_mm: Annotated[float | None, Option(metavar="MM", help="Radius of the spot (default: detected)")] = None,
    out: Fragment = None,
    as_json: Json = False,
) -> None:
    """Compute a measured TIF and the Preston constant from two maps of a spot."""
    from polishd.commissioning.calibration.fits import SpotPlace, tif_verb

    place = SpotPlace(depth_ratio, azimuth_deg, radius_mm)
    tif_verb((before, after), seconds, cell, place, out, profile=profile, as_json=as_json)


@app.command()
def exponent(
    spots: Annotated[Path, Argument(metavar="SPOTS.csv", help="Spots of one force: depth_ratio, volume_mm3_min")],
    out: Fragment = None,
    as_json: Json = False,
) -> None:
    """Fit the exponent of gamma for the correction "power"."""
    from polishd.commissioning.calibration.fits import exponent_verb

    exponent_verb(spots, out, as_json=as_json)


@app.command(name="first-touch")
def cell_(
    cell: Annotated[Path, Argument(metavar="CELL.toml", help="The cell, with a part like the witness part")],
    *,
    out: Annotated[Path, Option(metavar="DIR", help="New folder for program, job, picture and figures")],
    part: Annotated[str, Option(metavar="ID", help="Part name in the maps of the witness part")] = "WITNESS",
    minutes: Annotated[float, Option(min=0.1, metavar="MIN", help="Largest contact time")] = 20.0,
    want: Annotated[list[str] | None, Option(metavar="NAME=SIGMA", help="Standard error to reach; repeatable")] = None,
    as_json: Json = False,
) -> None:
    """Plan a first touch on a witness part: tracks with the most information on the machine per contact time."""
    from polishd.commissioning.calibration.first_touch import TouchOptions, touch_verb

    targets = {}
    for text in want or []:
        name, _, sigma = text.partition("=")
        try:
            targets[name.strip()] = float(sigma)
        except ValueError:
            raise typer.BadParameter(f"--want {text}: write NAME=SIGMA, such as rate=0.01") from None
    touch_verb(cell, out, TouchOptions(part, minutes, targets), as_json=as_json)
