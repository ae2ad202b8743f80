"""py_openshowvar, a client of KUKAVARPROXY, beside our driver on the simulated controller: both see the same machine.

``requirements.txt`` says which version; it is in no other environment. It reads at most 256 bytes of an answer, and
expects each answer in one piece.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from polishd.api import DeviceFault, DeviceRefused, RobotTimes
from polishd.drivers.kuka_kvp.driver import KukaRobot
from polishd.drivers.transport.address import Tcp, parse_address
from polishd.drivers.transport.file_delivery import Folder
from tests.interop.peers import Peer
from tests.programs import plan_of
from tests.system.sim_rig import Cell, cell
from tests.time_limits import SOON_S

PEER = Peer("py_openshowvar", "KUKAVARPROXY", "client", "PyPI", "py-openshowvar")
pytestmark = PEER.needed

SIM = """
[plant]
aperture_mm = 40.0
speed = 1.0
[robot]
kind = "kuka_kvp"
port = 0
"""
SLOW = [b"$VEL.CP=0.005", *(b"LIN {X %d,Y 0,Z 60,A 0,B 0,C 180}" % (2 * at) for at in range(1, 16))]
TIMES = RobotTimes(silence_s=3.0, watchdog_s=8.0, lifts=False)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("kuka"), SIM) as found:
        yield found


@pytest.fixture
def address(running: Cell) -> Tcp:
    found = parse_address(running.endpoints["robot"], running.state)
    assert isinstance(found, Tcp)
    return found


@pytest.fixture
async def robot(running: Cell, address: Tcp) -> AsyncIterator[KukaRobot]:
    folder = Folder(running.state / "programs")
    device = KukaRobot(address, folder, "/R1/PROGRAM/", TIMES, poll_s=0.01, load_s=10.0)
    await device.open()
    yield device
    await device.make_safe()
    await device.close()


@pytest.fixture
def client(address: Tcp) -> Iterator[Any]:
    from py_openshowvar import openshowvar

    found = openshowvar(address.host, address.port)
    assert found.read("PING", debug=False) == b"PONG"  # its can_connect leaves a socket open
    yield found
    found.close()


async def shows(client: Any, name: str, value: bytes) -> None:
    async with asyncio.timeout(SOON_S):
        while client.read(name, debug=False) != value:  # noqa: ASYNC110 -- KUKAVARPROXY sends no events
            await asyncio.sleep(0.02)


async def load(robot: KukaRobot) -> None:
    plan = plan_of(SLOW)
    await robot.prepare(plan)
    await robot.send(plan.segments)


async def executed(robot: KukaRobot, count: int) -> int:
    found = 0
    async for _ in robot.executed():
        found += 1
        if found == count:
            break
    return found


def test_it_reads_values_of_each_type_and_nothing_that_is_not_there(client: Any) -> None:
    def read(name: str) -> bytes | None:
        found: bytes | None = client.read(name, debug=False)
        return found

    assert (read("$OV_PRO"), read("$MODE_OP"), read("$PERI_RDY")) == (b"100", b"#AUT", b"TRUE")
    position = read("$POS_ACT")
    assert position is not None
    assert position.startswith(b"{E6POS: X 0, Y 0, Z 60")
    assert read("$ROBNAME[]") == b'"polishd"'
    assert read("NOWHERE") is None
    assert client.write("NOWHERE", "1", debug=False) is None


async def test_it_follows_our_program_from_selection_to_end(robot: KukaRobot, client: Any) -> None:
    await load(robot)
    await shows(client, "$PRO_STATE1", b"#P_ACTIVE")
    assert client.read("$PRO_NAME1[]", debug=False) == b'"POLISHD"'
    assert client.read("$ROB_STOPPED", debug=False) == b"TRUE"
    await robot.resume()
    await executed(robot, 3)
    assert client.read("$ROB_STOPPED", debug=False) == b"FALSE"
    assert 2 <= int(client.read("POLISHD_BLOCK", debug=False)) < len(SLOW)
    assert await executed(robot, len(SLOW)) == len(SLOW)
    await shows(client, "$PRO_STATE1", b"#P_END")
    assert client.read("$POS_ACT", debug=False).startswith(b"{E6POS: X 30, Y ")


async def test_an_override_that_it_writes_is_noticed_by_us(robot: KukaRobot, client: Any) -> None:
    await load(robot)
    await robot.resume()
    await executed(robot, 3)
    assert client.write("$OV_PRO", "50", debug=False) == b"50"
    with pytest.raises(DeviceFault, match="override is at 50 %"):
        await executed(robot, len(SLOW))
    await robot.make_safe()
    with pytest.raises(DeviceRefused, match="override is at 50 %"):
        await load(robot)
    assert client.write("$OV_PRO", "100", debug=False) == b"100"
    await shows(client, "$OV_PRO", b"100")


async def test_without_our_heartbeat_the_watchdog_stops_what_it_sees_moving(robot: KukaRobot, client: Any) -> None:
    assert client.write("POLISHD_TRIPPED", "FALSE", debug=False) == b"FALSE"
    await load(robot)
    await robot.resume()
    await executed(robot, 2)
    assert client.write("POLISHD_LIMIT", "10", debug=False) == b"10"
    with pytest.raises(DeviceFault):
        await executed(robot, len(SLOW))
    await shows(client, "$PRO_STATE1", b"#P_STOP")
    assert client.read("POLISHD_TRIPPED", debug=False) == b"TRUE"
