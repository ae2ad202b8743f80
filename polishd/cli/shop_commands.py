"""Commands of ``polishd shop``: with the database on the shop's computer, with the link on a cell's."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from polishd.cli.command_group import yield_to_daemon
from polishd.config.server_sections import load_shop
from polishd.plugin_loader import load_cell
from polishd.rendering.terminal import emit, figure_table, record_table, say, utc_minute
from polishd.shop import parts, server
from polishd.shop.database import Database, DatabaseTransaction
from polishd.shop.link import ShopLink
from polishd.shop.parts import digests, read_part
from polishd.shop.server import cells_of, serve, users_of
from polishd.util.command_line import terminal_user
from polishd.web.http.users import Role, UserFile


def serve_verb(
    path: Path,
    *,
    add_cell: str | None,
    remove_cell: str | None,
    add_user: str | None,
    role: str,
    remove_user: str | None,
) -> None:
    """Add or remove a token, or serve."""
    shop = load_shop(path)
    cells, users = cells_of(shop), users_of(shop)
    if add_cell is not None:
        _add_token(cells, add_cell, Role.WATCH, "is a cell of this shop")
    elif add_user is not None:
        _add_token(users, add_user, Role(role), f"has the role {role}")
    elif remove_cell is not None:
        cells.remove(remove_cell)
        say(f"cell {remove_cell} was removed; it keeps its parts", err=True)
    elif remove_user is not None:
        users.remove(remove_user)
        say(f"user {remove_user} was removed", err=True)
    else:
        if not cells:
            say("there are no cells; run: polishd shop serve SHOP.toml --add-cell NAME", err=True)
        serve(shop)


def link_verb(path: Path) -> None:
    """Run the link until Ctrl-C or SIGTERM."""
    config, hooks = load_cell(path)
    if config.shop is None:
        raise config.error("shop", "is missing; add [shop]: docs/how-to/shop.md")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    yield_to_daemon()
    ShopLink(config, hooks, config.shop).run(stop)


def add_verb(path: Path, files: Sequence[Path], by: str, *, as_json: bool) -> None:
    """Check the jobs as far as possible without a cell, and add them."""
    new = [read_part(file) for file in files]
    _in(path, lambda sql: parts.add(sql, new, by or terminal_user(), [digests(part) for part in new]))
    list_verb(path, as_json=as_json)


def list_verb(path: Path, *, as_json: bool) -> None:
    """Show the parts, and the last decisions on them."""
    found = _in(path, lambda sql: {**server.parts_view(sql), "words": server.decisions(sql)})
    columns = ("job", "part", "state", "cell", "added", "verdict", "why")
    rows = [
        (
            one["job"],
            one["part_id"],
            one["state"],
            one["cell"] or "",
            utc_minute(one["added"]),
            one["verdict"],
            _why(one),
        )
        for one in found["parts"]
    ]
    emit(found, as_json=as_json, table=lambda: record_table("parts of the shop", columns, rows))


def status_verb(path: Path, *, as_json: bool) -> None:
    """Show the cells, and the number of parts by state."""
    cells = cells_of(load_shop(path))
    found = _in(path, lambda sql: server.status_view(sql, cells))
    columns = ("cell", "last report, s", "state", "job", "why", "its parts", "passes")
    rows = [
        (one["cell"], _last_report(one), one.get("state", ""), one.get("job") or "", one.get("reason") or "",
         one["claims"], one["passes"])
        for one in found["cells"]
    ]  # fmt: skip
    title = "; ".join(f"{count} {state}" for state, count in found["parts"].items()) or "no parts"
    emit(found, as_json=as_json, table=lambda: record_table(title, columns, rows))


def history_verb(path: Path, *, as_json: bool) -> None:
    """Show the jobs of all cells."""
    found = _in(path, server.history)
    columns = ("job", "part", "cell", "began", "passes", "RMS nm", "outcome")
    rows = [
        (one["name"], one["part_id"], one["cell"], utc_minute(one["started"]), str(one["passes"]), _rms(one["rms_nm"]),
         one["outcome"].replace("_", " "))
        for one in found["jobs"]
    ]  # fmt: skip
    emit(found, as_json=as_json, table=lambda: figure_table(f"{len(rows)} jobs of the shop", columns, rows))


def shop_estimates_verb(path: Path, *, as_json: bool) -> None:
    """Show the last estimates of each recipe and cell."""
    found = _in(path, server.lessons)
    columns = ("recipe", "tool", "cell", "job", "pass", "at", "rate", "+-")
    rows = [
        (one["recipe"][:8], one["tool"] or "-", one["cell"], one["job"], str(one["of_cycle"] + 1),
         utc_minute(one["at_s"]), f"{one['rate']:.3f}", f"{one['sigma']:.3f}")
        for one in found["lessons"]
    ]  # fmt: skip
    emit(found, as_json=as_json, table=lambda: figure_table("estimates of the cells", columns, rows))


def release_verb(path: Path, job: str, by: str, why: str, *, cell_is_gone: bool, as_json: bool) -> None:
    """Release a part; the shop's journal records the user's name."""
    message = _in(path, lambda sql: parts.release(sql, job, by, why, gone=cell_is_gone))
    emit({"job": job, "said": message}, as_json=as_json, lines=[message])


def remove_verb(path: Path, job: str, by: str, why: str, *, as_json: bool) -> None:
    """Remove a part; the shop's journal records the user's name."""
    _in(path, lambda sql: parts.remove(sql, job, by, why))
    emit({"job": job, "removed": True}, as_json=as_json, lines=[f"job {job} was removed from the shop"])


def _in(path: Path, work: Callable[[DatabaseTransaction], Any]) -> Any:
    """Run one transaction; a server may run meanwhile."""
    with Database.open(load_shop(path).state_dir) as database, database.transaction() as sql:
        return work(sql)


def _add_token(users: UserFile, name: str, role: Role, what: str) -> None:
    token = users.add(name, role)
    say(f"{name} {what}; the token, which is not shown again:", err=True)
    say(token)


def _why(one: Mapping[str, Any]) -> str:
    is_back = one["back"] and one["state"] == "claimed"
    back = f"{one['back']} requested it back from {one['cell']}" if is_back else ""
    return "; ".join(filter(None, (one["reason"], back, one["not_for"])))


def _last_report(cell: Mapping[str, Any]) -> str:
    if cell["heard_s"] is None:
        return "never: does polishd shop connect CELL.toml run there?"
    return f"{cell['heard_s']:.0f}{' (away)' if cell['away'] else ''}"


def _rms(figures: Sequence[float]) -> str:
    return f"{figures[0]:.2f} -> {figures[-1]:.2f}" if len(figures) > 1 else "".join(f"{one:.2f}" for one in figures)
