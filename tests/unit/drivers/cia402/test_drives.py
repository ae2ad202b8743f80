"""The drivers of CiA 402 against what happens on a bus; what comes of it is asked of the simulated drive itself.

Contact detection by position.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from polishd.api import ActuatorTimes, DeviceFault, DeviceRefused, LinkError, ProtocolError, SpindleTimes
from polishd.drivers.cia402.actuator import WINDOW_S, Cia402Actuator, ContactDetector
from polishd.drivers.cia402.spindle import Cia402Spindle
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress
from polishd.sim_backends.cia402 import device as stage
from polishd.sim_backends.cia402.device import Motor
from tests.conformance.conftest import seen
from tests.fakes.can_peers import SlcanPeer, SocketcandPeer
from tests.fakes.cia402 import (
    CONTROLLER,
    EDS,
    FakeCoil,
    Frame,
    SimDrive,
    cia402_actuator,
    cia402_spindle,
    sim_coil,
    sim_motor,
)
from tests.fakes.wires import PtyWire, TcpWire
from tests.time_limits import SOON_S

PATIENT = SpindleTimes(silence_s=1.5, watchdog_s=2.5)
PATIENT_COIL = ActuatorTimes(silence_s=1.5, watchdog_s=2.5)
"""A busy machine is silent for a while."""
REST_MM = 0.1
"""Up, as the driver takes it: the spring may still be pulling."""

Spin = tuple[Cia402Spindle, SimDrive, Motor]
Press = tuple[Cia402Actuator, SimDrive, FakeCoil]


@pytest.fixture
async def spin(tmp_path: Path) -> AsyncIterator[Spin]:
    """A spindle, closed."""
    drive, motor = sim_motor()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "spindle")
    device = cia402_spindle(SlcanAddress(wire.path), PATIENT)
    yield device, drive, motor
    drive.stop()
    await device.close()
    await wire.close()


@pytest.fixture
async def press(tmp_path: Path) -> AsyncIterator[Press]:
    """An actuator, closed."""
    drive, coil = sim_coil()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = cia402_actuator(SlcanAddress(wire.path), PATIENT_COIL)
    yield device, drive, coil
    drive.stop()
    await device.close()
    await wire.close()


async def watch(device: Cia402Spindle | Cia402Actuator, until: Callable[[int], bool] = lambda fault: False) -> int:
    """Read samples until their fault is so."""
    async with asyncio.timeout(SOON_S):
        async for sample in device.samples():
            if until(sample.fault):
                return sample.fault
    raise AssertionError("samples ended")


def dropping(identifier: int) -> Callable[[Frame], list[Frame]]:
    return lambda frame: [] if frame[0] == identifier else [frame]


async def test_open_tells_the_drive_what_to_do_alone_and_enables_nothing(spin: Spin, press: Press) -> None:
    for (device, drive, _), alone in ((spin, 3), (press, 2)):
        await device.open()
        values = drive.node.objects.values
        assert (values[0x1016, 1], values[0x1017, 0]) == (CONTROLLER << 16 | 2500, 100)
        assert (values[0x6007, 0], values[0x605A, 0]) == (alone, 2)
        assert drive.written(0x6040) == drive.written(0x6060) == []
        assert drive.node.power.state == stage.DISABLED
    assert spin[1].node.objects[0x6085] == 200_000
    assert press[1].node.objects[0x6087] == 10_000


@pytest.mark.full
async def test_what_the_drive_has_already_is_not_written_again(spin: Spin) -> None:
    device, drive, _ = spin
    await device.open()
    writes = sum(data[0] >> 5 == 1 for _, data in drive.received)
    await device.close()
    await device.open()
    assert sum(data[0] >> 5 == 1 for _, data in drive.received) == writes > 0


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({(0x1018, 2): 0x0403}, "has product 0x00000403, its EDS file has 0x00000402"),
        ({(0x1018, 1): 1}, "has vendor 0x00000001"),
        ({(0x6502, 0): 0b1001}, r"has no mode 3 \(6502h says 0x9\)"),
        ({(0x1000, 0): 0x000F0191}, "has CiA profile 401"),
    ],
)
async def test_another_drive_is_refused(spin: Spin, change: dict[tuple[int, int], int], message: str) -> None:
    device, drive, _ = spin
    drive.node.objects.values.update(change)
    with pytest.raises(DeviceRefused, match=message):
        await device.open()
    with pytest.raises(LinkError, match="is not open"):
        await device.status()


async def test_a_drive_that_does_not_stop_by_itself_is_refused(press: Press) -> None:
    device, drive, _ = press
    drive.instead[b"\x2b\x07\x60"] = b"\x60\x07\x60\x00" + bytes(4)
    with pytest.raises(DeviceRefused, match=r"6007h \(Abort connection option code\) reads 1 after 2 was written"):
        await device.open()


@pytest.mark.full
async def test_a_drive_without_heartbeats_is_no_link(spin: Spin) -> None:
    device, drive, _ = spin
    drive.treat = dropping(0x705)
    with pytest.raises(LinkError, match=r"no heartbeat within 1.5 s"):
        await device.open()


async def test_a_refused_write_is_reported_with_its_reason_and_not_tried_again(spin: Spin) -> None:
    device, drive, motor = spin
    await device.open()
    drive.node.objects[0x6080] = 100  # less than at open
    with pytest.raises(DeviceRefused, match=r"60FFh \(Target velocity\) was refused with 0x06090030, value range"):
        await device.set_speed(1000.0)
    assert drive.written(0x60FF) == [0, 10_000]
    assert motor.rpm == 0.0


async def test_the_drives_own_limit_counts(spin: Spin) -> None:
    device, drive, _ = spin
    drive.node.objects[0x6080] = 100
    await device.open()
    with pytest.raises(DeviceRefused, match="outside the drive's 100 rpm"):
        await device.set_speed(101.0)
    assert drive.written(0x60FF) == []


@pytest.mark.full
async def test_a_drive_that_has_only_what_it_must_have(tmp_path: Path) -> None:
    text = EDS.read_text()
    for optional in ("1018sub2", "1018sub3", "1018sub4", "603F", "6080", "6502"):
        begin = text.index(f"[{optional}]")
        text = text[:begin] + text[text.find("\n\n", begin) :].removeprefix("\n\n") * ("\n\n" in text[begin:])
    (tmp_path / "bare.eds").write_text(text)
    drive, motor = sim_motor()
    for index, sub in ((0x1018, 2), (0x1018, 3), (0x1018, 4), (0x603F, 0), (0x6080, 0), (0x6502, 0)):
        drive.instead[b"\x40" + index.to_bytes(2, "little") + bytes([sub])] = b"\x80" + bytes(7)
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = cia402_spindle(SlcanAddress(wire.path), PATIENT, tmp_path / "bare.eds")
    await device.open()
    assert (await device.identify()).model == "0x00000000"
    await device.set_speed(500.0)
    assert motor.rpm == pytest.approx(500.0, rel=0.03)
    drive.treat = dropping(0x085)
    drive.node.fail()
    assert await watch(device, lambda fault: fault != 0) == 0x1000
    drive.stop()
    await device.close()
    await wire.close()


async def test_control_words_go_up_one_by_one_and_a_quick_stop_ends_it(spin: Spin) -> None:
    device, drive, motor = spin
    await device.open()
    await device.set_speed(-900.0)
    assert drive.written(0x6040) == [0x06, 0x07, 0x0F]
    assert drive.node.objects[0x6061] == 3
    assert motor.rpm == pytest.approx(-900.0, rel=0.03)
    await device.set_speed(1200.0)
    assert drive.written(0x6040) == [0x06, 0x07, 0x0F]
    await device.make_safe()
    assert drive.written(0x6040) == [0x06, 0x07, 0x0F, 0x02]
    assert (motor.rpm, drive.node.power.state) == (0.0, stage.DISABLED)


async def test_an_emergency_is_a_fault_with_its_code_and_text_and_stops_the_drive(spin: Spin) -> None:
    device, drive, motor = spin
    await device.open()
    await device.set_speed(1000.0)
    drive.node.fail()
    assert await watch(device, lambda fault: fault != 0) == 0x2310
    status = await device.status()
    assert (status.ready, status.state, status.detail) == (False, "fault", "current (2310h)")
    await seen(lambda: motor.rpm == 0.0)
    with pytest.raises(DeviceFault, match=r"cannot run at 500 rpm: current \(2310h\)"):
        await device.set_speed(500.0)
    await device.make_safe()  # a person's business: not reset
    assert drive.node.power.state == stage.FAULT
    assert not (await device.status()).ready


async def test_a_fault_whose_emergency_was_lost_is_read_from_the_drive(spin: Spin) -> None:
    device, drive, _ = spin
    await device.open()
    drive.treat = dropping(0x085)
    drive.node.fail(0x3210)
    assert await watch(device, lambda fault: fault != 0) == 0x3210
    assert (await device.status()).detail == "voltage (3210h)"


async def test_a_warning_without_a_fault_is_reported_and_kept(spin: Spin) -> None:
    device, drive, _ = spin
    await device.open()
    await device.set_speed(500.0)
    drive.node._emergency(0x8110)
    assert await watch(device, lambda fault: fault != 0) == 0x8110
    drive.node._emergency(0x0000)
    assert await watch(device, lambda fault: True) == 0x8110
    await device.make_safe()
    assert (await device.status()).ready


@pytest.mark.full
async def test_a_drive_that_starts_anew_is_lost_until_it_is_opened(spin: Spin) -> None:
    device, drive, motor = spin
    await device.open()
    await device.set_speed(1000.0)
    drive.node.reboot()
    with pytest.raises(LinkError, match=r"has restarted|no answer"):
        await watch(device)
    assert drive.node.power.state == stage.DISABLED
    with pytest.raises(LinkError):
        await device.set_speed(1000.0)
    await seen(lambda: motor.rpm == 0.0)
    await device.open()
    assert drive.node.objects[0x6007] == 3
    await device.set_speed(300.0)


@pytest.mark.full
async def test_bus_off_is_a_lost_link_and_the_drive_stops_by_itself(spin: Spin) -> None:
    device, drive, motor = spin
    await device.open()
    await device.set_speed(1000.0)
    drive.node.bus_off(for_s=4.0)
    with pytest.raises(LinkError, match=r"no (answer|heartbeat)"):
        await watch(device)
    await seen(lambda: "watchdog" in drive.events)
    await seen(lambda: motor.rpm == 0.0)
    with pytest.raises(LinkError):
        await device.status()
    await seen(lambda: drive.node.now_s > drive.node._dark_until_s)
    await device.open()
    await device.make_safe()
    assert (await device.status()).ready


def nodelay_of_connections_to(port: int) -> list[int]:
    """TCP_NODELAY of each connection of this process to that port on loopback."""
    found = []
    for name in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # no socket, or not connected
            one = socket.socket(fileno=int(name.name))
            try:
                if one.getpeername()[1:2] == (port,):
                    found.append(int(one.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0))
            finally:
                one.detach()
    return found


async def test_an_adapter_that_is_off_the_bus_says_so_and_that_is_a_lost_link() -> None:
    drive, _ = sim_motor()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    device = cia402_spindle(SocketcandAddress("127.0.0.1", wire.port, "can0"), PATIENT)
    await device.open()
    wire.write(b"< error 004 1.0 >")  # error passive: it goes on
    assert (await device.status()).ready
    assert nodelay_of_connections_to(wire.port) == [1], "a request waits for no acknowledgement of a heartbeat"
    wire.write(b"< error 040 1.0 >")
    with pytest.raises(LinkError, match="the adapter is off the bus"):
        await watch(device)
    drive.stop()
    await device.close()
    await wire.close()


@pytest.mark.full
async def test_silent_heartbeats_are_a_lost_link_though_the_drive_answers(spin: Spin) -> None:
    device, drive, motor = spin
    await device.open()
    await device.set_speed(1000.0)
    drive.treat = dropping(0x705)
    with pytest.raises(LinkError, match=r"no heartbeat for 1.5 s"):
        await watch(device)
    await seen(lambda: motor.rpm == 0.0)  # because it receives no heartbeat either
    assert drive.events == ["watchdog"]
    drive.treat = lambda frame: [frame]
    await device.make_safe()


@pytest.mark.full
async def test_a_late_answer_is_not_taken_for_the_next_ones(spin: Spin) -> None:
    device, drive, _ = spin
    await device.open()
    await device.set_speed(1000.0)
    held: list[Frame] = []

    def hold(frame: Frame) -> list[Frame]:
        if frame[0] == 0x585:
            held.append(frame)
            return []
        return [frame]

    drive.treat = hold
    with pytest.raises(LinkError, match=r"no answer within 1.5 s \(6041h was asked for\)"):
        await device.status()
    await seen(lambda: drive.node.power.state == stage.DISABLED)
    late = list(held)  # it says: enabled

    def first_the_late_one(frame: Frame) -> list[Frame]:
        due = [late.pop()] if late and frame[0] == 0x585 else []
        return [*due, frame]

    drive.treat = first_the_late_one
    await device.open()
    status = await device.status()
    assert (status.safe, status.state) == (True, "stopped")
    assert drive.node.power.state == stage.DISABLED


async def test_only_readings_keep_it_running(spin: Spin) -> None:
    device, drive, motor = spin
    await device.open()
    at_open = drive.beats
    await seen(lambda: drive.beats > at_open + 3)
    await device.set_speed(1000.0)
    driven = drive.beats
    await seen(lambda: drive.events == ["watchdog"])
    assert drive.beats == driven
    await seen(lambda: motor.rpm == 0.0)


async def test_the_actuator_lands_lightly_and_without_a_jump(press: Press) -> None:
    device, drive, coil = press
    await device.open()
    await device.set_force(20.0)
    assert drive.written(0x6071) == [0, 60, 440]  # 0, 1 N and 20 N, with 2 N against the spring
    assert drive.written(0x6040) == [0x06, 0x07, 0x0F]
    assert coil.force_n == 20.0
    await device.make_safe()
    assert coil.force_n == 0.0
    assert coil.position_mm <= REST_MM


async def test_a_part_that_is_not_there_is_no_contact(press: Press) -> None:
    device, drive, coil = press
    device._times = ActuatorTimes(landing_s=1.0)
    coil.touch_mm = 10.0  # the end of its stroke
    await device.open()
    with pytest.raises(DeviceFault, match=r"no contact after 1 s, 10.00 mm out"):
        await device.set_force(20.0)
    assert max(drive.written(0x6071)) == 60
    await device.retract()
    assert coil.position_mm <= REST_MM


@pytest.mark.one_of_each
@pytest.mark.parametrize(("lift", "modes"), [("spring", [4]), ("torque", [4]), ("position", [4, 1])])
async def test_force_off_then_up_then_current_off(tmp_path: Path, lift: str, modes: list[int]) -> None:
    drive, coil = sim_coil()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = cia402_actuator(SlcanAddress(wire.path), PATIENT_COIL, lift=lift, lift_n=3.0)
    await device.open()
    await device.set_force(10.0)
    del drive.received[:]
    await device.retract()
    assert drive.written(0x6071) == ([0, 0xFFC4] if lift == "torque" else [0])
    assert drive.written(0x6040) == ([0x3F, 0] if lift == "position" else [0])
    first = next(index for index, (_, data) in enumerate(drive.received) if data[0] >> 5 == 1)
    assert drive.received[first][1][1:3] == b"\x71\x60", "the force goes first"
    assert (coil.modes, drive.node.power.state) == (modes, stage.DISABLED)
    assert coil.position_mm <= REST_MM
    drive.stop()
    await device.close()
    await wire.close()


@pytest.mark.one_of_each
@pytest.mark.parametrize(("refused", "code"), [(b"\x2b\x71\x60", 0x08000021), (b"\x2f\x60\x60\x00\x01", 0x08000022)])
async def test_a_drive_that_refuses_to_lift_loses_its_current_and_the_spring_lifts(
    tmp_path: Path, refused: bytes, code: int, caplog: pytest.LogCaptureFixture
) -> None:
    drive, coil = sim_coil()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = cia402_actuator(SlcanAddress(wire.path), PATIENT_COIL, lift="position")
    await device.open()
    await device.set_force(10.0)
    drive.instead[refused] = b"\x80" + refused[1:3] + b"\0" + code.to_bytes(4, "little")
    await device.retract()
    assert coil.position_mm <= REST_MM
    assert drive.node.power.state == stage.DISABLED
    assert "The current is switched off" in caplog.text
    drive.stop()
    await device.close()
    await wire.close()


async def test_who_presses_while_it_is_lifted_is_refused(tmp_path: Path) -> None:
    drive, coil = sim_coil()
    wire = PtyWire(SlcanPeer(drive), tmp_path / "can")
    device = cia402_actuator(SlcanAddress(wire.path), PATIENT_COIL, lift="position")
    await device.open()
    await device.set_force(10.0)
    coil.stuck = True
    lifting = asyncio.create_task(device.retract())
    await seen(lambda: 0x3F in drive.written(0x6040))
    with pytest.raises(DeviceRefused, match=r"is lifting \(mode 1\)"):
        await device.set_force(10.0)
    coil.stuck = False
    await lifting
    assert coil.force_n == 0.0
    drive.stop()
    await device.close()
    await wire.close()


async def test_silence_while_it_had_no_power_is_harmless(spin: Spin, press: Press) -> None:
    device, drive, motor = spin
    await device.open()
    drive.node.fail(0x8130)  # as drives do that take any silence for a fault
    drive.node._estranged = True
    await seen(lambda: device._axis.link.silent_idly)
    assert drive.node.power.state == stage.FAULT
    await device.set_speed(600.0)
    assert motor.rpm == pytest.approx(600.0, rel=0.03)
    assert drive.received.count((0x000, b"\x82\x05")) == 1
    assert drive.node.objects.values[0x1016, 1] == CONTROLLER << 16 | 2500, "written again"
    await device.make_safe()
    actuator, drive, coil = press
    await actuator.open()
    drive.node._emergency(0x8130)
    await seen(lambda: actuator._axis.link.silent_idly)
    assert (await actuator.status()).ready
    await actuator.set_force(5.0)
    assert coil.force_n == 5.0


@pytest.mark.full
async def test_a_tool_that_sticks_is_a_fault(press: Press) -> None:
    device, _, coil = press
    device._times = ActuatorTimes(silence_s=1.5, watchdog_s=2.5, retract_s=0.5)
    await device.open()
    await device.set_force(10.0)
    coil.stuck = True
    with pytest.raises(DeviceFault, match=r"5.00 mm out, 0.7 s after the retract command \(switch on disabled\)"):
        await device.retract()
    coil.stuck = False
    await device.retract()


async def test_a_drive_that_cannot_press_that_much_is_refused(press: Press) -> None:
    device, drive, _ = press
    drive.node.objects[0x6072] = 1000
    with pytest.raises(DeviceRefused, match="6072h allows 1000 permille, max_n takes 1040"):
        await device.open()


async def test_an_impossible_status_word_is_a_protocol_error(spin: Spin) -> None:
    device, drive, _ = spin
    await device.open()
    drive.instead[b"\x40\x41\x60"] = bytes.fromhex("4b41600005000000")
    with pytest.raises(ProtocolError, match="status word 0x0005 is no state"):
        await device.status()
    drive.instead[b"\x40\x41\x60"] = bytes.fromhex("4341600037020000")
    with pytest.raises(ProtocolError, match=r"6041h \(Statusword\) has 4 bytes, its EDS file says 2"):
        await device.status()


@pytest.mark.full
async def test_a_jammed_spindle_is_a_fault(spin: Spin) -> None:
    device, drive, motor = spin
    device._times = SpindleTimes(silence_s=1.5, watchdog_s=2.5, spin_s=0.5)
    await device.open()
    motor.jammed = True
    with pytest.raises(DeviceFault, match=r"500 rpm not reached"):
        await device.set_speed(500.0)
    await device.make_safe()
    motor.rpm = 700.0
    began_s = time.monotonic()
    with pytest.raises(DeviceFault, match=r"switch on disabled at [67].* rpm, 0.5 s after the quick stop"):
        await device.make_safe()
    assert time.monotonic() - began_s >= 0.5
    assert drive.node.power.state == stage.DISABLED


def contacts(positions: Iterable[tuple[float, float]]) -> list[bool]:
    contact = ContactDetector(rest_mm=0.1, end_mm=9.9, travel_mm_s=1.0)
    return [contact.feed(at_s, position_mm) for at_s, position_mm in positions]


def way(
    *, speed_mm_s: float, touch_mm: float, until_s: float = 4.0, every_s: float = 0.05
) -> list[tuple[float, float]]:
    at_s = np.arange(0.0, until_s, every_s)
    return [(float(t), min(speed_mm_s * float(t), touch_mm)) for t in at_s]


def test_it_touches_once_it_no_longer_travels() -> None:
    positions = way(speed_mm_s=2.5, touch_mm=5.0)
    answers = contacts(positions)
    first = positions[answers.index(True)][0]
    assert 2.0 < first < 2.0 + 2 * WINDOW_S
    assert all(answers[answers.index(True) :])


def test_at_its_rest_and_at_its_end_it_touches_nothing() -> None:
    assert not any(contacts(way(speed_mm_s=0.0, touch_mm=5.0)))
    assert not any(contacts(way(speed_mm_s=5.0, touch_mm=10.0)))


def test_it_follows_the_part_and_tells_where_the_part_ends() -> None:
    hill = [(t, 5.0 + 0.5 * float(np.sin(1.5 * t))) for t in np.arange(0.0, 6.0, 0.05)]  # 0.75 mm/s at most
    assert all(contacts(hill)[2:])
    edge = [*hill, *((6.0 + t, hill[-1][1] + 20.0 * t) for t in np.arange(0.0, 0.2, 0.05))]
    assert not contacts(edge)[-1]


def test_a_pause_between_readings_is_no_contact_by_itself() -> None:
    assert contacts([(0.0, 0.0), (0.05, 0.125), (1.0, 2.5)]) == [False, False, False]


def test_what_was_before_a_lift_is_forgotten() -> None:
    contact = ContactDetector(rest_mm=0.1, end_mm=9.9, travel_mm_s=1.0)
    assert [contact.feed(t, 5.0) for t in (0.0, 0.1)] == [False, True]
    contact.reset()
    assert not contact.feed(0.2, 5.0)


def test_a_tool_that_lands_slower_than_its_stated_travel_has_not_landed_in_the_air() -> None:
    """``travel_mm_s`` above the speed of landing is a slip of the config: the full force would slam it down."""
    contact = ContactDetector(rest_mm=0.1, end_mm=9.9, travel_mm_s=20.0)
    positions = way(speed_mm_s=5.0, touch_mm=5.0)
    landed = []
    for at_s, position_mm in positions:
        contact.feed(at_s, position_mm)
        landed.append(contact.landed)
    assert 1.0 < positions[landed.index(True)][0] < 1.0 + 2 * WINDOW_S
