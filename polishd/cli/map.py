"""The verbs of ``polishd map``: options only. What each does lives in the module that is called as it is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

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
"""What ``polishd map FILE`` does."""
HELP = (
    "Maps of surfaces: polishd map FILE... gives their figures (options: polishd map figures --help); or compare, "
    "report, convert, average, subtract, stitch, absolute, commission."
)


class MapGroup(TyperGroup):
    """Takes files where other groups take a verb. A file that is called like a verb is given as ``./compare``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """What does not begin with a verb, or ask for help, are files and options of ``figures``."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = [DEFAULT, *args]
        found: list[str] = super().parse_args(ctx, args)
        return found


app = typer.Typer(cls=MapGroup, help=HELP, subcommand_metavar="FILE... | COMMAND [ARGS]...")


@app.command(DEFAULT)
@spread_options
def figures(
    files: Annotated[list[Path], Argument(metavar="FILE...", help="Maps.", readable=False)],
    *,
    as_json: Json = False,
    asked: FigureOptions,
) -> None:
    """Shape, pitch, PV, RMS, bands and warnings of each map: what "polishd map FILE..." does."""
    from polishd.maps.inspect import figures_verb

    figures_verb(files, asked, as_json=as_json)


@app.command()
@spread_options
def compare(
    before: Annotated[Path, Argument(metavar="BEFORE", readable=False)],
    after: Annotated[Path, Argument(metavar="AFTER", readable=False)],
    *,
    as_json: Json = False,
    asked: FigureOptions,
) -> None:
    """PV, RMS and bands of two maps over the samples that both have, and how much they fell."""
    from polishd.maps.compare import compare_verb

    compare_verb(before, after, asked, as_json=as_json)


@app.command()
@spread_options
def report(
    files: Annotated[list[Path], Argument(metavar="FILE...", help="Maps.", readable=False)],
    *,
    as_json: Json = False,
    asked: ReportOptions,
) -> None:
    """A report for the customer, HTML or PDF: figures in nm and waves, ISO 10110, Zernike, slope, profiles, PSD."""
    from polishd.reports.map_report import report_verb

    report_verb(files, asked, as_json=as_json)


@app.command()
@spread_options
def convert(
    source: Annotated[Path, Argument(metavar="A", help="A map.", readable=False)],
    target: Annotated[Path, Argument(metavar="B", help="The new file; its ending says the format.")],
    *,
    as_json: Json = False,
    asked: WriteOptions,
) -> None:
    """Write a map in another format; it is read back and compared before it appears."""
    from polishd.maps.convert import convert_verb

    convert_verb(source, target, asked, as_json=as_json)


@app.command()
@spread_options
def average(
    files: Annotated[list[Path], Argument(metavar="MAP...", help="Repeats.", readable=False)],
    *,
    as_json: Json = False,
    asked: AverageOptions,
) -> None:
    """The mean of repeated measurements, without maps and samples that deviate, and its uncertainty."""
    from polishd.maps.arithmetic import average_verb

    average_verb(files, asked, as_json=as_json)


@app.command()
@spread_options
def subtract(
    first: Annotated[Path, Argument(metavar="A", help="A map.", readable=False)],
    second: Annotated[Path, Argument(metavar="B", help="What is taken off it: a reference, say.", readable=False)],
    *,
    as_json: Json = False,
    asked: NewMapOptions,
) -> None:
    """A less B, over the samples that both have: a reference, a system error, the wavefront of a test stand."""
    from polishd.maps.arithmetic import subtract_verb

    subtract_verb(first, second, asked, as_json=as_json)


@app.command()
@spread_options
def stitch(
    files: Annotated[
        list[Path], Argument(metavar="MAP...", help="Sub-apertures; the first is the reference.", readable=False)
    ],
    *,
    as_json: Json = False,
    asked: StitchOptions,
) -> None:
    """Overlapping sub-apertures as one map, by least squares over what differs from map to map, and its uncertainty."""
    from polishd.maps.stitch import stitch_verb

    stitch_verb(files, asked, as_json=as_json)


@app.command()
@spread_options
def absolute(
    files: Annotated[list[Path], Argument(metavar="MAP...", help="One part, turned and shifted.", readable=False)],
    *,
    as_json: Json = False,
    asked: AbsoluteOptions,
) -> None:
    """The instrument's own error and the part, from maps of it turned and shifted, and what they do not tell."""
    from polishd.maps.absolute_test import absolute_verb

    absolute_verb(files, asked, as_json=as_json)


@app.command()
def commission(
    *,
    profile: Annotated[Path, Argument(metavar="P.toml", help="The instrument's profile.", readable=False)],
    surface: Annotated[Path, Argument(metavar="MAP", help="A map.", readable=False)],
    out: Annotated[Path | None, Option("--out", metavar="PNG", help="Draw what was found.")] = None,
    as_json: Json = False,
    cell: OfCell = None,
    masks: Masks = None,
) -> None:
    """Prove an instrument's profile with a map of its artefact, and record it: before that no map drives polishing."""
    from polishd.maps.commission import commission_verb

    commission_verb(profile, surface, out, cell, masks, as_json=as_json)


@app.command()
def formats(as_json: Json = False, cell: OfCell = None) -> None:
    """The formats that can be read, in the order asked, and written, and what is not installed for the rest."""
    from polishd.maps.inspect import formats_verb

    formats_verb(cell, as_json=as_json)
