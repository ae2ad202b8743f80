"""Plugin ``run_report``: writes ``report.html`` and ``pictures/*.png`` into a complete run or plan folder.

The page opens offline. A run that ended early is reported too, with a list of what is missing. A separate process
draws: in a thread, matplotlib would delay the contact loop.
"""

from __future__ import annotations

from polishd.api import Event, PolishdError, hookimpl
from polishd.model import events
from polishd.model.errors import ComputeError
from polishd.util.worker_process import WorkerLimit, WorkerProcess

POLISHD_API = 1
TARGET = "polishd.reports.run_report:start_worker"
LIMIT = WorkerLimit(wall_s=3600.0, cpu_s=900.0)
"""Of one report: some 4 s of CPU time, and 1.5 s for each pass, on a machine with a third of a usual speed."""


@hookimpl
def polishd_on_event(event: Event) -> None:
    """Write the report, or the picture of a failed removal check, into the folder of the event."""
    match event:
        case events.RemovalCheckFailed():
            _draw(event.cycle_dir, "gate")
        case events.RunFolderCompleted() | events.PlanWritten():
            _draw(event.run_dir)
        case _:
            pass


def _draw(folder: str, what: str = "report") -> None:
    with WorkerProcess(TARGET, "the report worker") as worker:
        try:
            worker.request({"folder": folder, "draw": what}, limit=LIMIT)
        except ComputeError as error:
            raise PolishdError(f"no report in {folder}: {error}") from error
