"""Messages for a device that does not answer, or not as its profile says: one line, and what to do."""

from __future__ import annotations

import termios
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from polishd.api import DeviceError, LinkError, ProtocolError
from polishd.commissioning.device_profiles import TEMPLATES, _try_all
from polishd.config.device_profile_checks import device_profile_of
from polishd.drivers.profile_device import build
from polishd.drivers.profile_device.drives import ProfiledActuator, ProfiledSpindle
from polishd.drivers.transport import streams
from polishd.drivers.transport.address import SerialLine, Tcp
from tests.fakes.devices_by_profile import file_of, shipped
from tests.fakes.profiled import ProfiledPeer, gauge, inverter
from tests.fakes.wires import PtyWire, TcpWire

BAUD = {9600: termios.B9600, 19_200: termios.B19200}


class Bench:
    """An inverter at 9600 baud, unit 1, on a serial line: what comes at another rate it does not understand."""

    def __init__(self, path: Path) -> None:
        self.peer = ProfiledPeer(file_of("delta_ms300"), inverter)
        self.wire = PtyWire(self.peer, path)
        answer = self.peer.on_bytes
        self.peer.on_bytes = lambda data: answer(data) if self.tuned else None  # type: ignore[method-assign]

    @property
    def tuned(self) -> bool:
        return termios.tcgetattr(self.wire._slave)[4] == BAUD[9600]

    def spindle(self, name: str = "delta_ms300", *, unit: int = 1, **line: object) -> ProfiledSpindle:
        address = SerialLine(self.wire.path, **{"baud": 9600, **line})
        return build.spindle(shipped(name), address, unit=unit)

    async def message(self, device: ProfiledSpindle | ProfiledActuator) -> str:
        """What opening it says."""
        with pytest.raises(DeviceError) as error:
            await device.open()
        return str(error.value).replace(str(self.wire.path), "PORT")


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    bench = Bench(tmp_path / "port")
    yield bench
    await bench.wire.close()


async def test_it_answers_as_it_should(bench: Bench) -> None:
    device = bench.spindle()
    await device.open()
    await device.close()


async def test_the_wrong_baud_rate(bench: Bench) -> None:
    assert await bench.message(bench.spindle(baud=19_200)) == (
        "serial:PORT unit 1: no answer within 0.8 s at 19200 8N1. Check power, baud rate, parity and unit number."
    )


async def test_the_wrong_parity(bench: Bench) -> None:
    bench.peer.silent = True  # a terminal has no parity: a device that receives nothing valid is silent
    assert "no answer within 0.8 s at 9600 8E1" in await bench.message(bench.spindle(parity="even"))


async def test_the_wrong_unit(bench: Bench) -> None:
    said = await bench.message(bench.spindle(unit=7))
    assert said.startswith("serial:PORT unit 7: no answer within 0.8 s at 9600 8N1.")


async def test_bytes_that_are_no_answer(bench: Bench) -> None:
    bench.peer.filter = lambda data: [bytes(byte << 1 & 0xFF | 1 for byte in data)]
    said = await bench.message(bench.spindle())
    assert "bytes within 0.8 s at 9600 8N1 are not an answer" in said
    assert said.endswith("Check baud rate, parity and stop bits.")


async def test_the_profile_of_another_device(bench: Bench) -> None:
    address = SerialLine(bench.wire.path, 9600)
    said = await bench.message(build.actuator(shipped("voice_coil_modbus"), address))
    assert said == "serial:PORT unit 1: exception 2, address not known; is it another device?"
    assert not any(request[1] in {5, 6, 15, 16} for request in bench.peer.requests), "and nothing was written to it"


async def test_a_device_that_is_not_the_expected_one(bench: Bench) -> None:
    text = file_of("delta_ms300").read_text() + '\n[[expects]]\nwhen = "commanded"\nequals = [4242]\n'
    profile = device_profile_of(text, Path("mine.toml"))
    said = await bench.message(build.spindle(profile, SerialLine(bench.wire.path, 9600)))
    assert "another device answers: its commanded reads 0.0, which is not what profile 'mine' expects" in said
    assert not any(request[1] in {5, 6, 15, 16} for request in bench.peer.requests), "and nothing was written to it"


async def test_the_wrong_word_order(tmp_path: Path) -> None:
    path = tmp_path / "floats.toml"
    path.write_text(
        (TEMPLATES / "force_sensor_modbus.toml").read_text().replace('"i32"', '"f32"').replace("scale = 0.01", "")
    )
    wire = await TcpWire(ProfiledPeer(path, gauge(lambda: 12.34), tcp=True)).start()
    swapped = path.read_text().replace('word_order = "high_first"', 'word_order = "low_first"')
    profile = device_profile_of(swapped, path)
    device = build.force_sensor(profile, Tcp("127.0.0.1", wire.port))
    with pytest.raises(ProtocolError, match=r"see word order, scale and whether it is this device$"):
        await device.open()
    right = build.force_sensor(device_profile_of(path.read_text(), path), Tcp("127.0.0.1", wire.port))
    await right.open()
    await right.close()
    await wire.close()


async def test_a_port_that_is_open_elsewhere(bench: Bench) -> None:
    first = bench.spindle()
    await first.open()
    said = await bench.message(bench.spindle())
    assert said == "serial:PORT: another program has the port open. End that program (lsof names it)."
    await first.close()


async def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    device = build.spindle(shipped("delta_ms300"), SerialLine(tmp_path / "none"))
    with pytest.raises(LinkError, match="none: the port does not exist"):
        await device.open()


async def test_a_path_that_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LinkError, match="it is not a serial port"):
        await build.spindle(shipped("delta_ms300"), SerialLine(tmp_path / "file")).open()


async def test_a_port_that_may_not_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_args: object, **_options: object) -> None:
        raise PermissionError(13, "could not open port: Permission denied")

    monkeypatch.setattr(streams.serial, "Serial", type("Serial", (), {"__init__": forbidden, "close": None}))
    with pytest.raises(LinkError, match="no permission to open the port"):
        await build.spindle(shipped("delta_ms300"), SerialLine(tmp_path / "port")).open()


async def test_a_gateway_whose_device_is_dead() -> None:
    peer = ProfiledPeer(file_of("hitachi_wj200"), inverter, tcp=True)
    wire = await TcpWire(peer).start()
    peer.filter = lambda data: [data[:5] + b"\x03" + data[6:7] + bytes([data[7] | 0x80, 11])]
    with pytest.raises(LinkError, match="the gateway answers, its unit 1 does not"):
        await build.spindle(shipped("hitachi_wj200"), Tcp("127.0.0.1", wire.port)).open()
    await wire.close()


async def test_something_else_on_the_tcp_port() -> None:
    peer = ProfiledPeer(file_of("hitachi_wj200"), inverter, tcp=True)
    wire = await TcpWire(peer).start()
    peer.filter = lambda data: [b"HTTP/1.1 400 Bad Request\r\n\r\n"]
    with pytest.raises(DeviceError, match="is not Modbus TCP"):
        await build.spindle(shipped("hitachi_wj200"), Tcp("127.0.0.1", wire.port)).open()
    await wire.close()


async def test_a_closed_tcp_port() -> None:
    with pytest.raises(LinkError, match="the port is closed"):
        await build.spindle(shipped("hitachi_wj200"), Tcp("127.0.0.1", 1)).open()


async def test_find_tells_the_settings_at_which_it_answers(bench: Bench) -> None:
    profile = shipped("delta_ms300")
    places = [
        (SerialLine(bench.wire.path, 19_200), 1),
        (SerialLine(bench.wire.path, 9600), 3),
        (SerialLine(bench.wire.path, 9600), 1),
    ]
    messages: list[str] = []
    found = await _try_all(profile, places, 0.3, messages.append)
    assert len(messages) == 3
    ((where, says),) = found
    assert where.endswith("port?baud=9600&parity=none&stop_bits=1, unit 1")
    assert says == "answers as in profile 'delta_ms300'"
    assert not any(request[1] in {5, 6, 15, 16} for request in bench.peer.requests), "it reads only"
