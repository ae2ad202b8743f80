"""The verbs of ``polishd calibrate``: options only. What they do lives in ``verbs.py``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.util.command_line import CommandGroup, Json

Fragment = Annotated[Path | None, Option("--out", metavar="FRAGMENT.toml", help="Write what a cell includes.")]
OfCell = Annotated[Path | None, Option("--cell", metavar="CELL.toml", help="The cell; default: the shipped values.")]

app = typer.Typer(
    cls=CommandGroup, help="Fit the cell's numbers to measurements; writes fragments that a cell includes."
)


@app.command()
def stiffness(
    *,
    tests: Annotated[Path, Argument(metavar="TESTS.csv", help="Static loading tests.")],
    cell: OfCell = None,
    held_out: Annotated[Path | None, Option(metavar="CSV", help="Further tests, which are only predicted.")] = None,
    projection: Annotated[Literal["normal", "linear", "quadratic"], Option(help="What a test measures.")] = "normal",
    out: Fragment = None,
    anyway: Annotated[bool, Option("--anyway", help="Write the fragment of a doubtful fit, too.")] = False,
    as_json: Json = False,
) -> None:
    """Fit the robot's stiffnesses to loading tests: pose, direction, um/N."""
    from polishd.commissioning.calibration.fits import LoadingFiles, stiffness_verb

    stiffness_verb(LoadingFiles(tests, held_out, projection), cell, out, anyway=anyway, as_json=as_json)


@app.command()
def tif(
    *,
    before: Annotated[Path, Argument(metavar="BEFORE", help="Map before the spot.")],
    after: Annotated[Path, Argument(metavar="AFTER", help="Map after it.")],
    seconds: Annotated[float, Option(metavar="S", help="Time on the spot.")],
    cell: OfCell = None,
    profile: Annotated[
        Path | None, Option(metavar="P.toml", help="The instrument's profile; default: the cell's.", readable=False)
    ] = None,
    depth_ratio: Annotated[float, Option(metavar="G", help="Gamma where the spot was made.")] = 1.0,
    azimuth_deg: Annotated[float, Option(help="Where the spindle leaned, from the map's x.")] = 0.0,
    radius_mm: Annotated[float | None, Option(help="The spot's rim; default: found.")] = None,
    out: Fragment = None,
    as_json: Json = False,
) -> None:
    """Make a measured TIF, and the Preston constant, out of a spot's maps."""
    from polishd.commissioning.calibration.fits import SpotPlace, tif_verb

    place = SpotPlace(depth_ratio, azimuth_deg, radius_mm)
    tif_verb((before, after), seconds, cell, place, out, profile=profile, as_json=as_json)


@app.command()
def exponent(
    spots: Annotated[Path, Argument(metavar="SPOTS.csv", help="Spots at several depths: depth_ratio, volume_mm3_min.")],
    out: Fragment = None,
    as_json: Json = False,
) -> None:
    """Fit gamma's exponent, for the correction "power"."""
    from polishd.commissioning.calibration.fits import exponent_verb

    exponent_verb(spots, out, as_json=as_json)


@app.command(name="first-touch")
def cell_(
    cell: Annotated[Path, Argument(metavar="CELL.toml", help="The cell, for parts like the witness.")],
    *,
    out: Annotated[Path, Option(metavar="DIR", help="A new folder, for program, job, picture and figures.")],
    part: Annotated[str, Option(metavar="ID", help="What the maps of the witness part name.")] = "WITNESS",
    minutes: Annotated[float, Option(min=0.1, metavar="M", help="Most contact time.")] = 20.0,
    want: Annotated[list[str] | None, Option(metavar="NAME=SIGMA", help="A standard error wanted; repeatable.")] = None,
    as_json: Json = False,
) -> None:
    """Plan a first touch on a witness part: the tracks that tell most of the machine in the least contact time."""
    from polishd.commissioning.calibration.first_touch import TouchOptions, touch_verb

    wanted = {}
    for text in want or []:
        name, _, sigma = text.partition("=")
        try:
            wanted[name.strip()] = float(sigma)
        except ValueError:
            raise typer.BadParameter(f"--want {text}: is no NAME=SIGMA, such as rate=0.01") from None
    touch_verb(cell, out, TouchOptions(part, minutes, wanted), as_json=as_json)
