"""fanuc-rmi, a client of others, on the simulated controller: motion, waits, frames, outputs, override and errors.

It knows the ports 16001 and 16002 only: it looks for ``Port`` in the answer to FRC_Connect, which the manual calls
``PortNumber``. Motion of joints is not simulated. ``requirements.txt`` says which version.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import socket
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.api import DeviceBusy, RobotTimes
from polishd.drivers.fanuc_rmi.driver import FanucRmi
from polishd.drivers.transport.address import Tcp
from tests.interop.peers import Peer
from tests.programs import plan_of
from tests.system.sim_rig import Cell, cell
from tests.unit.drivers.fanuc_rmi.test_program import program

PEER = Peer("fanuc-rmi", "FANUC RMI", "client", "PyPI", "fanuc-rmi")
pytestmark = PEER.needed

HOST, PORT = "127.0.0.1", 16001
SIM = f"""
[plant]
aperture_mm = 40.0
speed = 1.0
[robot]
kind = "fanuc_rmi"
port = {PORT}
session_port = {PORT + 1}
"""
TIMES = RobotTimes(silence_s=3.0, watchdog_s=60.0, held_instructions=8)
OVER = {"X": 10.0, "Y": 0.0, "Z": 60.0, "W": 180.0, "P": 0.0, "R": 0.0}


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    for port in (PORT, PORT + 1):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except OSError:
                pytest.skip(f"port {port}, which fanuc-rmi needs, is taken")
    with cell(tmp_path_factory.mktemp("fanuc"), SIM, "--only", "robot") as found:
        yield found


@pytest.fixture
def client(running: Cell) -> Iterator[Any]:
    import fanuc_rmi

    with contextlib.redirect_stdout(io.StringIO()):
        found = fanuc_rmi.RobotClient(host=HOST, socket_timeout=20.0, reader_timeout=20.0)
        found.connect()
        found.initialize(uframe=1, utool=1)
        yield found
        found.close()


@pytest.fixture
async def robot(running: Cell) -> AsyncIterator[FanucRmi]:
    device = FanucRmi(Tcp(HOST, PORT), TIMES)
    await device.open()
    yield device
    await device.make_safe()
    await device.close()


def where(client: Any, folder: Path) -> dict[str, float]:
    """Return the position that the client reads."""
    return dict(client.read_cartesian_coordinates(output_path=str(folder / "position.jsonl"))["Position"])


def test_its_moves_end_where_it_says_and_are_answered_when_they_are_executed(client: Any, tmp_path: Path) -> None:
    client.linear_absolute(OVER, speed=50, sequence_id=1, uframe=1, utool=1)
    found = where(client, tmp_path)
    assert {axis: found[axis] for axis in "XYZ"} == pytest.approx({"X": 10.0, "Y": 0.0, "Z": 60.0}, abs=1e-3)
    began_s = time.monotonic()
    step = {"X": 20.0, "Y": 0.0, "Z": 0.0, "W": 0.0, "P": 0.0, "R": 0.0}
    client.linear_relative(step, speed=20, sequence_id=2, uframe=1, utool=1)
    assert time.monotonic() - began_s >= 1.0
    assert where(client, tmp_path)["X"] == pytest.approx(30.0, abs=1e-3)


def test_a_wait_takes_its_time(client: Any) -> None:
    began_s = time.monotonic()
    client.wait_time(0.5, sequence_id=1)
    assert time.monotonic() - began_s >= 0.5


def test_a_wrong_sequence_number_is_refused_and_the_next_session_goes_on(client: Any, tmp_path: Path) -> None:
    before = where(client, tmp_path)
    client.linear_absolute(OVER, speed=50, sequence_id=7, uframe=1, utool=1)
    assert where(client, tmp_path) == before
    client.initialize(uframe=1, utool=1)  # resets


def test_frames_and_tools_are_written_and_read_back(client: Any) -> None:
    frame = {"X": 1.5, "Y": -2.0, "Z": 3.0, "W": 0.0, "P": 10.0, "R": 90.0}
    client.write_uframe_data(3, frame)
    assert client.read_uframe_data(3) == frame
    client.write_utool_data(2, frame)
    assert client.read_utool_data(2) == frame
    client.set_uframe_utool(3, 2)
    assert client.get_uframe_utool() == {"UFrameNumber": 3, "UToolNumber": 2}


def test_outputs_are_written_and_read_at_their_inputs(client: Any) -> None:
    assert client.write_dout(5, "ON")["ErrorID"] == 0
    assert client.read_din(5)["PortValue"] == 1
    assert client.write_dout(5, False)["ErrorID"] == 0
    assert client.read_din(5)["PortValue"] == 0
    assert client.read_din(9999)["ErrorID"] != 0


def test_an_override_that_it_sets_is_read_by_us(client: Any) -> None:
    client.speed_override(50)
    client.close()

    async def read() -> float | None:
        device = FanucRmi(Tcp(HOST, PORT), TIMES)
        await device.open()
        found = (await device.progress()).override
        await device.close()
        return found

    assert asyncio.run(read()) == 0.5
    client.connect()
    client.speed_override(100)


def test_its_session_keeps_us_out(client: Any) -> None:
    async def connect() -> None:
        await FanucRmi(Tcp(HOST, PORT), TIMES).open()

    with pytest.raises(DeviceBusy):
        asyncio.run(connect())


async def test_after_us_it_reads_where_our_program_ended(robot: FanucRmi, tmp_path: Path) -> None:
    plan = plan_of(program(*(f"L P[{number}] 50mm/sec CNT100 ;" for number in (1, 2, 3))))
    await robot.prepare(plan)
    await robot.send(plan.segments)
    await robot.resume()
    assert len([one async for one in robot.executed()]) == len(plan.segments)
    await robot.close()
    import fanuc_rmi

    def read() -> dict[str, float]:
        with contextlib.redirect_stdout(io.StringIO()):
            other = fanuc_rmi.RobotClient(host=HOST)
            other.connect()
            try:
                return where(other, tmp_path)
            finally:
                other.close()

    assert (await asyncio.to_thread(read))["X"] == pytest.approx(20.0, abs=1e-3)
