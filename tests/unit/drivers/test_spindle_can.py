"""The spindle driver against noise, silence, restarts and adapters that are not there."""

from __future__ import annotations

import asyncio
import os
import threading
import time
import tty
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import serial

from polishd.api import DeviceFault, DeviceRefused, LinkError, ProtocolError, SpindleTimes
from polishd.drivers import spindle_can
from polishd.drivers.spindle_can import SpindleCan
from polishd.drivers.transport import can_bus
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress
from tests.fakes.drive import Drive, SlcanPeer, SocketcandPeer
from tests.fakes.wires import Peer, PtyWire, TcpWire
from tests.patience import SOON_S, within

Rig = tuple[SpindleCan, Drive, PtyWire]
PATIENT = SpindleTimes(silence_s=1.5, watchdog_s=2.0)


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    drive = Drive()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = SpindleCan(SlcanAddress(wire.path), PATIENT)
    await device.open()
    yield device, drive, wire
    drive.stop()
    await device.close()
    await wire.close()


async def watch(device: SpindleCan) -> None:
    async for _ in device.samples():
        pass


async def test_the_adapter_is_set_up(rig: Rig) -> None:
    _, _, wire = rig
    assert isinstance(wire.peer, SlcanPeer)
    assert b"S6" in wire.peer.adapter
    assert wire.peer.adapter[-1] == b"O"


async def test_an_adapter_that_takes_nothing_is_told_at_once_and_holds_nobody_up(tmp_path: Path) -> None:
    """python-can waits for the line to take each frame, on the loop: pytest's timeout is what that would meet."""
    master, slave = os.openpty()
    tty.setraw(slave)
    (tmp_path / "can").symlink_to(os.ttyname(slave))
    link = await can_bus.open_bus(SlcanAddress(tmp_path / "can"), 5)
    frame = spindle_can.encode_command(5, run=True, counter=1, rpm=1000)

    def fill() -> None:
        for _ in range(10_000):
            link.send(frame)

    with pytest.raises(LinkError, match="takes no"):
        fill()
    await link.close()
    with serial.Serial(str(tmp_path / "can"), exclusive=True):
        pass  # and leaves its port to whoever opens it next
    os.close(master)
    os.close(slave)


async def test_identity_is_read_from_the_drive(rig: Rig) -> None:
    device, _, _ = rig
    identity = await device.identify()
    assert (identity.vendor, identity.model) == ("0x00000439", "0x00001001")
    assert (identity.serial, identity.firmware, identity.boot_id) == ("12345", "0x00020003", "7")


async def test_a_missing_object_is_a_protocol_error(rig: Rig) -> None:
    device, drive, _ = rig
    del drive.objects[0x2000, 0]
    with pytest.raises(ProtocolError, match="0x2000 sub 0 aborted with 0x06020000"):
        await device.identify()


@pytest.mark.full
async def test_noise_on_the_adapter_is_survived(rig: Rig) -> None:
    device, _, wire = rig
    await device.set_speed(1000.0)
    for noise in (b"\xff", b"\x80\x81\r", b"t\r", b"txyz\r", b"t1853\r", b"\a", b"t18580", b"z\r\r\r", b"T0000\r"):
        wire.write(noise)
        async with asyncio.timeout(SOON_S):
            async for sample in device.samples():
                assert sample.rpm == pytest.approx(1000.0)
                break
    assert (await device.status()).ready


async def test_frames_of_others_are_ignored(rig: Rig) -> None:
    device, _, wire = rig
    wire.write(b"t1868030100000000ff00\r" + b"T000001858030100000000ff00\r" + b"r1858\r")
    await asyncio.sleep(0.05)
    assert (await device.status()).state == "stopped"


@pytest.mark.one_of_each
@pytest.mark.parametrize(("identifier", "what"), [(0x700, "no heartbeat"), (0x180, "no process data")])
async def test_silence_is_a_lost_link(rig: Rig, identifier: int, what: str) -> None:
    device, drive, _ = rig
    await device.set_speed(1000.0)
    drive.mute.add(identifier)
    began = time.monotonic()
    with within(2.5), pytest.raises(LinkError, match=what):
        await watch(device)
    assert time.monotonic() - began > 0.3
    with pytest.raises(LinkError):
        await device.status()
    drive.mute.clear()
    with pytest.raises(LinkError):
        await device.status()
    await device.open()
    await device.make_safe()
    assert (await device.status()).ready


async def test_a_drive_that_starts_anew_is_not_driven_on(rig: Rig) -> None:
    device, drive, _ = rig
    await device.set_speed(1000.0)
    drive.reboot()
    drive.commands.clear()
    with pytest.raises(DeviceFault, match="started anew"):
        await watch(device)
    await asyncio.sleep(0.15)
    assert sum(run for run, _ in drive.commands) <= 1
    with pytest.raises(DeviceFault, match="started anew"):
        await device.set_speed(1000.0)
    await device.make_safe()
    assert drive.rpm == 0.0


async def test_commands_are_repeated_while_somebody_cares(rig: Rig) -> None:
    device, drive, _ = rig
    await device.set_speed(1000.0)
    drive.commands.clear()
    began = time.monotonic()
    watching = asyncio.create_task(watch(device))
    while len(drive.commands) < 6:  # noqa: ASYNC110 -- pytest's timeout is the limit
        await asyncio.sleep(0.01)
    assert time.monotonic() - began > 0.4, "ten a second"
    watching.cancel()
    with pytest.raises(asyncio.CancelledError):
        await watching
    assert set(drive.commands) == {(1, 1000)}


async def test_nothing_is_sent_while_it_stands(rig: Rig) -> None:
    device, drive, _ = rig
    await device.set_speed(500.0)
    await device.set_speed(0.0)
    drive.commands.clear()
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.3):
            await watch(device)
    assert drive.commands == []


async def test_over_speed_is_refused_by_the_drive(rig: Rig) -> None:
    device, drive, _ = rig
    drive.objects[0x6080, 0] = 400
    with pytest.raises(DeviceRefused, match="over-speed"):
        await device.set_speed(500.0)


async def test_a_drive_fault_is_a_fault(rig: Rig) -> None:
    device, drive, _ = rig
    drive.fault = 4
    with pytest.raises(DeviceFault, match=r"fault 4 \(drive"):
        await device.set_speed(500.0)
    status = await device.status()
    assert (status.ready, status.detail) == (False, "drive")


@pytest.mark.full
async def test_a_jammed_spindle_is_a_fault(rig: Rig) -> None:
    device, drive, _ = rig
    device._times = SpindleTimes(spin_s=0.5)
    drive.jammed = True
    with pytest.raises(DeviceFault, match="500 rpm not reached"):
        await device.set_speed(500.0)
    drive.jammed = False
    await device.set_speed(500.0)
    drive.jammed = True
    with pytest.raises(DeviceFault, match="after the stop command"):
        await device.make_safe()


async def test_an_old_answer_is_not_the_new_ones(rig: Rig) -> None:
    device, drive, _ = rig
    await device.set_speed(1000.0)
    await device.close()
    await device.open()
    drive._counter = 1
    await device.set_speed(1005.0)  # within 2 %: only the counter tells
    assert drive.commands[-1] == (1, 1005)
    assert drive.rpm == pytest.approx(1000.0, rel=0.02)


async def test_make_safe_stops_a_drive_whose_link_was_lost(rig: Rig) -> None:
    device, drive, _ = rig
    await device.set_speed(1000.0)
    drive.mute.add(0x700)
    with pytest.raises(LinkError):
        await watch(device)
    drive.mute.clear()
    await device.make_safe()
    assert drive.rpm == 0.0
    assert drive.commands[-1] == (0, 0)


@pytest.mark.full
async def test_another_node_is_not_there(rig: Rig) -> None:
    device, _, wire = rig
    await device.close()
    other = SpindleCan(SlcanAddress(wire.path), node=6)
    with pytest.raises(LinkError, match="node 6: no answer"):
        await other.open()


async def test_no_such_adapter(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="slcan:"):
        await SpindleCan(SlcanAddress(tmp_path / "none")).open()


class Mute(Peer):
    """Takes connections and says what it is told to."""

    def __init__(self, greeting: bytes) -> None:
        super().__init__()
        self.greeting = greeting

    def on_connect(self) -> None:
        self.write(self.greeting)

    def on_bytes(self, data: bytes) -> None:
        pass


@pytest.mark.parametrize(
    ("greeting", "reason"), [(b"", "silent|no greeting"), (b"SSH-2.0-" + b"x" * 80, "no socketcand server")]
)
async def test_what_is_no_socketcand_server(monkeypatch: pytest.MonkeyPatch, greeting: bytes, reason: str) -> None:
    monkeypatch.setattr(can_bus, "GREETING_S", 0.1)
    wire = await TcpWire(Mute(greeting)).start()
    with pytest.raises(LinkError, match=reason):
        await SpindleCan(SocketcandAddress("127.0.0.1", wire.port, "can0")).open()
    await wire.close()


async def test_a_socketcand_server_that_falls_silent_ends_the_open_and_its_thread() -> None:
    """Greets, and says nothing more: python-can itself would wait for ever, and the process for its thread."""
    wire = await TcpWire(Mute(b"< hi >")).start()
    before = set(threading.enumerate())
    with pytest.raises(LinkError, match="timed out"):
        await SpindleCan(SocketcandAddress("127.0.0.1", wire.port, "can0")).open()
    new = [thread for thread in set(threading.enumerate()) - before if not thread.daemon]
    await asyncio.get_running_loop().shutdown_default_executor()
    assert not any(thread.is_alive() for thread in new)
    await wire.close()


async def test_nobody_at_the_socketcand_address() -> None:
    with within(1.0), pytest.raises(LinkError):
        await SpindleCan(SocketcandAddress("127.0.0.1", 9, "can0")).open()


async def test_a_frame_that_cannot_be_read_is_raised_and_not_logged_beside_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    drive = Drive()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    device = SpindleCan(SocketcandAddress("127.0.0.1", wire.port, "can0"))
    await device.open()
    wire.peer.write(b"< frame 185 1.0 0x0y >")
    with pytest.raises(LinkError, match="non-hexadecimal"):
        await watch(device)
    assert not [record for record in caplog.records if record.name.startswith("can")]
    drive.stop()
    await device.close()
    await wire.close()


@pytest.mark.full
async def test_a_socketcand_server_that_goes_away(tmp_path: Path) -> None:
    drive = Drive()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    device = SpindleCan(SocketcandAddress("127.0.0.1", wire.port, "can0"))
    await device.open()
    wire.drop()
    with pytest.raises(LinkError):
        await watch(device)
    await device.open()
    await device.set_speed(700.0)
    await device.make_safe()
    drive.stop()
    await device.close()
    await wire.close()
