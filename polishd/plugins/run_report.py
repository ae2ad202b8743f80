"""Plugin ``run_report``: writes ``report.html`` and ``pictures/*.png`` into a run or plan folder when it is complete.

The page is self-contained: it opens offline and refers to nothing on a network. A run that ended early is reported
too, and the page says what is missing. It is drawn in a process of its own: in a thread, matplotlib would hold up the
loop that is in contact with a part.
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
    """Write the report, or the gate's picture, into the folder that the event names; other events pass by."""
    match event:
        case events.RemovalCheckFailed():
            _draw(event.cycle_dir, "gate")
        case events.RunFolderCompleted() | events.PlanWritten():
            _draw(event.run_dir)
        case _:
            pass


def _draw(*arguments: str) -> None:
    command = [sys.executable, "-P", "-m", "polishd.reports.run_report", *arguments]
    # in a group of its own: Ctrl-C is the daemon's to answer
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
