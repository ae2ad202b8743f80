"""The command line: the commands of a cell and those without a cell. Options only; the packages do the work."""

from __future__ import annotations

import errno
import os
import shlex
import sys
from pathlib import Path
from typing import Annotated, Literal, cast

import typer
from typer import Argument, Option

from polishd import __version__
from polishd.cli.calibrate import app as calibrations
from polishd.cli.device import app as devices
from polishd.cli.groups import Reason, jobs, opcua, recordings, reports, services
from polishd.cli.map import app as maps
from polishd.cli.program import app as programs
from polishd.cli.shop import app as shops
from polishd.cli.study import app as studies
from polishd.model.errors import ComputeError, PolishdError
from polishd.rendering.terminal import escape_logs, say
from polishd.util.command_line import Cell, CommandGroup, Json, Picture

# Commands that need no daemon.

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
    force: Annotated[bool, Option("--force", help="Overwrite existing files")] = False,
    status: Annotated[bool, Option("--status", help="Show the next step of a cell that exists; write nothing")] = False,
    as_json: Json = False,
) -> None:
    """Begin a cell: its commented file, an instrument's profile, a program, and the steps that remain."""
    if status:
        from polishd.commissioning.init.steps import setup_verb

        setup_verb(folder if folder.suffix == ".toml" else folder / "cell.toml", as_json=as_json)
        return
    from polishd.commissioning.init.write_cell import init_verb

    init_verb(folder, answers, dry_run=dry_run, force=force, as_json=as_json)


@offline_app.command()
def tif(
    cell: Cell,
    depth_ratio: Annotated[float, Option(metavar="G", help="Gamma: depth over the rigid robot's.")] = 1.0,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """The tool influence function of a cell: depth, pressure, peak, volume, profiles."""
    from polishd.cli.tif import tif_verb

    tif_verb(cell, depth_ratio, out, as_json=as_json)


@offline_app.command()
def compliance(
    cell: Cell,
    program: Annotated[Path | None, Option(metavar="P.rnc", help="Along this program, too.")] = None,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """The robot's equivalent compliance over the workspace and along a program, and the gamma that follows."""
    from polishd.cli.tif import compliance_verb

    compliance_verb(cell, program, out, as_json=as_json)


app = typer.Typer(
    cls=CommandGroup,
    name="polishd",
    help="Controller daemon of an unattended robotic polishing cell.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

STDOUT = 1
"""Its descriptor."""

Correction = Annotated[
    Literal["none", "pointwise", "linear", "power", "exact"] | None, Option(help="Override process.correction.")
]

Record = Annotated[
    Path | None,
    Option(metavar="FILE|DIR", help="Record what passes on the devices' links, to replay it (docs/recording.md)."),
]


def _version(asked: bool) -> None:
    if asked:
        say(__version__)
        raise typer.Exit


@app.callback()
def root(
    *,
    _asked: Annotated[
        bool, Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Controller daemon of an unattended robotic polishing cell."""
    # Before numpy is imported: BLAS threads that wait for each other take three times the CPU, on a busy machine more.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")


@app.command()
def demo(
    *,
    seed: Annotated[int, Option(help="What the simulated cell hides is drawn from it.")] = 1,
    speed: Annotated[float, Option(min=1.0, max=200.0, help="Process time per wall time.")] = 60.0,
    cycles: Annotated[int, Option(min=1, max=20, help="Most polishing passes.")] = 4,
    tolerance: Annotated[float, Option(min=0.01, metavar="NM", help="RMS to reach, nm.")] = 2.0,
    surface: Annotated[Path | None, Option(metavar="FILE", help="Start from a measured map (Zygo .dat).")] = None,
    correction: Correction = None,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder for everything it makes.")] = None,
    as_json: Json = False,
) -> None:
    """Polish a simulated part in a simulated cell, over real wires, with nobody there."""
    from polishd.cli.demo import DemoOptions, run_demo

    options = DemoOptions(seed, speed, cycles, tolerance, surface, correction, out)
    raise typer.Exit(run_demo(options, as_json=as_json))


@app.command()
def run(
    *,
    cells: Annotated[
        list[Path], Argument(metavar="CELL.toml...", help="Each cell's configuration.", show_default=False)
    ],
    correction: Correction = None,
    no_hold: Annotated[bool, Option("--no-hold", help="End where it would wait for a person to mend.")] = False,
    queue: Annotated[bool, Option("--queue", help="Work the queue of polishd queue; wait for more.")] = False,
    until_empty: Annotated[bool, Option("--until-empty", help="With --queue: end when no job waits.")] = False,
    record: Record = None,
    as_json: Json = False,
) -> None:
    """Run the daemon of a cell, or of several, until their jobs end. After an interruption one comes up held."""
    from polishd.cli.run import run_verb

    how = {"queue": queue, "until_empty": until_empty}
    raise typer.Exit(run_verb(cells, correction, holds=not no_hold, as_json=as_json, record=record, **how))


@app.command()
def plan(
    *,
    cell: Cell,
    surface: Annotated[Path, Argument(metavar="MAP", help="A measured map.")],
    program: Annotated[
        Path | None, Option(metavar="P.rnc", help="The RNC program to rewrite; default: the cell's.")
    ] = None,
    out: Annotated[Path, Option(metavar="DIR", help="New folder for the plan.")],
    correction: Correction = None,
    as_json: Json = False,
) -> None:
    """Everything short of motion: figures, corrected dwell, rewritten program, certificate, pictures."""
    from polishd.cli.cell import plan_verb

    plan_verb(cell, surface, program, out, correction, as_json=as_json)


@app.command()
def check(cell: Cell, as_json: Json = False) -> None:
    """Check config, plugins, program and reach. Opens nothing."""
    from polishd.cli.cell import check_verb

    check_verb(cell, as_json=as_json)


@app.command()
def probe(
    cell: Cell,
    only: Annotated[list[str] | None, Option(metavar="NAME", help="Ask that device who it is, nothing else.")] = None,
    record: Record = None,
    as_json: Json = False,
) -> None:
    """Connect to each device, identify it, leave it safe."""
    from polishd.cli.cell import probe_verb

    probe_verb(cell, only or (), record, as_json=as_json)


@app.command()
def hil(
    *,
    cell: Cell,
    level: Annotated[
        Literal["identify", "no-contact", "contact", "cycle"], Option(help="How far: what moves is said before.")
    ] = "identify",
    max_force: Annotated[float | None, Option(metavar="N", help="Nothing is pressed harder.")] = None,
    simulate: Annotated[str, Option(metavar="NAME,...", help="Devices that are simulated instead.")] = "",
    motion: Annotated[Path | None, Option(metavar="PROGRAM", help="Blocks that the robot may run in the air.")] = None,
    record: Record = None,
    yes: Annotated[bool, Option("--yes", help="Do not ask before anything moves.")] = False,
    as_json: Json = False,
) -> None:
    """Hold a real cell's devices to what their ports demand. Needs polishd[testing]."""
    from polishd.cli.hil import hil_verb

    hil_verb(cell, level, max_force, simulate, motion, record=record, yes=yes, as_json=as_json)


@app.command()
def notify(cell: Cell, as_json: Json = False) -> None:
    """Send a test through each notifier of a cell, and say how it went. Opens no device."""
    from polishd.cli.cell import notify_verb

    notify_verb(cell, as_json=as_json)


@app.command()
def status(
    cell: Cell,
    as_json: Json = False,
) -> None:
    """Show what the daemon of a cell is doing."""
    from polishd.cli.status import status_verb

    status_verb(cell, as_json=as_json)


@app.command()
def top(
    cells: Annotated[
        list[Path], Argument(metavar="CELL.toml...", help="Each cell's configuration.", show_default=False)
    ],
    once: Annotated[bool, Option("--once", help="One look, and end; so it does where stdout is no terminal.")] = False,
) -> None:
    """Watch cells in the terminal: part, phase, time left, force, speed, and how old each reading is."""
    from polishd.cli.top import top_verb

    top_verb(cells, once=once)


@app.command()
def events(
    cell: Cell,
    count: Annotated[int, Option("--last", min=0, max=10_000, help="So many of those before.")] = 50,
    follow: Annotated[bool, Option("--follow", help="Go on with what happens, until the daemon ends.")] = False,
    as_json: Json = False,
) -> None:
    """What happened in a cell, and who ordered it, from its journal. Needs no daemon."""
    from polishd.cli.events import events_verb

    events_verb(cell, count, follow=follow, as_json=as_json)


@app.command()
def hold(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Leave contact, stand still, and wait for resume."""
    _order(cell, "hold", reason, as_json=as_json)


@app.command()
def resume(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Go on, with a new measurement first."""
    _order(cell, "resume", reason, as_json=as_json)


@app.command()
def approve(cell: Cell, as_json: Json = False) -> None:
    """The plan that waits may run (job.approve)."""
    from polishd.cli.status import approve_verb

    approve_verb(cell, as_json=as_json)


@app.command()
def stop(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Leave contact, stand still, and end the daemon."""
    _order(cell, "stop", reason, as_json=as_json)


@app.command()
def estop(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Stop motion at once, whatever the part costs; then wait for resume. No substitute for the button."""
    _order(cell, "estop", reason, as_json=as_json)


@app.command()
def web(
    *,
    cell: Cell,
    add_user: Annotated[str | None, Option(metavar="NAME", help="Make a token for somebody, and show it once.")] = None,
    role: Annotated[Literal["watch", "operate", "engineer"], Option(help="With --add-user: what they may.")] = "watch",
    remove_user: Annotated[str | None, Option(metavar="NAME", help="Their token is worth nothing any more.")] = None,
) -> None:
    """Serve the page and the HTTP API of a cell, beside its daemon; ends with Ctrl-C."""
    from polishd.cli.cell import web_verb
    from polishd.web.http.users import Role

    web_verb(cell, add_user, Role(role), remove_user)


@app.command()
def history(
    cell: Cell,
    out: Annotated[
        Path | None, Option(metavar="PICTURE.png", help="Picture: convergence, removal rate, faults over weeks.")
    ] = None,
    as_json: Json = False,
) -> None:
    """What became of the cell's parts: figures, removal rate and faults of all jobs. Needs no daemon."""
    from polishd.cli.history import history_verb

    history_verb(cell, out, as_json=as_json)


@app.command()
def estimates(
    cell: Cell,
    forget: Annotated[bool, Option("--forget", help="Begin anew: the next job begins with nothing learned.")] = False,
    reason: Reason = "",
    as_json: Json = False,
) -> None:
    """What the cell has learned of rate and machine, and the next job begins with."""
    from polishd.cli.history import beliefs_verb, forget_verb

    if forget:
        forget_verb(cell, reason, as_json=as_json)
    else:
        beliefs_verb(cell, as_json=as_json)


@app.command()
def plugins(
    cell: Annotated[Path | None, Argument(metavar="[CELL.toml]")] = None,
    as_json: Json = False,
) -> None:
    """The plugins of a cell (without CELL: polishd's own), and what each brings."""
    from polishd.cli.cell import plugins_verb

    plugins_verb(cell, as_json=as_json)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def sim(
    *,
    context: typer.Context,
    config: Annotated[Path, Argument(metavar="SIM.toml", show_default=False)],
) -> None:
    """Start a simulated cell as separate processes, until Ctrl-C. Further options go to the simulator."""
    from polishd.commissioning.rehearsal.simulated_cell import run_simulator

    raise typer.Exit(run_simulator(config, context.args))


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def rehearse(
    *,
    context: typer.Context,
    cell: Cell,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder for the simulated copy of the cell")] = None,
    write_only: Annotated[bool, Option("--write-only", help="Write the files; start nothing")] = False,
) -> None:
    """Start the simulated copy of a cell, to rehearse its job. Further options go to the simulator."""
    from polishd.commissioning.rehearsal.rehearsal import rehearsal_verb

    raise typer.Exit(rehearsal_verb(cell, out, context.args, write_only=write_only))


@app.command()
def version() -> None:
    """Print the version."""
    say(__version__)


app.command()(opcua)
app.add_typer(jobs, name="queue", no_args_is_help=True)
app.add_typer(services, name="service", no_args_is_help=True)
app.add_typer(recordings, name="recording", no_args_is_help=True)
app.add_typer(reports, name="report", no_args_is_help=True)
app.add_typer(shops, name="shop", no_args_is_help=True)
app.add_typer(offline_app)


def _order(cell: Path, verb: str, reason: str, *, as_json: bool) -> None:
    from polishd.cli.status import order_verb

    order_verb(cell, verb, reason, as_json=as_json)


def main() -> None:
    """The command line: errors of the tree, and of files, become one message and their exit code."""
    escape_logs()
    try:
        _plugin_commands()
        app()
    except PolishdError as error:
        say(f"polishd: {_with_cell(str(error))}", err=True)
        sys.exit(error.exit_code)
    except MemoryError as error:
        what = str(error) or "the computation"
        say(
            f"polishd: this computer has too little memory: {what}. Check sizes and pitches in the files "
            "(part, process.grid_mm, plant.pitch_mm), or end other programs",
            err=True,
        )
        sys.exit(ComputeError.exit_code)
    except OSError as error:
        full = error.errno == errno.ENOSPC
        name = error.filename or (_full_output() if full else None)
        if name is None:
            raise
        advice = "; make room" if full else ""
        say(f"polishd: {name}: {error.strerror}{advice}", err=True)
        sys.exit(1)


def _with_cell(text: str) -> str:
    """Commands in it can be copied: they name the cell that was asked for."""
    cell = next((word for word in sys.argv[1:] if word.endswith(".toml")), None)
    return text if cell is None else text.replace("CELL.toml", shlex.quote(cell))


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
    if asked is not None and asked not in _verbs(app):
        from polishd.plugin_loader import load_own

        load_own().cli(app)


def _verbs(group: typer.Typer) -> set[str]:
    """What may be said first, with the verbs of groups that have no name of their own."""
    own = {command.name or getattr(command.callback, "__name__", "") for command in group.registered_commands}
    for inner in group.registered_groups:
        own |= {inner.name} if inner.name else _verbs(cast(typer.Typer, inner.typer_instance))
    return own


if __name__ == "__main__":
    main()
