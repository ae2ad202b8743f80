"""The whole simulated cell on an ABB controller: seat, first touch, queue, and a daemon that dies."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.config.cell import load_config
from tests.system.abb_rig import dwell_cell, module, write_files
from tests.system.cell_rig import Daemon, events, with_keys, with_part
from tests.system.sim_rig import alive, wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full]

ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
EARLY = 40
RIM = {"aperture_mm": 14.0, "edge_mm": 2.0}
"""Wide enough for the tool to rest on it."""
WITNESS = {"aperture_mm": 30.0, "edge_mm": 1.0}
"""Wide enough for the tracks of a first touch."""
SPEED = "4"
QUEUE_S = 600.0


def polishd(files: DemoFiles, *arguments: str) -> str:
    command = [sys.executable, "-m", "polishd.cli.app", *arguments]
    done = subprocess.run(command, cwd=files.out, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def simulator(files: DemoFiles) -> list[str]:
    return ["--state", str(files.sim_dir), "--seed", "1", "--speed", SPEED]


@pytest.mark.slow
@pytest.mark.timeout(700)
def test_a_queue_proves_the_seat_of_each_part_before_its_pass(tmp_path: Path) -> None:
    """The modules of the touch-off are for the tool and the work object of the part's own."""
    files = write_files(tmp_path / "cell", touch_off=True, tolerance_nm=60.0, max_cycles=2)
    with_part(files, RIM, module)
    loader = f'\n[loader]\ntype = "loader_line"\naddress = "tcp://127.0.0.1:{free_port()}"\n'
    files.cell.write_text(files.cell.read_text() + loader)
    files.sim.write_text(files.sim.read_text() + "\n[loader]\n")
    jobs = [files.out / f"{name}.toml" for name in ("one", "two")]
    for job in jobs:
        job.write_text(f'[job]\nid = "{job.stem}"\n[part]\nid = "P-{job.stem}"\n')
    polishd(files, "queue", "add", "cell.toml", *(job.name for job in jobs))
    with simulated_cell(files.sim, simulator(files), files.out / "sim.stderr"):
        with Daemon(files, "--queue", "--until-empty") as daemon:
            daemon.process.wait(QUEUE_S)
        names = [event["event"] for event in events(files)]
    assert daemon.process.returncode == 0, daemon.output.read_text()
    assert names.count("tool_landed") == 2 * (3 + 1)
    assert "Traceback" not in daemon.output.read_text()


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
