"""The whole simulated cell with a real LinuxCNC for its robot: held, resumed, aborted, cut off."""

from __future__ import annotations

import contextlib
import re
import signal
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.daemon.socket import client
from tests.system.cell_rig import PATIENT, account, events, summary, with_keys
from tests.system.linuxcnc_moves import CORNER, END, START
from tests.system.linuxcnc_rig import ON_RING, Cell, Turns, linuxcnc_cell, write_files
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = pytest.mark.system

LONG_S = 0.6
"""Dwell that lasts longer than a hold takes to arrive."""


def require_safe_end(files: DemoFiles) -> None:
    """Require that contact ended before the robot went up, and that the robot stands still."""
    names = [event["event"] for event in events(files)]
    last = {name: k for k, name in enumerate(names)}
    assert last["force_zero"] < last["tool_lifted"] < last["motion_started"] < last["motion_stopped"], names


@pytest.mark.full
def test_the_seat_is_proved_at_three_places_with_linuxcnc_too(tmp_path: Path) -> None:
    with linuxcnc_cell(write_files(tmp_path / "cell", touch_off=True, tolerance_nm=0.01, max_cycles=1)) as cell:
        files = cell.files
        with cell.daemon() as daemon:
            assert daemon.wait() == 1, daemon.output.read_text()
        require_safe_end(files)
        touched = account(files)["stands"][:3]
    assert summary(files)["outcome"] == "cycles_used"
    places = [(stand["x_mm"], stand["y_mm"]) for stand in touched]
    assert np.array(places) == pytest.approx(np.array(ON_RING["points_mm"]), abs=0.01)
    assert all(stand["most_n"] <= 1.0 and stand["most_rpm"] == 0.0 for stand in touched), touched


@pytest.mark.full
def test_a_dwell_is_left_before_it_is_held_and_a_silent_daemon_is_noticed_by_the_gate(tmp_path: Path) -> None:
    """LinuxCNC does not pause a dwell: the tool is lifted before motion is held, and lands again on command only."""
    with linuxcnc_cell(write_files(tmp_path / "cell", tolerance_nm=0.01, max_cycles=3)) as cell:
        files = cell.files
        with cell.daemon() as daemon:
            point, began_s = in_a_long_dwell(files)
            held = client.request(files.state_dir, "hold", 10.0)
            require_left_within_the_dwell(files, began_s)
            require_uncertain(files, point, held["reason"])
            stood = len(events(files))
            assert client.request(files.state_dir, "resume", 10.0)["ok"]
            came = wait_for(lambda: dwells_in_contact(files, stood), "the next pass")
            assert came.index("measured") < came.index("motion_started"), "a new map comes first"
            daemon.end(signal.SIGKILL)
        wait_for(lambda: events(files)[-1]["event"] == "motion_stopped", "the gate's hold")
        require_safe_order(events(files))
        before = len(events(files))
        assert _status(cell) == "RUNNING", "held by the gate, not ended"
        with cell.daemon() as daemon:
            assert "uncertain" in daemon.wait_for_state("held")["reason"]
            assert not [e for e in events(files)[before:] if e["event"] in ("motion_started", "force_on")]
            daemon.end()
        assert _status(cell) == "IDLE", "what was under way is aborted"


def in_a_long_dwell(files: DemoFiles) -> tuple[int, float]:
    """Wait until the longest dwell of the next pass begins; return its block and when it began."""
    before, rests = len(events(files)), len(events(files, "rest_begun"))
    wait_for(lambda: "program_loaded" in [e["event"] for e in events(files)[before:]], "a pass")
    lines = (files.sim_dir / "linuxcnc" / "nc" / "polishd.ngc").read_bytes().split(b"\n")
    blocks = [line for line in lines if not line.startswith(b"(MSG")]
    dwells = {k: float(block[4:]) for k, block in enumerate(blocks) if block.startswith(b"G4 P")}
    seq = max(dwells, key=dwells.__getitem__)
    assert dwells[seq] > LONG_S

    def began() -> list[float]:
        return [e["mono_s"] for e in events(files, "rest_begun")[rests:] if e["at_seq"] == seq - 1]

    return seq, wait_for(began, "a long dwell")[0]


def dwells_in_contact(files: DemoFiles, since: int) -> list[str]:
    """Wait until a dwell of a pass has begun after that event, and return the names of the events since then."""
    names = [e["event"] for e in events(files)[since:]]
    return names if "force_on" in names and "rest_begun" in names[names.index("force_on") :] else []


def require_left_within_the_dwell(files: DemoFiles, began_s: float) -> None:
    """Require that the tool was lifted while the dwell ran, and that nothing moved afterwards."""
    wait_for(lambda: events(files, "motion_stopped")[-1]["mono_s"] > began_s, "standstill")
    log = events(files)
    require_safe_order(log)
    after = [e["event"] for e in log if e["mono_s"] > began_s]
    assert after.index("force_zero") < after.index("tool_lifted") < after.index("rest_ended")
    assert not {"rest_begun", "motion_started"} & set(after)


def require_uncertain(files: DemoFiles, dwell: int, reason: str) -> None:
    """The plant records removal in that dwell; the daemon reports the block as uncertain."""
    found = re.search(r"uncertain: blocks (\d+) to", reason)
    assert found is not None, reason
    first = int(found[1])
    assert dwell - 2 <= first < dwell, "the block before it may wait for its samples yet"
    was = account(files)["programs"][-1]["contact_s"]
    assert sum(was[dwell - 1 : dwell + 1]) > 0.02
    assert not any(was[dwell + 1 :])
    with contextlib.closing(sqlite3.connect(files.state_dir / "journal.sqlite")) as journal:
        touched = [row[0] for row in journal.execute("SELECT seq FROM segment WHERE touched = 1")]
    assert max(touched) == first - 1


@pytest.mark.full
def test_a_part_on_a_tilting_table_is_polished_as_if_the_tool_were_turned(tmp_path: Path) -> None:
    """xyzac-trt-kins: polishd's tip and axis agree with those that the plant calculates from the joints."""
    files = write_files(tmp_path / "cell", turns="table", tolerance_nm=0.01, max_cycles=1)
    files.cell.write_text(with_keys(files.cell.read_text(), PATIENT))
    with linuxcnc_cell(files) as cell:
        with cell.daemon() as daemon:
            assert daemon.wait() == 1, daemon.output.read_text()
        require_safe_end(files)
        (program,) = account(files)["programs"]
    first, final = summary(files)["cycles"]
    # One pass, before the additional time per block of a controller on a busy computer is known.
    assert final["rms_nm"] < 0.8 * first["rms_nm"]
    assert program["loads"] == 1
    rows = np.genfromtxt(files.run_dir / "cycle-00" / "executed.csv", delimiter=",", names=True)
    assert np.all(np.diff(rows["seq"]) == 1), "each block of the contact once, and in order"
    reported_s = np.sum((rows["end_s"] - rows["start_s"]) * (rows["contact"] == 1))
    assert reported_s == pytest.approx(sum(program["contact_s"]), rel=0.01)


@pytest.mark.full
@pytest.mark.parametrize("turns", ["tool", "table"])
def test_it_stops_at_the_requested_block_and_is_held_aborted_and_refuses(tmp_path: Path, turns: Turns) -> None:
    with linuxcnc_cell(write_files(tmp_path / "cell", turns=turns)) as cell:
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


def _status(cell: Cell) -> str:
    said = [line.strip() for line in cell.linuxcncrsh("get program_status")]
    return next(line for line in said if line.startswith("PROGRAM_STATUS")).split()[1]
