"""The spindle drive and its two ways to the bus, against the documented vectors."""

from __future__ import annotations

from typing import Any

import pytest

from polishd.config.simulator import FaultSection
from polishd.sim_backends.common.can import SlcanHost, SocketcandHost, slcan_frame, slcan_line
from polishd.sim_backends.spindle import Drive
from tests.unit.sim_backends.vectors import vectors


def frame(text: str) -> tuple[int, bytes]:
    identifier, data = text.split("#")
    return int(identifier, 16), bytes.fromhex(data)


VECTORS = {name: frame(value) for name, value in vectors("spindle_can").items()}


class Bench:
    def __init__(self) -> None:
        self.log = []
        objects = {(0x1018, 4): 12345, (0x2000, 0): 3, (0x6080, 0): 3000}
        self.drive = Drive(5, 3000, objects, lambda name, at_s: self.log.append(name), 0.0)
        self.sent = []

    def until(self, now: float, command: Any = None) -> None:
        """Let time pass in ticks; a command given is repeated as a controller would."""
        while self.drive.now_s < now - 1e-9:
            if command is not None:
                self.drive.on_frame(*command)
            self.sent += [(self.drive.now_s, *each) for each in self.drive.step(self.drive.now_s + 0.01)]


def run(rpm: float, counter: int = 9) -> tuple[int, bytes]:
    return 0x205, b"\x01" + bytes([counter]) + rpm.to_bytes(2, "little", signed=True) + bytes(4)


def test_the_page_says_run_and_it_runs() -> None:
    bench = Bench()
    assert run(1000) == VECTORS["run_1000_counter_9"]
    bench.until(0.4, VECTORS["run_1000_counter_9"])
    assert bench.drive.state == 1
    assert bench.drive.rpm == pytest.approx(780, abs=25)
    bench.until(0.6, VECTORS["run_1000_counter_9"])
    assert bench.drive.status() == VECTORS["status_at_speed"]
    bench.until(1.3, VECTORS["stop_counter_10"])
    assert (bench.drive.rpm, bench.drive.state) == (0.0, 0)
    assert bench.log == ["spindle_ramping", "spindle_at_speed", "spindle_ramping", "spindle_stopped"]


def test_status_and_heartbeat_come_by_themselves() -> None:
    bench = Bench()
    bench.until(1.0)
    at = {ident: [t for t, i, _ in bench.sent if i == ident] for ident in (0x185, 0x705)}
    assert len(at[0x185]) == pytest.approx(20, abs=1)
    assert len(at[0x705]) == pytest.approx(11, abs=1)
    assert bench.sent[0][1:] == (0x705, b"\0")
    assert (bench.sent[-1][1:] == VECTORS["heartbeat"]) or VECTORS["heartbeat"] in [s[1:] for s in bench.sent]


def test_silence_is_a_fault_that_a_stop_clears() -> None:
    bench = Bench()
    bench.until(0.6, run(1000))
    bench.until(0.6 + 0.8 * bench.drive.watchdog_s)
    assert bench.drive.fault == 0
    bench.until(2.5)
    assert (bench.drive.fault, bench.drive.rpm, bench.drive.state) == (1, 0.0, 3)
    bench.until(2.6, run(1000))
    assert bench.drive.rpm == 0.0
    bench.until(2.7, VECTORS["stop_counter_10"])
    bench.until(2.9, run(1000))
    assert bench.drive.rpm > 0.0


def test_over_speed_is_ignored_and_told() -> None:
    bench = Bench()
    bench.until(0.6, run(1000))
    bench.until(0.7, run(3001))
    assert (bench.drive.rpm, bench.drive.fault) == (1000.0, 2)
    bench.until(0.8, run(-500))
    assert bench.drive.fault == 0
    bench.until(1.7, run(-500))
    assert bench.drive.rpm == -500.0


def test_samples_hold_the_ramp() -> None:
    bench = Bench()
    bench.until(0.25, run(1000))
    times = [t for t, _ in bench.drive.samples]
    assert times == sorted(times)
    assert bench.drive.samples[-1][1] == pytest.approx(bench.drive.rpm)


def test_identity_by_sdo() -> None:
    drive = Bench().drive
    assert drive.on_frame(*VECTORS["identity_request"]) == [VECTORS["identity_answer"]]
    assert drive.on_frame(*frame("605#4000200000000000")) == [frame("585#4300200003000000")]
    assert drive.on_frame(*frame("605#4099990000000000")) == [frame("585#8099990000000206")]
    assert drive.on_frame(0x606, bytes(8)) == []
    assert drive.on_frame(0x205, bytes(3)) == []


def test_slcan_line_of_the_page() -> None:
    assert slcan_line(VECTORS["run_1000_counter_9"]) == b"t20580109e80300000000\r"
    assert slcan_frame(b"t20580109e80300000000") == VECTORS["run_1000_counter_9"]
    assert slcan_frame(b"t2058010") is None
    assert slcan_frame(b"t20x0") is None


def test_slcan_adapter() -> None:
    heard = []
    host = SlcanHost(lambda ident, data: heard.append((ident, data)) or [(0x585, b"\x01")])
    assert host.feed(b"t2050\r") == b"\a"
    assert host.send([(0x705, b"\5")]) == b""
    assert host.feed(b"C\rS6\rO") == b"\r\r"
    assert host.feed(b"\r") == b"\r"
    assert host.feed(b"t205201ff\r") == b"z\rt585101\r"
    assert heard == [(0x205, b"\x01\xff")]
    assert host.send([(0x705, b"\5")]) == b"t705105\r"
    assert host.feed(b"V\rN\rF\rjunk\r") == b"V1013\rNSIM1\rF00\r\a"


def test_socketcand_connection() -> None:
    heard = []
    host = SocketcandHost(lambda ident, data: heard.append((ident, data)) or [(0x585, b"\x01")])
    assert host.feed(b"< open can0 >< raw") == b"< ok >"
    assert host.send([(0x705, b"\5")]) == b""
    assert host.feed(b"mode >") == b"< ok >"
    assert host.send([(0x705, b"\5")]) == b"< frame 705 0.000000 05 >"
    assert host.feed(b"< send 205 2 1 FF >") == b"< frame 585 0.000000 01 >"
    assert heard == [(0x205, b"\x01\xff")]
    assert host.feed(b"< send 205 3 1 FF >< dance >") == b"< error malformed frame >< error unknown command >"


def test_with_two_phases_exchanged_it_turns_the_other_way_and_its_encoder_reads_that() -> None:
    bench = Bench()
    bench.drive.suffer(FaultSection(device="spindle", what="reverse", at_s=0.0), True)
    bench.until(0.6, run(1000))
    assert bench.drive.samples[-1][1] == -1000.0
    assert int.from_bytes(bench.drive.status()[1][2:6], "little", signed=True) == -10_000
