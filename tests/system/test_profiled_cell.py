"""A cell whose actuator and spindle are profiles: a whole job, and the report of ``polishd probe`` for a wrong wire."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from tests.fakes.devices_by_profile import file_of
from tests.system.agreement import require_agreement
from tests.system.cell_rig import ONE_PASS, Daemon, summary, write_small
from tests.time_limits import SOON_S

pytestmark = [pytest.mark.system, pytest.mark.full]

DRIVE = file_of("line_drive.toml")
ACTUATOR = f"""[actuator]
type = "actuator_profile"
profile = "{DRIVE}"
address = "serial:sim/actuator"
silence_s = 3.0
watchdog_s = 5.0
"""
SPINDLE = """[spindle]
type = "spindle_profile"
profile = "delta_ms300"
address = "serial:sim/spindle"
silence_s = 6.0
watchdog_s = 6.0
"""


def with_section(text: str, name: str, section: str) -> str:
    """Return the TOML text with the table of that name replaced."""
    changed, count = re.subn(rf"^\[{name}\]\n(?:(?!\[).*\n)*", section + "\n", text, flags=re.MULTILINE)
    assert count == 1
    return changed


def profiled_files(out: Path) -> DemoFiles:
    """Write the files of such a cell."""
    files = write_small(out, **ONE_PASS)
    cell = files.cell.read_text()
    cell = with_section(with_section(cell, "actuator", ACTUATOR), "spindle", SPINDLE)
    files.cell.write_text(cell)
    return files


@contextmanager
def profiled_cell(out: Path) -> Iterator[DemoFiles]:
    """Run a simulator for the duration of the block; the cell's files."""
    files = profiled_files(out)
    with simulated_cell(files.sim, ["--state", str(files.sim_dir), "--seed", "3", "--speed", "40"], out / "sim.stderr"):
        yield files


def polishd(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "polishd.cli.app", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, check=False)


def test_a_job_is_polished_by_profiles(tmp_path: Path) -> None:
    with profiled_cell(tmp_path / "cell") as files:
        with Daemon(files) as daemon:
            assert daemon.wait() == 0, daemon.output.read_text()
        require_agreement(files)
    assert summary(files)["outcome"] == "in_tolerance"


def test_probe_says_what_is_wrong_in_one_line(tmp_path: Path) -> None:
    with profiled_cell(tmp_path / "cell") as files:
        good = files.cell.read_text()
        assert polishd("probe", files.cell).returncode == 0
        cases = [
            (SPINDLE, SPINDLE + "unit = 9\n", r"^serial:\S+ unit 9: no answer within 6 s at 9600 8N1"),
            (SPINDLE, SPINDLE.replace("delta_ms300", "hitachi_wj200"), r"exception \d, .*; is it another device\?$"),
            (
                ACTUATOR,
                ACTUATOR.replace(str(DRIVE), "voice_coil_serial"),
                r"ST\?: '!unknown.*' within 3 s at 115200 8N1 is not an answer\. Check the device\.$",
            ),
            (ACTUATOR, ACTUATOR.replace("sim/actuator", "sim/none"), r"the port does not exist"),
        ]
        for old, new, said in cases:
            files.cell.write_text(good.replace(old, new))
            (line,) = what_is_wrong(files).values()
            assert re.search(said, line), line
        files.cell.write_text(good)
        with serial.Serial(str(files.sim_dir / "spindle"), exclusive=True):
            wrong = what_is_wrong(files)
        assert wrong["spindle"].endswith("another program has the port open. End that program (lsof names it).")


def what_is_wrong(files: DemoFiles) -> dict[str, str]:
    """Return the error that ``probe`` reports for each device with a wrong answer."""
    answer = polishd("probe", files.cell, "--json")
    assert answer.returncode == 5
    errors = {name: facts["error"] for name, facts in json.loads(answer.stdout).items() if "error" in facts}
    assert not any("\n" in error for error in errors.values())
    return errors
