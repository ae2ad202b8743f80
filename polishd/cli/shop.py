"""``polishd shop``: one office for several cells; its verbs and their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from polishd.util.command_line import Cell, CommandGroup, Json

app = typer.Typer(cls=CommandGroup, help="A shop of several cells: parts, recipes, queue and history in one database.")

Shop = Annotated[Path, Argument(metavar="SHOP.toml", help="The shop's configuration.", show_default=False)]
JobId = Annotated[str, Argument(metavar="JOB", help="Its job.id.", show_default=False)]
By = Annotated[str, Option("--by", metavar="NAME", help="Who wants it: for the shop's own journal.")]
Why = Annotated[str, Option("--reason", metavar="TEXT", help="Why: for whoever reads the shop's journal.")]
Token = Annotated[str | None, Option(metavar="NAME", help="Make a token, and show it once.")]
Removed = Annotated[str | None, Option(metavar="NAME", help="Their token is worth nothing any more.")]


@app.command("serve")
def shop_serve(
    *,
    shop: Shop,
    add_cell: Token = None,
    remove_cell: Removed = None,
    add_user: Token = None,
    role: Annotated[Literal["watch", "operate"], Option(help="With --add-user: what they may.")] = "watch",
    remove_user: Removed = None,
) -> None:
    """Serve the shop to its cells; ends with Ctrl-C. With an option: make or end somebody's token instead."""
    from polishd.cli.shop_commands import serve_verb

    serve_verb(shop, add_cell=add_cell, remove_cell=remove_cell, add_user=add_user, role=role, remove_user=remove_user)


@app.command("connect")
def link(cell: Cell) -> None:
    """Tell the shop what happens in a cell, and ask it for parts; beside the daemon, ends with Ctrl-C."""
    from polishd.cli.shop_commands import link_verb

    link_verb(cell)


@app.command("add")
def add(
    *,
    shop: Shop,
    files: Annotated[list[Path], Argument(metavar="JOB.toml...", help="Jobs, in their order.", show_default=False)],
    by: By = "",
    as_json: Json = False,
) -> None:
    """Put jobs at the end of the shop's queue, with the files that they name: all of them, or none."""
    from polishd.cli.shop_commands import add_verb

    add_verb(shop, files, by, as_json=as_json)


@app.command("list")
def shop_parts(shop: Shop, as_json: Json = False) -> None:
    """The parts of a shop: what waits, which cell has what, and how each ended; and what was decided over them."""
    from polishd.cli.shop_commands import list_verb

    list_verb(shop, as_json=as_json)


@app.command("status")
def status(shop: Shop, as_json: Json = False) -> None:
    """The cells of a shop: what each does, and since when it has said nothing."""
    from polishd.cli.shop_commands import status_verb

    status_verb(shop, as_json=as_json)


@app.command("history")
def history(shop: Shop, as_json: Json = False) -> None:
    """What became of the parts of all cells."""
    from polishd.cli.shop_commands import history_verb

    history_verb(shop, as_json=as_json)


@app.command("estimates")
def lessons(shop: Shop, as_json: Json = False) -> None:
    """What each cell has learned last of each recipe, and is offered to those that have no lesson of it."""
    from polishd.cli.shop_commands import lessons_verb

    lessons_verb(shop, as_json=as_json)


@app.command("release")
def release(
    *,
    shop: Shop,
    job: JobId,
    by: By,
    reason: Why = "",
    cell_is_gone: Annotated[
        bool, Option("--cell-is-gone", help="Its cell does not run, and its part is not in there: I have looked.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Let another cell have a part: its cell is asked to give it back, and keeps it until it has."""
    from polishd.cli.shop_commands import release_verb

    release_verb(shop, job, by, reason, gone=cell_is_gone, as_json=as_json)


@app.command("remove")
def remove(*, shop: Shop, job: JobId, by: By, reason: Why = "", as_json: Json = False) -> None:
    """Take a part out of the shop that waits, or that was set aside."""
    from polishd.cli.shop_commands import remove_verb

    remove_verb(shop, job, by, reason, as_json=as_json)
