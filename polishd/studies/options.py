"""Options of ``polishd study``, in a separate file so that the command line starts fast."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option


@dataclass(frozen=True, slots=True)
class StudyOptions:
    """Selection and output of a study."""

    out: Annotated[
        Path | None,
        Option(metavar="DIR", help="Folder for tables, pictures and finished cases; a later run continues there"),
    ] = None
    limit: Annotated[int | None, Option(min=1, metavar="N", help="Compute only the first N cases")] = None
    workers: Annotated[
        int | None, Option(min=1, metavar="K", help="Processes of this machine (default: one for each core)")
    ] = None
    scheduler: Annotated[
        str | None, Option(metavar="tcp://HOST:PORT", help="Compute on this Dask cluster instead (extra: dask)")
    ] = None
    case_s: Annotated[
        float, Option("--case-s", min=1.0, metavar="S", help="Time limit of a case; it is killed then")
    ] = 600.0
