"""ur_rtde, a client of others, beside our driver on the simulated controller: both must see the same machine.

It knows RTDE's own port only, so the cell takes 30004. ``requirements.txt`` says which version; it is in no other
environment.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from typing import Any

import pytest

from polishd.api import DeviceFault, ExecutedBlock, RobotTimes
from polishd.drivers.universal_robots.driver import Addresses, UniversalRobot
from polishd.drivers.universal_robots.rtde import UrRegisters
from polishd.drivers.universal_robots.script import Settings
from tests.interop.peers import Peer
from tests.programs import plan_of
from tests.system.sim_rig import Cell, cell
from tests.time_limits import SOON_S

PEER = Peer("ur_rtde", "RTDE", "client", "PyPI", "ur-rtde")
pytestmark = PEER.needed

HOST, RTDE, DASHBOARD, PRIMARY = "127.0.0.1", 30004, 29999, 30001
SIM = f"""
[plant]
aperture_mm = 40.0
speed = 1.0
[robot]
kind = "universal_robots"
port = {RTDE}
dashboard_port = {DASHBOARD}
primary_port = {PRIMARY}
"""
QUICK, SLOW = (
    [b"movel(p[%.3f, 0, 0.06, 3.14159, 0, 0], a=1, v=%g)" % (0.002 * at, speed) for at in range(1, 21)]
    for speed in (0.02, 0.004)
)
"""To their end in 2 s; and so slow that they are not over before the peer has acted."""
TIMES = RobotTimes(silence_s=3.0, watchdog_s=8.0)
RUNNING, NORMAL, STOPPED, PLAYING = 7, 1, 1, 2


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    for port in (RTDE, DASHBOARD, PRIMARY):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except OSError:
                pytest.skip(f"port {port}, which ur_rtde needs, is taken")
    with cell(tmp_path_factory.mktemp("ur"), SIM) as found:
        yield found


@pytest.fixture
async def robot(running: Cell) -> AsyncIterator[UniversalRobot]:
    device = UniversalRobot(Addresses.of(HOST, RTDE, DASHBOARD, PRIMARY), Settings(UrRegisters(), 8.0), TIMES)
    await device.open()
    yield device
    await device.make_safe()
    await device.close()


@pytest.fixture
def receive(running: Cell) -> Iterator[Any]:
    import rtde_receive

    client = rtde_receive.RTDEReceiveInterface(HOST, 125.0)
    yield client
    client.disconnect()


@pytest.fixture
def dashboard(running: Cell) -> Iterator[Any]:
    import dashboard_client

    client = dashboard_client.DashboardClient(HOST, DASHBOARD)
    client.connect()
    yield client
    client.disconnect()


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(SOON_S):
        while not condition():  # noqa: ASYNC110 -- ur_rtde has no events
            await asyncio.sleep(0.01)


async def load(robot: UniversalRobot, lines: Sequence[bytes] = SLOW) -> None:
    plan = plan_of(lines)
    await robot.prepare(plan)
    await robot.send(plan.segments)


async def executed(robot: UniversalRobot, count: int) -> list[ExecutedBlock]:
    found = []
    async for one in robot.executed():
        found.append(one)
        if len(found) == count:
            break
    return found


async def test_both_see_the_same_machine_at_rest_and_in_motion(robot: UniversalRobot, receive: Any) -> None:
    assert (receive.getRobotMode(), receive.getSafetyMode()) == (RUNNING, NORMAL)
    assert receive.getTargetSpeedFraction() == 1.0
    began_s = receive.getTimestamp()
    await load(robot, QUICK)
    await until(lambda: receive.getRuntimeState() == PLAYING)
    await robot.resume()
    blocks = await executed(robot, len(QUICK))
    await until(lambda: receive.getRuntimeState() == STOPPED)
    assert receive.getTargetTCPPose()[:3] == pytest.approx([0.040, 0.0, 0.060], abs=1e-6)
    assert max(map(abs, receive.getTargetTCPSpeed())) == 0.0
    took_s = blocks[-1].end_s - blocks[0].start_s
    assert 0.0 < took_s < receive.getTimestamp() - began_s


async def test_its_dashboard_reads_ours_and_stops_our_program(robot: UniversalRobot, dashboard: Any) -> None:
    assert dashboard.isConnected()
    assert not dashboard.running()
    assert dashboard.isInRemoteControl()
    assert "RUNNING" in dashboard.robotmode()
    assert "NORMAL" in dashboard.safetystatus()
    assert dashboard.getRobotModel() == "UR5"
    assert "5.11" in dashboard.polyscopeVersion()
    await load(robot)
    await robot.resume()
    await executed(robot, 2)
    assert dashboard.running()
    assert "PLAYING" in dashboard.programState()
    dashboard.stop()
    with pytest.raises(DeviceFault, match="stopped at the controller"):
        await executed(robot, len(SLOW))
    assert not dashboard.running()


async def test_a_slider_that_it_moves_is_noticed_by_us(robot: UniversalRobot, receive: Any) -> None:
    import rtde_io

    other = rtde_io.RTDEIOInterface(HOST, False, True)
    try:
        await load(robot)
        await robot.resume()
        await executed(robot, 2)
        assert other.setSpeedSlider(0.5)
        with pytest.raises(DeviceFault, match="speed slider is at 50 %"):
            await executed(robot, len(SLOW))
        await until(lambda: receive.getTargetSpeedFraction() == 0.5)
        assert not (await robot.status()).ready
        assert other.setSpeedSlider(1.0)
        await until(lambda: receive.getTargetSpeedFraction() == 1.0)
    finally:
        other.disconnect()


async def test_its_registers_and_ours_do_not_meet(robot: UniversalRobot) -> None:
    """It holds the upper range's last six; a program of ours runs beside it."""
    import rtde_io

    other = rtde_io.RTDEIOInterface(HOST, False, True)
    try:
        assert other.setInputIntRegister(43, 17)
        await load(robot, QUICK)
        await robot.resume()
        assert len(await executed(robot, len(QUICK))) == len(QUICK)
    finally:
        other.disconnect()
