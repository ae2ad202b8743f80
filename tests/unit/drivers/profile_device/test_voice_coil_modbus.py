"""The Modbus driver against late, short, long, wrong and missing answers."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator, Iterable
from pathlib import Path

import pytest

from polishd.api import ActuatorTimes, DeviceFault, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.profile_device.drives import ProfiledActuator
from polishd.drivers.profile_device.links import ModbusWire
from polishd.drivers.transport.address import SerialLine, Tcp
from tests.fakes.actuator import Coil, ModbusCoil, crc16
from tests.fakes.devices_by_profile import shipped, voice_coil_modbus
from tests.fakes.wires import Once, PtyWire, TcpWire
from tests.time_limits import SOON_S, within
from tests.vectors import vectors

POLLED = shipped("voice_coil_modbus").polled


class Rig:
    """A coil on a serial line, and its driver."""

    def __init__(self, path: Path) -> None:
        self.coil = Coil()
        self.peer = ModbusCoil(self.coil, rtu=True)
        self.line = PtyWire(self.peer, path)
        self.wire = ModbusWire(shipped("voice_coil_modbus"), SerialLine(path), 1.0)
        self.device = ProfiledActuator(self.wire, ActuatorTimes(watchdog_s=1.0, landing_s=1.0, retract_s=0.5))

    def writes(self, register: int) -> list[int]:
        """What was written there."""
        pdus = [struct.unpack(">BHH", pdu) for pdu in self.peer.requests]
        return [value for function, address, value in pdus if (function, address) == (6, register)]


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    rig = Rig(tmp_path / "line")
    await rig.device.open()
    yield rig
    await rig.device.close()
    await rig.line.close()


def sealed(body: bytes) -> bytes:
    return body + struct.pack("<H", crc16(body))


async def test_requests_are_the_vectors(rig: Rig) -> None:
    received: list[bytes] = []
    answer = rig.peer.on_bytes
    rig.peer.on_bytes = lambda data: (received.append(data), answer(data))[1]  # type: ignore[method-assign]
    await rig.wire.order("force", 12.0)
    await rig.wire.read(POLLED)
    lines = vectors("voice_coil_modbus")
    assert b"".join(received).hex() == lines["write_setpoint"] + lines["read_inputs"]


async def test_the_answer_vector_is_read(rig: Rig) -> None:
    rig.peer.filter = lambda data: [bytes.fromhex(vectors("voice_coil_modbus")["inputs"])]
    values = await rig.wire.read(POLLED)
    assert (values["force"], values["set_point"], values["position"]) == (11.98, 12.0, 5.0)


@pytest.mark.full
async def test_a_late_answer_is_not_the_next_ones(rig: Rig) -> None:
    kept: list[bytes] = []

    def keep(data: bytes) -> Iterable[bytes]:
        kept.append(data)
        return []

    rig.peer.filter = Once(keep)
    with pytest.raises(LinkError):
        await rig.device.status()  # its answer will say: retracted, set point 0
    asyncio.get_running_loop().call_soon(rig.line.write, kept.pop())  # when the next question is to be asked
    rig.coil.setpoint_n, rig.coil.boots = 9.0, 77
    assert (await rig.device.identify()).boot_id == "77"
    assert (await rig.wire.read(POLLED))["set_point"] == 9.0


@pytest.mark.full
async def test_a_write_is_not_repeated(rig: Rig) -> None:
    rig.peer.filter = Once(lambda data: [])
    with pytest.raises(LinkError):
        await rig.device.set_force(12.0)
    assert rig.writes(1) == [1200]
    assert rig.writes(0) == []
    assert (await rig.device.status()).ready


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(lambda data: [sealed(b"\x01\x04\x00")], id="empty"),
        pytest.param(lambda data: [sealed(data[:2] + b"\x0a" + data[3:-4])], id="short"),
        pytest.param(lambda data: [sealed(data[:2] + b"\x0e" + data[3:-2] + b"\0\0")], id="long"),
        pytest.param(lambda data: [sealed(b"\x01\x03" + data[2:-2])], id="other function"),
        pytest.param(lambda data: [sealed(b"\x01\x06\0\0\0\0")], id="answer to a write"),
        pytest.param(lambda data: [data[:-1] + bytes([data[-1] ^ 1])], id="wrong CRC"),
        pytest.param(lambda data: [sealed(b"\x02" + data[1:-2])], id="other unit"),
        pytest.param(lambda data: [data[:7]], id="cut off"),
        pytest.param(lambda data: [b"\xff" * 300], id="garbage"),
    ],
)
async def test_nonsense_is_never_a_reading(rig: Rig, fault: Once) -> None:
    rig.peer.filter = Once(fault)
    with pytest.raises((LinkError, ProtocolError)):
        await rig.device.status()
    status = await rig.device.status()
    assert (status.state, status.ready) == ("retracted", True)


@pytest.mark.parametrize(
    "echo", [b"\x01\x06\x00\x01\x04\xb1", b"\x01\x06\x00\x02\x04\xb0", b"\x01\x10\x00\x01\x00\x01"]
)
async def test_a_wrong_echo_is_a_protocol_error(rig: Rig, echo: bytes) -> None:
    rig.peer.filter = Once(lambda data: [sealed(echo)])
    with pytest.raises(ProtocolError, match="was answered by"):
        await rig.device.set_force(12.0)


async def test_a_stale_heartbeat_is_a_protocol_error(rig: Rig) -> None:
    await rig.wire.order("heartbeat")
    rig.coil.heartbeat = 60_000
    with pytest.raises(ProtocolError, match="heartbeat echo 60000"):
        await rig.wire.read(POLLED)
    assert not rig.wire.connected


async def test_dribbled_answers_are_read(rig: Rig) -> None:
    rig.peer.filter = lambda data: [data[at : at + 1] for at in range(len(data))]
    assert (await rig.device.status()).ready
    await rig.device.set_force(5.0)
    await rig.device.retract()


async def test_exceptions_are_refusals(rig: Rig) -> None:
    with pytest.raises(DeviceRefused, match="exception 3, value out of range"):
        await rig.wire.order("watchdog", 7)
    rig.coil.fault = 2
    with pytest.raises(DeviceRefused, match="exception 4"):
        await rig.wire.order("engage")
    assert rig.wire.connected


async def test_the_watchdog_time_is_written(tmp_path: Path) -> None:
    coil = Coil()
    line = PtyWire(ModbusCoil(coil, rtu=True), tmp_path / "line")
    device = voice_coil_modbus(SerialLine(line.path), ActuatorTimes(watchdog_s=1.5))
    await device.open()
    assert coil.watchdog_ms == 1500
    coil.watchdog_ms = 500  # a power cycle
    line.peer.filter = Once(lambda data: [])
    with pytest.raises(LinkError):
        await device.status()
    await device.status()
    assert coil.watchdog_ms == 1500
    await device.close()
    await line.close()


async def test_other_units_do_not_answer(tmp_path: Path) -> None:
    line = PtyWire(ModbusCoil(Coil(), rtu=True, unit=9), tmp_path / "line")
    with pytest.raises(LinkError):
        await voice_coil_modbus(SerialLine(line.path), unit=8).open()
    device = voice_coil_modbus(SerialLine(line.path), unit=9)
    await device.open()
    await device.close()
    await line.close()


async def test_silence_in_contact_loses_the_link_but_not_the_way_to_safety(rig: Rig) -> None:
    await rig.device.set_force(12.0)
    rig.peer.filter = Once(lambda data: [])
    with pytest.raises(LinkError):
        await rig.device.status()
    asked = len(rig.peer.requests)
    for call in (rig.device.status, rig.device.identify, lambda: rig.device.set_force(13.0)):
        with pytest.raises(LinkError, match="only retracting"):
            await call()
    assert len(rig.peer.requests) == asked
    await rig.device.retract()
    assert rig.coil.state == 0
    assert (await rig.device.status()).safe


async def test_make_safe_gets_through_one_lost_answer(rig: Rig) -> None:
    await rig.device.set_force(12.0)
    rig.peer.filter = Once(lambda data: [])
    await rig.device.make_safe()
    assert rig.coil.state == 0
    assert rig.writes(0)[-1] == 0


async def test_an_engage_of_unknown_outcome_counts_as_contact(rig: Rig) -> None:
    lost = Once(lambda data: [])
    rig.peer.filter = lambda data: lost(data) if data[:4] == b"\x01\x06\x00\x00" else [data]
    with pytest.raises(LinkError):
        await rig.device.set_force(12.0)
    with pytest.raises(LinkError, match="only retracting"):
        await rig.device.status()
    await rig.device.make_safe()
    assert rig.coil.state == 0


async def test_retracting_waits_for_one_other_request_at_most(rig: Rig) -> None:
    await rig.device.set_force(12.0)
    polls = [asyncio.create_task(rig.device.status()) for _ in range(50)]
    await asyncio.sleep(0)
    before = len(rig.peer.requests)
    await rig.device.retract()
    first_write = next(at for at, pdu in enumerate(rig.peer.requests[before:]) if pdu[:3] == b"\x06\0\0")
    assert first_write <= 1
    await asyncio.gather(*polls)


@pytest.mark.full
async def test_a_stuck_tool_is_a_fault(rig: Rig) -> None:
    await rig.device.set_force(12.0)
    rig.coil.stuck = True
    with within(1.5), pytest.raises(DeviceFault, match=r"not retracted after 0\.7 s"):
        await rig.device.make_safe()
    rig.coil.fault = 4
    with pytest.raises(DeviceFault, match="drive"):
        await rig.device.retract()


async def test_no_contact_is_a_fault(rig: Rig) -> None:
    rig.coil.stuck = True
    with pytest.raises(DeviceFault, match="no contact after 1 s"):
        await rig.device.set_force(12.0)
    assert not rig.coil.fault, "the watchdog was fed meanwhile"
    rig.coil.stuck = False
    await rig.device.make_safe()


async def landing_begun(rig: Rig) -> asyncio.Task[None]:
    """The landing, of which the coil has the order."""
    landing = asyncio.create_task(rig.device.set_force(12.0))
    async with asyncio.timeout(SOON_S):
        while not rig.coil.command:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    return landing


async def test_retracting_ends_a_landing(rig: Rig) -> None:
    rig.coil.stuck = True
    landing = await landing_begun(rig)
    await rig.device.retract()
    with pytest.raises(DeviceRefused, match="retracted while landing"):
        await landing


async def test_a_fault_while_landing(rig: Rig) -> None:
    rig.coil.stuck = True
    landing = await landing_begun(rig)
    rig.coil.fault = 8
    with pytest.raises(DeviceFault, match=r"fault 8 while landing \(encoder"):
        await landing


async def test_a_tcp_link_that_was_cut_is_taken_up_again_out_of_contact() -> None:
    coil = Coil()
    wire = await TcpWire(ModbusCoil(coil, rtu=False)).start()
    device = voice_coil_modbus(Tcp("127.0.0.1", wire.port))
    await device.open()
    wire.drop()
    await asyncio.sleep(0.02)
    assert (await device.status()).ready
    await device.set_force(3.0)
    wire.drop()
    await asyncio.sleep(0.02)
    with pytest.raises(LinkError, match="only retracting"):
        await device.status()
    await device.make_safe()
    assert coil.state == 0
    await device.close()
    await wire.close()
