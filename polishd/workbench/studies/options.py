"""Options of ``polishd study``, apart so that the command line is read fast."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """What of a study is run, and where it goes."""

    out: Annotated[
        Path | None, Option(metavar="DIR", help="Folder for pictures and tables; a study of loops goes on there.")
    ] = None
    limit: Annotated[int | None, Option(min=1, metavar="N", help="Of a study of loops: so many seeds.")] = None
    jobs: Annotated[int | None, Option(min=1, metavar="K", help="Of loops: processes; default: one a core.")] = None
