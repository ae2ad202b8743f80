"""The command line: verbs only. What they do lives in ``console`` and ``daemon``."""

from __future__ import annotations

import errno
import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Optional

import typer

from polishd import __version__
from polishd.model.errors import PolishdError
from polishd.workbench.maps.cli import map_verbs
from polishd.workbench.programs.cli import program as program_verbs

app = typer.Typer(
    name="polishd",
    help="Controller daemon of an unattended robotic polishing cell.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

STDOUT = 1
"""Its descriptor."""

Cell = Annotated[Path, typer.Argument(metavar="CELL.toml", help="The cell's configuration.", show_default=False)]
Picture = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option("--out", metavar="PNG", help="Draw it, too.", show_default=False),
]
Fragment = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option("--out", metavar="FRAGMENT.toml", help="Write what a cell includes.", show_default=False),
]
OfCell = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option("--cell", metavar="CELL.toml", help="The cell; default: the shipped values.", show_default=False),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, for programs.")]

Reason = Annotated[str, typer.Option("--reason", metavar="TEXT", help="Why: for the journal, and for status.")]


class CorrectionChoice(StrEnum):
    """What ``--correction`` takes."""

    none = "none"
    pointwise = "pointwise"
    linear = "linear"
    power = "power"
    exact = "exact"


class ProjectionChoice(StrEnum):
    """What ``--projection`` takes."""

    normal = "normal"
    linear = "linear"
    quadratic = "quadratic"


CorrectionOption = Annotated[
    Optional[CorrectionChoice],  # noqa: UP045 - typer reads it
    typer.Option(help="Override process.correction.", show_default=False),
]


@app.command()
def demo(  # noqa: PLR0917 - typer reads the options off the signature
    seed: Annotated[int, typer.Option(help="What the simulated cell hides is drawn from it.")] = 1,
    speed: Annotated[float, typer.Option(min=1.0, max=200.0, help="Process time per wall time.")] = 60.0,
    cycles: Annotated[int, typer.Option(min=1, max=20, help="Most polishing passes.")] = 4,
    tolerance: Annotated[float, typer.Option(min=0.01, metavar="NM", help="RMS to reach, nm.")] = 2.0,
    surface: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(metavar="FILE", help="Start from a measured map (Zygo .dat)."),
    ] = None,
    correction: CorrectionOption = None,
    out: Annotated[Optional[Path], typer.Option(metavar="DIR", help="Folder for everything it makes.")] = None,  # noqa: UP045
    as_json: Json = False,
) -> None:
    """Polish a simulated part in a simulated cell, over real wires, with nobody there."""
    from polishd.console.demo import DemoOptions, run_demo

    options = DemoOptions(seed, speed, cycles, tolerance, surface, correction.value if correction else None, out)
    raise typer.Exit(run_demo(options, as_json=as_json))


@app.command()
def run(
    cells: Annotated[
        list[Path], typer.Argument(metavar="CELL.toml...", help="Each cell's configuration.", show_default=False)
    ],
    correction: CorrectionOption = None,
    no_hold: Annotated[bool, typer.Option("--no-hold", help="End where it would wait for a person to mend.")] = False,
    as_json: Json = False,
) -> None:
    """Run the daemon of a cell, or of several, until their jobs end. After an interruption one comes up held."""
    from polishd.console.run import run_verb

    raise typer.Exit(run_verb(cells, correction.value if correction else None, holds=not no_hold, as_json=as_json))


@app.command()
def plan(  # noqa: PLR0917 - typer reads the options off the signature
    cell: Cell,
    surface: Annotated[Path, typer.Argument(metavar="MAP", help="A measured map.", show_default=False)],
    program: Annotated[Path, typer.Option(metavar="P.rnc", help="The RNC program to rewrite.", show_default=False)],
    out: Annotated[Path, typer.Option(metavar="DIR", help="New folder for the plan.", show_default=False)],
    correction: CorrectionOption = None,
    as_json: Json = False,
) -> None:
    """Everything short of motion: figures, corrected dwell, rewritten program, certificate, pictures."""
    from polishd.console.verbs import plan_verb

    plan_verb(cell, surface, program, out, correction.value if correction else None, as_json=as_json)


@app.command()
def check(cell: Cell, as_json: Json = False) -> None:
    """Check config, plugins, program and reach. Opens nothing."""
    from polishd.console.verbs import check_verb

    check_verb(cell, as_json=as_json)


@app.command()
def probe(cell: Cell, as_json: Json = False) -> None:
    """Connect to each device, identify it, leave it safe."""
    from polishd.console.verbs import probe_verb

    probe_verb(cell, as_json=as_json)


@app.command()
def status(cell: Cell, as_json: Json = False) -> None:
    """What the daemon of a cell is doing."""
    from polishd.console.verbs import status_verb

    status_verb(cell, as_json=as_json)


@app.command()
def hold(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Leave contact, stand still, and wait for resume."""
    _order(cell, "hold", reason, as_json=as_json)


@app.command()
def resume(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Go on, with a new measurement first."""
    _order(cell, "resume", reason, as_json=as_json)


@app.command()
def stop(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Leave contact, stand still, and end the daemon."""
    _order(cell, "stop", reason, as_json=as_json)


@app.command()
def estop(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Stop motion at once, whatever the part costs; then wait for resume. No substitute for the button."""
    _order(cell, "estop", reason, as_json=as_json)


@app.command()
def plugins(
    cell: Annotated[Optional[Path], typer.Argument(metavar="[CELL.toml]", show_default=False)] = None,  # noqa: UP045
    as_json: Json = False,
) -> None:
    """The plugins of a cell (without CELL: polishd's own), and what each brings."""
    from polishd.console.verbs import plugins_verb

    plugins_verb(cell, as_json=as_json)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def sim(
    context: typer.Context,
    config: Annotated[Path, typer.Argument(metavar="SIM.toml", show_default=False)],
) -> None:
    """Start a simulated cell, as processes of their own; ends with Ctrl-C. Further options go to the simulator."""
    from polishd.console.simulator import run_simulator

    raise typer.Exit(run_simulator(config, context.args))


@app.command()
def tif(
    cell: Cell,
    depth_ratio: Annotated[float, typer.Option(metavar="G", help="Gamma: depth over the rigid robot's.")] = 1.0,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """The tool influence function of a cell: depth, pressure, peak, volume, profiles."""
    from polishd.workbench.physics.verbs import tif_verb

    tif_verb(cell, depth_ratio, out, as_json=as_json)


@app.command()
def compliance(
    cell: Cell,
    program: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(metavar="P.rnc", help="Along this program, too.", show_default=False),
    ] = None,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """The robot's equivalent compliance over the workspace and along a program, and the gamma that follows."""
    from polishd.workbench.physics.verbs import compliance_verb

    compliance_verb(cell, program, out, as_json=as_json)


@app.command()
def study(
    file: Annotated[Path, typer.Argument(metavar="STUDY.toml", show_default=False)],
    out: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(metavar="DIR", help="Folder for pictures and tables.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """A simulation without a cell: corrections compared, spots of a table, passes of equal dwell."""
    from polishd.workbench.studies.verb import study_verb

    study_verb(file, out, as_json=as_json)


calibrate = typer.Typer(help="Fit the cell's numbers to measurements; writes fragments that a cell includes.")
app.add_typer(calibrate, name="calibrate", no_args_is_help=True)
app.add_typer(program_verbs, name="program", no_args_is_help=True)
app.add_typer(map_verbs, name="map", no_args_is_help=True)


@calibrate.command("stiffness")
def calibrate_stiffness(  # noqa: PLR0917 - typer reads the options off the signature
    tests: Annotated[Path, typer.Argument(metavar="TESTS.csv", help="Static loading tests.", show_default=False)],
    cell: OfCell = None,
    held_out: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option(metavar="CSV", help="Further tests, which are only predicted.", show_default=False),
    ] = None,
    projection: Annotated[ProjectionChoice, typer.Option(help="What a test measures.")] = ProjectionChoice.normal,
    out: Fragment = None,
    anyway: Annotated[bool, typer.Option("--anyway", help="Write the fragment of a doubtful fit, too.")] = False,
    as_json: Json = False,
) -> None:
    """Fit the robot's stiffnesses to loading tests: pose, direction, um/N."""
    from polishd.workbench.calibration.verbs import LoadingFiles, stiffness_verb

    files = LoadingFiles(tests, held_out, projection.value)
    stiffness_verb(files, cell, out, anyway=anyway, as_json=as_json)


@calibrate.command("tif")
def calibrate_tif(  # noqa: PLR0917 - typer reads the options off the signature
    before: Annotated[Path, typer.Argument(metavar="BEFORE", help="Map before the spot.", show_default=False)],
    after: Annotated[Path, typer.Argument(metavar="AFTER", help="Map after it.", show_default=False)],
    seconds: Annotated[float, typer.Option(metavar="S", help="Time on the spot.", show_default=False)],
    cell: OfCell = None,
    depth_ratio: Annotated[float, typer.Option(metavar="G", help="Gamma where the spot was made.")] = 1.0,
    azimuth_deg: Annotated[float, typer.Option(help="Where the spindle leaned, from the map's x.")] = 0.0,
    radius_mm: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(help="The spot's rim; default: found.", show_default=False),
    ] = None,
    out: Fragment = None,
    as_json: Json = False,
) -> None:
    """Make a measured TIF, and the Preston constant, out of a spot's maps."""
    from polishd.workbench.calibration.verbs import SpotPlace, tif_verb

    tif_verb((before, after), seconds, cell, SpotPlace(depth_ratio, azimuth_deg, radius_mm), out, as_json=as_json)


@calibrate.command("exponent")
def calibrate_exponent(
    spots: Annotated[
        Path, typer.Argument(metavar="SPOTS.csv", help="Spots at several depths: depth_ratio, volume_mm3_min.")
    ],
    out: Fragment = None,
    as_json: Json = False,
) -> None:
    """Fit gamma's exponent, for the correction "power"."""
    from polishd.workbench.calibration.verbs import exponent_verb

    exponent_verb(spots, out, as_json=as_json)


@app.command()
def version() -> None:
    """Print the version."""
    typer.echo(__version__)


def _order(cell: Path, verb: str, reason: str, *, as_json: bool) -> None:
    from polishd.console.verbs import order_verb

    order_verb(cell, verb, reason, as_json=as_json)


def main() -> None:
    """The command line: errors of the tree, and of files, become one message and their exit code."""
    try:
        _plugin_commands()
        app()
    except PolishdError as error:
        typer.echo(f"polishd: {error}", err=True)
        sys.exit(error.exit_code)
    except OSError as error:
        full = error.errno == errno.ENOSPC
        name = error.filename or (_full_output() if full else None)
        if name is None:
            raise
        advice = "; make room" if full else ""
        typer.echo(f"polishd: {name}: {error.strerror}{advice}", err=True)
        sys.exit(1)


def _full_output() -> str:
    """What has no room where no file is named: standard output, if it takes not even the end of a line."""
    try:
        os.write(STDOUT, b"\n")
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), STDOUT)  # Python flushes what is left as it ends
        return "standard output"
    return "a file"


def _plugin_commands() -> None:
    """Commands that polishd's own plugins add; loaded only where no verb of ours is asked for."""
    asked = next((word for word in sys.argv[1:] if not word.startswith("-")), None)
    own = {command.name or getattr(command.callback, "__name__", "") for command in app.registered_commands}
    own |= {group.name or "" for group in app.registered_groups}
    if asked is not None and asked not in own:
        from polishd.hooks.loader import load_own

        load_own().cli(app)


if __name__ == "__main__":
    main()
