"""What reaches a terminal: text from outside has its control characters escaped here, and nowhere else.

``say`` is for lines, ``Terminal`` for all that rich lays out, and ``escape_logs`` for what a process logs to stderr.
"""

from __future__ import annotations

import logging

import typer

from polishd.model.printable import printable


def say(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print a text on stdout, or on stderr."""
    typer.echo(printable(text), err=err, nl=nl)


def escape_logs() -> None:
    """Escape what this process logs to stderr where no log file is set up."""
    if logging.lastResort is not None:
        logging.lastResort.setFormatter(_Escaped())


class _Escaped(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))
