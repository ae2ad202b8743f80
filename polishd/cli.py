"""The command line: verbs only. What they do lives in ``console`` and ``daemon``."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Optional

import typer

from polishd import __version__
from polishd.model.errors import PolishdError

app = typer.Typer(
    name="polishd",
    help="Controller daemon of an unattended robotic polishing cell.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Cell = Annotated[Path, typer.Argument(metavar="CELL.toml", help="The cell's configuration.", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, for programs.")]


class CorrectionChoice(StrEnum):
    """What ``--correction`` takes."""

    none = "none"
    linear = "linear"
    exact = "exact"


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
def run(cell: Cell, correction: CorrectionOption = None, as_json: Json = False) -> None:
    """Run the daemon of a cell until its job ends. After an interruption it comes up held."""
    from polishd.console.verbs import run_verb

    raise typer.Exit(run_verb(cell, correction.value if correction else None, as_json=as_json))


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
def hold(cell: Cell, as_json: Json = False) -> None:
    """Leave contact, stand still, and wait for resume."""
    _order(cell, "hold", as_json=as_json)


@app.command()
def resume(cell: Cell, as_json: Json = False) -> None:
    """Go on, with a new measurement first."""
    _order(cell, "resume", as_json=as_json)


@app.command()
def stop(cell: Cell, as_json: Json = False) -> None:
    """Leave contact, stand still, and end the daemon."""
    _order(cell, "stop", as_json=as_json)


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
def version() -> None:
    """Print the version."""
    typer.echo(__version__)


def _order(cell: Path, verb: str, *, as_json: bool) -> None:
    from polishd.console.verbs import order_verb

    order_verb(cell, verb, as_json=as_json)


def main() -> None:
    """Entry point: errors of the tree become one message and their exit code."""
    try:
        _plugin_commands()
        app()
    except PolishdError as error:
        typer.echo(f"polishd: {error}", err=True)
        sys.exit(error.exit_code)


def _plugin_commands() -> None:
    """Commands that polishd's own plugins add; loaded only where no verb of ours is asked for."""
    asked = next((word for word in sys.argv[1:] if not word.startswith("-")), None)
    own = {command.name or getattr(command.callback, "__name__", "") for command in app.registered_commands}
    if asked is not None and asked not in own:
        from polishd.daemon.plugins import load_own

        load_own().cli(app)


if __name__ == "__main__":
    main()
