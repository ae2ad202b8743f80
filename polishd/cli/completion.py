"""Completion of arguments in the shell: cells, jobs, dialects and devices, by the metavar of the argument."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from typer.core import CompletionItem  # type: ignore[attr-defined]  # of click, or of a copy in typer

from polishd.model.errors import PolishdError
from polishd.util.files import named_path

MOST_BYTES = 1_000_000
"""Larger TOML files are offered without a look into them."""


def complete(param: Any, ctx: Any, incomplete: str) -> list[Any]:
    """Return the completions of an argument or of an option's value; those of typer where the metavar has none here.

    It never fails: a shell would show a traceback in the middle of a command line.
    """
    found = VALUES.get(param.metavar or "") or VALUES.get(f"--{param.name}")
    if found is None:
        return list(type(param).shell_complete(param, ctx, incomplete))
    given = [str(one) for one in ctx.params.get(param.name) or ()] if param.nargs == -1 else []
    with suppress(PolishdError, OSError, ValueError):
        # A list after commas is completed at its last item.
        before, comma, last = incomplete.rpartition(",") if param.metavar == "NAME,..." else ("", "", incomplete)
        return [CompletionItem(f"{before}{comma}{one}") for one in found(ctx, last) if one not in given]
    return []


def toml_files(of: Callable[[Mapping[str, Any]], bool], incomplete: str) -> Iterator[str]:
    """Yield TOML files of a kind, and folders, that begin with this text; of a single folder what it contains."""
    head, slash, start = incomplete.rpartition("/")
    folder = named_path(Path(), f"{head}{slash}")
    names = sorted(one for one in folder.iterdir() if one.name.startswith(start))
    shown = [one for one in names if start.startswith(".") or not one.name.startswith(".")]
    folders = [f"{head}{slash}{one.name}/" for one in shown if one.is_dir()]
    files = [f"{head}{slash}{one.name}" for one in shown if one.suffix == ".toml" and _is_of(of, one)]
    if folders and not files and len(folders) == 1:
        yield from toml_files(of, folders[0])
        return
    yield from [*files, *folders]


def _is_of(of: Callable[[Mapping[str, Any]], bool], path: Path) -> bool:
    if not path.is_file() or path.stat().st_size > MOST_BYTES:
        return path.is_file()
    with suppress(OSError, ValueError):
        return of(tomllib.loads(path.read_text(encoding="utf-8")))
    return False


def _cells(_ctx: Any, incomplete: str) -> Iterable[str]:
    return toml_files(lambda content: "name" in content.get("cell", {}) or "include" in content, incomplete)


def _tables(*names: str) -> Callable[[Any, str], Iterable[str]]:
    """Return the completion of TOML files that are no cells and have one of these tables or keys."""
    return lambda _ctx, incomplete: toml_files(
        lambda content: not isinstance(content.get("cell"), dict) and any(name in content for name in names),
        incomplete,
    )


def _jobs(ctx: Any, incomplete: str) -> Iterator[str]:
    """Yield the jobs of the queue and of the journal of the cell before it in the command line."""
    from polishd.cli.status import cell_summary
    from polishd.daemon.journal.history import read_only

    with read_only(cell_summary(_cell_of(ctx)).state_dir) as journal:
        ended = "" if ctx.info_name == "make" else " WHERE ended IS NULL"
        names = [name for (name,) in journal.execute(f"SELECT name FROM queue{ended} ORDER BY id")]  # noqa: S608 - constant
        if ctx.info_name == "make":
            names += [name for (name,) in journal.execute("SELECT name FROM job ORDER BY id DESC")]
    yield from (one for one in dict.fromkeys(names) if one.startswith(incomplete))


def _shop_jobs(ctx: Any, incomplete: str) -> Iterator[str]:
    from polishd.config.server_sections import load_shop
    from polishd.shop.database import DATABASE_NAME, open_database

    path = load_shop(Path(ctx.params["shop"])).state_dir / DATABASE_NAME
    if path.exists():
        connection = open_database(path)
        try:
            names = [name for (name,) in connection.execute("SELECT job FROM part ORDER BY id")]
        finally:
            connection.close()
        yield from (name for name in names if name.startswith(incomplete))


def _devices(ctx: Any, incomplete: str) -> Iterator[str]:
    """Yield the devices of the cell before it in the command line."""
    from polishd.config.cell import load_config

    yield from (name for name in load_config(_cell_of(ctx)).devices if name.startswith(incomplete))


def _cell_of(ctx: Any) -> Path:
    """Return the cell of the command line; ValueError without one."""
    # Behind an option without its value the arguments are not assigned yet.
    given = [ctx.params.get("cell"), ctx.params.get("run"), *ctx.args]
    cell = next((one for one in given if one is not None), None)
    if cell is None:
        raise ValueError("no cell before the argument")
    return Path(cell)


def _dialects(_ctx: Any, incomplete: str) -> Iterator[str]:
    from polishd.plugins.rnc_robot.dialect import DIALECTS

    yield from (name for name in DIALECTS if name.startswith(incomplete))
    yield from _tables("extends")(_ctx, incomplete)


def _profiles(_ctx: Any, incomplete: str) -> Iterator[str]:
    from polishd.config.device_profile_checks import shipped

    yield from (name for name in shipped() if name.startswith(incomplete))
    yield from _tables("actuator", "spindle", "force_sensor")(_ctx, incomplete)


def _addresses(_ctx: Any, incomplete: str) -> Iterator[str]:
    """Yield the serial ports of this computer; nothing is opened."""
    from serial.tools.list_ports import comports

    yield from (name for port in comports() if (name := f"serial:{port.device}").startswith(incomplete))


VALUES: Mapping[str, Callable[[Any, str], Iterable[str]]] = {
    "CELL.toml": _cells,
    "CELL.toml...": _cells,
    "[CELL.toml]": _cells,
    "RUN|CELL.toml": _cells,
    "JOB.toml...": _tables("job"),
    "SHOP.toml": _tables("shop"),
    "STUDY.toml": _tables("kind"),
    "SIM.toml": _tables("plant"),
    "ID": _jobs,
    "[OTHER]": _jobs,
    "JOB": _shop_jobs,
    "NAME|D.toml": _dialects,
    "NAME|FILE.toml": _profiles,
    "ADDRESS": _addresses,
    "--only": _devices,
    "--simulate": _devices,
}
"""Completions by metavar, or by option where its metavar is a common word."""
