"""``polishd status``, and commands to the running daemon.

They need only the cell's name and state folder, and work even if the file was damaged while the daemon runs. For a
short start they import neither numpy nor config models.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from polishd.cli.json_error import error_facts, refusal_of
from polishd.daemon.runtime.exit_record import EndCause, for_cell, last_ending
from polishd.daemon.socket import client
from polishd.model.errors import ConfigError, NoDaemon
from polishd.model.states import CellSafety
from polishd.model.tolerance import line_results, worst_line
from polishd.rendering.terminal import emit, key_table, say
from polishd.util.command_line import terminal_user
from polishd.util.files import named_path, toml_text


@dataclass(frozen=True, slots=True)
class CellSummary:
    """Name and state folder of a cell."""

    name: str
    """As ``cell.name``."""
    state_dir: Path
    """As ``CellConfig.state_dir``, absolute."""


def cell_summary(path: Path) -> CellSummary:
    """Read the summary from a cell's file; raise the ConfigError of ``load_config`` if that fails."""
    try:
        name, state_dir = (_cell_value(path, key) for key in ("name", "state_dir"))
    except (ConfigError, ValueError, LookupError):
        from polishd.config.cell import load_config  # its error names the fault and its line

        config = load_config(path)
        return CellSummary(config.cell.name, config.state_dir)
    return CellSummary(name, named_path(path.absolute().parent, state_dir))


def _cell_value(path: Path, key: str) -> str:
    """Return the value of that key of ``[cell]``: that of the last fragment which has it, or of the file."""
    raw = _read(path)
    fragments = [_read(named_path(path.parent, name)) for name in _included_files(raw)]
    values = [part["cell"][key] for part in (raw, *fragments) if key in part.get("cell", {})]
    if not values or not isinstance(values[-1], str) or not values[-1]:
        raise LookupError(key)
    return values[-1]


def _read(path: Path) -> Mapping[str, Any]:
    found = tomllib.loads(toml_text(path))
    if not isinstance(found.get("cell", {}), dict):
        raise LookupError("cell")
    return found


def _included_files(raw: Mapping[str, Any]) -> list[str]:
    names = raw.get("include", [])
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise LookupError("include")
    return names


# The last lines of ``polishd run``, for the operator: is the cell safe, which device did not confirm, what to do next.


def end_rows(facts: Mapping[str, Any], cell: Path) -> list[tuple[str, str]]:
    """Return names and texts of a summary, a state event or a status; commands in them name that cell."""
    safety = CellSafety.of(facts)
    rows = [*safety.rows(), ("run folder", facts.get("run_dir", "")), ("next", safety.next)]
    return [(name, for_cell(text, cell)) for name, text in rows if text]


def print_end(facts: Mapping[str, Any], cell: Path, prefix: str = "") -> None:
    """Print ``end_rows`` on stderr; stdout stays free for programs."""
    for name, text in end_rows(facts, cell):
        say(f"{prefix}{name}: {text}", err=True)


def status_verb(cell: Path, *, as_json: bool) -> None:
    """Show the running daemon's status; if none runs, the exit record of the last one."""
    place = cell_summary(cell)
    try:
        answer = client.request(place.state_dir, "status")
    except NoDaemon as absent:
        last = {**error_facts(absent, str(absent), absent.exit_code), **last_ending(place.state_dir)}
        if as_json:
            say(json.dumps(last))
        else:
            _print_last(last, place.name, cell)
        raise typer.Exit(absent.exit_code) from None
    words = {
        key: value
        for key, value in answer.items()
        if key not in {"ok", "cycles", "devices", "signals", "health", "map_refused"}
    }
    rows = [(key, for_cell(str(value), cell)) for key, value in words.items() if value]
    rows += [("map refused", _refused(answer["map_refused"]))] if answer.get("map_refused") else []
    rows += [(name, _device(facts)) for name, facts in answer.get("devices", {}).items()]
    rows += [(f"measurement {i}", _measured(cycle)) for i, cycle in enumerate(answer.get("cycles", []))]
    rows += [
        (name, f"{facts['text']}{': ' * bool(facts['wrong'])}{facts['wrong']}")
        for name, facts in answer.get("signals", {}).items()
    ]
    rows += [(name, _figure(facts)) for name, facts in answer.get("health", {}).items()]
    emit(answer, as_json=as_json, table=lambda: key_table(place.name, rows))


def _refused(facts: Mapping[str, Any]) -> str:
    copy = f"; the file is in {facts['kept']}" if facts["kept"] else ""
    return f"{facts['file']}: {facts['kind']}: {facts['reason']}{copy}. To do: {facts['todo']}"


def _measured(cycle: Mapping[str, Any]) -> str:
    farthest = worst_line(line_results(cycle))
    judged = f"; {'in tolerance' if farthest.holds else 'not in tolerance'}: {farthest}" if farthest else ""
    return f"RMS {cycle['rms_nm']:.2f} nm{judged}"


def _figure(facts: Mapping[str, Any]) -> str:
    bound = "least" if facts["least"] else "most"
    return f"{facts['value']:.4g} (at {bound} {facts['limit']:.4g}{'' if facts['fits'] else ': ' + facts['advice']})"


def _device(facts: Mapping[str, Any]) -> str:
    who = " ".join(facts[key] for key in ("vendor", "model", "serial") if facts.get(key))
    last_reply_s = facts.get("heard_s_ago")
    age = "" if last_reply_s is None else f", answered {last_reply_s:.1f} s ago"
    return who + age + ("" if facts["used"] else " (not used by this job)")


def _print_last(last: Mapping[str, Any], name: str, cell: Path) -> None:
    """Print plain lines, as at the end of ``run``: a table would break commands and paths."""
    rows = [(key, last[key]) for key in ("state", "at", "reason") if last.get(key)]
    rows += [("cause", str(EndCause(**cause))) for cause in last.get("causes", [])]
    for key, text in [(name, "no daemon is running"), *rows, *end_rows(last, cell)]:
        say(f"{key}: {text}")


def order_verb(cell: Path, verb: str, reason: str, *, as_json: bool) -> None:
    """Send a command to the running daemon; return when it is done, and exit with the error if it is refused."""
    place = cell_summary(cell)
    args = {"reason": reason} if reason else {}
    _print_answer(
        place, verb, client.request(place.state_dir, verb, args={**args, "by": terminal_user()}), cell, as_json
    )


def approve_verb(cell: Path, *, as_json: bool) -> None:
    """Approve the plan that waits now."""
    place = cell_summary(cell)
    waits = {"program_sha256": client.request(place.state_dir, "live").get("approval", "")}
    _print_answer(
        place,
        "approve",
        client.request(place.state_dir, "approve", args={**waits, "by": terminal_user()}),
        cell,
        as_json,
    )


def _print_answer(place: CellSummary, verb: str, answer: Mapping[str, Any], cell: Path, as_json: bool) -> None:
    if not answer["ok"]:
        raise refusal_of(answer)
    rows = [(key, for_cell(str(value), cell)) for key, value in answer.items() if value]
    emit(answer, as_json=as_json, table=lambda: key_table(f"{place.name}: {verb}", rows))
