"""The voice coil's behaviour, and the two protocols over it."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from polishd.config.simulator_faults import FaultSection
from polishd.sim_backends.common.framing import AsciiSlave, CoilRegisters, RtuSlave, TcpSlave, body, crc16, line, rtu
from polishd.sim_backends.common.voice_coil import (
    CONTACT,
    EXTENDING,
    FAULT,
    RETRACTED,
    RETRACTING,
    CoilDynamics,
    VoiceCoil,
)
from tests.unit.sim_backends.vectors import vectors


class Bench:
    """A coil on a bench, with its log."""

    def __init__(self, touch_um: float | None = 5000.0, **options: Any) -> None:
        self.log = []
        self.coil = VoiceCoil(
            rng=np.random.default_rng(1),
            report=lambda name, at_s, **data: self.log.append((name, at_s)),
            now_s=0.0,
            touch_um=touch_um,
            **options,
        )

    def until(self, now: float, fed: bool = True) -> None:
        while self.coil.now_s < now - 1e-9:
            self.coil.step(min(self.coil.now_s + 0.02, now))
            if fed:
                self.coil.feed(7)

    def pressed(self, force: float = 12.0) -> Bench:
        self.coil.set_force(force)
        self.coil.engage()
        self.until(0.3)
        return self

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.log]


def test_it_lands_and_presses() -> None:
    bench = Bench()
    assert bench.coil.state == RETRACTED
    bench.coil.set_force(12.0)
    bench.coil.engage()
    bench.until(0.05)
    assert bench.coil.state == EXTENDING
    bench.until(0.3)
    assert (bench.coil.state, bench.coil.force_n, bench.coil.position_um) == (CONTACT, 12.0, 5000.0)
    readings = [bench.coil.measured_n for _ in range(500)]
    assert np.mean(readings) == pytest.approx(12.0, abs=0.4)
    assert bench.names == ["force_setpoint", "engage", "tool_landed", "force_on"]


@pytest.mark.parametrize("touch_um", [4500.0, 5300.0])
def test_its_position_is_where_the_part_is(touch_um: float) -> None:
    bench = Bench(touch_um=touch_um).pressed(0.8)
    assert (bench.coil.state, bench.coil.position_um) == (CONTACT, touch_um)


def test_it_follows_a_surface_that_slopes() -> None:
    bench = Bench().pressed()
    for touch_um in (5001.0, 5010.0, 4990.0):
        bench.coil.touch_um = touch_um
        bench.until(bench.coil.now_s + 0.1)
        assert (bench.coil.position_um, bench.coil.force_n) == (touch_um, 12.0)
    assert "contact_lost" not in bench.names


def test_without_a_part_it_finds_nothing_to_press() -> None:
    bench = Bench(touch_um=None).pressed()
    assert (bench.coil.state, bench.coil.force_n) == (EXTENDING, 0.0)
    assert bench.coil.position_um == 10000.0


def test_retract_takes_the_force_off_before_it_lifts() -> None:
    bench = Bench().pressed()
    bench.coil.retract()
    bench.until(0.31)
    assert bench.coil.state == RETRACTING
    bench.until(0.6)
    assert bench.coil.state == RETRACTED
    assert bench.names[-4:] == ["retract", "force_zero", "tool_lifted", "retracted"]


def test_force_zero_stays_extended() -> None:
    bench = Bench().pressed()
    bench.coil.set_force(0.0)
    bench.until(0.5)
    assert (bench.coil.state, bench.coil.force_n) == (CONTACT, 0.0)


def test_silence_makes_it_let_go() -> None:
    bench = Bench().pressed()
    bench.until(0.79, fed=False)
    assert bench.coil.state == CONTACT
    bench.until(1.2, fed=False)
    assert (bench.coil.state, bench.coil.faults, bench.coil.force_n) == (FAULT, 1, 0.0)
    assert bench.coil.engage() == "fault"
    bench.coil.retract()
    assert (bench.coil.state, bench.coil.engage()) == (RETRACTED, "")


def test_samples_describe_the_force_without_a_gap() -> None:
    bench = Bench().pressed()
    times, force = np.array(bench.coil.samples).T
    assert (np.diff(times) >= -1e-12).all()
    assert force[-1] == 12.0
    assert np.interp(0.15, times, force) == pytest.approx(12.0 * 0.5, abs=1.5)


def test_a_part_that_goes_away_takes_the_force_with_it() -> None:
    bench = Bench().pressed()
    bench.coil.touch_um = None
    bench.until(0.4)
    assert (bench.coil.state, bench.coil.force_n) == (EXTENDING, 0.0)
    assert "contact_lost" in bench.names


def test_a_force_that_sticks_falls_until_it_lets_go() -> None:
    bench = Bench().pressed()
    stick = FaultSection(device="actuator", what="stick", at_s=0.0)
    bench.coil.suffer(stick, True)
    bench.until(1.0)
    assert bench.coil.force_n == pytest.approx(7.2)
    bench.coil.suffer(stick, False)
    bench.until(1.5)
    assert bench.coil.force_n == 12.0
    bench.coil.suffer(stick, True)
    bench.until(2.0)
    assert bench.coil.force_n == pytest.approx(7.2)
    bench.coil.retract()
    bench.until(2.3)
    assert bench.coil.state == RETRACTED


def fault(what: str, **keys: float) -> FaultSection:
    return FaultSection.model_validate({"device": "actuator", "what": what, "at_s": 0.0, **keys})


def test_a_spike_acts_at_once_is_read_and_goes_with_its_time() -> None:
    bench = Bench().pressed()
    spike = fault("spike", force_n=36.0, duration_s=0.1)
    bench.coil.suffer(spike, True)
    bench.until(0.32)
    assert bench.coil.force_n == pytest.approx(48.0)
    assert bench.coil.measured_n == pytest.approx(48.0, rel=0.1)
    bench.coil.suffer(spike, False)
    bench.until(0.34)
    assert bench.coil.force_n == pytest.approx(12.0)
    bench.coil.suffer(fault("spike", force_n=-30.0), True)
    bench.until(0.36)
    assert bench.coil.force_n == 0.0


def test_one_that_spikes_lets_go_when_it_is_retracted() -> None:
    bench = Bench().pressed()
    bench.coil.suffer(fault("spike", force_n=36.0), True)
    bench.until(0.32)
    bench.coil.retract()
    bench.until(0.6)
    assert (bench.coil.state, bench.coil.force_n) == (RETRACTED, 0.0)


def test_one_that_presses_lands_with_that_force_for_any_set_point() -> None:
    bench = Bench()
    bench.coil.suffer(fault("press", force_n=49.0), True)
    bench.coil.set_force(0.8)
    bench.coil.engage()
    bench.until(0.6)
    assert (bench.coil.state, bench.coil.force_n) == (CONTACT, 49.0)
    bench.coil.retract()
    bench.until(1.0)
    assert (bench.coil.state, bench.coil.force_n) == (RETRACTED, 0.0)


@pytest.mark.parametrize(
    ("keys", "acts_n", "reads_n"),
    [
        ({"offset_n": -4.0}, 16.0, 12.0),
        ({"factor": 0.5}, 24.0, 12.0),
        ({"factor": 0.0}, 12.0, 0.0),
    ],
)
def test_one_that_lies_regulates_by_what_it_reads(keys: dict[str, float], acts_n: float, reads_n: float) -> None:
    bench = Bench().pressed()
    bench.coil.suffer(fault("lie", **keys), True)
    bench.until(1.0)
    assert bench.coil.force_n == pytest.approx(acts_n)
    assert np.mean([bench.coil.measured_n for _ in range(500)]) == pytest.approx(reads_n, abs=0.6)


@pytest.mark.parametrize("force", [-0.1, 50.1, float("nan")])
def test_ranges(force: float) -> None:
    assert Bench().coil.set_force(force) == "range"
    assert Bench().coil.set_watchdog(99) == "range"


def registers(coil: VoiceCoil) -> CoilRegisters:
    return CoilRegisters(coil, "polishd", "VC50", "S-1", "1.0", 70000)


def test_modbus_vectors() -> None:
    expected = {name: bytes.fromhex(value) for name, value in vectors("voice_coil_modbus").items()}
    coil = Bench().pressed().coil
    slave = RtuSlave(1, registers(coil).answer)
    assert rtu(1, b"\x06\x00\x01\x04\xb0") == expected["write_setpoint"]
    assert list(slave.feed(expected["write_setpoint"], 1.0)) == [(8, expected["write_setpoint"])]
    assert coil.setpoint_n == 12.0
    coil.feed(7)
    ((_, answer),) = slave.feed(expected["read_inputs"], 1.0)
    shown = struct.unpack(">3x6H2x", expected["inputs"])
    state, force, setpoint, position, fault, heartbeat = struct.unpack(">3x6H2x", answer)
    assert (state, setpoint, position, fault, heartbeat) == (shown[0], *shown[2:])
    assert force == pytest.approx(shown[1], abs=60)
    assert crc16(answer[:-2]) == struct.unpack("<H", answer[-2:])[0]


def pdu(function: int, *words: int) -> bytes:
    return struct.pack(f">B{len(words)}H", function, *words)


@pytest.mark.parametrize(
    ("request_pdu", "answer"),
    [
        (pdu(3, 0, 4), b"\x03\x08\0\0\0\0\x01\xf4\0\0"),
        (pdu(4, 128, 2), b"\x04\x04\x00\x01\x11\x70"),
        (pdu(4, 100, 4), b"\x04\x08polishd\0"),
        (pdu(4, 6, 1), b"\x84\x02"),
        (pdu(3, 3, 2), b"\x83\x02"),
        (pdu(4, 0, 0), b"\x84\x03"),
        (pdu(6, 1, 5001), b"\x86\x03"),
        (pdu(6, 2, 99), b"\x86\x03"),
        (pdu(6, 0, 2), b"\x86\x03"),
        (pdu(6, 9, 1), b"\x86\x02"),
        (pdu(16, 1, 2) + b"\x04" + struct.pack(">2H", 500, 700), pdu(16, 1, 2)),
        (pdu(16, 1, 2) + b"\x03" + b"abc", b"\x90\x03"),
        (pdu(16, 3, 2) + b"\x04" + struct.pack(">2H", 5, 7), b"\x90\x02"),
        (pdu(5, 0, 1), b"\x85\x01"),
    ],
)
def test_modbus_answers(request_pdu: bytes, answer: Any) -> None:
    assert registers(Bench().coil).answer(request_pdu) == answer


def test_engage_is_refused_while_a_fault_is_set() -> None:
    bench = Bench()
    bench.coil.faults = 1
    table = registers(bench.coil)
    assert table.answer(pdu(6, 0, 1)) == b"\x86\x04"
    assert table.answer(pdu(6, 0, 0)) == pdu(6, 0, 0)
    assert table.answer(pdu(6, 0, 1)) == pdu(6, 0, 1)


def test_rtu_keeps_silent_about_what_is_damaged_or_not_for_it() -> None:
    slave = RtuSlave(1, registers(Bench().coil).answer)
    good = rtu(1, pdu(3, 0, 1))
    assert list(slave.feed(rtu(2, pdu(3, 0, 1)), 0.0)) == []
    assert list(slave.feed(good[:-1] + b"\0", 0.1)) == []
    assert list(slave.feed(good[:5], 0.2)) == []
    assert len(list(slave.feed(good[5:], 0.21))) == 1
    assert list(slave.feed(good[:5], 0.3)) == []
    assert len(list(slave.feed(good + good, 0.5))) == 2


def test_modbus_tcp_echoes_the_transaction() -> None:
    slave = TcpSlave(1, registers(Bench().coil).answer)
    request = struct.pack(">HHHB", 77, 0, 6, 1) + pdu(3, 2, 1)
    assert list(slave.feed(request[:9], 0.0)) == []
    ((_, answer),) = slave.feed(request[9:], 0.0)
    assert answer == struct.pack(">HHHB", 77, 0, 5, 1) + b"\x03\x02\x01\xf4"
    assert list(slave.feed(struct.pack(">HHHB", 1, 9, 6, 1) + pdu(3, 2, 1), 0.0)) == []


def test_ascii_vectors() -> None:
    expected = {name: value.encode() + b"\r\n" for name, value in vectors("voice_coil_serial").items()}
    assert line("7,OK") == expected["ok"]
    assert line("8,ST,2,11.98,12.00,5000,0") == expected["status"]
    assert body(expected["set_force"].strip()) == "7,F,12.00"
    coil = Bench().coil
    slave = AsciiSlave(coil, "polishd,VC50,S-1,1.0,3")
    assert [answer for _, answer in slave.feed(expected["set_force"], 0.0)] == [expected["ok"]]
    assert coil.setpoint_n == 12.0
    ((_, answer),) = slave.feed(expected["status_request"], 0.0)
    assert body(answer.strip()).startswith("8,ST,0,")


@pytest.mark.parametrize(
    ("request_body", "answer"),
    [
        ("1,ID?", "1,ID,polishd,VC50,S-1,1.0,3"),
        ("2,ENG", "2,OK"),
        ("3,RET", "3,OK"),
        ("4,HB", "4,OK"),
        ("5,WD,500", "5,OK"),
        ("6,WD,5", "6,ERR,range,value out of range"),
        ("7,F,51", "7,ERR,range,value out of range"),
        ("8,F,x", "8,ERR,range,value out of range"),
        ("9,DANCE", "9,ERR,unknown,no such request"),
        ("65535,HB", "65535,OK"),
    ],
)
def test_ascii_answers(request_body: str, answer: Any) -> None:
    slave = AsciiSlave(Bench().coil, "polishd,VC50,S-1,1.0,3")
    assert [body(got.strip()) for _, got in slave.feed(line(request_body), 0.0)] == [answer]


def test_broken_lines_are_not_answered() -> None:
    slave = AsciiSlave(Bench().coil, "x")
    dirt = b"$1,HB*00\r\nnoise\r\n$*00\r\n$70000,HB*" + line("70000,HB")[-4:] + b"$" + b"1" * 200 + b"\r\n"
    assert list(slave.feed(dirt, 0.0)) == []
    assert len(list(slave.feed(line("1,HB"), 0.0))) == 1


def test_status_does_not_feed_the_watchdog_and_a_heartbeat_does() -> None:
    bench = Bench().pressed()
    slave = AsciiSlave(bench.coil, "x")
    for k in range(30):
        bench.until(0.3 + 0.02 * k, fed=False)
        list(slave.feed(line("1,ST?"), 0.0))
    assert bench.coil.faults == 1


SLOW = CoilDynamics(land_s=2.0, lift_s=4.0, stick_share=0.5, resting_force_n=0.1)


def test_landing_and_lifting_take_the_time_that_hardware_takes() -> None:
    bench = Bench(pace=SLOW)
    bench.coil.set_force(12.0)
    bench.coil.engage()
    bench.until(1.9)
    assert bench.coil.state == EXTENDING
    bench.until(2.3)
    assert (bench.coil.state, bench.coil.force_n) == (CONTACT, 12.0)
    bench.coil.retract()
    bench.until(2.4)
    assert bench.coil.force_n == 0.1, "force off, and the tool still rests on the part"
    bench.until(4.2)
    assert (bench.coil.state, bench.coil.force_n) == (RETRACTING, 0.1)
    bench.until(4.5)
    assert bench.coil.force_n == 0.0
    bench.until(6.5)
    assert bench.coil.state == RETRACTED
    assert bench.names[-5:] == ["retract", "force_off", "force_zero", "tool_lifted", "retracted"]


def test_firmware_that_hangs_goes_on_pressing() -> None:
    bench = Bench().pressed()
    bench.coil.hung = True
    bench.until(5.0, fed=False)
    assert (bench.coil.force_n, bench.coil.faults) == (12.0, 0)


def test_a_frozen_sensor_reports_the_same_for_any_force() -> None:
    bench = Bench().pressed()
    freeze = FaultSection(device="actuator", what="freeze", at_s=0.0)
    bench.coil.suffer(freeze, True)
    bench.coil.set_force(5.0)
    bench.until(1.0)
    assert bench.coil.force_n == 5.0
    assert bench.coil.measured_n == pytest.approx(12.0, abs=0.6)
    bench.coil.suffer(freeze, False)
    assert bench.coil.measured_n == pytest.approx(5.0, abs=0.3)


def test_one_whose_sensor_drifts_regulates_by_it_and_still_reads_so_at_rest() -> None:
    bench = Bench().pressed()
    coil = bench.coil
    drift = FaultSection(device="actuator", what="drift", at_s=0.0, drift_n_s=2.0)
    coil.suffer(drift, True)
    bench.until(2.2)
    coil.suffer(drift, False)
    bench.until(2.5)
    assert coil.measured_n == pytest.approx(12.0, abs=0.6), "by its own word all is well"
    assert coil.force_n == pytest.approx(12.0 - coil.drift_n, abs=0.1)
    assert 3.0 < coil.drift_n <= 4.0
    coil.retract()
    bench.until(4.0)
    assert (coil.force_n, coil.measured_n) == (0.0, pytest.approx(coil.drift_n, abs=0.1))
