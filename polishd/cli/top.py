"""``polishd top``: live values of each cell in the terminal, with their ages and lost daemons."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from polishd.config.cell import CellConfig, load_config
from polishd.daemon.runtime.exit_record import for_cell, last_ending
from polishd.daemon.socket import client
from polishd.model.errors import NoDaemon, PolishdError
from polishd.model.states import CellSafety
from polishd.model.tolerance import line_results, worst_line
from polishd.rendering.terminal import stdout
from polishd.web.watcher import OLD_S

POLL_S = 0.5
"""Period of polls."""
REPLY_TIMEOUT_S = 1.0
"""Time limit of an answer."""
CYCLES_S = 5.0
"""Period of polls of the measurements, which change once in a pass."""


@dataclass(slots=True)
class CellView:
    """One cell and its last answers."""

    config: CellConfig
    path: Path
    live: Mapping[str, Any] = field(default_factory=dict)
    """The last answer to ``live``; empty before the first."""
    last_reply_s: float | None = None
    """Monotonic time of the last answer."""
    cycles: Sequence[Mapping[str, Any]] = ()
    cycles_read_s: float = float("-inf")
    trouble: str = ""
    """Reason why there is no answer now."""

    def look(self) -> None:
        """Poll its daemon."""
        try:
            self.live = client.request(self.config.state_dir, "live", REPLY_TIMEOUT_S)
            self.last_reply_s, self.trouble = time.monotonic(), ""
            if self.last_reply_s - self.cycles_read_s > CYCLES_S:
                self.cycles = client.request(self.config.state_dir, "status", REPLY_TIMEOUT_S).get("cycles", [])
                self.cycles_read_s = self.last_reply_s
        except NoDaemon:
            self.trouble = "NO DAEMON RUNS"
        except PolishdError as error:
            self.trouble = f"THE DAEMON DOES NOT ANSWER: {error}"


def top_verb(cells: Sequence[Path], *, once: bool) -> None:
    """Show the cells until Ctrl-C; once if stdout is not a terminal."""
    seen = [CellView(load_config(cell), cell) for cell in cells]
    if once or not stdout.is_terminal:
        for one in seen:
            one.look()
        stdout.print(picture(seen, time.monotonic()))
        return
    pause = threading.Event()  # never set
    with suppress(KeyboardInterrupt), Live(console=stdout, screen=True, auto_refresh=False) as screen:
        while True:
            for one in seen:
                one.look()
            screen.update(picture(seen, time.monotonic()), refresh=True)
            pause.wait(POLL_S)


def picture(seen: Sequence[CellView], now_s: float) -> RenderableType:
    """Return one panel for each cell."""
    return Group(*(_panel(one, now_s) for one in seen))


def _panel(one: CellView, now_s: float) -> Panel:
    live, name = one.live, one.config.cell.name
    if one.trouble and not live:
        last = last_ending(one.config.state_dir)
        ended: list[Row] = [(what, for_cell(text, one.path)) for what, text in CellSafety.of(last).rows() if text]
        return Panel(_table(ended), title=Text(f"{name}: {one.trouble}"), border_style="red")
    passed_s = 0.0 if one.last_reply_s is None else now_s - one.last_reply_s
    rows = list(_rows(one, passed_s))
    phase = f", {live['phase']}" if live.get("phase") else ""
    title, style = f"{name}: {live.get('state')}{phase}", "yellow" if live.get("state") == "held" else "green"
    if one.trouble:
        title, style = f"{name}: {one.trouble}; these values are {passed_s:.0f} s old", "red"
    return Panel(_table(rows, old=bool(one.trouble)), title=Text(title), border_style=style)


def _table(rows: Sequence[Row], *, old: bool = False) -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(name, value, style="dim" if old else "")
    return table


Row = tuple[str, RenderableType]
READINGS: Sequence[tuple[str, str, str]] = (
    ("force", "force", "{force_n:.2f} N of {setpoint_n:.1f}"),
    ("sensed", "force sensor", "{force_n:.2f} N"),
    ("speed", "speed", "{rpm:.0f} rpm"),
    ("robot", "robot", "{state}, block {executed}, {buffer_s:.1f} s buffered"),
)
"""Readings of the devices: name in the answer, shown name, and format."""
TEXTS = ("leaving", "reason", "next")
"""Texts of the answer that are shown."""


def _rows(one: CellView, passed_s: float) -> Iterator[Row]:
    live = one.live
    cycle = "" if live.get("cycle") is None else f", cycle {live['cycle']}"
    yield "part", Text(f"{live.get('part')}, job {live.get('job')}{cycle}")
    yield from ((name, Text(for_cell(str(live[name]), one.path))) for name in TEXTS if live.get(name))
    if one.cycles:
        yield "figure", Text(_figure(one.cycles))
        if (left := _time_left(one.cycles[-1])) is not None:
            yield "pass", left
    yield "tool", Text("ON THE PART" if live.get("pressing") else "off the part")
    yield from _readings(live, passed_s)
    yield from _troubles(live)


def _readings(live: Mapping[str, Any], passed_s: float) -> Iterator[Row]:
    readings = live.get("readings", {})
    for key, name, shown in READINGS:
        if (reading := readings.get(key)) is not None:
            yield name, _aged(shown.format(**reading), reading["age_s"] + passed_s)
    for device, age_s in live.get("ages_s", {}).items():
        if age_s is not None:
            yield f"answer {device}", _aged("", age_s + passed_s)
    for name, facts in live.get("signals", {}).items():
        yield name, Text(f"{facts['text']}{': ' * bool(facts['wrong'])}{facts['wrong']}", "red" * bool(facts["wrong"]))


def _troubles(live: Mapping[str, Any]) -> Iterator[Row]:
    for facts in live.get("health", {}).values():
        if not facts["fits"]:
            yield facts["name"], Text(f"{facts['value']:.4g}: {facts['advice']}", "red")
    for unsafe in live.get("unsafe", ()):
        yield "NOT SAFE", Text(str(unsafe), "bold red")


def _aged(text: str, age_s: float) -> Text:
    """Return a reading with its age, dim if it is old."""
    return Text(f"{text}  ({age_s:.1f} s ago)".strip(), "dim italic" if age_s > OLD_S else "")


def _figure(cycles: Sequence[Mapping[str, Any]]) -> str:
    """Return the RMS of the last measurements, and the prediction for the present pass."""
    last, farthest = cycles[-1], worst_line(line_results(cycles[-1]))
    words = "RMS " + " > ".join(f"{cycle['rms_nm']:.2f}" for cycle in cycles[-5:]) + " nm"
    if last.get("predicted_rms_nm") is not None:
        words += f", then {last['predicted_rms_nm']:.2f} predicted"
    return (
        words
        if farthest is None
        else f"{words}; {'in tolerance' if farthest.holds else 'not in tolerance'}: {farthest}"
    )


def _time_left(cycle: Mapping[str, Any]) -> RenderableType | None:
    """Return the progress of the present pass by time in contact."""
    if cycle.get("how") != "begun" or not cycle.get("dwell_s"):
        return None
    done_s, all_s = min(cycle.get("executed_s") or 0.0, cycle["dwell_s"]), cycle["dwell_s"]
    row = Table.grid(padding=(0, 1))
    row.add_row(ProgressBar(all_s, done_s, width=30), f"{(all_s - done_s) / 60:.1f} of {all_s / 60:.1f} min left")
    return row
