"""What a person sees while a job runs: a line a measurement, and a bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from polishd.console.tables import stderr

Show = Callable[[str, int | None, Mapping[str, Any]], None]
"""(event's name, its cycle, its data)."""


@contextmanager
def progress() -> Iterator[Show]:
    """Show events on stderr for as long as the block lasts; stdout stays free for programs."""
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"), TimeElapsedColumn())
    with Progress(*columns, console=stderr) as bar:
        task = bar.add_task("starting", total=None, note="")
        yield lambda name, cycle, data: _show(bar, task, name, cycle, data)


def _show(bar: Progress, task: TaskID, name: str, cycle: int | None, data: Mapping[str, Any]) -> None:
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
        case "pass_ended":
            bar.update(task, description=f"cycle {cycle}: measuring", total=None, note="")
        case "state" if data["state"] == "held":
            stderr.print(f"held: {data['reason']}", markup=False)
            bar.update(task, description="held", total=None, note="")
        case "failed":
            stderr.print(f"{data['kind']}: {data['error']}", style="red", markup=False)
        case "job_finished":
            bar.update(task, description="writing the report", total=None, note="")
        case _:
            pass
