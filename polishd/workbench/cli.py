"""The verbs of the workbench: what people do without a daemon. Options only; what they do lives in the packages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from polishd.workbench.calibration.cli import app as calibrations
from polishd.workbench.devices.cli import app as devices
from polishd.workbench.maps.cli import app as maps
from polishd.workbench.options import Cell, Json, Picture
from polishd.workbench.programs.cli import app as programs
from polishd.workbench.studies.cli import app as studies

offline_app = typer.Typer(help="Maps, programs, calibration, physics and studies.", no_args_is_help=True)
offline_app.add_typer(calibrations, name="calibrate", no_args_is_help=True)
offline_app.add_typer(programs, name="program", no_args_is_help=True)
offline_app.add_typer(maps, name="map", no_args_is_help=True)
offline_app.add_typer(devices, name="device", no_args_is_help=True)
offline_app.add_typer(studies, name="study", no_args_is_help=True)


@offline_app.command()
def init(
    *,
    folder: Annotated[Path, Argument(metavar="DIR", help="Where the cell is to stand; made where it is not there.")],
    answers: Annotated[
        Path | None, Option("--from", metavar="ANSWERS.toml", help="What is known of it; left out: you are asked.")
    ] = None,
    dry_run: Annotated[bool, Option("--dry-run", help="Show what it would write; write nothing.")] = False,
    force: Annotated[bool, Option("--force", help="Overwrite what is there.")] = False,
    as_json: Json = False,
) -> None:
    """Begin a cell: its commented file, an instrument's profile, a program, and what is still to be done."""
    from polishd.workbench.setup.verb import init_verb

    init_verb(folder, answers, dry_run=dry_run, force=force, as_json=as_json)


@offline_app.command()
def tif(
    cell: Cell,
    depth_ratio: Annotated[float, Option(metavar="G", help="Gamma: depth over the rigid robot's.")] = 1.0,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """The tool influence function of a cell: depth, pressure, peak, volume, profiles."""
    from polishd.workbench.physics.verbs import tif_verb

    tif_verb(cell, depth_ratio, out, as_json=as_json)


@offline_app.command()
def compliance(
    cell: Cell,
    program: Annotated[Path | None, Option(metavar="P.rnc", help="Along this program, too.")] = None,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """The robot's equivalent compliance over the workspace and along a program, and the gamma that follows."""
    from polishd.workbench.physics.verbs import compliance_verb

    compliance_verb(cell, program, out, as_json=as_json)
