"""The drivers against the simulator's own processes, over real wires: what holds for the fakes holds for these too.

Six cells serve the whole module: between them they have every wire that the simulator speaks but OPC UA and ADS.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import sys
import time
import tomllib
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import pytest

from polishd.api import DeviceRefused, ExecutedBlock, ForceSample, LinkError, Robot, SpeedSample, SpindleTimes
from polishd.commissioning.rehearsal.simulated_cell import free_port
from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.abb_rws.driver import AbbRobot
from polishd.drivers.abb_rws.services import Account
from polishd.drivers.fanuc_rmi.driver import FanucRmi
from polishd.drivers.fanuc_rmi.protocol import MOST_OUTSTANDING
from polishd.drivers.kuka_kvp.driver import KukaRobot
from polishd.drivers.monitor_line import MonitorLine
from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.hses import Hses
from polishd.drivers.plc_robot.modbus import Modbus
from polishd.drivers.profile_device import build
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import SerialLine, SlcanAddress, SocketcandAddress, Tcp, parse_address
from polishd.drivers.transport.file_delivery import Folder
from polishd.drivers.universal_robots.driver import Addresses, UniversalRobot
from polishd.drivers.universal_robots.rtde import UrRegisters
from polishd.drivers.universal_robots.script import Settings
from polishd.testing.device_rig import Rig
from polishd.testing.helpers import until_lost
from polishd.testing.suites.actuator import ActuatorRig
from polishd.testing.suites.robot import RobotRig
from polishd.testing.suites.spindle import SpindleRig
from tests.conformance.conftest import BOUND_S, PROMPT_S, seen
from tests.conformance.rigs.actuators import PATIENT
from tests.conformance.rigs.robots import PATIENT_ROBOT
from tests.conformance.rigs.sensors_and_monitors import PATIENT_MONITOR, PATIENT_SENSOR
from tests.conformance.rigs.spindles import PATIENT_SPINDLE
from tests.fakes.cia402 import cia402_spindle
from tests.fakes.devices_by_profile import file_of, shipped, voice_coil_modbus, voice_coil_serial
from tests.programs import plan_of
from tests.selection import kind
from tests.system.sim_rig import ROOT, Cell, alive, cell, wait_for
from tests.time_limits import SOON_S, within
from tests.unit.drivers.fanuc_rmi.test_program import program as tp_program

# python-can leaves the socket of a bus that it refuses to open to the collector
LEFT = "ignore:Exception ignored in. <socket.socket:pytest.PytestUnraisableExceptionWarning"
pytestmark = [pytest.mark.system, pytest.mark.filterwarnings(LEFT)]

# The robot stands with the tool's tip on the part, so that there is something to press on.
BASE = """
[plant]
aperture_mm = 20.0
speed = 20.0
[robot]
port = 0
home = [0.0, 0.0, 0.0, 15.0, 0.0]
"""
UNIVERSAL = """\
kind = "universal_robots"
cycle_hz = 125
dashboard_port = FREE
primary_port = FREE
"""
CELLS = {
    "rtu_slcan": BASE + '[force_sensor]\n[monitor]\nkind = "serial"\n',
    "tcp_socketcand": BASE + '[actuator]\nkind = "modbus_tcp"\n[spindle]\nkind = "socketcand"\n',
    "ascii": BASE + '[actuator]\nkind = "serial"\n',
    "profiles": BASE
    + f'[actuator]\nkind = "profile"\nbaud = 57600\nprofile = "{file_of("line_drive.toml")}"\n'
    + f'[spindle]\nkind = "profile_tcp"\nprofile = "{file_of("delta_ms300")}"\n',
    "universal_robots": BASE.replace("port = 0\n", f"port = 0\n{UNIVERSAL}"),
    "abb_rws": BASE.replace("port = 0\n", 'port = 0\nkind = "abb_rws"\n'),
    "fanuc_rmi": BASE.replace("port = 0\n", 'port = 0\nsession_port = FREE\nkind = "fanuc_rmi"\n'),
    "kuka_kvp": BASE.replace("port = 0\n", 'port = 0\nkind = "kuka_kvp"\n'),
    "handover_modbus": BASE.replace("port = 0\n", 'port = 0\nkind = "modbus"\n'),
    "yaskawa_hses": BASE.replace("port = 0\n", 'port = FREE\nkind = "hses"\n').replace("speed = 20.0", "speed = 1.0"),
}
AT_REST = {
    "robot": ("motion_started", {"motion_stopped", "boot", "lost"}),
    "actuator": ("engage", {"retracted", "boot", "lost"}),
    "spindle": ("spindle_ramping", {"spindle_stopped", "boot", "lost"}),
}
"""By device: the event that ends its rest, and those that begin it."""


UNCOUNTED = {"profiles", "universal_robots", "abb_rws", "fanuc_rmi", "yaskawa_hses"}
"""Cells whose devices do not distinguish one power-up from another."""


@dataclass(frozen=True)
class Place:
    """A device of one of the cells."""

    cell: str
    device: str

    def __str__(self) -> str:
        return f"{self.device}-{self.cell}"


ROBOTS = [
    *kind(
        *(
            Place(name, "robot")
            for name in ("rtu_slcan", "universal_robots", "abb_rws", "fanuc_rmi", "kuka_kvp", "handover_modbus")
        )
    ),
    pytest.param(Place("yaskawa_hses", "robot"), marks=pytest.mark.slow),  # in real time, and a tenth cell side by side
]
ACTUATORS = kind(*(Place(name, "actuator") for name in ("rtu_slcan", "tcp_socketcand", "ascii", "profiles")))
SPINDLES = kind(*(Place(name, "spindle") for name in ("rtu_slcan", "tcp_socketcand", "profiles")))
LOOKING = kind(Place("rtu_slcan", "force_sensor"), Place("rtu_slcan", "monitor"))


STARTER = """
import json, subprocess, sys
for line in sys.stdin:
    child = subprocess.Popen(json.loads(line), stdout=subprocess.PIPE, text=True)
    print(child.pid, child.stdout.readline().strip(), flush=True)
"""
"""Starts devices that are to outlive the test which boots them; they end with it."""


class Cells:
    """Cells by name, started when first asked for."""

    def __init__(self, folder: Path, starter: Popen[str]) -> None:
        self.folder = folder
        self.starter = starter
        self.running: dict[str, Cell] = {}
        self.booted: dict[tuple[str, str], int] = {}

    def get(self, name: str) -> Cell:
        """The running cell."""
        return self.running[name]

    def pid(self, place: Place) -> int:
        """Process of a device, also one that was booted by hand."""
        return self.booted.get((place.cell, place.device)) or self.get(place.cell).pids[place.device]

    def boot(self, place: Place) -> None:
        """Power on again, where it is off."""
        if alive(self.pid(place)):
            return
        command = [sys.executable, "-m", "polishd.sim_backends", *self.get(place.cell).arguments]
        assert self.starter.stdin is not None
        assert self.starter.stdout is not None
        self.starter.stdin.write(json.dumps([*command, "--device", place.device]) + "\n")
        self.starter.stdin.flush()
        pid, ready = self.starter.stdout.readline().split(maxsplit=1)
        assert json.loads(ready)["ready"] == place.device
        self.booted[place.cell, place.device] = int(pid)

    def history(self, place: Place) -> list[dict[str, Any]]:
        """Events of the device in the simulator's log; the last line may be incomplete."""
        lines = (self.get(place.cell).state / "sim.log").read_text().splitlines(keepends=True)
        events = [line for line in lines if f'"device": "{place.device}"' in line and line.endswith("\n")]
        return [json.loads(line) for line in events]

    def at_rest(self, place: Place) -> bool:
        """Whether the machine itself exerts nothing and stands, as its witness says (it speaks a moment later)."""
        if place.device not in AT_REST:
            return True
        begins, ends = AT_REST[place.device]

        def rests() -> bool:
            events = [event["event"] for event in self.history(place) if event["event"] in {begins, *ends}]
            return bool(events) and events[-1] in ends

        try:
            return bool(wait_for(rests, "rest"))
        except AssertionError:
            return False


@pytest.fixture(scope="module")
def cells(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cells]:
    """Run the cells that the selected tests need, in parallel."""
    chosen: list[Any] = [item for item in request.session.items if item.path == request.path]
    values = [value for item in chosen for value in item.callspec.params.values()]
    names = {value.cell for value in values if isinstance(value, Place)}
    with ExitStack() as stack:
        starter = stack.enter_context(
            Popen([sys.executable, "-c", STARTER], stdin=PIPE, stdout=PIPE, text=True, cwd=ROOT)
        )
        known = Cells(tmp_path_factory.mktemp("cells"), starter)
        for name in sorted(names):
            folder = known.folder / name
            folder.mkdir()
            config = re.sub("FREE", lambda _: str(free_port()), CELLS[name])
            known.running[name] = stack.enter_context(cell(folder, config))
        yield known


WATCHDOG_S = 60 * PATIENT_ROBOT.watchdog_s
"""The simulated clock runs 20 times as fast, and nine cells side by side leave a heartbeat waiting for seconds."""


def robot_of(cells: Cells, place: Place, address: Tcp) -> RobotLink | UniversalRobot | FanucRmi | KukaRobot | PlcRobot:
    """The driver of a cell's robot."""
    running = cells.get(place.cell)
    match place.cell:
        case "universal_robots":
            ports = tomllib.loads(running.toml.read_text())["robot"]
            addresses = Addresses.of(address.host, address.port, ports["dashboard_port"], ports["primary_port"])
            # its controller's clock is the simulated one: a busy machine is silent for seconds of that
            return UniversalRobot(addresses, Settings(UrRegisters(), 10 * PATIENT_ROBOT.watchdog_s), PATIENT_ROBOT)
        case "abb_rws":
            account = Account(address, "1.0", "Default User", "robotics")
            return AbbRobot(account, replace(PATIENT_ROBOT, watchdog_s=WATCHDOG_S, lifts=False))
        case "fanuc_rmi":
            held = {"lifts": False, "held_instructions": MOST_OUTSTANDING}
            return FanucRmi(address, replace(PATIENT_ROBOT, watchdog_s=WATCHDOG_S, **held))
        case "kuka_kvp":
            # its watchdog counts the simulated time
            times = replace(PATIENT_ROBOT, watchdog_s=WATCHDOG_S, lifts=False)
            folder = Folder(running.state / "programs")
            return KukaRobot(address, folder, "/R1/PROGRAM/", times, poll_s=0.005, load_s=10.0)
        case "handover_modbus":
            profile = load_controller_profile("plc-modbus", Path())
            make_link = partial(Modbus, address, profile.variables, profile.silence_s)
            return PlcRobot("simulated PLC", profile, make_link, Folder(running.state / "programs"))
        case "yaskawa_hses":
            profile = load_controller_profile("yaskawa-hses", Path())
            make = partial(Hses, address, profile.variables, profile.silence_s, 0.1)
            return PlcRobot("simulated Yaskawa", profile, make, Folder(running.state / "programs"))
    return RobotLink(address)


def connect(cells: Cells, place: Place) -> Any:
    """The driver that goes with the device's wire; opens nothing."""
    running = cells.get(place.cell)
    address = parse_address(running.endpoints[place.device].replace("hses://", "tcp://"), running.state)
    match address:
        case Tcp() | SerialLine() if place.device == "force_sensor":
            return build.force_sensor(shipped("force_sensor_line"), address, PATIENT_SENSOR)
        case Tcp() | SerialLine() if place.device == "monitor":
            return MonitorLine(address, PATIENT_MONITOR)
        case Tcp() if place.device == "robot":
            return robot_of(cells, place, address)
        case SerialLine() if place.cell == "profiles":
            return build.actuator(shipped("line_drive.toml"), address, PATIENT)
        case Tcp() if place.cell == "profiles":
            return build.spindle(shipped("delta_ms300"), address, PATIENT_SPINDLE)
        case SlcanAddress() | SocketcandAddress():
            return cia402_spindle(address, SpindleTimes(silence_s=1.5))
        case SerialLine() if place.cell == "ascii":
            return voice_coil_serial(address, PATIENT)
        case SerialLine() | Tcp():
            return voice_coil_modbus(address, PATIENT)
    raise AssertionError(address)


@asynccontextmanager
async def sim_rig(cells: Cells, place: Place) -> AsyncIterator[Rig[Any]]:
    """A device of a cell as a rig: cut is a power cut, mute a process that hangs. It is at rest before and after."""
    cells.boot(place)
    device = connect(cells, place)
    stopped: list[int] = []
    cut: list[int] = []

    def kill() -> None:
        cut.append(cells.pid(place))
        os.kill(cut[-1], signal.SIGKILL)

    def mute() -> None:
        stopped.append(cells.pid(place))
        os.kill(stopped[-1], signal.SIGSTOP)

    try:
        yield Rig(device, kill, mute, lambda: cells.at_rest(place))
    finally:
        for pid in stopped:
            os.kill(pid, signal.SIGCONT)
        await device.close()
        for pid in cut:
            wait_for(lambda pid=pid: not alive(pid), "the power cut")
        if not cut:
            await at_rest_again(connect(cells, place))


async def at_rest_again(device: Any) -> None:
    """Make safe; a process that hung for a while first works off what it was asked meanwhile."""
    async with asyncio.timeout(SOON_S):
        while True:
            try:
                await device.make_safe()
            except (LinkError, DeviceRefused):
                await asyncio.sleep(0.02)
            else:
                return


@pytest.fixture(params=[*ROBOTS, *ACTUATORS, *SPINDLES, *LOOKING], ids=str)
async def any_device(request: pytest.FixtureRequest, cells: Cells) -> AsyncIterator[Rig[Any]]:
    """Every device."""
    async with sim_rig(cells, request.param) as rig:
        yield rig


@pytest.fixture(params=ROBOTS, ids=str)
async def robot(request: pytest.FixtureRequest, cells: Cells) -> AsyncIterator[RobotRig]:
    """An open robot."""
    async with sim_rig(cells, request.param) as rig:
        await rig.device.open()
        yield rig


@pytest.fixture(params=ACTUATORS, ids=str)
async def actuator(request: pytest.FixtureRequest, cells: Cells) -> AsyncIterator[ActuatorRig]:
    """An open actuator."""
    async with sim_rig(cells, request.param) as rig:
        await rig.device.open()
        yield rig


@pytest.fixture(params=SPINDLES, ids=str)
async def spindle(request: pytest.FixtureRequest, cells: Cells) -> AsyncIterator[SpindleRig]:
    """An open spindle."""
    async with sim_rig(cells, request.param) as rig:
        await rig.device.open()
        yield rig


async def first(device: Any, condition: Callable[[Any], bool] = lambda one: True) -> Any:
    """The first sample of that kind."""
    async with asyncio.timeout(SOON_S):
        async for sample in device.samples():
            if condition(sample):
                return sample
    raise AssertionError("samples ended")


# every device: power cuts, and processes that hang


async def test_a_power_cut_is_known_at_once(any_device: Rig[Any]) -> None:
    await any_device.device.open()
    any_device.cut()
    with within(PROMPT_S), pytest.raises(LinkError):
        await until_lost(any_device.device.status)
    with within(BOUND_S), pytest.raises(LinkError):
        await any_device.device.make_safe()


@pytest.mark.one_of_each
async def test_a_process_that_hangs_is_known_at_once(any_device: Rig[Any]) -> None:
    await any_device.device.open()
    any_device.mute()
    with within(PROMPT_S), pytest.raises(LinkError):
        await until_lost(any_device.device.status)
    with within(BOUND_S), pytest.raises(LinkError):
        await any_device.device.make_safe()


@pytest.mark.one_of_each
async def test_a_device_that_was_booted_again_says_so(any_device: Rig[Any], cells: Cells, request: Any) -> None:
    place = request.node.callspec.params["any_device"]
    await any_device.device.open()
    before = await any_device.device.identify()
    any_device.cut()
    wait_for(lambda: not alive(cells.pid(place)), "the power cut")
    cells.boot(place)
    device = connect(cells, place)
    try:
        await device.open()
        after = await device.identify()
        assert (await device.status()).safe
    finally:
        await device.close()
    counted = place.cell not in UNCOUNTED and place.device != "spindle"  # a CANopen drive counts none
    assert after.boot_id != before.boot_id or not counted
    assert (after.vendor, after.model, after.serial) == (before.vendor, before.model, before.serial)


# the robot


async def executed(robot: Robot, count: int) -> list[ExecutedBlock]:
    """The first records."""
    found = []
    async with asyncio.timeout(SOON_S):
        async for one in robot.executed():
            found.append(one)
            if len(found) == count:
                break
    return found


# along the part, so that the actuator still finds it
LINES = [b"G21 G90 G94", b"G0 X0 Y0 Z0", *(b"G1 X%.1f Y%.1f F300" % (0.1 * k, -0.1 * k) for k in range(1, 60)), b"M2"]
SLOW = [line.replace(b"F300", b"F20") for line in LINES]
"""More than a second on the wall, so that it is not over before a busy machine has held it."""


@pytest.fixture
def slow(request: pytest.FixtureRequest) -> list[bytes]:
    """A program for the robot of this test, of blocks that last some tens of ms of the wall."""
    place: Place = request.node.callspec.params["robot"]
    if place.cell == "abb_rws":
        target = b"[[%.1f,0,0],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
        return [b"MoveL %b,v10\\T:=0.4,z1,tool0;" % (target % (0.4 * k)) for k in range(60)]
    if place.cell == "fanuc_rmi":
        moves = [f"L P[{k}] 0.4sec CNT100 ;" for k in range(1, 61)]
        return tp_program(*moves, x_mm=tuple(0.4 * k for k in range(1, 61)))
    if place.cell == "kuka_kvp":
        lines = [b"LIN {X %.2f,Y 0,Z 0,A 0,B 0,C 165}" % (0.4 * k) for k in range(58)]
        return [b"$VEL.CP=0.001", *lines, b"WAIT SEC 0.2"]
    if place.cell == "yaskawa_hses":
        points = [b"C%05d=%.1f,0,0,165,0,0" % (at, 0.4 * at) for at in range(2)]
        moves = [b"MOVL C%05d V=10.0 PL=0" % (at % 2) for at in range(50)]
        return [b"/JOB", b"//NAME POLISH", b"//POS", b"///RECTAN", *points, b"//INST", b"NOP", *moves, b"END"]
    if place.cell != "universal_robots":
        return SLOW
    return [b"movel(p[%.4f, 0, 0, 0, 3.14159, 0], a=5, v=0.001)" % (4e-4 * k) for k in range(60)]


async def test_the_robot_executes_all_in_order_and_once(robot: RobotRig, slow: list[bytes]) -> None:
    plan = plan_of(slow)
    await robot.device.prepare(plan)
    await robot.device.send(plan.segments)
    progress = await robot.device.progress()
    assert (progress.state, progress.accepted, progress.executed) == ("held", len(slow), 0)
    assert progress.program_sha256 == plan.program.sha256
    await robot.device.resume()
    found = [one async for one in robot.device.executed()]
    assert [one.seq for one in found] == list(range(len(slow)))
    assert all(a.end_s <= b.start_s + 1e-9 for a, b in pairwise(found))
    assert (await robot.device.progress()).state == "done"
    assert robot.safe()


@pytest.mark.parametrize("robot", ROBOTS[:1], ids=str, indirect=True)
async def test_blocks_last_as_long_as_the_machine_moves(robot: RobotRig) -> None:
    plan = plan_of(LINES)
    await robot.device.prepare(plan)
    await robot.device.send(plan.segments)
    await robot.device.resume()
    found = await executed(robot.device, len(LINES))
    # 0.1 mm a block both ways at 5 mm/s, and the machine's own overhead
    middle = [one.end_s - one.start_s for one in found[10:50]]
    assert sum(middle) / len(middle) == pytest.approx(0.1 * 2**0.5 / 5.0, abs=0.012)


async def test_the_robot_stops_where_it_is_reported_and_goes_on_from_there(robot: RobotRig, slow: list[bytes]) -> None:
    plan = plan_of(slow)
    await robot.device.prepare(plan)
    await robot.device.send(plan.segments)
    await robot.device.resume(until=20)
    assert [one.seq for one in await executed(robot.device, 20)] == list(range(20))
    await seen(robot.safe)
    assert (await robot.device.progress()).executed == 20
    await robot.device.resume()
    assert [one.seq for one in await executed(robot.device, len(slow))] == list(range(len(slow)))


async def test_the_robot_holds_and_resumes_without_losing_or_repeating(robot: RobotRig, slow: list[bytes]) -> None:
    plan = plan_of(slow)
    await robot.device.prepare(plan)
    await robot.device.send(plan.segments)
    await robot.device.resume()
    await executed(robot.device, 5)
    await robot.device.hold()
    held = await robot.device.progress()
    assert held.state == "held"
    assert 5 <= held.executed < len(slow)
    assert (await robot.device.status()).safe
    await robot.device.hold()
    assert (await robot.device.progress()).executed == held.executed
    await robot.device.resume()
    assert [one.seq for one in await executed(robot.device, len(slow))] == list(range(len(slow)))


@pytest.mark.one_of_each
@pytest.mark.parametrize("how", ["cut", "mute"])
async def test_all_who_wait_for_a_dead_robot_hear_of_it(robot: RobotRig, how: str, slow: list[bytes]) -> None:
    plan = plan_of(slow)
    await robot.device.prepare(plan)
    await robot.device.send(plan.segments)
    await robot.device.resume()
    await executed(robot.device, 1)
    getattr(robot, how)()
    with within(PROMPT_S):
        ends = await asyncio.gather(executed(robot.device, 99), until_lost(robot.device.status), return_exceptions=True)
    assert [type(end) for end in ends] == [LinkError, LinkError]
    assert robot.device.buffer_s == 0.0


@pytest.mark.parametrize("robot", ROBOTS[:1], ids=str, indirect=True)
@pytest.mark.parametrize(
    ("line", "why"),
    [(b"G1 X9999 F60", "limits"), (b"G1 X1 Z-50 F60", "limits"), (b"G2 X1 Y1 I1 F60", "syntax"), (b"G4 X1", "syntax")],
)
async def test_the_robot_refuses_what_it_cannot_do(robot: RobotRig, line: bytes, why: str) -> None:
    plan = plan_of([b"G21 G90 G94", line, b"M2"])
    await robot.device.prepare(plan)
    with pytest.raises(DeviceRefused, match=f"block 1.*{why}|{why}.*block 1"):
        await robot.device.send(plan.segments)
    assert robot.safe()


# the actuator


async def test_the_actuator_lands_regulates_and_lets_go(actuator: ActuatorRig) -> None:
    for force_n in (12.0, 6.5):
        began_s = time.monotonic()
        await actuator.device.set_force(force_n)
        sample: ForceSample = await first(actuator.device, lambda one, n=force_n: abs(one.force_n - n) < 0.05 * n)
        assert sample.in_contact
        assert not sample.retracted
        assert sample.setpoint_n == pytest.approx(force_n)
        assert sample.fault == 0
        assert began_s < sample.at_s <= time.monotonic()
    assert not (await actuator.device.status()).safe
    await actuator.device.set_force(0.0)
    assert (await first(actuator.device, lambda one: abs(one.force_n) < 0.1)).in_contact
    await actuator.device.retract()
    assert (await first(actuator.device)).retracted
    assert (await actuator.device.status()).safe
    assert actuator.safe()


async def test_make_safe_in_contact_takes_the_force_off_before_it_lifts(
    actuator: ActuatorRig, cells: Cells, request: Any
) -> None:
    place = request.node.callspec.params["actuator"]
    await actuator.device.set_force(12.0)
    before = len(cells.history(place))
    await actuator.device.make_safe()
    await actuator.device.make_safe()
    assert actuator.safe()
    events = [event["event"] for event in cells.history(place)[before:]]
    order = [name for name in events if name in {"force_zero", "tool_lifted", "retracted"}]
    assert order == ["force_zero", "tool_lifted", "retracted"]


async def test_an_actuator_without_a_controller_lets_go_alone(actuator: ActuatorRig) -> None:
    await actuator.device.set_force(12.0)
    await seen(actuator.safe)
    status = await actuator.device.status()
    assert (status.ready, status.detail) == (False, "watchdog ran out")
    with pytest.raises(DeviceRefused):
        await actuator.device.set_force(12.0)
    await actuator.device.make_safe()
    assert (await actuator.device.status()).ready


@pytest.mark.one_of_each
@pytest.mark.parametrize("how", ["cut", "mute"])
async def test_samples_of_a_dead_actuator_end_and_it_is_not_taken_up_again(actuator: ActuatorRig, how: str) -> None:
    await actuator.device.set_force(12.0)
    await first(actuator.device)
    getattr(actuator, how)()
    with within(PROMPT_S), pytest.raises(LinkError):
        await first(actuator.device, lambda one: False)
    for _ in range(2):
        with within(BOUND_S), pytest.raises(LinkError):
            await actuator.device.set_force(13.0)


# the spindle


async def test_the_spindle_runs_changes_and_stops(spindle: SpindleRig) -> None:
    for rpm in (600.0, -400.0):
        await spindle.device.set_speed(rpm)
        sample: SpeedSample = await first(spindle.device)
        assert sample.rpm == pytest.approx(rpm, rel=0.02)
        assert (sample.setpoint_rpm, sample.fault) == (rpm, 0)
    assert not (await spindle.device.status()).safe
    await spindle.device.set_speed(0.0)
    assert (await spindle.device.status()).safe
    assert spindle.safe()


@pytest.mark.full
async def test_the_spindle_refuses_what_its_drive_says_it_cannot(spindle: SpindleRig) -> None:
    with pytest.raises(DeviceRefused):
        await spindle.device.set_speed(3001.0)
    assert spindle.safe()


@pytest.mark.full
async def test_a_spindle_without_a_controller_stops_and_says_why(
    spindle: SpindleRig, cells: Cells, request: Any
) -> None:
    place = request.node.callspec.params["spindle"]
    await spindle.device.set_speed(500.0)
    before = len(cells.history(place))
    await seen(lambda: any(e["event"] == "watchdog" for e in cells.history(place)[before:]))
    fault = (await first(spindle.device, lambda one: one.fault != 0)).fault
    assert fault == (58 if place.cell == "profiles" else 0x8130), "the heartbeat is missing"
    await spindle.device.make_safe()
    assert (await first(spindle.device, lambda one: one.fault == 0)).rpm == 0.0


@pytest.mark.full
@pytest.mark.parametrize("how", ["cut", "mute"])
async def test_samples_of_a_dead_spindle_end(spindle: SpindleRig, how: str) -> None:
    await spindle.device.set_speed(500.0)
    await first(spindle.device)
    getattr(spindle, how)()
    with within(PROMPT_S), pytest.raises(LinkError):
        await first(spindle.device, lambda one: False)
