"""``polishd run``: the daemons of one cell or several, watched, and how each of them ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType

from polishd.config.cell import CellConfig
from polishd.console.last_words import tell
from polishd.console.progress import Show, progress
from polishd.daemon.app import CellRun, run_cells
from polishd.daemon.last_word import for_cell
from polishd.hooks.cell import load_cell
from polishd.model.errors import ConfigError, PolishdError, SafetyStop
from polishd.model.events import Event
from polishd.show.tables import emit, key_table, outcome_tables
from polishd.show.terminal import say
from polishd.threads import run_loop

Ended = Mapping[str, Any] | Exception


def run_verb(
    cells: Sequence[Path],
    correction: str | None,
    *,
    holds: bool,
    as_json: bool,
    queue: bool = False,
    until_empty: bool = False,
    record: Path | None = None,
) -> int:
    """Run the daemons; the worst exit code. The last lines on stderr say how each cell stands and what to do."""
    try:
        if until_empty and not queue:
            raise ConfigError("--until-empty goes with --queue; add that, or leave both away")
        if queue and correction is not None:
            raise ConfigError(
                "--correction is for the cell's own job; a job of the queue says process.correction itself"
            )
        if record is not None and len(cells) > 1 and not record.is_dir():
            raise ConfigError(
                f"--record {record}: is no folder; several cells have a file each, in a folder that exists"
            )
        loaded = [load_cell(cell, correction) for cell in cells]
        names = _names(cells, [config for config, _ in loaded])
        with progress(names) as shows:
            runs = [
                CellRun(config, hooks, partial(_shown, show), queue, until_empty, record)
                for (config, hooks), show in zip(loaded, shows, strict=True)
            ]
            ended = run_loop(run_cells(runs, holds=holds))
    except PolishdError as error:
        return _opened_nothing(error, "", cells[0])
    named = list(zip(names, ended, strict=True))
    summaries = {name: found for (name, _), found in named if not isinstance(found, Exception)}
    codes = [_code(found) for found in ended]
    if summaries and len(cells) == 1:
        emit(summaries[""], as_json=as_json, table=lambda: _table(summaries[""]))
    elif summaries:
        whole = {"exit_code": worst_exit_code(codes), "cells": {name: _facts(found) for (name, _), found in named}}
        emit(whole, as_json=as_json, table=lambda: Group(*map(_table, summaries.values())))
    for (name, cell), found in named:
        _tell_end(found, cell, f"{name}: " if name else "")
    return worst_exit_code(codes)


def _table(summary: Mapping[str, Any]) -> RenderableType:
    """Of a job its measurements; of a queue how many jobs ended how."""
    if "jobs" not in summary:
        return outcome_tables(summary)
    return key_table(f"queue: {summary['outcome']}", summary["jobs"].items())


def worst_exit_code(codes: Sequence[int]) -> int:
    """A safety stop before everything else, then the highest."""
    return max(codes, key=lambda code: (code == SafetyStop.exit_code, code))


def _names(cells: Sequence[Path], configs: Sequence[CellConfig]) -> list[tuple[str, Path]]:
    """What each cell's lines begin with: nothing where there is one, else its name, or its file where two share that.

    ConfigError where two have one state folder.
    """
    if len(cells) == 1:
        return [("", cells[0])]
    for number, config in enumerate(configs):
        for other in configs[:number]:
            if config.state_dir.resolve() == other.state_dir.resolve():
                problem = f"is that of {other.path}, too; give each cell a state_dir of its own, and name each once"
                raise ConfigError(str(config.error("cell.state_dir", problem)))
    names = [config.cell.name for config in configs]
    return list(zip(names if len(set(names)) == len(names) else map(str, cells), cells, strict=True))


def _shown(show: Show, event: Event) -> None:
    show(event.name, event.cycle, event.data)


def _code(found: Ended) -> int:
    return getattr(found, "exit_code", 1) if isinstance(found, Exception) else int(found["exit_code"])


def _facts(found: Ended) -> Mapping[str, Any]:
    return {"error": str(found), "exit_code": _code(found)} if isinstance(found, Exception) else found


def _tell_end(found: Ended, cell: Path, prefix: str) -> None:
    if isinstance(found, PolishdError):
        _opened_nothing(found, prefix, cell)
    elif isinstance(found, Exception):
        if not prefix:
            raise found  # a fault of ours: with its traceback, which is in the log, too
        say(f"polishd: {prefix}{type(found).__name__}: {found} (more in its log)", err=True)
    else:
        for note in found["notes"]:
            say(f"polishd: {prefix}{note}", err=True)
        tell(found, cell, prefix)


def _opened_nothing(error: PolishdError, prefix: str, cell: Path) -> int:
    say(f"polishd: {prefix}{for_cell(str(error), cell)}\n{prefix}this run opened nothing, and moved nothing", err=True)
    return error.exit_code
