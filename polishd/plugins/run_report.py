"""Plugin ``run_report``: writes ``report.html`` and ``pictures/*.png`` into a complete run or plan folder.

The page opens offline. A run that ended early is reported too, with a list of what is missing. A separate process
draws: in a thread, matplotlib would delay the contact loop.
"""

from __future__ import annotations

import subprocess
import sys

from polishd.api import Event, PolishdError, hookimpl
from polishd.model import events
from polishd.util.secret_files import environment_without_secrets

POLISHD_API = 1


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


def _draw(*arguments: str) -> None:
    command = [sys.executable, "-P", "-m", "polishd.reports.run_report", *arguments]
    # its own process group: Ctrl-C is for the daemon
    drawn = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        process_group=0,
        env=environment_without_secrets(),
    )
    if drawn.returncode:
        raise PolishdError(f"no report in {arguments[0]}: {drawn.stderr.strip()}")
