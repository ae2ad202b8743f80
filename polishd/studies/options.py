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
        Path | None, Option(metavar="DIR", help="Folder for tables and pictures; cases are kept there, it goes on.")
    ] = None
    limit: Annotated[int | None, Option(min=1, metavar="N", help="Of many cases the first N.")] = None
    workers: Annotated[
        int | None, Option(min=1, metavar="K", help="Processes of this machine; default: one a core.")
    ] = None
    scheduler: Annotated[
        str | None, Option(metavar="tcp://HOST:PORT", help="Compute on this Dask cluster instead (extra: dask).")
    ] = None
    case_s: Annotated[
        float, Option("--case-s", min=1.0, metavar="S", help="Longest that a case may take; it is killed then.")
    ] = 600.0
