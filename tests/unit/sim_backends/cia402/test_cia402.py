"""The simulated drive of CiA 402: its page's vectors, its reactions, and what it refuses. Its clock is the test's."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.config.simulator_faults import FaultSection
from polishd.sim_backends.cia402 import device as stage
from polishd.sim_backends.cia402.device import (
    BOOT_S,
    I8,
    I16,
    I32,
    OBJECTS,
    U8,
    U16,
    U32,
    DrivenCoil,
    Motor,
    Node,
    Objects,
)
from polishd.sim_backends.common.voice_coil import VoiceCoil
from tests.unit.sim_backends.vectors import vectors

CONTROLLER = 0x45
SIZE = {U8: 1, I8: 1, U16: 2, I16: 2, U32: 4, I32: 4}


def frame(text: str) -> tuple[int, bytes]:
    identifier, data = text.split("#")
    return int(identifier, 16), bytes.fromhex(data)


VECTORS = {name: frame(value) for name, value in vectors("cia402").items()}


class Bench:
    """A drive, its clock, and what it says."""

    def __init__(self, moved: Motor | VoiceCoil) -> None:
        self.log: list[str] = []
        self.sent: list[tuple[float, int, bytes]] = []
        axis = moved if isinstance(moved, Motor) else DrivenCoil(moved)
        self.node = Node(5, axis, lambda name, at_s, **_: self.log.append(name), 0.0)

    def until(self, at_s: float, *, has_heartbeat: bool = True) -> None:
        """Advance the node; the controller's heartbeat comes with each tick or not at all."""
        while self.node.now_s < at_s - 1e-9:
            if has_heartbeat:
                self.node.on_frame(*VECTORS["our_heartbeat"])
            self.sent += [(self.node.now_s, *each) for each in self.node.step(self.node.now_s + 0.01)]

    def write(self, index: int, value: int, sub: int = 0) -> int:
        """Write an object over SDO and return the abort code, or 0."""
        size = SIZE[OBJECTS[index, sub][0]]
        data = value.to_bytes(size, "little", signed=value < 0)
        request = struct.pack("<BHB4s", 0x23 | (4 - size) << 2, index, sub, data)
        ((identifier, answer),) = self.node.on_frame(0x605, request)
        assert identifier == 0x585
        return 0 if answer[0] == 0x60 else int.from_bytes(answer[4:], "little")

    def emergencies(self) -> list[tuple[int, int]]:
        return [struct.unpack("<HB5x", data) for _, identifier, data in self.sent if identifier == 0x085]

    def enable(self, mode: int) -> None:
        for index, value in ((0x6060, mode), (0x6040, 6), (0x6040, 7), (0x6040, 15)):
            assert self.write(index, value) == 0

    def watch(self, option: int) -> None:
        """Set watchdog reaction and heartbeat consumer as the drivers do."""
        assert self.write(0x6007, option) == 0
        assert self.write(0x1016, CONTROLLER << 16 | 500, 1) == 0


def spindle() -> tuple[Bench, Motor]:
    motor = Motor(np.random.default_rng(1), lambda *_, **__: None, 0.0)
    return Bench(motor), motor


def actuator() -> tuple[Bench, VoiceCoil]:
    coil = VoiceCoil(np.random.default_rng(1), lambda *_, **__: None, 0.0, touch_um=5000.0)
    return Bench(coil), coil


def test_it_answers_the_vectors() -> None:
    bench, _ = spindle()
    bench.until(0.01)
    assert bench.sent[0][1:] == VECTORS["boot"]
    assert bench.node.on_frame(*VECTORS["write_mode_velocity"])[0][1][0] == 0x60
    bench.enable(3)
    assert bench.node.on_frame(*VECTORS["write_target_velocity_10000"]) == [VECTORS["written_target_velocity"]]
    assert bench.node.on_frame(*VECTORS["read_status_word"]) == [VECTORS["status_word_enabled"]]
    assert bench.node.on_frame(0x605, bytes.fromhex("2f60600002000000")) == [VECTORS["refused_mode"]]
    assert bench.node.on_frame(*VECTORS["start_node"]) == []
    bench.write(0x1017, 100)
    bench.until(0.2)
    assert bench.sent[-1][1:] == VECTORS["heartbeat"]


def test_the_rotor_follows_the_ramps_and_stops_on_that_of_the_quick_stop() -> None:
    bench, motor = spindle()
    bench.write(0x6083, 10_000)
    bench.write(0x6085, 40_000)
    bench.enable(3)
    bench.write(0x60FF, 10_000)
    bench.until(0.5)
    assert motor.rpm == pytest.approx(480.0, abs=15.0)  # 20 ms late
    bench.until(1.3)
    assert motor.rpm == pytest.approx(1000.0, abs=1.0)
    assert bench.node.objects[0x6041] & 0x46F == 0x427
    bench.write(0x6040, 2)
    assert bench.node.power.state == stage.QUICK_STOP
    bench.until(1.4)
    assert motor.rpm == pytest.approx(680.0, abs=30.0)
    bench.until(1.8)
    assert (motor.rpm, bench.node.power.state) == (0.0, stage.DISABLED)


def test_with_two_phases_exchanged_its_encoder_reads_the_other_way() -> None:
    bench, motor = spindle()
    motor.suffer(FaultSection(device="spindle", what="reverse", at_s=0.0), True)
    bench.enable(3)
    bench.write(0x60FF, 10_000)
    bench.until(1.5)
    assert motor.samples[-1][1] == pytest.approx(-1000.0, abs=1.0)
    assert bench.node.objects[0x606C] == pytest.approx(-10_000, abs=30)


def test_the_coil_spikes_and_its_torque_shows_it() -> None:
    bench, coil = actuator()
    bench.enable(4)
    bench.write(0x6071, 280)  # 14 N, 2 of them against the spring
    bench.until(0.5)
    assert coil.force_n == pytest.approx(12.0)
    coil.suffer(FaultSection(device="actuator", what="spike", at_s=0.0, force_n=36.0), True)
    bench.until(0.55)
    assert coil.force_n == pytest.approx(48.0)
    assert bench.node.objects[0x6077] * 0.05 - 2.0 == pytest.approx(48.0, rel=0.1)


@pytest.mark.parametrize(
    ("option", "ends"), [(0, stage.ENABLED), (1, stage.FAULT), (2, stage.DISABLED), (3, stage.DISABLED)]
)
def test_its_reaction_to_silence_is_the_configured_one(option: int, ends: int) -> None:
    bench, motor = spindle()
    bench.watch(option)
    bench.until(0.1)
    bench.enable(3)
    bench.write(0x60FF, 5000)
    bench.until(1.0)
    bench.until(1.45, has_heartbeat=False)
    assert bench.emergencies() == []
    bench.until(4.5, has_heartbeat=False)
    assert bench.emergencies() == [(0x8130, 0x11)]
    assert bench.log[0] == "watchdog"
    assert bench.node.state == 0x7F
    assert bench.node.power.state == ends
    assert (motor.rpm == 0.0) == (option != 0)
    assert frame(vectors("cia402")["emergency_heartbeat"]) in [(i, d) for _, i, d in bench.sent]


def test_a_controller_that_comes_back_ends_the_emergency_but_not_the_fault() -> None:
    bench, _ = spindle()
    bench.watch(1)
    bench.until(0.1)
    bench.enable(3)
    bench.until(1.0, has_heartbeat=False)
    bench.until(1.2)
    assert bench.node.power.state == stage.FAULT
    assert bench.node.objects[0x603F] == 0x8130
    for word in (0x00, 0x80):
        bench.write(0x6040, word)
    assert bench.node.power.state == stage.FAULT, "not before the communication is reset"
    bench.node.on_frame(*VECTORS["reset_communication"])
    assert bench.node.objects.values[0x1016, 1] == 0
    assert bench.node.objects[0x6007] == 1
    for word in (0x00, 0x80):
        bench.write(0x6040, word)
    bench.until(1.3)
    assert bench.emergencies() == [(0x8130, 0x11), (0, 0)]
    assert [data for _, identifier, data in bench.sent if identifier == 0x705 and data == b"\0"] == [b"\0"] * 2
    assert (bench.node.power.state, bench.node.objects[0x1001]) == (stage.DISABLED, 0)


def test_a_rebooted_drive_has_lost_its_settings() -> None:
    bench, motor = spindle()
    bench.watch(3)
    bench.enable(3)
    bench.write(0x60FF, 5000)
    bench.until(1.0)
    bench.node.reboot()
    assert bench.node.on_frame(*VECTORS["read_status_word"]) == []
    bench.sent.clear()
    bench.until(1.0 + BOOT_S + 0.05)
    assert [each[1:] for each in bench.sent] == [VECTORS["boot"]]
    assert {key: bench.node.objects.values[key] for key in ((0x6007, 0), (0x1016, 1), (0x60FF, 0), (0x6060, 0))} == {
        (0x6007, 0): 1,
        (0x1016, 1): 0,
        (0x60FF, 0): 0,
        (0x6060, 0): 0,
    }
    bench.until(5.0)
    assert motor.rpm == 0.0


def test_off_the_bus_it_neither_receives_nor_sends_and_reports_it_afterwards() -> None:
    bench, _ = spindle()
    bench.until(0.1)
    bench.node.bus_off(0.5)
    bench.sent.clear()
    bench.until(0.55)
    assert bench.node.on_frame(*VECTORS["read_status_word"]) == []
    assert bench.sent == []
    bench.until(0.7)
    assert bench.emergencies() == [(0x8140, 0)]


def test_the_coil_presses_with_what_is_beyond_its_spring_and_a_spring_lifts_it() -> None:
    bench, coil = actuator()
    bench.watch(2)
    bench.enable(4)
    bench.until(0.3)
    assert coil.position_um == 0.0
    bench.write(0x6071, 60)
    bench.until(0.6)
    assert coil.position_um == 5000.0
    bench.write(0x6071, 280)
    bench.until(1.0)
    assert coil.force_n == pytest.approx(12.0)
    assert bench.node.objects[0x6077] == pytest.approx(280, abs=15)
    bench.until(2.0, has_heartbeat=False)
    assert (coil.force_n, coil.position_um, bench.node.power.state) == (0.0, 0.0, stage.DISABLED)


def test_profile_position_lifts_it() -> None:
    bench, coil = actuator()
    bench.enable(4)
    bench.write(0x6071, 100)
    bench.until(0.6)
    assert coil.force_n == pytest.approx(3.0)
    for index, value in ((0x6071, 0), (0x607A, 0), (0x6060, 1), (0x6040, 0x3F)):
        assert bench.write(index, value) == 0
    bench.until(1.2)
    assert (coil.position_um, bench.node.power.state) == (0.0, stage.ENABLED)


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("2b41600037020000", 0x06010002),
        ("23406000060000 00", 0x06070010),
        ("4000500000000000", 0x06020000),
        ("4018100900000000", 0x06090011),
        ("2b716000dc050000", 0),
        ("2b71600000060000", 0x06090030),
        ("a018100000000000", 0x05040001),
    ],
)
def test_what_it_refuses(request_: str, code: int) -> None:
    answer = Objects().serve(bytes.fromhex(request_))
    assert answer is not None
    assert answer[0] == (0x80 if code else 0x60)
    assert int.from_bytes(answer[4:], "little") == code


@given(st.lists(st.one_of(st.binary(min_size=8, max_size=8), st.sampled_from([bytes.fromhex("80")]))))
def test_any_request_is_survived(requests: list[bytes]) -> None:
    bench, _ = spindle()
    receive: Callable[[int, bytes], list[tuple[int, bytes]]] = bench.node.on_frame
    for request in requests:
        for identifier in (0x000, 0x605, 0x745):
            receive(identifier, request)
        bench.node.step(bench.node.now_s + 0.1)
