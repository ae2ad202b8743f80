"""The whole simulated cell on an ABB controller: seat, first touch, queue, and a daemon that dies."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import simulated_cell
from tests.system.abb_rig import SPEED, dwell_cell, module, write_files
from tests.system.cell_rig import Daemon, account, events, summary, with_part
from tests.system.sim_rig import alive, wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full]

ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
EARLY = 40
RIM = {"aperture_mm": 14.0, "edge_mm": 2.0}
"""Wide enough for the tool to rest on it."""


def test_the_seat_is_proved_in_the_programs_own_frame_before_the_pass(tmp_path: Path) -> None:
    files = write_files(tmp_path / "cell", touch_off=True, **ONE_PASS)
    with_part(files, RIM, module)
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", "4"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"), Daemon(files) as daemon:
        daemon.wait()
        stands, names = account(files)["stands"], [event["event"] for event in events(files)]
    assert summary(files)["outcome"] == "cycles_used", daemon.output.read_text()
    assert len(stands) >= 3
    assert names.count("tool_landed") == 4, "three points, and the pass"
    seat = json.loads((files.run_dir / "cycle-00/touch_off.json").read_text())
    assert abs(seat["height_mm"]) < 0.05, seat
