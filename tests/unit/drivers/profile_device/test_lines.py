"""Plain lines bear no numbers: what is late, stale or broken is never taken for an answer."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import aclosing
from pathlib import Path

import pytest

from polishd.api import ActuatorTimes, DeviceFault, DeviceRefused, LinkError, ProtocolError, SensorTimes
from polishd.config.device_profile_checks import device_profile_of
from polishd.drivers.profile_device import build
from polishd.drivers.profile_device.drives import ProfiledActuator
from polishd.drivers.profile_device.links import LineWire
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.sim_backends.profile_device.device import Gauge
from tests.fakes.devices_by_profile import file_of, shipped
from tests.fakes.profiled import IdealDrive, ProfiledPeer, gauge
from tests.fakes.wires import Once, PtyWire, TcpWire

DRIVE = shipped("line_drive.toml")


class Rig:
    """A line drive, and its driver."""

    def __init__(self, path: Path) -> None:
        self.peer = ProfiledPeer(file_of("line_drive.toml"), IdealDrive)
        self.line = PtyWire(self.peer, path)
        self.wire = LineWire(DRIVE, SerialLine(path), 0.8)
        self.device = ProfiledActuator(self.wire, ActuatorTimes(watchdog_s=1.0, landing_s=1.0, retract_s=0.5))

    @property
    def coil(self) -> IdealDrive:
        assert isinstance(self.peer.machine, IdealDrive)
        return self.peer.machine

    def received(self, start: bytes) -> list[bytes]:
        """Requests that begin like that."""
        return [request for request in self.peer.requests if request.startswith(start)]


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    rig = Rig(tmp_path / "line")
    await rig.device.open()
    yield rig
    await rig.device.close()
    await rig.line.close()


async def test_what_is_sent_is_what_the_page_says(rig: Rig) -> None:
    await rig.device.set_force(12.0)
    await rig.device.retract()
    sent = list(dict.fromkeys(rig.peer.requests))
    assert sent == [b"?\r\n", b"W1000\r\n", b"F12.00\r\n", b"R\r\n"]


async def test_a_late_answer_is_not_the_next_ones(rig: Rig) -> None:
    kept: list[bytes] = []

    def keep(data: bytes) -> Iterable[bytes]:
        kept.append(data)
        return []

    rig.peer.filter = Once(keep)
    with pytest.raises(LinkError, match=r"no answer to '\?' within 0\.8 s at 115200 8N1"):
        await rig.device.status()
    assert not rig.wire.connected
    rig.line.write(b"C 40.00 5.000 0\r\n")  # while the line is closed
    assert (await rig.device.status()).state == "retracted"


async def test_what_came_before_the_question_is_no_answer(rig: Rig) -> None:
    rig.peer.filter = Once(lambda data: [data, b"C 40.00 5.000 0\r\nOK\r\n"])
    for _ in range(3):
        assert (await rig.device.status()).state == "retracted"


async def test_a_write_is_not_repeated(rig: Rig) -> None:
    lost = Once(lambda data: [])
    rig.peer.filter = lambda data: lost(data) if data.startswith(b"OK") else [data]
    with pytest.raises(LinkError):
        await rig.device.set_force(12.0)
    assert len(rig.received(b"F")) == 1
    with pytest.raises(LinkError, match="only retracting opens the link again"):
        await rig.device.status()
    await rig.device.make_safe()
    assert rig.coil.state() == "retracted"


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(lambda data: [b"OK\r\n"], id="another answer"),
        pytest.param(lambda data: [b"C 40.00 5.000\r\n"], id="cut off"),
        pytest.param(lambda data: [data.replace(b".", b",")], id="other decimals"),
        pytest.param(lambda data: [b"\xff" * 600 + b"\n"], id="garbage"),
        pytest.param(lambda data: [data[:-1]], id="no end"),
        pytest.param(lambda data: [b"U nan 0.000 0\r\n"], id="no number"),
        pytest.param(lambda data: [b"U 400.00 0.000 0\r\n"], id="cannot be"),
    ],
)
async def test_nonsense_is_never_a_reading(rig: Rig, fault: Callable[[bytes], Iterable[bytes]]) -> None:
    rig.peer.filter = Once(fault)
    with pytest.raises((LinkError, ProtocolError)):
        await rig.device.status()
    assert (await rig.device.status()).ready


async def test_dribbled_answers_are_read(rig: Rig) -> None:
    rig.peer.filter = lambda data: [data[at : at + 1] for at in range(len(data))]
    await rig.device.set_force(5.0)
    await rig.device.retract()


async def test_refusals_say_why(rig: Rig) -> None:
    with pytest.raises(DeviceRefused, match=r"F60\.00 was refused: range,value out of range"):
        await rig.wire.order("force", 60.0)
    assert rig.wire.connected


async def test_over_a_fault_it_does_not_engage(rig: Rig) -> None:
    rig.coil.coil.fault = 1
    with pytest.raises(DeviceRefused, match=r"does not press over fault 1 \(watchdog ran out\)"):
        await rig.device.set_force(5.0)
    assert not rig.received(b"F"), "nothing was sent"
    await rig.device.make_safe()
    await rig.device.set_force(5.0)
    await rig.device.retract()


async def test_a_value_that_only_some_answers_have_is_reported(tmp_path: Path) -> None:
    text = file_of("line_drive.toml").read_text().replace(r"(?P<fault>\d+)'", r"?(?P<fault>\d+)?'")
    profile = device_profile_of(text, Path("mine.toml"))
    peer = ProfiledPeer(file_of("line_drive.toml"), IdealDrive)
    wire = PtyWire(peer, tmp_path / "line")
    peer.filter = lambda data: [data.replace(b" 0\r", b"\r")]
    device = build.actuator(profile, SerialLine(wire.path))
    with pytest.raises(ProtocolError, match="no answer says 'fault'; see asks in profile 'mine'"):
        await device.open()
    await wire.close()


async def test_a_stuck_tool_is_a_fault(rig: Rig) -> None:
    rig.coil.coil.stuck = True
    with pytest.raises(DeviceFault, match="no contact after 1 s"):
        await rig.device.set_force(12.0)
    rig.coil.coil.stuck = False
    await rig.device.make_safe()


# commands without answer, and a sensor


async def test_a_gauge_is_read_and_zeroed() -> None:
    pressed = [0.7]
    peer = ProfiledPeer(file_of("mark10_series5"), gauge(lambda: pressed[0]))
    wire = await TcpWire(peer).start()
    device = build.force_sensor(shipped("mark10_series5"), Tcp("127.0.0.1", wire.port), SensorTimes(1.0))
    await device.open()
    await device.tare()
    pressed[0] = 12.7
    async for one in device.samples():
        assert (one.at_s > 0.0, round(one.force_n, 3), one.fault) == (True, 12.0, 0)
        break
    identity = await device.identify()
    assert (identity.vendor, identity.model, identity.serial) == ("Mark-10", "F-1", "42")
    assert (await device.status()).ready
    await device.close()
    await wire.close()


async def test_a_sensor_that_is_unplugged_is_read_again_once_it_is_back() -> None:
    peer = ProfiledPeer(file_of("laumas_tlb"), gauge(lambda: -3.21), tcp=True)
    wire = await TcpWire(peer).start()
    device = build.force_sensor(shipped("laumas_tlb"), Tcp("127.0.0.1", wire.port), SensorTimes(1.0))
    await device.open()
    samples = device.samples()
    assert (await anext(samples)).force_n == pytest.approx(-3.21)
    wire.drop()
    with pytest.raises(LinkError):
        await anext(samples)
    assert (await device.status()).ready
    await device.close()
    await wire.close()


class Deaf(Gauge):
    """It says yes to a tare, and does nothing."""

    def order(self, name: str, asked: float) -> str:
        return ""


class Counting(Gauge):
    """It counts its conversions, and is asked more often than it makes one."""

    counts = (1.0, 1.0, 1.0, 2.0, 2.0, 3.0)
    asked = 0

    def values(self) -> dict[str, float | str]:
        Counting.asked += 1
        return {**super().values(), "count": self.counts[min(Counting.asked, len(self.counts)) - 1]}


async def test_a_sensor_that_reads_a_force_after_its_tare_is_a_fault() -> None:
    peer = ProfiledPeer(file_of("laumas_tlb"), lambda _sheet: Deaf(lambda: 5.0, {}), tcp=True)
    wire = await TcpWire(peer).start()
    device = build.force_sensor(shipped("laumas_tlb"), Tcp("127.0.0.1", wire.port), SensorTimes(1.0, tare_s=0.2))
    await device.open()
    with pytest.raises(DeviceFault, match=r"not tared after 0\.2 s, reads 5 N"):
        await device.tare()
    await device.close()
    await wire.close()


async def test_a_conversion_that_was_reported_before_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "counting.toml"
    path.write_text(file_of("laumas_tlb").read_text().replace("[registers.gross]", "[registers.count]"))
    peer = ProfiledPeer(path, lambda _sheet: Counting(lambda: 1.0, {}), tcp=True)
    wire = await TcpWire(peer).start()
    profile = device_profile_of(path.read_text(), path)
    device = build.force_sensor(profile, Tcp("127.0.0.1", wire.port), SensorTimes(1.0))
    await device.open()
    asked, count = Counting.asked, 0
    async with aclosing(device.samples()) as samples:  # type: ignore[type-var]
        async for _ in samples:
            count += 1
            if Counting.asked >= len(Counting.counts):
                break
    assert count < Counting.asked - asked, "repeated conversions are omitted"
    await device.close()
    await wire.close()
