"""Commands of studies: ``polishd study STUDY.toml`` and ``polishd study show DIR``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument

from polishd.cli.command_group import CommandGroup
from polishd.studies.options import StudyOptions
from polishd.util.command_line import Json, spread_options


class _FileOrVerb(CommandGroup):
    """Group that runs a study's file if there is no command."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Add ``run`` before a file."""
        if args and args[0] not in {*self.commands, *self.get_help_option_names(ctx)}:
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_FileOrVerb,
    help="Simulations without a cell: corrections, spots, passes of equal dwell, whole jobs in a closed loop.",
)


@app.command()
@spread_options
def run(
    file: Annotated[Path, Argument(metavar="STUDY.toml", help="The study's configuration")],
    options: StudyOptions,
    as_json: Json = False,
) -> None:
    """Run a study, as `polishd study STUDY.toml`."""
    from polishd.studies.run import study_verb

    study_verb(file, options, as_json=as_json)


@app.command()
def show(
    folder: Annotated[Path, Argument(metavar="DIR", help="The --out folder of a study, which may still run")],
    *,
    as_json: Json = False,
) -> None:
    """Show results of many cases: medians, paired differences, sensitivity, failures; pictures in DIR."""
    from polishd.studies.run import show_verb

    show_verb(folder, as_json=as_json)
