"""Command groups of a cell: queue, estimates, service, recordings of its links, and certificates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.cli.calibrate import app as calibrations
from polishd.cli.command_group import CommandGroup
from polishd.commissioning.calibration.options import InstrumentOptions
from polishd.reports.certificate.options import CertificateOptions
from polishd.util.command_line import Cell, Json, spread_options

jobs = typer.Typer(cls=CommandGroup, help="The queue of a cell: jobs, one after another.")
estimates = typer.Typer(cls=CommandGroup, help="Estimates of removal rate and machine with which the next job starts.")
services = typer.Typer(cls=CommandGroup, help="Run a cell as a systemd service.")
recordings = typer.Typer(cls=CommandGroup, help="Recordings of a cell's links (run --record).")
certificates = typer.Typer(cls=CommandGroup, help="Certificates of parts: make, sign, verify.")

Reason = Annotated[str, Option("--reason", metavar="TEXT", help="Reason, for the journal and for status")]
JobId = Annotated[str, Argument(metavar="ID", help="Job (its job.id)", show_default=False)]
Served = Annotated[list[Path], Argument(metavar="CELL.toml...", help="Configuration of each cell", show_default=False)]
Queued = Annotated[bool, Option("--queue", help="Run the cells' queues, as polishd run --queue")]
Beside = Annotated[
    Literal["web", "opcua", "shop-connect", "shop-serve"] | None,
    Option(help="Unit of this server instead of the daemon; for shop-serve the file is SHOP.toml"),
]
Scope = Annotated[bool, Option("--system/--user", help="Use the systemd of the computer, or of the present user")]


def opcua(cell: Cell) -> None:
    """Serve a cell to OPC UA clients on this computer, as a machine of OPC 40001-1, until Ctrl-C. Read-only."""
    from polishd.cli.cell import opcua_verb

    opcua_verb(cell)


@jobs.command("add")
def queue_add(
    *,
    cell: Cell,
    files: Annotated[list[Path], Argument(metavar="JOB.toml...", help="Jobs, in their order", show_default=False)],
    as_json: Json = False,
) -> None:
    """Check jobs, as polishd check, and add them at the end of the queue: all of them, or none."""
    from polishd.cli.queue import add_verb

    add_verb(cell, files, as_json=as_json)


@jobs.command("list")
def queue_list(cell: Cell, as_json: Json = False) -> None:
    """List the queue: running, waiting and ended jobs."""
    from polishd.cli.queue import list_verb

    list_verb(cell, as_json=as_json)


@jobs.command("move")
def queue_move(
    *,
    cell: Cell,
    job: JobId,
    where: Annotated[Literal["before", "after", "first", "last"], Argument(help="New position", show_default=False)],
    other: Annotated[str, Argument(metavar="[OTHER]", help="The job before or after it", show_default=False)] = "",
    as_json: Json = False,
) -> None:
    """Move a waiting job: before ID, after ID, first, last."""
    from polishd.cli.queue import move_verb

    move_verb(cell, job, where, other, as_json=as_json)


@jobs.command("remove")
def queue_remove(*, cell: Cell, job: JobId, reason: Reason = "", as_json: Json = False) -> None:
    """Remove a waiting job, or set aside the job for which the cell is held."""
    from polishd.cli.queue import remove_verb

    remove_verb(cell, job, reason, as_json=as_json)


@estimates.command("show")
def estimates_show(cell: Cell, as_json: Json = False) -> None:
    """Show the estimates of removal rate and machine with which the next job starts. Needs no daemon."""
    from polishd.cli.history import estimates_verb

    estimates_verb(cell, as_json=as_json)


@estimates.command("forget")
def estimates_forget(cell: Cell, reason: Reason = "", as_json: Json = False) -> None:
    """Start the next job without earlier estimates; the journal keeps them."""
    from polishd.cli.history import forget_verb

    forget_verb(cell, reason, as_json=as_json)


@calibrations.command("instrument")
@spread_options
def calibrate_instrument(
    cell: Annotated[Path, Argument(metavar="CELL.toml", help="The instrument's cell")],
    maps: Annotated[
        list[Path] | None, Argument(metavar="[MAP...]", help="Maps of one part, rotated (default: take new maps)")
    ] = None,
    *,
    as_json: Json = False,
    options: InstrumentOptions,
) -> None:
    """Measure the instrument's error from maps of a rotated part, and write it into its profile.

    Without --angles: show the required rotations.
    """
    from polishd.commissioning.calibration.instrument import calibrate_verb

    calibrate_verb(cell, maps or [], options, as_json=as_json)


@services.command("install")
def service_install(files: Served, *, system: Scope, queue: Queued = False, of: Beside = None) -> None:
    """Write a systemd unit that runs these cells in one supervised process, and show how to start it."""
    from polishd.cli.service import install_verb

    install_verb(files, system=system, queue=queue, of=of)


@services.command("show")
def service_show(files: Served, *, system: Scope, queue: Queued = False, of: Beside = None) -> None:
    """Print the systemd unit; write nothing."""
    from polishd.cli.service import show_verb

    show_verb(files, system=system, queue=queue, of=of)


@recordings.command("show")
def recording_show(
    file: Annotated[Path, Argument(metavar="FILE", help="A recording", show_default=False)], as_json: Json = False
) -> None:
    """Show each link: messages and bytes in both directions, first and last time, longest silence; missing data."""
    from polishd.cli.events import show_verb

    show_verb(file, as_json=as_json)


@certificates.command("make")
@spread_options
def certificate_make(
    run: Annotated[
        Path, Argument(metavar="RUN|CELL.toml", help="A run folder, or a cell for its last job", show_default=False)
    ],
    *,
    as_json: Json = False,
    options: CertificateOptions,
) -> None:
    """Make the certificate of a part for the customer, as PDF and JSON, signed if the shop has a key."""
    from polishd.reports.certificate.issue import certificate_verb

    certificate_verb(run, options, as_json=as_json)


@certificates.command("verify")
def certificate_verify(
    file: Annotated[Path, Argument(metavar="FILE.pdf|FILE.json", help="A certificate", show_default=False)],
    *,
    key: Annotated[Path | None, Option("--key", metavar="PUBLIC", help="The shop's public key")] = None,
    as_json: Json = False,
) -> None:
    """Verify that a certificate, PDF and JSON, is unchanged and signed with that key; exit code 1 if not."""
    from polishd.reports.certificate.issue import verify_verb

    verify_verb(file, key, as_json=as_json)


@certificates.command("keygen")
def certificate_keygen(
    file: Annotated[
        Path, Argument(metavar="FILE", help="New private key; the public key is FILE.pub", show_default=False)
    ],
    as_json: Json = False,
) -> None:
    """Make the shop's key pair for certificates."""
    from polishd.reports.certificate.issue import key_verb

    key_verb(file, as_json=as_json)


@certificates.command("schema")
def certificate_schema() -> None:
    """Print the JSON Schema of a certificate."""
    from polishd.reports.certificate.issue import schema_verb

    schema_verb()
