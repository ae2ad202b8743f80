"""Commands of ``polishd map``: options only."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from polishd.cli.command_group import CommandGroup
from polishd.maps.options import (
    AbsoluteOptions,
    AverageOptions,
    FigureOptions,
    Json,
    Masks,
    NewMapOptions,
    OfCell,
    ReportOptions,
    StitchOptions,
    WriteOptions,
)
from polishd.util.command_line import spread_options

DEFAULT = "figures"
"""Command of ``polishd map FILE``."""
HELP = """Read, compare, convert, combine and report surface maps.

polishd map FILE... shows the figures of each map; its options are those of polishd map figures."""


class MapCommands(CommandGroup):
    """Group that accepts files instead of a command. Write a file that is named like a command as ``./compare``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Take arguments without a command, except help, as files and options of ``figures``."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = [DEFAULT, *args]
        found: list[str] = super().parse_args(ctx, args)
        return found


app = typer.Typer(cls=MapCommands, help=HELP, subcommand_metavar="FILE... | COMMAND [ARGS]...")


@app.command(DEFAULT)
@spread_options
def figures(
    files: Annotated[list[Path], Argument(metavar="FILE...", help="Maps", readable=False)],
    *,
    as_json: Json = False,
    options: FigureOptions,
) -> None:
    """Show shape, pitch, PV, RMS, bands and warnings of each map, as "polishd map FILE..."."""
    from polishd.maps.inspect import figures_verb

    figures_verb(files, options, as_json=as_json)


@app.command()
@spread_options
def compare(
    before: Annotated[Path, Argument(metavar="BEFORE", help="Map before", readable=False)],
    after: Annotated[Path, Argument(metavar="AFTER", help="Map after", readable=False)],
    *,
    as_json: Json = False,
    options: FigureOptions,
) -> None:
    """Compare PV, RMS and bands of two maps over their common samples, with the reduction."""
    from polishd.maps.compare import compare_verb

    compare_verb(before, after, options, as_json=as_json)


@app.command()
@spread_options
def report(
    files: Annotated[list[Path], Argument(metavar="FILE...", help="Maps", readable=False)],
    *,
    as_json: Json = False,
    options: ReportOptions,
) -> None:
    """Make a report for the customer, HTML or PDF: figures in nm and waves, ISO 10110, Zernike, slope, PSD."""
    from polishd.reports.map_report import report_verb

    report_verb(files, options, as_json=as_json)


@app.command()
@spread_options
def convert(
    source: Annotated[Path, Argument(metavar="A", help="A map", readable=False)],
    target: Annotated[Path, Argument(metavar="B", help="New file; its ending sets the format")],
    *,
    as_json: Json = False,
    options: WriteOptions,
) -> None:
    """Write a map in another format, after reading it back for comparison."""
    from polishd.maps.convert import convert_verb

    convert_verb(source, target, options, as_json=as_json)


@app.command()
@spread_options
def average(
    files: Annotated[list[Path], Argument(metavar="MAP...", help="Repeated maps", readable=False)],
    *,
    as_json: Json = False,
    options: AverageOptions,
) -> None:
    """Average repeated measurements without outlying maps and samples, with the uncertainty."""
    from polishd.maps.arithmetic import average_verb

    average_verb(files, options, as_json=as_json)


@app.command()
@spread_options
def subtract(
    first: Annotated[Path, Argument(metavar="A", help="A map", readable=False)],
    second: Annotated[Path, Argument(metavar="B", help="Map to subtract, such as a reference", readable=False)],
    *,
    as_json: Json = False,
    options: NewMapOptions,
) -> None:
    """Subtract map B from map A over their common samples: a reference, a system error, a test stand's wavefront."""
    from polishd.maps.arithmetic import subtract_verb

    subtract_verb(first, second, options, as_json=as_json)


@app.command()
@spread_options
def stitch(
    files: Annotated[
        list[Path], Argument(metavar="MAP...", help="Sub-apertures; the first is the reference", readable=False)
    ],
    *,
    as_json: Json = False,
    options: StitchOptions,
) -> None:
    """Stitch overlapping sub-apertures into one map, by least squares of their alignments, with the uncertainty."""
    from polishd.maps.stitch import stitch_verb

    stitch_verb(files, options, as_json=as_json)


@app.command()
@spread_options
def absolute(
    files: Annotated[list[Path], Argument(metavar="MAP...", help="One part, rotated and shifted", readable=False)],
    *,
    as_json: Json = False,
    options: AbsoluteOptions,
) -> None:
    """Separate the instrument's error from the part, from maps of a rotated and shifted part; list unmeasured terms."""
    from polishd.maps.absolute_test import absolute_verb

    absolute_verb(files, options, as_json=as_json)


@app.command()
def commission(
    *,
    profile: Annotated[Path, Argument(metavar="P.toml", help="The instrument's profile", readable=False)],
    surface: Annotated[Path, Argument(metavar="MAP", help="Map of the artefact", readable=False)],
    out: Annotated[Path | None, Option("--out", metavar="PNG", help="Draw the result")] = None,
    as_json: Json = False,
    cell: OfCell = None,
    masks: Masks = None,
) -> None:
    """Commission an instrument's profile with a map of its artefact. Polishing needs a commissioned profile."""
    from polishd.maps.commission import commission_verb

    commission_verb(profile, surface, out, cell, masks, as_json=as_json)


@app.command()
def formats(as_json: Json = False, cell: OfCell = None) -> None:
    """List the formats that can be read, in their order, and written, and missing packages for others."""
    from polishd.maps.inspect import formats_verb

    formats_verb(cell, as_json=as_json)
