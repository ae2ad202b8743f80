"""Verbs of a cell that come in groups: its queue, its service, recordings of its wires, and certificates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.cli.calibrate import app as calibrations
from polishd.commissioning.calibration.options import InstrumentOptions
from polishd.reports.certificate.issue import CertificateOptions
from polishd.util.command_line import Cell, CommandGroup, Json, spread_options

jobs = typer.Typer(help="The queue of a cell: parts, one after another.")
services = typer.Typer(help="Run a cell as a service of systemd.")
recordings = typer.Typer(help="Recordings of a cell's wires (run --record).")
reports = typer.Typer(cls=CommandGroup, help="Certificates of parts: made, signed, verified.")

Reason = Annotated[str, Option("--reason", metavar="TEXT", help="Why: for the journal, and for status.")]
JobId = Annotated[str, Argument(metavar="ID", help="Its job.id.", show_default=False)]
Served = Annotated[list[Path], Argument(metavar="CELL.toml...", help="Each cell's configuration.", show_default=False)]
Queued = Annotated[bool, Option("--queue", help="They work their queues, as with polishd run --queue.")]
Beside = Annotated[
    Literal["web", "opcua", "shop-connect", "shop-serve"] | None,
    Option(help="Not of the daemon, but of what runs beside it; of shop-serve the file is SHOP.toml."),
]
Scope = Annotated[bool, Option("--system/--user", help="The computer's systemd, or that of the present user.")]


def opcua(cell: Cell) -> None:
    """Serve a cell to OPC UA clients on this computer, as a machine of OPC 40001-1; ends with Ctrl-C. Reads only."""
    from polishd.cli.cell import opcua_verb

    opcua_verb(cell)


@jobs.command("add")
def queue_add(
    *,
    cell: Cell,
    files: Annotated[list[Path], Argument(metavar="JOB.toml...", help="Jobs, in their order.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Judge jobs as a whole, as check does, and put them at the end of the queue: all of them, or none."""
    from polishd.cli.queue import add_verb

    add_verb(cell, files, as_json=as_json)


@jobs.command("list")
def queue_list(cell: Cell, as_json: Json = False) -> None:
    """The queue: what is under way, what waits, and how each job ended."""
    from polishd.cli.queue import list_verb

    list_verb(cell, as_json=as_json)


@jobs.command("move")
def queue_move(
    *,
    cell: Cell,
    job: JobId,
    where: Annotated[Literal["before", "after", "first", "last"], Argument(show_default=False)],
    other: Annotated[str, Argument(metavar="[OTHER]", help="Before or after which job.", show_default=False)] = "",
    as_json: Json = False,
) -> None:
    """Move a job that waits: before ID, after ID, first, last."""
    from polishd.cli.queue import move_verb

    move_verb(cell, job, where, other, as_json=as_json)


@jobs.command("remove")
def queue_remove(*, cell: Cell, job: JobId, reason: Reason = "", as_json: Json = False) -> None:
    """Take a job out that waits; the one over which the cell is held is set aside."""
    from polishd.cli.queue import remove_verb

    remove_verb(cell, job, reason, as_json=as_json)


@calibrations.command("instrument")
@spread_options
def calibrate_instrument(
    cell: Annotated[Path, Argument(metavar="CELL.toml", help="The cell whose instrument it is.")],
    maps: Annotated[
        list[Path] | None, Argument(metavar="[MAP...]", help="One part, turned; none: taken as they come.")
    ] = None,
    *,
    as_json: Json = False,
    asked: InstrumentOptions,
) -> None:
    """Tell the instrument's own error by turning the part, into its profile; without --angles: which turns it takes."""
    from polishd.commissioning.calibration.instrument import calibrate_verb

    calibrate_verb(cell, maps or [], asked, as_json=as_json)


@services.command("install")
def service_install(files: Served, *, system: Scope, queue: Queued = False, of: Beside = None) -> None:
    """Write a unit that runs these cells in one process, supervised; says how to start it."""
    from polishd.cli.service import install_verb

    install_verb(files, system=system, queue=queue, of=of)


@services.command("show")
def service_show(files: Served, *, system: Scope, queue: Queued = False, of: Beside = None) -> None:
    """Print that unit; nothing is written."""
    from polishd.cli.service import show_verb

    show_verb(files, system=system, queue=queue, of=of)


@recordings.command("show")
def record_show(
    file: Annotated[Path, Argument(metavar="FILE", help="A recording.", show_default=False)], as_json: Json = False
) -> None:
    """Each link: messages and bytes either way, first and last, the longest silence; and what is missing."""
    from polishd.cli.events import show_verb

    show_verb(file, as_json=as_json)


@reports.command("certificate")
@spread_options
def report_certificate(
    run: Annotated[
        Path, Argument(metavar="RUN|CELL.toml", help="A run folder, or a cell: its last job.", show_default=False)
    ],
    *,
    as_json: Json = False,
    asked: CertificateOptions,
) -> None:
    """The certificate of a part, for the customer: a PDF and its twin in JSON, signed where the shop has a key."""
    from polishd.reports.certificate.issue import certificate_verb

    certificate_verb(run, asked, as_json=as_json)


@reports.command("verify")
def report_verify(
    file: Annotated[Path, Argument(metavar="FILE.pdf|FILE.json", help="A certificate.", show_default=False)],
    *,
    key: Annotated[Path | None, Option("--key", metavar="PUBLIC", help="The shop's public key.")] = None,
    as_json: Json = False,
) -> None:
    """Whether a certificate is as it was made, PDF and twin, and whether that key signed it; exit code 1: it is not."""
    from polishd.reports.certificate.issue import verify_verb

    verify_verb(file, key, as_json=as_json)


@reports.command("keygen")
def report_key(
    file: Annotated[
        Path, Argument(metavar="FILE", help="The new private key; FILE.pub beside it.", show_default=False)
    ],
    as_json: Json = False,
) -> None:
    """Make the shop's key pair for certificates."""
    from polishd.reports.certificate.issue import key_verb

    key_verb(file, as_json=as_json)


@reports.command("schema")
def report_schema() -> None:
    """Print the JSON Schema of a certificate's twin."""
    from polishd.reports.certificate.issue import schema_verb

    schema_verb()
