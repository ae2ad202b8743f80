"""The command line: commands of a cell and commands without a cell. Options only; other packages do the work."""

from __future__ import annotations

import copy
import errno
import functools
import gc
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, cast

import typer
from typer import Argument, Option
from typer.models import CommandInfo

from polishd import __version__
from polishd.cli.calibrate import app as calibrations
from polishd.cli.command_group import CommandGroup
from polishd.cli.device import app as devices
from polishd.cli.groups import Reason, certificates, estimates, jobs, opcua, recordings, services
from polishd.cli.json_error import print_json_error
from polishd.cli.map import app as maps
from polishd.cli.program import app as programs
from polishd.cli.shop import app as shops
from polishd.cli.study import app as studies
from polishd.model.errors import ComputeError, PolishdError
from polishd.rendering.terminal import escape_logs, json_output, say
from polishd.util.command_line import Cell, Json, Picture

# The panels of the help, with their commands in order.

PANELS: Mapping[str, Sequence[str]] = {
    "Start": ("demo", "init", "doctor", "check", "probe", "rehearse"),
    "Run a cell": ("run", "queue", "hold", "resume", "approve", "stop", "estop"),
    "Look": ("status", "top", "events", "history", "estimates", "recording"),
    "Maps and programs": ("map", "program", "plan", "certificate"),
    "Calibrate": ("calibrate", "tif", "compliance", "device"),
    "Studies": ("study",),
    "Services": ("service", "web", "notify", "opcua", "shop"),
    "Develop": ("sim", "hil", "plugins"),
}
PANEL_OF = {name: panel for panel, names in PANELS.items() for name in names}


class RootGroup(CommandGroup):
    """All commands in panels; commands of plugins in the last one."""

    def list_commands(self, ctx: Any) -> list[str]:
        """See TyperGroup."""
        order = list(PANEL_OF)
        return sorted(super().list_commands(ctx), key=lambda name: order.index(name) if name in order else len(order))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """See TyperGroup."""
        found = super().get_command(ctx, cmd_name)
        if found is not None:
            found.rich_help_panel = PANEL_OF.get(cmd_name, "Plugins")
        return found


# Commands that need no daemon.

offline_app = typer.Typer(
    cls=CommandGroup, help="Maps, programs, calibration, physics and studies.", no_args_is_help=True
)
offline_app.add_typer(calibrations, name="calibrate", no_args_is_help=True)
offline_app.add_typer(programs, name="program", no_args_is_help=True)
offline_app.add_typer(maps, name="map", no_args_is_help=True)
offline_app.add_typer(devices, name="device", no_args_is_help=True)
offline_app.add_typer(studies, name="study", no_args_is_help=True)


@offline_app.command()
def init(
    *,
    folder: Annotated[
        Path, Argument(metavar="DIR", help="Folder of the new cell, created if missing; with --status also CELL.toml")
    ],
    answers: Annotated[
        Path | None, Option("--from", metavar="ANSWERS.toml", help="File of answers (default: ask at the terminal)")
    ] = None,
    dry_run: Annotated[bool, Option("--dry-run", help="Show the files; write nothing")] = False,
    force: Annotated[bool, Option("--force", help="Overwrite existing files")] = False,
    status: Annotated[bool, Option("--status", help="Show the next step of a cell that exists; write nothing")] = False,
    as_json: Json = False,
) -> None:
    """Start a new cell: its commented file, an instrument's profile, a program, and the next steps."""
    if status:
        from polishd.commissioning.init.steps import setup_verb

        setup_verb(folder if folder.suffix == ".toml" else folder / "cell.toml", as_json=as_json)
        return
    from polishd.commissioning.init.write_cell import init_verb

    init_verb(folder, answers, dry_run=dry_run, force=force, as_json=as_json)


@offline_app.command()
def tif(
    cell: Cell,
    depth_ratio: Annotated[float, Option(metavar="G", help="Gamma: depth divided by the rigid robot's depth")] = 1.0,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """Show the tool influence function of a cell: depth, pressure, peak, volume, profiles."""
    from polishd.cli.tif import tif_verb

    tif_verb(cell, depth_ratio, out, as_json=as_json)


@offline_app.command()
def compliance(
    cell: Cell,
    *,
    program: Annotated[Path | None, Option(metavar="P.rnc", help="Show it along this program, too")] = None,
    place: Annotated[bool, Option("--place", help="Search where gamma changes least over the part")] = False,
    within: Annotated[float, Option(metavar="MM", help="Distance to search within, with --place")] = 200.0,
    removal: Annotated[float, Option(metavar="NM", help="Mean removal of the errors, with --place")] = 100.0,
    out: Picture = None,
    as_json: Json = False,
) -> None:
    """Show the robot's equivalent compliance over the workspace and along a program, and its gamma."""
    from polishd.cli.tif import compliance_verb, placement_verb

    if not place:
        compliance_verb(cell, program, out, as_json=as_json)
    elif program is not None:
        raise typer.BadParameter("--place searches the part's place without a program: use one of the two")
    else:
        placement_verb(cell, within, removal, out, as_json=as_json)


app = typer.Typer(
    cls=RootGroup,
    name="polishd",
    help="Controller daemon of an unattended robotic polishing cell.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

STDOUT = 1
"""File descriptor of standard output."""

Correction = Annotated[
    Literal["none", "pointwise", "linear", "power", "exact"] | None, Option(help="Override process.correction")
]

Record = Annotated[
    Path | None,
    Option(metavar="FILE|DIR", help="Record the devices' links, for replay (docs/how-to/recording.md)"),
]


def _version(given: bool) -> None:
    if given:
        say(__version__)
        raise typer.Exit


@app.callback()
def root(
    *,
    _show: Annotated[
        bool, Option("--version", callback=_version, is_eager=True, help="Print the version and exit")
    ] = False,
) -> None:
    """Controller daemon of an unattended robotic polishing cell."""
    # Set before numpy is imported: BLAS threads that wait for each other take three times the CPU or more.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")


@app.command()
def demo(
    *,
    seed: Annotated[int, Option(metavar="N", help="Seed of the simulated cell's hidden parameters")] = 1,
    speed: Annotated[float, Option(min=1.0, max=200.0, metavar="FACTOR", help="Process time per wall time")] = 60.0,
    cycles: Annotated[int, Option(min=1, max=20, metavar="N", help="Largest number of polishing passes")] = 4,
    tolerance: Annotated[float, Option(min=0.01, metavar="NM", help="RMS to reach")] = 2.0,
    surface: Annotated[Path | None, Option(metavar="FILE", help="Start from a measured map (Zygo .dat)")] = None,
    correction: Correction = None,
    out: Annotated[Path | None, Option(metavar="DIR", help="Folder for all files of the demo")] = None,
    as_json: Json = False,
) -> None:
    """Polish a simulated part unattended in a simulated cell, over real links."""
    from polishd.cli.demo import DemoOptions, run_demo

    options = DemoOptions(seed, speed, cycles, tolerance, surface, correction, out)
    raise typer.Exit(run_demo(options, as_json=as_json))


@app.command()
def run(
    *,
    cells: Annotated[
        list[Path], Argument(metavar="CELL.toml...", help="Configuration of each cell", show_default=False)
    ],
    correction: Correction = None,
    no_hold: Annotated[bool, Option("--no-hold", help="End instead of waiting for an operator")] = False,
    start_held: Annotated[bool, Option("--start-held", help="Only make devices safe until polishd resume")] = False,
    queue: Annotated[bool, Option("--queue", help="Run the jobs of polishd queue, and wait for more")] = False,
    until_empty: Annotated[bool, Option("--until-empty", help="With --queue: end when no job waits")] = False,
    record: Record = None,
    as_json: Json = False,
) -> None:
    """Run the daemon of one or several cells until their jobs end. After an interruption a cell starts held."""
    from polishd.cli.run import run_verb

    how = {"queue": queue, "until_empty": until_empty, "start_held": start_held}
    raise typer.Exit(run_verb(cells, correction, holds=not no_hold, as_json=as_json, record=record, **how))


@app.command()
def plan(
    *,
    cell: Cell,
    surface: Annotated[Path, Argument(metavar="MAP", help="A measured map")],
    program: Annotated[
        Path | None, Option(metavar="P.rnc", help="RNC program to rewrite (default: the cell's)")
    ] = None,
    of_pass: Annotated[
        int | None,
        Option("--pass", min=1, metavar="N", help="Take the program of pass N, where several take turns (default: 1)"),
    ] = None,
    out: Annotated[Path, Option(metavar="DIR", help="New folder for the plan")],
    correction: Correction = None,
    as_json: Json = False,
) -> None:
    """Plan a pass without motion: figures, corrected dwell, rewritten program, certificate, pictures."""
    from polishd.cli.cell import plan_verb

    plan_verb(cell, surface, program, out, correction, of_pass=of_pass, as_json=as_json)


@app.command()
def doctor(
    *,
    cell: Annotated[Path | None, Argument(metavar="[CELL.toml]", help="The cell's configuration")] = None,
    compile_ahead: Annotated[
        bool, Option("--compile", help="Only compile the functions of large plans, after an installation")
    ] = False,
    as_json: Json = False,
) -> None:
    """Check software, permissions, clock and disk of this computer, and a cell's addresses. No device is opened."""
    if compile_ahead:
        from polishd.commissioning.compile_ahead import compile_verb

        compile_verb(as_json=as_json)
        return
    from polishd.commissioning.doctor import doctor_verb

    doctor_verb(cell, as_json=as_json)


@app.command()
def check(cell: Cell, as_json: Json = False) -> None:
    """Check config, plugins, program and reach. No device is opened."""
    gc.disable()  # a tenth of the time would go into collections that find next to nothing
    from polishd.cli.cell import check_verb

    check_verb(cell, as_json=as_json)


@app.command()
def probe(
    cell: Cell,
    only: Annotated[list[str] | None, Option(metavar="NAME", help="Only identify this device")] = None,
    record: Record = None,
    as_json: Json = False,
) -> None:
    """Open each device, identify it, and leave it safe."""
    from polishd.cli.cell import probe_verb

    probe_verb(cell, only or (), record, as_json=as_json)


@app.command()
def hil(
    *,
    cell: Cell,
    level: Annotated[
        Literal["identify", "no-contact", "contact", "cycle"],
        Option(help="Level of the test"),
    ] = "identify",
    max_force: Annotated[float | None, Option(metavar="N", help="Largest force of the test")] = None,
    simulate: Annotated[str, Option(metavar="NAME,...", help="Simulate these devices")] = "",
    motion: Annotated[Path | None, Option(metavar="PROGRAM", help="Program that the robot may run in the air")] = None,
    record: Record = None,
    yes: Annotated[bool, Option("--yes", help="Move without confirmation")] = False,
    as_json: Json = False,
) -> None:
    """Test a real cell's devices against the requirements of their ports. Needs polishd[testing]."""
    from polishd.cli.hil import hil_verb

    hil_verb(cell, level, max_force, simulate, motion, record=record, yes=yes, as_json=as_json)


@app.command()
def notify(cell: Cell, as_json: Json = False) -> None:
    """Send a test through each notifier of a cell, and show the results. No device is opened."""
    from polishd.cli.cell import notify_verb

    notify_verb(cell, as_json=as_json)


@app.command()
def status(
    cell: Cell,
    as_json: Json = False,
) -> None:
    """Show the status of a cell's daemon."""
    from polishd.cli.status import status_verb

    status_verb(cell, as_json=as_json)


@app.command()
def top(
    cells: Annotated[
        list[Path], Argument(metavar="CELL.toml...", help="Configuration of each cell", show_default=False)
    ],
    once: Annotated[bool, Option("--once", help="Print once and end (always, if stdout is not a terminal)")] = False,
) -> None:
    """Monitor cells in the terminal: part, phase, remaining time, force, speed, and the age of each reading."""
    from polishd.cli.top import top_verb

    top_verb(cells, once=once)


@app.command()
def events(
    cell: Cell,
    count: Annotated[int, Option("--last", min=0, max=10_000, metavar="N", help="Number of past events")] = 50,
    follow: Annotated[bool, Option("--follow", help="Continue with new events until the daemon ends")] = False,
    as_json: Json = False,
) -> None:
    """Show the events of a cell's journal, with the user who ordered each. Needs no daemon."""
    from polishd.cli.events import events_verb

    events_verb(cell, count, follow=follow, as_json=as_json)


@app.command()
def hold(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Leave contact, stop motion, and wait for resume."""
    _order(cell, "hold", reason, as_json=as_json)


@app.command()
def resume(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Continue, with a new measurement first."""
    _order(cell, "resume", reason, as_json=as_json)


@app.command()
def approve(cell: Cell, as_json: Json = False) -> None:
    """Approve the waiting plan (job.approve)."""
    from polishd.cli.status import approve_verb

    approve_verb(cell, as_json=as_json)


@app.command()
def stop(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Leave contact, stop motion, and end the daemon."""
    _order(cell, "stop", reason, as_json=as_json)


@app.command()
def estop(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Stop motion at once, even if that damages the part, and wait for resume. It does not replace the button."""
    _order(cell, "estop", reason, as_json=as_json)


@app.command()
def web(
    *,
    cell: Cell,
    add_user: Annotated[str | None, Option(metavar="NAME", help="Add a user, and show the token once")] = None,
    role: Annotated[
        Literal["watch", "operate", "engineer"], Option(help="Role of the new user (with --add-user)")
    ] = "watch",
    remove_user: Annotated[str | None, Option(metavar="NAME", help="Remove a user; the token is void")] = None,
) -> None:
    """Serve the web page and the HTTP API of a cell until Ctrl-C, in its own process."""
    from polishd.cli.cell import web_verb
    from polishd.web.http.users import Role

    web_verb(cell, add_user, Role(role), remove_user)


@app.command()
def history(
    cell: Cell,
    out: Annotated[
        Path | None, Option(metavar="PICTURE.png", help="Draw convergence, removal rate and faults over weeks")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show the history of a cell's parts: figures, removal rate and faults of all jobs. Needs no daemon."""
    from polishd.cli.history import history_verb

    history_verb(cell, out, as_json=as_json)


@app.command()
def plugins(
    cell: Annotated[Path | None, Argument(metavar="[CELL.toml]", help="The cell's configuration")] = None,
    as_json: Json = False,
) -> None:
    """Show the plugins of a cell, or polishd's own without CELL.toml, and the functions of each."""
    from polishd.cli.cell import plugins_verb

    plugins_verb(cell, as_json=as_json)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def sim(
    *,
    context: typer.Context,
    config: Annotated[Path, Argument(metavar="SIM.toml", help="The simulator's configuration", show_default=False)],
) -> None:
    """Run a simulated cell in separate processes until Ctrl-C.

    Further options: --speed FACTOR, --seed N, --surface MAP, --state DIR, --only DEVICE, --artefact FILE.
    """
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
    """Run a simulated copy of a cell, to rehearse its job.

    Further options, for the simulator: --speed FACTOR, --seed N, --surface MAP.
    """
    from polishd.commissioning.rehearsal.rehearsal import rehearsal_verb

    raise typer.Exit(rehearsal_verb(cell, out, context.args, write_only=write_only))


app.command()(opcua)
app.add_typer(jobs, name="queue", no_args_is_help=True)
app.add_typer(estimates, name="estimates", no_args_is_help=True)
app.add_typer(services, name="service", no_args_is_help=True)
app.add_typer(recordings, name="recording", no_args_is_help=True)
app.add_typer(certificates, name="certificate", no_args_is_help=True)
app.add_typer(shops, name="shop", no_args_is_help=True)
app.add_typer(offline_app)


def _order(cell: Path, verb: str, reason: str, *, as_json: bool) -> None:
    from polishd.cli.status import order_verb

    order_verb(cell, verb, reason, as_json=as_json)


def main() -> None:
    """Run the command line; print each known error as a message, with --json also as JSON, and exit with its code."""
    escape_logs()
    json_output.is_printed = False
    if os.environ.get("NO_COLOR"):
        from typer import rich_utils  # this import is slow

        rich_utils.COLOR_SYSTEM = None  # without bold and dim text, too
    try:
        _plugin_commands()
        _commands(_given_command())()
    except PolishdError as error:
        _fail(error, _with_cell(str(error)), error.exit_code)
    except MemoryError as error:
        what = str(error) or "the computation"
        message = (
            f"not enough memory: {what}. Check sizes and pitches in the files "
            "(part, process.grid_mm, plant.pitch_mm), or end other programs"
        )
        _fail(error, message, ComputeError.exit_code)
    except OSError as error:
        full = error.errno == errno.ENOSPC
        name = error.filename or (_full_output() if full else None)
        if name is None:
            raise
        advice = "make room" if full else "check the path, its permissions and its disk"
        _fail(error, f"{name}: {error.strerror}; {advice}", 1)


def _fail(error: Exception, message: str, exit_code: int) -> NoReturn:
    say(f"polishd: {message}", err=True)
    print_json_error(error, message, exit_code)
    sys.exit(exit_code)


@functools.cache
def _commands(given: str | None) -> Any:
    """Build the command of ``app``, once: it takes 40 ms, and the tests call ``main`` hundreds of times.

    Where a command of ``app`` itself is ``given``, with this one alone: most of that time goes into the other 70.
    """
    shown = copy.copy(app)
    if own := [command for command in app.registered_commands if _name(command) == given]:
        shown.registered_commands, shown.registered_groups = own, []
    return typer.main.get_command(shown)


def _given_command() -> str | None:
    """Return the first word of the command line that is no option: a command, or a group of commands."""
    return next((word for word in sys.argv[1:] if not word.startswith("-")), None)


def _name(command: CommandInfo) -> str:
    return str(command.name or getattr(command.callback, "__name__", ""))


def _with_cell(text: str) -> str:
    """Put the given cell's path into the commands of a message, so that they can be copied."""
    if "CELL.toml" not in text:
        return text
    command, words = _commands(_given_command()), sys.argv[1:]
    while words and words[0] in getattr(command, "commands", {}):
        command, words = command.commands[words[0]], words[1:]
    given = command.make_context("", words, resilient_parsing=True).params
    named = (given[one.name] for one in command.params if "CELL.toml" in (one.metavar or ""))
    cells = [cell for value in named for cell in (value if isinstance(value, list | tuple) else [value]) if cell]
    cells = [cell for cell in cells if not Path(cell).is_dir()]  # RUN|CELL.toml may be a folder
    return text.replace("CELL.toml", shlex.quote(str(cells[0]))) if cells else text


def _full_output() -> str:
    """Name the full output if the error names no file: standard output, if it takes not even a line end."""
    try:
        os.write(STDOUT, b"\n")
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), STDOUT)  # Python flushes what is left as it ends
        return "standard output"
    return "a file"


def _plugin_commands() -> None:
    """Add commands of polishd's plugins; load them only for a command that is not built in."""
    command = _given_command()
    if command is not None and command not in _verbs(app):
        from polishd.plugin_loader import load_own

        load_own().cli(app)
        _commands.cache_clear()


def _verbs(group: typer.Typer) -> set[str]:
    """Return the names of commands and groups, with the commands of groups without a name."""
    own = {_name(command) for command in group.registered_commands}
    for inner in group.registered_groups:
        own |= {inner.name} if inner.name else _verbs(cast(typer.Typer, inner.typer_instance))
    return own


if __name__ == "__main__":
    main()
