"""The verbs of ``polishd program``: options only. What they do lives in the modules beside."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.programs.options import Encoding, MakeOptions
from polishd.util.command_line import Json, spread_options

app = typer.Typer(help="RNC programs: inspect, rewrite the dwell, prove that the motion stayed, make new ones.")

# readable=False: what cannot be read is exit code 9, as what is not there is; typer would make it 2
File = Annotated[Path, Argument(metavar="FILE", help="The RNC program.", readable=False)]
Dialect = Annotated[
    str | None,
    Option(
        metavar="NAME|D.toml",
        help="Its dialect (polishd program dialects), or a profile of your own; default: by its text and ending.",
    ),
]


@app.command()
def inspect(
    file: File,
    dialect: Dialect = None,
    picture: Annotated[Path | None, Option(metavar="PNG", help="Draw where it dwells, and for how long.")] = None,
    as_json: Json = False,
) -> None:
    """Points, dwell, feeds, bounds and warnings of a program; refuses what cannot be read without guessing."""
    from polishd.programs.show import inspect_verb

    inspect_verb(file, dialect, picture, as_json=as_json)


@app.command()
def rewrite(
    *,
    file: File,
    dwell: Annotated[
        Path, Option(metavar="CSV", help="One dwell in seconds a row, no header, one row a point.", readable=False)
    ],
    out: Annotated[Path, Option(metavar="FILE", help="The new program; not FILE itself.")],
    dialect: Dialect = None,
    encoding: Annotated[
        Encoding | None, Option(help="Where the time is written; default: where the program has it.")
    ] = None,
    comment: Annotated[bool, Option("--comment", help="Say in the first line what was done.")] = False,
    as_json: Json = False,
) -> None:
    """Other dwells in the same program: changes the numbers that carry time, and no other byte."""
    from polishd.programs.show import rewrite_verb

    rewrite_verb(file, dwell, out, dialect, encoding, comment=comment, as_json=as_json)


@app.command()
def verify(
    old: Annotated[Path, Argument(metavar="OLD", help="The program as it was.", readable=False)],
    new: Annotated[Path, Argument(metavar="NEW", help="The program as it is.", readable=False)],
    dialect: Dialect = None,
    interpreter: Annotated[
        Literal["rs274"] | None, Option("--with", help="Prove it with LinuxCNC's interpreter, too.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Prove that two programs move alike, and list what changed; exit code 9 where it is not proved."""
    from polishd.programs.show import verify_verb

    verify_verb(old, new, dialect, with_rs274=interpreter is not None, as_json=as_json)


@app.command()
def dialects(as_json: Json = False) -> None:
    """The dialects that polishd reads: how each writes a dwell, in which unit, how finely."""
    from polishd.programs.show import dialects_verb

    dialects_verb(as_json=as_json)


@app.command()
@spread_options
def make(asked: MakeOptions, as_json: Json = False) -> None:
    """Make a raster or a spiral over an aperture, on a flat, sphere or asphere, with the tool along its normals."""
    from polishd.programs.make import make_verb

    make_verb(asked, as_json=as_json)
