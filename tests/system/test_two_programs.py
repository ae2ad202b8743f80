"""A second program at the devices of a cell that polishes: refused by name, and the pass goes on."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.daemon.socket import client
from tests.system.cell_rig import Daemon, events, small_cell, with_keys
from tests.time_limits import SOON_S

pytestmark = pytest.mark.system


def polishd(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "polishd", *map(str, arguments)]
    return subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=SOON_S, check=False
    )


def copied(files: DemoFiles) -> Path:
    """Write the same cell with another state folder, as for a trial."""
    copy = files.cell.with_name("copy.toml")
    copy.write_text(with_keys(files.cell.read_text(), {"cell": {"state_dir": "another state", "name": "copy"}}))
    return copy


def require_refused(done: subprocess.CompletedProcess[str], daemon: Daemon) -> None:
    """Require that the message names the daemon's process and cell."""
    said = " ".join((done.stderr + done.stdout).split())
    assert done.returncode != 0, said
    assert "another program uses this device" in said, said
    assert f"pid {daemon.process.pid} " in said, said
    assert "cell 'bench-cell'" in said, said


def require_undisturbed(files: DemoFiles, daemon: Daemon, before: int) -> None:
    """Require that nothing connected, nothing was held, and the tool is still on the part."""
    since = [event["event"] for event in events(files)[before:]]
    assert not {"client", "force_zero", "tool_lifted", "retracted", "motion_stopped", "hold"} & set(since), since
    assert daemon.process.poll() is None, daemon.output.read_text()
    assert client.request(files.state_dir, "status", 5.0)["state"] == "polishing"


@pytest.mark.full
def test_probe_with_a_copy_of_the_cell_leaves_a_pass_alone(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=2, speed=4.0, tolerance_nm=0.01, max_cycles=3) as files:
        copy = copied(files)
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            before = len(events(files))
            done = polishd("probe", copy, "--json")
            require_refused(done, daemon)
            require_undisturbed(files, daemon, before)
            answer = json.loads(done.stdout)
            assert set(answer) == {"actuator", "robot", "spindle", "metrology"}
            assert all("another program" in one["error"] for one in answer.values()), "none is made safe by it"
            assert daemon.end() == 1
        assert polishd("probe", copy).returncode == 0, "the daemon gave its claims back"


@pytest.mark.full
def test_no_other_verb_gets_in_either_and_kill_9_leaves_no_claim(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=2, speed=1.0, tolerance_nm=0.01, max_cycles=3) as files:
        copy = copied(files)
        with Daemon(files) as daemon:
            daemon.wait_in_contact(20)
            before = len(events(files))
            require_refused(polishd("device", "scan", "voice_coil_modbus", f"serial:{files.sim_dir}/actuator"), daemon)
            require_undisturbed(files, daemon, before)
            require_refused(polishd("calibrate", "instrument", copy, "--angles", "0,90,180"), daemon)
            require_undisturbed(files, daemon, before)
            require_refused(polishd("hil", copy, "--yes"), daemon)
            require_undisturbed(files, daemon, before)
            require_refused(polishd("run", copy, "--no-hold"), daemon)
            require_undisturbed(files, daemon, before)
            daemon.process.kill()
            daemon.wait()
        found = polishd("device", "scan", "voice_coil_modbus", f"serial:{files.sim_dir}/actuator")
        assert "another program" not in found.stderr
