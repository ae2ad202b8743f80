"""CiA 402 between processes: both drivers in a whole simulated cell, whose plant records what the tool did.

With a node and a client of others: tests/interop/test_canopen.py.
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.api import ActuatorTimes, ForceSample, SpindleTimes
from polishd.commissioning.rehearsal.simulated_cell import simulated_cell
from polishd.drivers.cia402.actuator import ActuatorScale, Cia402Actuator
from polishd.drivers.cia402.drive import CanNodeAddress
from polishd.drivers.cia402.protocol import read_dictionary
from polishd.drivers.cia402.spindle import Cia402Spindle, SpindleScale
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress, parse_address
from tests.fakes.cia402 import EDS
from tests.system.cell_rig import ONE_PASS, Daemon, events, summary, write_small
from tests.system.sim_rig import ROOT, Cell, cell, end_pid, wait_for
from tests.system.test_daemon import require_nothing_twice
from tests.system.test_faults import require_off_the_part
from tests.time_limits import SOON_S

pytestmark = [pytest.mark.system, pytest.mark.full]

SIM = """
[plant]
aperture_mm = 40.0
[robot]
port = 0
watchdog_s = 30.0
[actuator]
kind = "slcan"
[spindle]
kind = "socketcand"
"""
PRESSED = [b"G21 G90", b"G0 X0 Y0 Z0 A15 C0", b"M2"]


ACTUATOR = """[actuator]
type = "cia402_actuator"
address = "slcan:sim/actuator?bitrate=500000"
eds = "drive.eds"
node = 6
n_per_permille = 0.05
mm_per_increment = 0.001
balance_n = 2.0
travel_mm_s = 20.0
silence_s = 3.0
watchdog_s = 5.0
landing_s = 10.0
retract_s = 5.0
"""
SPINDLE = """[spindle]
type = "cia402_spindle"
address = "slcan:sim/spindle?bitrate=500000"
eds = "drive.eds"
node = 5
rpm_per_unit = 0.1
silence_s = 6.0
watchdog_s = 6.0
"""


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Cell]:
    """Run a simulated cell with both drives."""
    with cell(tmp_path, SIM, "--speed", "20", "--seed", "7") as found:
        yield found


def drivers(running: Cell) -> tuple[Cia402Spindle, Cia402Actuator]:
    """Open the two drivers on that cell's wires."""
    spindle_bus, actuator_bus = (parse_address(running.endpoints[name], ROOT) for name in ("spindle", "actuator"))
    assert isinstance(spindle_bus, SocketcandAddress)
    assert isinstance(actuator_bus, SlcanAddress)
    spindle = Cia402Spindle(
        CanNodeAddress(spindle_bus, 5, 0x45, silence_s=3.0, watchdog_s=3.0),
        read_dictionary(EDS, 5),
        SpindleScale(0.1),
        SpindleTimes(silence_s=3.0),
    )
    actuator = Cia402Actuator(
        CanNodeAddress(actuator_bus, 6, 0x46, silence_s=3.0, watchdog_s=3.0),
        read_dictionary(EDS, 6),
        ActuatorScale(0.05, 0.001, balance_n=2.0),
        ActuatorTimes(silence_s=3.0),
    )
    return spindle, actuator


def lower_the_tool(running: Cell) -> None:
    robot = running.robot()
    robot.load(PRESSED)
    robot.resume()
    robot.state("done")


async def pressed_with(actuator: Cia402Actuator, force_n: float) -> ForceSample:
    async with asyncio.timeout(SOON_S):
        async for sample in actuator.samples():
            if sample.in_contact and sample.force_n == pytest.approx(force_n, rel=0.1):
                return sample
    raise AssertionError("samples ended")


async def test_a_tool_is_turned_pressed_and_lifted(running: Cell) -> None:
    await asyncio.to_thread(lower_the_tool, running)
    spindle, actuator = drivers(running)
    await spindle.open()
    await actuator.open()
    await spindle.set_speed(1000.0)
    await actuator.set_force(12.0)
    sample = await pressed_with(actuator, 12.0)
    assert sample.position_mm == pytest.approx(5.0, abs=0.1)
    await actuator.make_safe()
    await spindle.make_safe()
    wait_for(lambda: "spindle_stopped" in running.events(), "the plant's event")
    events = running.events("engage", "tool_landed", "retract", "force_zero", "tool_lifted", "retracted")
    assert events == ["engage", "tool_landed", "retract", "force_zero", "tool_lifted", "retracted"]
    await actuator.close()
    await spindle.close()


async def test_without_a_controller_both_drives_end_it_by_themselves(running: Cell) -> None:
    await asyncio.to_thread(lower_the_tool, running)
    spindle, actuator = drivers(running)
    await spindle.open()
    await actuator.open()
    await spindle.set_speed(1000.0)
    await actuator.set_force(12.0)
    await pressed_with(actuator, 12.0)
    silent_s = time.monotonic()
    await asyncio.gather(actuator.close(), spindle.close())
    wait_for(lambda: {"retracted", "spindle_stopped"} <= set(running.events()), "both at rest")
    log = [entry for entry in running.log() if entry["mono_s"] > silent_s and entry["event"] != "force_setpoint"]
    assert next(entry["event"] for entry in log if entry["device"] == "spindle") == "watchdog"
    coil = [entry["event"] for entry in log if entry["device"] == "actuator"]
    assert coil == ["watchdog", "retract", "force_off", "force_zero", "tool_lifted", "retracted"]
    await actuator.make_safe()
    await actuator.open()
    assert (await actuator.status()).ready
    await actuator.close()


async def test_a_drive_that_dies_in_contact_lifts_and_is_a_lost_link(running: Cell) -> None:
    await asyncio.to_thread(lower_the_tool, running)
    _, actuator = drivers(running)
    await actuator.open()
    await actuator.set_force(12.0)
    await pressed_with(actuator, 12.0)
    await asyncio.to_thread(end_pid, running.pids["actuator"])
    with pytest.raises(Exception, match="slcan"):
        await pressed_with(actuator, -1.0)
    wait_for(lambda: "lost" in running.events(), "the plant to see it")
    await asyncio.to_thread(running.boot, "actuator")
    await actuator.open()
    assert (await actuator.status()).safe
    await actuator.close()


def test_a_part_is_polished_by_drives_off_the_shelf(tmp_path: Path) -> None:
    """The shipped cell works with the two device sections replaced."""
    files = write_small(tmp_path / "cell", **ONE_PASS)
    text = files.cell.read_text().replace('"voice_coil", ', "", 1)
    for section, ours in (("actuator", ACTUATOR), ("spindle", SPINDLE)):
        text = re.sub(rf"^\[{section}\].*?(?=^\[)", f"{ours}\n", text, flags=re.MULTILINE | re.DOTALL)
    files.cell.write_text(text)
    (files.cell.parent / "drive.eds").write_bytes(EDS.read_bytes())
    options = ["--state", str(files.sim_dir), "--seed", "3", "--speed", "40"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        with Daemon(files) as daemon:
            assert daemon.wait() == 0, daemon.output.read_text()
        require_nothing_twice(files)
        require_off_the_part(files)
        assert not events(files, "watchdog", "drive_fault")
    assert summary(files)["outcome"] == "in_tolerance"
