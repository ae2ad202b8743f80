"""Shared options of the command line, and commands whose options are the fields of a record."""

from __future__ import annotations

import inspect
import os
import pwd
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from typer import Argument, Option

Cell = Annotated[Path, Argument(metavar="CELL.toml", help="The cell's configuration")]
Json = Annotated[bool, Option("--json", help="Print one JSON object on stdout")]
Picture = Annotated[Path | None, Option("--out", metavar="PNG", help="Draw a picture, too")]


def spread_options(command: Callable[..., None]) -> Callable[..., None]:
    """Expand a command's dataclass parameter into options, one for each field.

    So an option's name, unit, default and help stand in one place, and what the command does is handed one record.
    """
    signature = inspect.signature(command, eval_str=True)
    records: dict[str, Any] = {
        p.name: p.annotation for p in signature.parameters.values() if is_dataclass(p.annotation)
    }
    ((given, record),) = records.items()
    hints = get_type_hints(record, include_extras=True)
    options = [p.replace(annotation=hints[p.name]) for p in inspect.signature(record).parameters.values()]
    shown = [p for own in signature.parameters.values() for p in (options if own.name == given else [own])]

    @wraps(command)
    def with_record(**values: Any) -> None:
        asked = {field.name: values.pop(field.name) for field in fields(record)}
        command(**values, **{given: record(**asked)})

    by_name = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in shown]
    with_record.__signature__ = signature.replace(parameters=by_name)  # type: ignore[attr-defined]
    return with_record


# The user at the terminal, whom the journal names with each command.


def account_name(number: int) -> str:
    """The name of an account; its number where it has none here."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:  # of a folder from another computer
        return str(number)


def terminal_user() -> str:
    """The present account, and that it spoke at a terminal."""
    return f"{account_name(os.getuid())} (command line)"
