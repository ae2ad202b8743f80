"""Too much force, on each simulated actuator: one reading above the limit leaves contact, also while it lands.

What truly acts is the plant's; the simulator's log says when it began and when no force was left.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from tests.campaigns.faults.links import LINKS
from tests.system.cell_rig import ONE_PASS, Daemon, account, events, summary, with_faults, write_small
from tests.system.sim_rig import wait_for
from tests.system.test_faults import SAFETY, Fault, require_off_the_part
from tests.system.test_force_and_signals import SENSOR, watched_cell
from tests.system.test_profiled_cell import profiled_files

pytestmark = [pytest.mark.system, pytest.mark.full]

ACTUATORS: dict[str, Callable[[Path], DemoFiles]] = {
    name.removeprefix("actuator, "): link.write for name, link in LINKS.items() if name.startswith("actuator, ")
} | {"profile": profiled_files}
SOON_S = 1.0
"""Longest time from a wrong force to none, in s: reading, command, retraction, and delays of a busy machine."""


@contextlib.contextmanager
def running(files: DemoFiles, *faults: Fault, speed: float = 10.0) -> Iterator[DemoFiles]:
    """Run the simulator of that cell with these faults for the duration of the block."""
    files.sim.write_text(with_faults(files.sim.read_text(), *faults))
    options = ["--state", str(files.sim_dir), "--seed", "2", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


def stopped(files: DemoFiles) -> tuple[str, float]:
    """Require that the daemon ended in the safe order; return its reason and how long the wrong force acted, in s."""
    with Daemon(files) as daemon:
        assert daemon.wait() == SAFETY, daemon.output.read_text()
    require_off_the_part(files)
    begins = max(event["mono_s"] for event in events(files, "tool_landed", "fault_begins"))
    return summary(files)["reason"], events(files, "force_zero")[-1]["mono_s"] - begins


@pytest.mark.parametrize("kind", ACTUATORS)
def test_a_spike_leaves_contact_at_its_first_reading(tmp_path: Path, kind: str) -> None:
    spike = {"device": "actuator", "what": "spike", "contact_s": 0.7, "force_n": 36.0, "duration_s": 0.2}
    with running(ACTUATORS[kind](tmp_path / "cell"), spike) as files:
        reason, seconds = stopped(files)
    assert "the actuator reads 4" in reason
    assert "at most 18 N may act (process.force_max_n), the set point is 12 N" in reason
    assert seconds < SOON_S


@pytest.mark.parametrize("kind", ACTUATORS)
def test_a_landing_with_49_n_ends_at_its_first_reading(tmp_path: Path, kind: str) -> None:
    press = {"device": "actuator", "what": "press", "at_s": 0.0, "force_n": 49.0}
    with running(ACTUATORS[kind](tmp_path / "cell"), press) as files:
        reason, seconds = stopped(files)
    assert "process.force_max_n" in reason
    assert seconds < SOON_S


def test_a_touch_off_with_33_n_ends_at_its_first_reading(tmp_path: Path) -> None:
    press = {"device": "actuator", "what": "press", "at_s": 0.0, "force_n": 33.0}
    with running(write_small(tmp_path / "cell", touch_off=True, **ONE_PASS), press) as files:
        reason, seconds = stopped(files)
        wait_for((files.sim_dir / "dwell_account.json").exists, "the account")
        assert account(files)["rms_nm"] == pytest.approx(events(files, "boot")[0]["true_rms_nm"], abs=1e-9)
    assert "touch_off.force_max_n" in reason
    assert seconds < SOON_S


def test_a_landing_that_only_the_force_sensor_feels_ends(tmp_path: Path) -> None:
    """The actuator presses but reads no force: without the sensor it would press until the landing times out."""
    lie = {"device": "actuator", "what": "lie", "at_s": 0.0, "factor": 0.0}
    sensor = SENSOR.format(silence_s=1.0, delay_s=0.4)
    with watched_cell(tmp_path / "cell", sensor, '[force_sensor]\nkind = "serial"\n', [lie]) as files:
        reason, seconds = stopped(files)
    assert "the force sensor reads 1" in reason
    assert "N and the actuator none (" in reason
    assert seconds < SOON_S + 0.5


def test_a_touch_off_and_a_pass_go_through_with_the_limits_that_a_cell_has(tmp_path: Path) -> None:
    files = write_small(tmp_path / "cell", touch_off=True, **ONE_PASS)
    with running(files, speed=40.0), Daemon(files) as daemon:
        assert daemon.wait() == 0, daemon.output.read_text()
