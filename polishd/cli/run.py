"""``polishd run``: run the daemons of one or several cells, show their events and how each ended."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from polishd.cli.json_error import error_facts, print_json_error
from polishd.cli.status import end_rows, print_end
from polishd.config.cell import CellConfig
from polishd.daemon.app import CellRun, run_cells
from polishd.daemon.runtime.exit_record import for_cell
from polishd.model.errors import ConfigError, PolishdError, SafetyStop
from polishd.model.events import Event
from polishd.model.tolerance import line_results, worst_line
from polishd.plugin_loader import load_cell
from polishd.rendering.terminal import emit, key_table, outcome_tables, say, stderr
from polishd.util.threads import run_loop

# Output while jobs run: a line for each measurement, and a bar for each cell.

SHORT_COLLECTIONS = 700
"""New objects between two garbage collections of a daemon: few, so that none delays the contact loop."""
Show = Callable[[str, int | None, Mapping[str, Any]], None]
"""(event's name, its cycle, its data)."""


AFTER = {"pass_ended": "cycle {cycle}: measuring", "run_folder_completed": "writing the report"}
"""Activity after an event."""


@contextmanager
def progress(cells: Sequence[tuple[str, Path]]) -> Iterator[list[Show]]:
    """Show events of each cell on stderr while the block runs; stdout stays free for programs.

    ``cells`` are the prefix of each cell's lines (empty for one cell), and its path for commands in messages.
    """
    words = [TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}")]
    columns = (words[0], BarColumn(), words[1], TimeElapsedColumn())
    with Progress(*columns, console=stderr) as bar:
        yield [_Line(bar, f"{name}: " if name else "", cell).show for name, cell in cells]


def _trouble(name: str, data: Mapping[str, Any]) -> str:
    if name == "map_refused":
        return f"waiting for another map: {data['file']} was refused: {data['reason']}. To do: {data['todo']}"
    who = data.get("kind") or data.get("notifier") or data["signal"]
    return f"{who}: {data.get('error') or data['what']}"


class _Line:
    """One cell's bar."""

    def __init__(self, bar: Progress, prefix: str, cell: Path) -> None:
        self._bar, self._prefix, self._cell = bar, prefix, cell
        self._task: TaskID = bar.add_task(f"{prefix}starting", total=None, note="")

    def show(self, name: str, cycle: int | None, data: Mapping[str, Any]) -> None:
        """Show an event."""
        match name:
            case "map_measured":
                self._measured(cycle, data)
                self._update(f"cycle {cycle}: solving", total=None, note="")
            case "dwell_solved":
                note = f"predicted RMS {data['predicted_rms_nm']:.2f} nm, KKT {data['kkt_residual']:.1e}"
                self._update(f"cycle {cycle}: planning", note=note)
            case "pass_started":
                note = f"{data['dwell_s'] / 60:.1f} min of dwell"
                if expected := data.get("forecast"):
                    note += f", then {expected['low_nm']:.2f} to {expected['high_nm']:.2f} nm"
                self._update(f"cycle {cycle}: polishing", total=data["blocks"], completed=0, note=note)
            case "pass_progressed":
                self._bar.update(self._task, completed=data["block"])
            case "pass_ended" | "run_folder_completed":
                self._update(AFTER[name].format(cycle=cycle), total=None, note="")
            case "state_changed":
                self._state(data)
            case "daemon_failed" | "finding_reported" | "notification_failed" | "signal_out_of_range" | "map_refused":
                self._print(_trouble(name, data), style="red")
            case _:
                self._show_queue(name, data)
        for note in data.get("notes", ()):
            self._print(f"note: {note}")

    def _measured(self, cycle: int | None, data: Mapping[str, Any]) -> None:
        band = data["band_rms_nm"]
        beyond = "" if band is None else f", {band:.2f} nm in the tolerance's band"
        self._print(f"measurement {cycle}: RMS {data['rms_nm']:.2f} nm, PV {data['pv_nm']:.1f} nm{beyond}")
        judged = line_results(data)
        if len(judged) > 1 or not all(one.judged_as_measured for one in judged):
            held = sum(one.holds for one in judged)
            self._print(f"{held} of {len(judged)} lines of the tolerance hold; the worst: {worst_line(judged)}")

    def _state(self, data: Mapping[str, Any]) -> None:
        match data["state"]:
            case "held":
                for word, text in [("held", data["reason"]), *end_rows(data, self._cell)]:
                    self._print(f"{word}: {text}")
                self._update("held", total=None, note="")
            case "starting" if data["reason"]:
                self._print(f"starting: {data['reason']}")
            case "idle" | "changing" as state:
                if data["reason"]:
                    self._print(data["reason"])
                self._update({"idle": "next job", "changing": "changing the part"}[state], total=None, note="")
            case _:
                pass

    def _show_queue(self, name: str, data: Mapping[str, Any]) -> None:
        """Show an event between jobs."""
        match name:
            case "job_started":
                self._print(f"job {data['job']}, part {data['part_id']}")
            case "queue_job_ended":
                why = f": {data['reason']}" if data["verdict"] != "accepted" else ""
                self._print(f"job {data['job']} {data['verdict']}{why}")
            case _:
                pass

    def _update(self, what: str, **fields: Any) -> None:
        self._bar.update(self._task, description=f"{self._prefix}{what}", **fields)

    def _print(self, text: str, style: str | None = None) -> None:
        stderr.print(f"{self._prefix}{text}", style=style, markup=False, soft_wrap=True)


Ended = Mapping[str, Any] | Exception


def run_verb(
    cells: Sequence[Path],
    correction: str | None,
    *,
    holds: bool,
    as_json: bool,
    queue: bool = False,
    until_empty: bool = False,
    start_held: bool = False,
    record: Path | None = None,
) -> int:
    """Run the daemons, and return the worst exit code. The last lines on stderr show each cell's state and advice."""
    try:
        if until_empty and not queue:
            raise ConfigError("--until-empty needs --queue; add it, or remove both")
        if start_held and not holds:
            raise ConfigError("--start-held cannot be used with --no-hold; remove one of them")
        if queue and correction is not None:
            raise ConfigError("--correction cannot be used with --queue; set process.correction in the job's file")
        if record is not None and len(cells) > 1 and not record.is_dir():
            raise ConfigError(f"--record {record}: is not a folder; name an existing folder for several cells")
        loaded = [load_cell(cell, correction) for cell in cells]
        gc.set_threshold(SHORT_COLLECTIONS)
        names = _names(cells, [config for config, _ in loaded])
        with progress(names) as shows:
            runs = [
                CellRun(config, hooks, partial(_shown, show), queue, until_empty, start_held, record)
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
    elif len(cells) > 1 and (summaries or as_json):
        combined = {"exit_code": worst_exit_code(codes), "cells": {name: _facts(found) for (name, _), found in named}}
        emit(combined, as_json=as_json, table=lambda: Group(*map(_table, summaries.values())))
    for (name, cell), found in named:
        _print_cell_end(found, cell, f"{name}: " if name else "")
    return worst_exit_code(codes)


def _table(summary: Mapping[str, Any]) -> RenderableType:
    """Return the measurements of a job, or the number of jobs of a queue by outcome."""
    if "jobs" not in summary:
        return outcome_tables(summary)
    return key_table(f"queue: {summary['outcome']}", summary["jobs"].items())


def worst_exit_code(codes: Sequence[int]) -> int:
    """Return the code of a safety stop if there is one, else the highest code."""
    return max(codes, key=lambda code: (code == SafetyStop.exit_code, code))


def _names(cells: Sequence[Path], configs: Sequence[CellConfig]) -> list[tuple[str, Path]]:
    """Return the prefix of each cell's lines: empty for one cell, else its name, or its file if names repeat.

    Raise ConfigError if two cells have the same state folder.
    """
    if len(cells) == 1:
        return [("", cells[0])]
    for number, config in enumerate(configs):
        for other in configs[:number]:
            if config.state_dir.resolve() == other.state_dir.resolve():
                problem = f"is also that of {other.path}; give each cell another state_dir, and name each cell once"
                raise ConfigError(str(config.error("cell.state_dir", problem)))
    names = [config.cell.name for config in configs]
    return list(zip(names if len(set(names)) == len(names) else map(str, cells), cells, strict=True))


def _shown(show: Show, event: Event) -> None:
    show(event.name, event.cycle, event.data)


def _code(found: Ended) -> int:
    return getattr(found, "exit_code", 1) if isinstance(found, Exception) else int(found["exit_code"])


def _facts(found: Ended) -> Mapping[str, Any]:
    return error_facts(found, str(found), _code(found)) if isinstance(found, Exception) else found


def _print_cell_end(found: Ended, cell: Path, prefix: str) -> None:
    if isinstance(found, PolishdError):
        _opened_nothing(found, prefix, cell)
    elif isinstance(found, Exception):
        if not prefix:
            raise found  # a bug: show its traceback, which is also in the log
        say(f"polishd: {prefix}{type(found).__name__}: {found} (more in its log)", err=True)
    else:
        for note in found["notes"]:
            say(f"polishd: {prefix}{note}", err=True)
        print_end(found, cell, prefix)


def _opened_nothing(error: PolishdError, prefix: str, cell: Path) -> int:
    message = for_cell(str(error), cell)
    say(f"polishd: {prefix}{message}\n{prefix}This run opened nothing and moved nothing", err=True)
    print_json_error(error, message, error.exit_code)
    return error.exit_code
