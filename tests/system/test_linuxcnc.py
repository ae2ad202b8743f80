"""The whole simulated cell with a real LinuxCNC for its robot: polished, held, resumed, aborted, cut off."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.console.demo_files import DemoFiles
from polishd.daemon import client
from tests.system.cell_rig import account, events, summary
from tests.system.linuxcnc_moves import CORNER, END, START
from tests.system.linuxcnc_rig import Cell, linuxcnc_cell
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]


def last(files: DemoFiles, name: str) -> dict[str, Any]:
    return events(files, name)[-1]


def require_times_agree(files: DemoFiles, cycle: int) -> None:
    """What the driver was told of the blocks, against samples of the motion every 5 ms: each block, and the sum."""
    rows = np.genfromtxt(files.run_dir / f"cycle-{cycle:02d}" / "executed.csv", delimiter=",", names=True)
    was = np.array(account(files)["programs"][-1]["contact_s"])
    told = np.zeros(len(was))
    np.add.at(told, rows["seq"].astype(int), (rows["end_s"] - rows["start_s"]) * (rows["contact"] == 1))
    polished = was > 0
    assert told.sum() == pytest.approx(was.sum(), rel=0.03)
    assert np.median(np.abs(told - was)[polished]) < 0.015


def test_linuxcnc_polishes_is_held_resumed_and_stopped(tmp_path: Path) -> None:
    with linuxcnc_cell(tmp_path / "cell", tolerance_nm=0.01, max_cycles=1) as cell:
        files = cell.files
        with cell.daemon() as daemon:
            daemon.wait_in_contact(30)
            assert client.request(files.state_dir, "hold", 10.0)["state"] == "held"
            require_safe_order(events(files))
            stood = last(files, "motion_stopped")["mono_s"]
            assert not [e for e in events(files, "motion_started") if e["mono_s"] > stood]
            assert client.request(files.state_dir, "resume", 10.0)["ok"]
            wait_for((files.run_dir / "cycle-01" / "map.dat").exists, "a new measurement")
            assert daemon.process.wait(60.0) == 1, daemon.output.read_text()
        polished = summary(files)
        assert polished["outcome"] == "cycles_used"
        require_times_agree(files, 1)
    first, *_, final = polished["cycles"]
    assert final["rms_nm"] < 0.8 * first["rms_nm"]
    programs = json.loads((files.sim_dir / "dwell_account.json").read_text())["programs"]
    assert [program["loads"] for program in programs] == [1] * len(programs)


def test_it_stops_where_it_is_told_and_is_held_aborted_and_refuses(tmp_path: Path) -> None:
    with linuxcnc_cell(tmp_path / "cell") as cell:
        said = cell.moves()
        assert said["before"] == "idle"
        assert said["stop"] == ["held", START, True]
        state, executed, safe = said["held"]
        assert (state, safe) == ("held", True)
        assert START < executed < CORNER, "held on its way"
        assert said["in_dwell"] == ["held", CORNER, True]
        assert said["end_of_contact"] == ["held", END, True]
        assert len(said["dwell_s"]) == 1
        assert said["done"] == "done"
        assert said["after"] == [True, "aborted"]
        assert "Bad character '?'" in said["refused"]
        positions = [line for line in cell.linuxcncrsh("get abs_act_pos") if line.startswith("ABS_ACT_POS")]
        assert positions, "and it still answers others"


def test_a_silent_daemon_is_noticed_by_the_gate_and_nothing_moves_when_it_is_back(tmp_path: Path) -> None:
    with linuxcnc_cell(tmp_path / "cell", tolerance_nm=0.01, max_cycles=1) as cell:
        files = cell.files
        with cell.daemon() as daemon:
            daemon.wait_in_contact(40)
            daemon.end(signal.SIGKILL)
        wait_for(lambda: events(files)[-1]["event"] == "motion_stopped", "the gate's hold", 10.0)
        require_safe_order(events(files))
        before = len(events(files))
        assert _status(cell) == "RUNNING", "held by the gate, not ended"
        with cell.daemon() as daemon:
            assert "uncertain" in daemon.wait_for_state("held")["reason"]
            assert not [e for e in events(files)[before:] if e["event"] in ("motion_started", "force_on")]
            daemon.end()


def _status(cell: Cell) -> str:
    said = [line.strip() for line in cell.linuxcncrsh("get program_status")]
    return next(line for line in said if line.startswith("PROGRAM_STATUS")).split()[1]
