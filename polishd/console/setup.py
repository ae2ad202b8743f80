"""``polishd status --setup``: how far a cell is from its first pass. Opens no device, asks no daemon."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

from polishd.hooks.cell import load_cell
from polishd.model.errors import PolishdError
from polishd.show.tables import emit, stderr
from polishd.workbench.setup.steps import CHECK, SetupStep, lines, steps


def setup_verb(cell: Path, *, as_json: bool) -> None:
    """Each step with what there is of it on disk, and the command that does it; the cell is checked meanwhile."""
    with stderr.status("checking the cell"):
        found = [_checked(cell, step) if step.what == CHECK else step for step in steps(cell)]
    done = sum(step.done is True for step in found)
    answer = {"cell": str(cell), "done": done, "steps": [asdict(step) for step in found]}
    emit(answer, as_json=as_json, lines=[f"{cell}: {done} of {len(found)} steps are done", *lines(found)])


def _checked(cell: Path, step: SetupStep) -> SetupStep:
    """What `polishd check` says of the files as they are now."""
    from polishd.daemon.checking import check_cell

    try:
        facts = check_cell(*load_cell(cell))
    except PolishdError as error:
        return replace(step, done=False, found=str(error))
    return replace(step, done=True, found=f"passes: reach {facts['reach']}, gamma {facts['gamma']}")
