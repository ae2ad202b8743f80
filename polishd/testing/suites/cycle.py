"""Suite of a whole cell: one cycle of its job."""

from __future__ import annotations

from typing import Any

import pytest

from polishd.daemon.app import CellRun, run_cells
from polishd.testing.hil_bench import HilBench
from polishd.testing.pytest_plugin import BENCH


@pytest.fixture
def cell(request: pytest.FixtureRequest) -> HilBench:
    """Return the cell of ``--cell``."""
    found: HilBench = request.config.stash[BENCH]
    return found


@pytest.mark.polishd_cycles
async def test_a_cycle_of_the_cells_job(cell: HilBench) -> None:
    """The cell's daemon runs one cycle of its job, from the map to the report, and ends."""
    ended: Any
    (ended,) = await run_cells([CellRun(cell.config, cell.hooks)], holds=False)
    if isinstance(ended, Exception):
        raise ended
    assert ended["outcome"] in {"in_tolerance", "cycles_used"}, f"{ended['outcome']}: see {ended['run_dir']}"
