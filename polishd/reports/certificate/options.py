"""Options of ``polishd certificate make``; the command line loads them without what draws and signs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option


@dataclass(frozen=True, slots=True)
class CertificateOptions:
    """Options of ``polishd certificate make``."""

    out: Annotated[
        Path | None,
        Option("--out", metavar="FILE.pdf", help="New PDF; the JSON goes beside it (default: in the run folder)"),
    ] = None
    job: Annotated[str | None, Option("--job", metavar="ID", help="Job of CELL.toml (default: the last)")] = None
    key: Annotated[
        Path | None, Option("--key", metavar="FILE", help="Key to sign with (default: the cell's certificate.key)")
    ] = None
    operator: Annotated[str, Option("--operator", metavar="NAME", help="Person responsible for the certificate")] = ""
    customer: Annotated[str, Option("--customer", metavar="NAME", help="Customer")] = ""
    drawing: Annotated[str, Option("--drawing", metavar="TEXT", help="Number and revision of the drawing")] = ""
    number: Annotated[
        str, Option("--number", metavar="TEXT", help="Certificate number (default: from job, day and journal)")
    ] = ""
    shop: Annotated[str, Option("--shop", metavar="NAME", help="Issuer (default: certificate.shop)")] = ""
    wavelength: Annotated[
        float, Option("--wavelength", metavar="NM", min=1.0, help="Wavelength of a wave of surface height")
    ] = 546.07
