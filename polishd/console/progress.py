"""What a person sees while jobs run: a line a measurement, and a bar for each cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from polishd.console.last_words import last_words
from polishd.model.tolerance import judged_of, worst
from polishd.show.tables import stderr

Show = Callable[[str, int | None, Mapping[str, Any]], None]
"""(event's name, its cycle, its data)."""


AFTER = {"pass_ended": "cycle {cycle}: measuring", "job_finished": "writing the report"}
"""What goes on after an event."""


@contextmanager
def progress(cells: Sequence[tuple[str, Path]]) -> Iterator[list[Show]]:
    """Show events of each cell on stderr for as long as the block lasts; stdout stays free for programs.

    ``cells`` are what each one's lines begin with (nothing, for one), and what commands are told with.
    """
    words = [TextColumn(text, markup=False) for text in ("{task.description}", "{task.fields[note]}")]
    columns = (words[0], BarColumn(), words[1], TimeElapsedColumn())
    with Progress(*columns, console=stderr) as bar:
        yield [_Line(bar, f"{name}: " if name else "", cell).show for name, cell in cells]


def _trouble(name: str, data: Mapping[str, Any]) -> str:
    if name == "map_refused":
        return f"waiting for another map: {data['file']} is refused: {data['reason']}. To do: {data['todo']}"
    who = data.get("kind") or data.get("notifier") or data["signal"]
    return f"{who}: {data.get('error') or data['what']}"


class _Line:
    """One cell's bar."""

    def __init__(self, bar: Progress, prefix: str, cell: Path) -> None:
        self._bar, self._prefix, self._cell = bar, prefix, cell
        self._task: TaskID = bar.add_task(f"{prefix}starting", total=None, note="")

    def show(self, name: str, cycle: int | None, data: Mapping[str, Any]) -> None:
        """An event."""
        match name:
            case "measured":
                self._measured(cycle, data)
                self._update(f"cycle {cycle}: solving", total=None, note="")
            case "solved":
                note = f"predicted RMS {data['predicted_rms_nm']:.2f} nm, KKT {data['kkt_residual']:.1e}"
                self._update(f"cycle {cycle}: planning", note=note)
            case "pass_begun":
                note = f"{data['dwell_s'] / 60:.1f} min of dwell"
                if expected := data.get("forecast"):
                    note += f", then {expected['low_nm']:.2f} to {expected['high_nm']:.2f} nm"
                self._update(f"cycle {cycle}: polishing", total=data["blocks"], completed=0, note=note)
            case "progress":
                self._bar.update(self._task, completed=data["block"])
            case "pass_ended" | "job_finished":
                self._update(AFTER[name].format(cycle=cycle), total=None, note="")
            case "state":
                self._state(data)
            case "failed" | "found" | "notification_failed" | "signal_wrong" | "map_refused":
                self._print(_trouble(name, data), style="red")
            case _:
                self._show_queue(name, data)
        for note in data.get("notes", ()):
            self._print(f"note: {note}")

    def _measured(self, cycle: int | None, data: Mapping[str, Any]) -> None:
        band = data["band_rms_nm"]
        beyond = "" if band is None else f", {band:.2f} nm in the tolerance's band"
        self._print(f"measurement {cycle}: RMS {data['rms_nm']:.2f} nm, PV {data['pv_nm']:.1f} nm{beyond}")
        judged = judged_of(data)
        if len(judged) > 1 or any(one.bound is not None for one in judged):
            held = sum(one.holds for one in judged)
            self._print(f"{held} of {len(judged)} lines of the tolerance hold; the worst: {worst(judged)}")

    def _state(self, data: Mapping[str, Any]) -> None:
        match data["state"]:
            case "held":
                for word, text in [("held", data["reason"]), *last_words(data, self._cell)]:
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
        """What happens between jobs."""
        match name:
            case "job_begun":
                self._print(f"job {data['job']}, part {data['part_id']}")
            case "job_ended":
                why = f": {data['reason']}" if data["verdict"] != "accepted" else ""
                self._print(f"job {data['job']} {data['verdict']}{why}")
            case _:
                pass

    def _update(self, what: str, **fields: Any) -> None:
        self._bar.update(self._task, description=f"{self._prefix}{what}", **fields)

    def _print(self, text: str, style: str | None = None) -> None:
        stderr.print(f"{self._prefix}{text}", style=style, markup=False, soft_wrap=True)
