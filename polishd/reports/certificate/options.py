"""What ``polishd report certificate`` takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option


@dataclass(frozen=True, slots=True)
class CertificateOptions:
    """What is said of a certificate beside its run."""

    out: Annotated[Path, Option("--out", metavar="FILE.pdf", help="The PDF; its twin is FILE.json beside it.")]
    job: Annotated[str | None, Option("--job", metavar="ID", help="With CELL.toml: its job; default: the last.")] = None
    key: Annotated[
        Path | None, Option("--key", metavar="FILE", help="Sign with this key; default: the cell's certificate.key.")
    ] = None
    operator: Annotated[str, Option("--operator", metavar="NAME", help="Who answers for it.")] = ""
    customer: Annotated[str, Option("--customer", metavar="NAME", help="For whom it is.")] = ""
    drawing: Annotated[str, Option("--drawing", metavar="TEXT", help="Number and revision of the drawing.")] = ""
    number: Annotated[str, Option("--number", metavar="TEXT", help="Its number; default: of job, day and journal.")] = (
        ""
    )
    shop: Annotated[str, Option("--shop", metavar="NAME", help="Who issues it; default: certificate.shop.")] = ""
    wavelength: Annotated[
        float, Option("--wavelength", metavar="NM", min=1.0, help="Of waves, nm of surface height.")
    ] = 546.07
