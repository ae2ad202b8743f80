"""yrcom, a client of Yaskawa's High-Speed Ethernet Server, beside our driver on the simulated controller.

``requirements.txt`` says which version; it is in no other environment. It reads the status of an answer one byte
further than the manual puts it, where the number of added words is (the public clients moto-hses and YaskawaRobot read
it as the manual says, and so do we): a refusal with a reason is status 1 without a reason to it, and one without a
reason is a success. Requests, numbers and data agree.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from polishd.api import DeviceFault, DeviceRefused
from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR, load_controller_profile
from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.hses import Hses
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.file_delivery import Folder
from tests.interop.peers import Peer
from tests.programs import plan_of
from tests.system.sim_rig import Cell, cell, wait_for

PEER = Peer("yrcom", "HSES", "client", "PyPI", "yrcom")
pytestmark = PEER.needed

SIM = """
[plant]
aperture_mm = 40.0
speed = 1.0
[robot]
kind = "hses"
port = 0
watchdog_s = 30.0
"""
PROFILE = load_controller_profile("yaskawa-hses", CONTROLLER_PROFILE_DIR)
HEAD = [b"/JOB", b"//NAME POLISH", b"//POS", b"///RECTAN", b"C00000=0,0,60,180,0,0", b"C00001=30,0,60,180,0,0"]
JOB = [*HEAD, b"//INST", b"NOP", b"MOVL C00000 V=20.0", b"MOVL C00001 V=2.0", b"TIMER T=0.50", b"END"]
QUICK = [line.replace(b"V=2.0", b"V=50.0") for line in JOB]
OPERATOR = [line.replace(b"POLISH", b"OTHER") for line in JOB]
REFUSED = 0x01
"""What yrcom takes for the status of a refusal with one word of reason."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("yaskawa"), SIM) as found:
        yield found


@pytest.fixture
def address(running: Cell) -> Tcp:
    host, _, port = running.endpoints["robot"].removeprefix("hses://").partition(":")
    return Tcp(host, int(port))


@pytest.fixture
async def robot(running: Cell, address: Tcp) -> AsyncIterator[PlcRobot]:
    make = lambda: Hses(address, PROFILE.variables, 10.0, 0.1)  # noqa: E731
    device = PlcRobot("simulated Yaskawa", PROFILE, make, Folder(running.state / "programs"))
    await device.open()
    yield device
    await device.make_safe()
    await device.close()


@pytest.fixture
def client(address: Tcp) -> Iterator[Any]:
    from yrcom import HsesClient

    with HsesClient(address.host, address.port, timeout=10.0) as found:
        yield found
        found.hold()
        wait_for(lambda: not found.read_status()["running"], "standstill")
        found.hold(on=False)


def refusal(call: Any, *arguments: Any) -> tuple[int, int]:
    """Status and added status that it reads in a refusal; (0, 0) where it reads none."""
    from yrcom import HsesError

    try:
        call(*arguments)
    except HsesError as error:
        return error.status, error.added
    return 0, 0


def test_it_reads_the_status_the_job_the_system_and_the_position(client: Any) -> None:
    status = client.read_status()
    on = {name for name, is_on in status.items() if is_on}
    assert on == {"one_cycle", "play", "cmd_remote", "servo_on"}
    job = client.read_job()
    assert (job["job_line"], job["job_step"], job["job_speed"]) == (0, 0, 10000)
    assert client.read_alarm()["alarm_type"] == 0
    assert client.read_system_info()["model"] == "polishd sim"
    position = client.read_position(101)
    assert (position["pos_X"], position["pos_Y"], position["pos_Z"]) == (0.0, 0.0, 60.0)
    assert abs(position["pos_Rx"]) == 180.0


def test_variables_that_it_writes_are_what_it_reads(client: Any) -> None:
    client.write_b_var(11, 200)
    client.write_i_var(11, -300)
    client.write_d_var(11, -70_000)
    client.write_r_var(11, 1.5)
    client.write_s_var(11, "Düse 3")
    assert (client.read_b_var(11), client.read_i_var(11), client.read_d_var(11)) == (200, -300, -70_000)
    assert (client.read_r_var(11), client.read_s_var(11)) == (1.5, "Düse 3")
    assert client.read_b_var(12) == 0


def test_it_selects_starts_holds_and_continues_a_job(client: Any, running: Cell) -> None:
    (running.state / "programs" / "OTHER.JBI").write_bytes(b"\r\n".join([*OPERATOR, b""]))
    client.select_job("OTHER")
    wait_for(lambda: client.read_job()["job_name"] == "OTHER", "the job is selected")
    client.start_job()
    wait_for(lambda: client.read_job()["job_line"] == 2, "the second move")
    assert client.read_job()["job_step"] == 2
    assert client.read_status()["running"]
    assert refusal(client.start_job)[0] == REFUSED
    client.hold()
    wait_for(lambda: not client.read_status()["running"], "standstill")
    held_at = client.read_position(101)["pos_X"]
    assert 0.0 < held_at < 30.0
    assert client.read_status()["hold_cmd"]
    assert refusal(client.start_job)[0] == REFUSED
    client.hold(on=False)
    client.start_job()
    wait_for(lambda: client.read_position(101)["pos_X"] > held_at, "it goes on")
    wait_for(lambda: client.read_status()["running"], "its report")


def test_an_alarm_that_it_resets(client: Any, running: Cell) -> None:
    (running.state / "programs" / "BAD.JBI").write_bytes(
        b"\r\n".join([b"/JOB", b"//NAME BAD", b"NOP", b"JUMP *A", b""])
    )
    client.select_job("BAD")
    wait_for(lambda: client.read_status()["alarm"], "the alarm")
    alarm = client.read_alarm()
    assert (alarm["alarm_code"], alarm["alarm_type"]) == (1, 1)
    assert "JUMP" in alarm["alarm_name"]
    assert refusal(client.start_job)[0] == REFUSED
    client.reset_alarm()
    client.cancel_error()
    wait_for(lambda: not client.read_status()["alarm"], "no alarm")


def test_where_it_reads_a_refusal_otherwise_than_the_manual(client: Any) -> None:
    """By the manual: 0x1f with 0x4040 (no such job), 0x28 (no such number), 0x08 (no such command)."""
    assert refusal(client.select_job, "NONE") == (REFUSED, 0)
    assert refusal(client.read_b_var, 100) == (0, 0)
    assert refusal(client.read_torque) == (0, 0)
    assert client.detect_model() == "yrc1000"


async def test_both_see_the_same_job_and_we_notice_what_it_does(robot: PlcRobot, client: Any) -> None:
    plan = plan_of(JOB)
    await robot.prepare(plan)
    await robot.send(plan.segments)
    assert await asyncio.to_thread(client.read_job) | {"job_step": 0} == {
        "job_name": "POLISH", "job_line": 0, "job_step": 0, "job_speed": 10000,
    }  # fmt: skip
    await robot.resume()
    async for one in robot.executed():
        if one.seq == JOB.index(b"NOP") + 1:
            break
    assert (await asyncio.to_thread(client.read_job))["job_line"] == 2
    assert (await asyncio.to_thread(client.read_d_var, 10)) > 0, "our heartbeat"
    await asyncio.to_thread(client.hold)
    with pytest.raises(DeviceFault, match="it was held at the controller"):
        _ = [one async for one in robot.executed(len(JOB) - 1)]


async def test_its_hold_ends_with_our_start(robot: PlcRobot, client: Any) -> None:
    await asyncio.to_thread(client.hold)
    plan = plan_of(QUICK)
    await robot.prepare(plan)
    await robot.send(plan.segments)
    await robot.resume()
    assert [one.seq async for one in robot.executed()] == list(range(len(QUICK)))
    with pytest.raises(DeviceRefused, match="the program is over"):
        await robot.resume()
