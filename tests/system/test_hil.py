"""``polishd hil`` and ``pytest -m hil``: simulated cells replace real ones."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import simulated_cell
from polishd.util.wire_recording import read_recording
from tests.system.cell_rig import events, small_cell, with_keys, write_small
from tests.system.sim_rig import ROOT, wait_for
from tests.time_limits import SOON_S

pytestmark = pytest.mark.system
MOTION = "G21 G90 G94\nG1 X0 Y0 Z3 F60\nG1 X0.5 Y0 Z3 F60\nG1 X0.5 Y0.5 Z3 F60\nG1 X0 Y0.5 Z3 F60\n"


def hil(cell: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "polishd", "hil", str(cell), *options]
    return subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)


def counted(output: str) -> dict[str, int]:
    """Return the number of tests by outcome."""
    return {
        word: int(count) for count, word in re.findall(r"(\d+) (passed|failed|error|skipped)", output.splitlines()[-1])
    }


@pytest.mark.full
def test_nothing_is_opened_where_no_operator_can_confirm(tmp_path: Path) -> None:
    done = hil(Path(shutil.copy(ROOT / "examples" / "cell.toml", tmp_path)))
    assert done.returncode == 3
    assert "use --yes to continue without it. Nothing was opened" in done.stderr
    assert "REAL, robot_link tcp://" in done.stdout


@pytest.mark.full
def test_a_dead_device_fails_and_the_simulated_ones_beside_it_pass(tmp_path: Path) -> None:
    files, case = write_small(tmp_path), tmp_path / "case.wire.jsonl.gz"
    done = hil(files.cell, "--simulate", "robot,spindle", "--yes", "--record", str(case))
    assert done.returncode == 5, done.stdout + done.stderr
    assert re.search(r"test_it_identifies_itself\[actuator\] (FAILED|ERROR)", done.stdout)
    for device in ("robot", "spindle"):
        found = re.findall(rf"^\S+\[{device}\] (\w+)", done.stdout, re.MULTILINE)
        assert len(found) > 10
        assert set(found) == {"PASSED"}
    assert "requirement of the port" in done.stdout
    found = read_recording(case)
    assert {one.role for one in found.passed} == {"robot", "spindle"}, "the actuator has no line to open"
    assert {one.way for one in found.passed} == {"open", "out", "in", "end"}
    again = hil(files.cell, "--yes", "--record", str(case))
    assert again.returncode == 3
    assert "exists already. Name another file or a folder" in again.stderr


@pytest.mark.full
def test_a_program_reads_what_was_found(tmp_path: Path) -> None:
    """A device is missing: the text for people is on stderr."""
    done = hil(write_small(tmp_path).cell, "--simulate", "robot,spindle", "--yes", "--json")
    assert done.returncode == 5, done.stderr
    report = json.loads(done.stdout)
    assert {"actuator", "robot", "spindle", "metrology"} <= {one["device"] for one in report["devices"]}
    assert report["kept"] > 20
    assert report["broken"] == len(report["problems"]) > 0
    assert any(one["demand"] == "test_it_identifies_itself[actuator]" and one["why"] for one in report["problems"])
    assert "FAILED" in done.stderr or "ERROR" in done.stderr


@pytest.mark.full
def test_a_cell_is_tried_up_to_contact_and_never_harder_than_allowed(tmp_path: Path) -> None:
    with small_cell(tmp_path, speed=20.0) as files:
        motion = files.out / "air.nc"
        motion.write_text(MOTION)
        how = ["--level", "contact", "--max-force", "4", "--motion", str(motion), "--simulate", "spindle", "--yes"]
        done = hil(files.cell, *how)
        assert done.returncode == 0, done.stdout + done.stderr
        assert counted(done.stdout)["passed"] > 60
        assert {event["device"] for event in events(files, "motion_started", "engage")} == {"robot", "actuator"}
        assert not events(files, "spindle_ramping"), "the real one turned, and the other was asked for"
        last = [event["event"] for event in events(files, "engage", "retracted")][-1]
        assert last == "retracted"


@pytest.mark.full
def test_the_tool_is_up_after_an_interrupt(tmp_path: Path) -> None:
    files = write_small(tmp_path)
    on_part = {"robot": {"home": [0.0, 0.0, 0.0, 15.0, 0.0]}}
    files.sim.write_text(with_keys(files.sim.read_text(), on_part))
    options = ["--level", "contact", "--max-force", "4", "--simulate", "robot,spindle", "--yes"]
    command = [sys.executable, "-m", "polishd", "hil", str(files.cell), *options]
    with simulated_cell(files.sim, ["--state", str(files.sim_dir), "--speed", "4"], files.out / "sim.stderr"):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True) as process:
            wait_for(lambda: events(files, "force_on"), "contact")
            os.killpg(process.pid, signal.SIGINT)  # as the terminal does
            assert process.wait(SOON_S) == 130
        assert events(files, "engage", "retracted")[-1]["event"] == "retracted"
        assert not events(files, "watchdog"), "the driver did not lift the tool, and the watchdog expired"


@pytest.mark.full
def test_from_a_checkout_and_a_cycle(tmp_path: Path) -> None:
    with small_cell(tmp_path, speed=20.0) as files:
        options = ["--cell", str(files.cell), "--hil-level", "cycle", "--hil-max-force", "10"]
        command = [sys.executable, "-m", "pytest", "-m", "hil", "-p", "no:cacheprovider", *options, "tests/hil"]
        only = ["-k", "cycle or identifies"]
        done = subprocess.run([*command, *only], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout
        assert counted(done.stdout)["passed"] == 4
        (run,) = (files.state_dir / "runs").glob("hil-*")
        assert json.loads((run / "summary.json").read_text())["outcome"] in {"in_tolerance", "cycles_used"}
