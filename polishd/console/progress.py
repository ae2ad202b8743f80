"""What a person sees while a job runs: a line a measurement, and a bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from polishd.console.last_words import last_words
from polishd.show.tables import stderr

Show = Callable[[str, int | None, Mapping[str, Any]], None]
"""(event's name, its cycle, its data)."""


AFTER = {"pass_ended": "cycle {cycle}: measuring", "job_finished": "writing the report"}
"""What goes on after an event."""


@contextmanager
def progress(cell: Path) -> Iterator[Show]:
    """Show events on stderr for as long as the block lasts; stdout stays free for programs.

    ``cell`` is what commands are told with.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"), TimeElapsedColumn())
    with Progress(*columns, console=stderr) as bar:
        task = bar.add_task("starting", total=None, note="")
        yield lambda name, cycle, data: _show(bar, (task, cell), name, cycle, data)


def _show(bar: Progress, shown: tuple[TaskID, Path], name: str, cycle: int | None, data: Mapping[str, Any]) -> None:
    task, cell = shown
    match name:
        case "measured":
            band = data["band_rms_nm"]
            beyond = "" if band is None else f", {band:.2f} nm in the tolerance's band"
            stderr.print(f"measurement {cycle}: RMS {data['rms_nm']:.2f} nm, PV {data['pv_nm']:.1f} nm{beyond}")
            bar.update(task, description=f"cycle {cycle}: solving", total=None, note="")
        case "solved":
            note = f"predicted RMS {data['predicted_rms_nm']:.2f} nm, KKT {data['kkt_residual']:.1e}"
            bar.update(task, description=f"cycle {cycle}: planning", note=note)
        case "pass_begun":
            minutes = f"{data['dwell_s'] / 60:.1f} min of dwell"
            bar.update(task, description=f"cycle {cycle}: polishing", total=data["blocks"], completed=0, note=minutes)
        case "progress":
            bar.update(task, completed=data["block"])
        case "pass_ended" | "job_finished":
            bar.update(task, description=AFTER[name].format(cycle=cycle), total=None, note="")
        case "state" if data["state"] == "held":
            for word, text in [("held", data["reason"]), *last_words(data, cell)]:
                stderr.print(f"{word}: {text}", markup=False, soft_wrap=True)
            bar.update(task, description="held", total=None, note="")
        case "failed":
            stderr.print(f"{data['kind']}: {data['error']}", style="red", markup=False)
        case _:
            pass
    for note in data.get("notes", ()):
        stderr.print(f"note: {note}", markup=False)
