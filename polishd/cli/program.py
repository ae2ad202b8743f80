"""Commands of ``polishd program``: options only."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.cli.command_group import CommandGroup
from polishd.programs.options import EncodingOption, ForceOption, MakeOptions
from polishd.util.command_line import Json, spread_options

app = typer.Typer(
    cls=CommandGroup, help="RNC programs: inspect, rewrite the dwell, verify equal motion, make new ones."
)

# readable=False: a file that cannot be read has exit code 9, as a missing file; typer would use 2
File = Annotated[Path, Argument(metavar="FILE", help="The RNC program", readable=False)]
Dialect = Annotated[
    str | None,
    Option(
        metavar="NAME|D.toml",
        help="Its dialect (polishd program dialects), or your own profile (default: detected from text and ending)",
    ),
]


@app.command()
def inspect(
    file: File,
    dialect: Dialect = None,
    picture: Annotated[Path | None, Option(metavar="PNG", help="Draw the dwell along the path")] = None,
    as_json: Json = False,
) -> None:
    """Show points, dwell, feeds, bounds and warnings of a program. An ambiguous program is refused."""
    from polishd.programs.show import inspect_verb

    inspect_verb(file, dialect, picture, as_json=as_json)


@app.command()
def rewrite(
    *,
    file: File,
    dwell: Annotated[
        Path,
        Option(
            metavar="CSV",
            help="Dwell of each point in seconds, one per row, no header; or a plan's dwell.csv",
            readable=False,
        ),
    ],
    out: Annotated[Path, Option(metavar="FILE", help="The new program; not the same file")],
    dialect: Dialect = None,
    encoding: Annotated[
        EncodingOption | None,
        Option(help="Encoding of the time: the speed or the time of each move, or a wait (default: as in the program)"),
    ] = None,
    comment: Annotated[bool, Option("--comment", help="Add a comment on the change in the first line")] = False,
    force: ForceOption = False,
    as_json: Json = False,
) -> None:
    """Rewrite the dwells of a program. Only the numbers of times change, and no other byte."""
    from polishd.programs.show import rewrite_verb

    written = "dwell" if encoding == "wait" else encoding
    rewrite_verb(file, dwell, out, dialect, written, comment=comment, force=force, as_json=as_json)


@app.command()
def verify(
    old: Annotated[Path, Argument(metavar="OLD", help="The old program", readable=False)],
    new: Annotated[Path, Argument(metavar="NEW", help="The new program", readable=False)],
    dialect: Dialect = None,
    interpreter: Annotated[
        Literal["rs274"] | None, Option("--with", help="Verify with LinuxCNC's interpreter, too")
    ] = None,
    as_json: Json = False,
) -> None:
    """Verify that two programs have the same motion, and list the changes; exit code 9 if not."""
    from polishd.programs.show import verify_verb

    verify_verb(old, new, dialect, with_rs274=interpreter is not None, as_json=as_json)


@app.command()
def dialects(as_json: Json = False) -> None:
    """List the dialects that polishd reads, with form, unit and resolution of their dwells."""
    from polishd.programs.show import dialects_verb

    dialects_verb(as_json=as_json)


@app.command()
@spread_options
def make(options: MakeOptions, as_json: Json = False) -> None:
    """Make a path over a flat, spherical or aspheric aperture, with the tool along its normals."""
    from polishd.programs.make import make_verb

    make_verb(options, as_json=as_json)
