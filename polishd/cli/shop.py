"""``polishd shop``: common queue and history of several cells; commands and their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.cli.command_group import CommandGroup
from polishd.util.command_line import Cell, Json

app = typer.Typer(cls=CommandGroup, help="A shop of several cells: parts, recipes, queue and history in one database.")

Shop = Annotated[Path, Argument(metavar="SHOP.toml", help="The shop's configuration", show_default=False)]
JobId = Annotated[str, Argument(metavar="JOB", help="Job (its job.id)", show_default=False)]
By = Annotated[str, Option("--by", metavar="NAME", help="Your name, for the shop's journal")]
Why = Annotated[str, Option("--reason", metavar="TEXT", help="Reason, for the shop's journal")]
Token = Annotated[str | None, Option(metavar="NAME", help="Add a token, and show it once")]
Removed = Annotated[str | None, Option(metavar="NAME", help="Remove a token")]


@app.command("serve")
def shop_serve(
    *,
    shop: Shop,
    add_cell: Token = None,
    remove_cell: Removed = None,
    add_user: Token = None,
    role: Annotated[Literal["watch", "operate"], Option(help="Role of the new user (with --add-user)")] = "watch",
    remove_user: Removed = None,
) -> None:
    """Serve the shop to its cells until Ctrl-C. With an option: add or remove a token instead."""
    from polishd.cli.shop_commands import serve_verb

    serve_verb(shop, add_cell=add_cell, remove_cell=remove_cell, add_user=add_user, role=role, remove_user=remove_user)


@app.command("connect")
def link(cell: Cell) -> None:
    """Report a cell's events to the shop, and request parts, until Ctrl-C, in its own process."""
    from polishd.cli.shop_commands import link_verb

    link_verb(cell)


@app.command("add")
def add(
    *,
    shop: Shop,
    files: Annotated[list[Path], Argument(metavar="JOB.toml...", help="Jobs, in their order", show_default=False)],
    by: By = "",
    as_json: Json = False,
) -> None:
    """Add jobs with their files at the end of the shop's queue: all of them, or none."""
    from polishd.cli.shop_commands import add_verb

    add_verb(shop, files, by, as_json=as_json)


@app.command("list")
def shop_parts(shop: Shop, as_json: Json = False) -> None:
    """List the parts of a shop: waiting, in a cell, or ended; and decisions on them."""
    from polishd.cli.shop_commands import list_verb

    list_verb(shop, as_json=as_json)


@app.command("status")
def status(shop: Shop, as_json: Json = False) -> None:
    """Show the cells of a shop: state, and time since the last report."""
    from polishd.cli.shop_commands import status_verb

    status_verb(shop, as_json=as_json)


@app.command("history")
def history(shop: Shop, as_json: Json = False) -> None:
    """Show the history of the parts of all cells."""
    from polishd.cli.shop_commands import history_verb

    history_verb(shop, as_json=as_json)


@app.command("estimates")
def estimates(shop: Shop, as_json: Json = False) -> None:
    """Show the last estimates of each recipe and cell, which the shop offers to cells without estimates."""
    from polishd.cli.shop_commands import shop_estimates_verb

    shop_estimates_verb(shop, as_json=as_json)


@app.command("release")
def release(
    *,
    shop: Shop,
    job: JobId,
    by: By,
    reason: Why = "",
    cell_is_gone: Annotated[
        bool, Option("--cell-is-gone", help="Confirm that the cell does not run, and that the part is not in it")
    ] = False,
    as_json: Json = False,
) -> None:
    """Release a part for another cell. Its cell keeps it until it has returned it."""
    from polishd.cli.shop_commands import release_verb

    release_verb(shop, job, by, reason, cell_is_gone=cell_is_gone, as_json=as_json)


@app.command("remove")
def remove(*, shop: Shop, job: JobId, by: By, reason: Why = "", as_json: Json = False) -> None:
    """Remove a part from the shop that waits or was set aside."""
    from polishd.cli.shop_commands import remove_verb

    remove_verb(shop, job, by, reason, as_json=as_json)
