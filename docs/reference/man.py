"""The man page, written from the verbs and options of the command line: ``python -m docs.reference.man``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from polishd import __version__
from polishd.cli.app import app

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "polishd.1"
ERRORS = Path(__file__).with_name("errors.md")
EXAMPLES = (
    ("polishd demo", "Polish a simulated part, from the first map to the report."),
    ("polishd init new-cell", "Begin a new cell, and list what is left to do."),
    ("polishd doctor CELL.toml", "Show what the computer and the cell still lack."),
    ("polishd check CELL.toml && polishd run CELL.toml", "Check a cell, and run its daemon."),
    ("polishd hold CELL.toml --reason 'a scratch'", "Leave contact, and wait for resume."),
    ("polishd status CELL.toml --json", "What the daemon does, for a program."),
)
"""Commands, and what they are for."""
_TYPE = re.compile(r" <(?:list\[)?(?:path|Path|str)\]?>(?:\.\.\.)?$")
"""Type of an argument that its name shows already."""


def page() -> str:
    """The whole page, in roff."""
    return "\n".join(_lines()) + "\n"


def exit_codes() -> list[tuple[str, str]]:
    """Return each code with its meaning, from the table in docs/reference/errors.md."""
    rows = (line.strip("|").split("|") for line in ERRORS.read_text(encoding="utf-8").splitlines())
    found = [(row[0].strip(), row[1].strip()) for row in rows if len(row) == 2 and row[0].strip().isdigit()]
    if not found:
        raise ValueError(f"{ERRORS}: no table of exit codes (| code | meaning |)")
    return found


def _lines() -> Iterator[str]:
    command: Any = typer.main.get_command(app)
    yield '.\\" Written by make reference, from the command line itself.'
    yield f'.TH POLISHD 1 "" "polishd {__version__}" "User Commands"'
    yield from (".SH NAME", f"polishd {_roff('-')} {_roff(one_line(command.help).rstrip('.').lower())}")
    yield from (".SH SYNOPSIS", ".B polishd", _roff("COMMAND [OPTIONS] [ARGUMENTS]"))
    yield from (".SH DESCRIPTION", _roff(one_line(command.help)))
    yield _roff("polishd run starts the daemon of a cell; the other commands make its files, or use its socket.")
    yield _roff("Each command has --help, with the text of this page, and most have --json.")
    yield ".SH COMMANDS"
    yield from _commands(command, "polishd")
    yield ".SH EXIT STATUS"
    for code, what in exit_codes():
        yield from (".TP", f".B {code}", _roff(what))
    yield ".SH EXAMPLES"
    for line, what in EXAMPLES:
        yield from (".TP", f".B {_roff(line)}", _roff(what))
    yield from (".SH SEE ALSO", _roff("The documentation of polishd: docs/index.md beside its source."))


def _commands(group: Any, path: str) -> Iterator[str]:
    """Yield each command of a group; commands of groups in it have their whole names."""
    for name, command in sorted(group.commands.items()):
        if command.hidden:
            continue
        whole = f"{path} {name}"
        if hasattr(command, "commands"):
            yield from _commands(command, whole)
            continue
        context = typer.Context(command, info_name=whole)
        pieces = [piece for piece in command.collect_usage_pieces(context) if piece != "[OPTIONS]"]
        usage = _roff(" ".join([whole, *pieces])).replace('"', "\\(dq")
        yield f'.SS "{usage}"'
        yield _roff(one_line(command.help))
        for param in command.get_params(context):
            record = None if "--help" in getattr(param, "opts", ()) else param.get_help_record(context)
            if record is not None:
                yield from (
                    ".TP",
                    f".B {_roff(_TYPE.sub('', one_line(record[0])))}",
                    _roff(one_line(record[1]) or "As its name says."),
                )


def one_line(text: str | None) -> str:
    """Return the text with each run of white space as one space."""
    return re.sub(r"\s+", " ", text or "").strip()


def _roff(text: str) -> str:
    """Escape the text: nothing in it is a request, and a hyphen can be copied."""
    safe = text.replace("\\", "\\e").replace("-", "\\-")
    return f"\\&{safe}" if safe.startswith((".", "'")) else safe


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
