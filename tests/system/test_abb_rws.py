"""The whole simulated cell on an ABB controller: a first touch, and a daemon that dies."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.config.cell import load_config
from tests.system.abb_rig import dwell_cell, module, write_files
from tests.system.cell_rig import Daemon, events, with_keys, with_part
from tests.system.sim_rig import alive, wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full]

ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
EARLY = 40
WITNESS = {"aperture_mm": 30.0, "edge_mm": 1.0}
"""Part that is wide enough for the tracks of a first touch."""


def polishd(files: DemoFiles, *arguments: str) -> str:
    command = [sys.executable, "-m", "polishd.cli.app", *arguments]
    done = subprocess.run(command, cwd=files.out, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_first_touch_is_planned_in_rapid_and_check_takes_it(tmp_path: Path) -> None:
    files = write_files(tmp_path / "cell", **ONE_PASS)
    with_part(files, WITNESS, module)
    files.cell.write_text(with_keys(files.cell.read_text(), {"process": {"estimates": "machine"}}))
    part = load_config(files.cell).part.id
    touch = ("calibrate", "first-touch", "cell.toml", "--out", "touch", "--part", part, "--json")
    assert json.loads(polishd(files, *touch))["contact_min"] < 5.0
    assert b",tool0\\WObj:=wobj0;" in (files.out / "touch/touch.rnc").read_bytes()
    files.cell.write_text(f'include = ["touch/fragment.toml"]\n{files.cell.read_text()}')
    polishd(files, "check", "cell.toml")


def test_a_daemon_that_dies_is_noticed_by_the_shipped_watchdog_after_the_tool_is_up(tmp_path: Path) -> None:
    with dwell_cell(tmp_path / "cell", speed=1.0, **ONE_PASS) as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact(EARLY)
            daemon.end(signal.SIGKILL)
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
        require_safe_order(events(files))
        before = len(events(files))
        with Daemon(files) as daemon:
            daemon.wait_for_state("held")
            assert not [e for e in events(files)[before:] if e["event"] in ("motion_started", "force_on")]
            daemon.end()
        assert not alive(daemon.process.pid)
