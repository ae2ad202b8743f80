"""The verbs of ``polishd program``: options only. What they do lives in ``program.py`` and its like."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Optional

import typer

from polishd.workbench.programs.make_cli import make

program = typer.Typer(help="RNC programs: inspect, rewrite the dwell, prove that the motion stayed, make new ones.")

# readable=False: what cannot be read is exit code 9, as what is not there is; typer would make it 2
File = Annotated[Path, typer.Argument(metavar="FILE", help="The RNC program.", readable=False, show_default=False)]
Dialect = Annotated[
    str,
    typer.Option(metavar="NAME|D.toml", help="Its dialect (polishd program dialects), or a profile of your own."),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout, for programs.")]


EncodingChoice = Literal["dwell", "feed", "inverse"]


@program.command()
def inspect(
    file: File,
    dialect: Dialect = "rs274",
    picture: Annotated[
        Optional[Path],  # noqa: UP045 - typer reads it
        typer.Option(metavar="PNG", help="Draw where it dwells, and for how long.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Points, dwell, feeds, bounds and warnings of a program; refuses what cannot be read without guessing."""
    from polishd.workbench.programs.show import inspect_verb

    inspect_verb(file, dialect, picture, as_json=as_json)


@program.command()
def rewrite(  # noqa: PLR0917 - typer reads the options off the signature
    file: File,
    dwell: Annotated[
        Path,
        typer.Option(
            metavar="CSV",
            help="One dwell in seconds a row, no header, one row a point.",
            readable=False,
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The new program; not FILE itself.", show_default=False)],
    dialect: Dialect = "rs274",
    encoding: Annotated[
        Optional[EncodingChoice],  # noqa: UP045 - typer reads it
        typer.Option(help="Where the time is written; default: where the program has it.", show_default=False),
    ] = None,
    comment: Annotated[bool, typer.Option("--comment", help="Say in the first line what was done.")] = False,
    as_json: Json = False,
) -> None:
    """Other dwells in the same program: changes the numbers that carry time, and no other byte."""
    from polishd.workbench.programs.show import rewrite_verb

    rewrite_verb(file, dwell, out, dialect, encoding, comment=comment, as_json=as_json)


@program.command()
def verify(
    old: Annotated[
        Path, typer.Argument(metavar="OLD", help="The program as it was.", readable=False, show_default=False)
    ],
    new: Annotated[
        Path, typer.Argument(metavar="NEW", help="The program as it is.", readable=False, show_default=False)
    ],
    dialect: Dialect = "rs274",
    interpreter: Annotated[
        Optional[Literal["rs274"]],  # noqa: UP045 - typer reads it
        typer.Option("--with", help="Prove it with LinuxCNC's interpreter, too.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Prove that two programs move alike, and list what changed; exit code 9 where it is not proved."""
    from polishd.workbench.programs.show import verify_verb

    verify_verb(old, new, dialect, with_rs274=interpreter is not None, as_json=as_json)


@program.command()
def dialects(as_json: Json = False) -> None:
    """The dialects that polishd reads: how each writes a dwell, in which unit, how finely."""
    from polishd.workbench.programs.dialects import dialects_verb

    dialects_verb(as_json=as_json)


program.command()(make)
