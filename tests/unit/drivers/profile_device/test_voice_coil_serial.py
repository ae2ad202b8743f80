"""The ASCII driver: numbers distinguish answers, and damaged ones are refused."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable
from pathlib import Path

import pytest

from polishd.api import ActuatorTimes, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.profile_device.drives import ProfiledActuator
from polishd.drivers.profile_device.links import LineWire
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.lines import NumberedLines
from tests.fakes.actuator import AsciiCoil, Coil
from tests.fakes.devices_by_profile import shipped, voice_coil_serial
from tests.fakes.wires import Once, PtyWire, TcpWire


class Rig:
    """A coil on a serial line, and its driver."""

    def __init__(self, path: Path) -> None:
        self.coil = Coil()
        self.peer = AsciiCoil(self.coil)
        self.line = PtyWire(self.peer, path)
        self.wire = LineWire(shipped("voice_coil_serial"), SerialLine(path), 0.3)
        self.device = ProfiledActuator(self.wire, ActuatorTimes())


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    rig = Rig(tmp_path / "line")
    await rig.device.open()
    yield rig
    await rig.device.close()
    await rig.line.close()


async def test_a_late_answer_is_dropped_and_costs_nothing(rig: Rig) -> None:
    kept: list[bytes] = []

    def keep(data: bytes) -> Iterable[bytes]:
        kept.append(data)
        return []

    rig.peer.filter = Once(keep)
    with pytest.raises(LinkError, match=r"no answer to ST\?"):
        await rig.device.status()
    assert rig.wire.connected
    rig.coil.boots = 78
    asyncio.get_running_loop().call_soon(rig.line.write, kept.pop())  # while the next question is asked
    assert (await rig.device.identify()).boot_id == "78"
    assert (await rig.device.status()).ready


async def test_a_doubled_answer_is_dropped(rig: Rig) -> None:
    rig.peer.filter = lambda data: [data, data]
    for _ in range(3):
        assert (await rig.device.status()).ready
        assert (await rig.device.identify()).vendor == "Fake Coils"


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(lambda data: [], id="none"),
        pytest.param(lambda data: [data.replace(b",", b";", 1)], id="broken"),
        pytest.param(lambda data: [data[:-6] + b"\r\n"], id="cut off"),
        pytest.param(lambda data: [b"$" * 500 + b"\n"], id="garbage"),
    ],
)
async def test_a_broken_answer_is_no_answer(rig: Rig, fault: Callable[[bytes], Iterable[bytes]]) -> None:
    rig.peer.filter = Once(fault)
    with pytest.raises(LinkError, match="answer"):
        await rig.device.set_force(12.0)
    assert [request for request in rig.peer.requests if request.startswith("F,")] == ["F,12.00"]
    assert (await rig.device.status()).ready


async def test_noise_between_answers_is_skipped(rig: Rig) -> None:
    rig.peer.filter = lambda data: [b"\x00\xff\r\n$99,OK*16\r\n$junk", data]
    await rig.device.set_force(12.0)
    await rig.device.retract()


async def test_a_sound_line_that_is_no_answer_is_a_protocol_error(rig: Rig) -> None:
    answer = rig.peer._answer
    rig.peer._answer = lambda request: "MAYBE" if request == "HB" else answer(request)  # type: ignore[method-assign]
    with pytest.raises(ProtocolError, match="'MAYBE'"):
        await rig.device.set_force(1.0)


async def test_refusals(rig: Rig) -> None:
    with pytest.raises(DeviceRefused, match="range"):
        await rig.wire.order("force", 60.0)
    rig.coil.fault = 2
    with pytest.raises(DeviceRefused, match="a fault is set"):
        await rig.wire.order("engage")


async def test_request_numbers_wrap(rig: Rig) -> None:
    lines = rig.wire._lines
    assert isinstance(lines, NumberedLines)
    lines._number = 0xFFFE
    for _ in range(4):
        await rig.device.status()
    assert lines._number == 2


async def test_a_hung_up_line_is_opened_again_out_of_contact(tmp_path: Path) -> None:
    path = tmp_path / "line"
    first = Rig(path)
    await first.device.open()
    first.line.cut()
    with pytest.raises(LinkError):
        await first.device.status()
    second = PtyWire(AsciiCoil(first.coil), path)
    assert (await first.device.status()).ready
    await first.device.close()
    await second.close()


async def test_it_works_behind_a_terminal_server() -> None:
    coil = Coil()
    wire = await TcpWire(AsciiCoil(coil)).start()
    device = voice_coil_serial(Tcp("127.0.0.1", wire.port))
    await device.open()
    await device.set_force(2.5)
    assert coil.setpoint_n == 2.5
    await device.make_safe()
    await device.close()
    await wire.close()
