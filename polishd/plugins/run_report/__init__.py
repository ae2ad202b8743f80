"""Plugin ``run_report``: writes ``report.html`` and ``pictures/*.png`` into a run or plan folder when it is complete.

The page is self-contained: it opens offline and refers to nothing on a network. A run that ended early is reported
too, and the page says what is missing. matplotlib is imported when the first report is written, not at start.
"""

from __future__ import annotations

from pathlib import Path

from polishd.api import Event, hookimpl

POLISHD_API = 1

REPORTED = frozenset({"job_finished", "plan_written"})
"""Events that end with a report; their data names the folder as ``run_dir``."""
STOPPED = "gate_stopped"
"""The gate's: its data names the cycle's folder as ``cycle_dir``."""


@hookimpl
def polishd_on_event(event: Event) -> None:
    """Write the report, or the gate's picture, into the folder that the event names; other events pass by."""
    if event.name == STOPPED:
        from polishd.plugins.run_report.gate import write_gate

        write_gate(Path(event.data["cycle_dir"]))
        return
    run_dir = event.data.get("run_dir")
    if event.name not in REPORTED or not run_dir:
        return
    from polishd.plugins.run_report.report import write_report

    write_report(Path(run_dir))
