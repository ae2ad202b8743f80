"""The simulated PLC: orders by edges and levels, its outputs, and its automatic reactions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polishd.sim_backends.plc_robot.controller import (
    DONE,
    FAULT,
    HELD,
    IDLE,
    LINES_A_CYCLE,
    PAUSED,
    READY,
    RUNNING,
    Plc,
    PlcProgram,
)
from polishd.sim_backends.plc_robot.device import ModbusServer
from tests.fakes.plc_robot import FakePlc

PROGRAM = b"G1 X1 F60\nG1 X2\nG4 P0.5 (polishd)\nM0 (polishd)\nG1 X3\nM2\n"
"""A second a millimetre; polishd's lines are marked."""


class Bench:
    """A PLC on a clock of the test's own: a second is a second."""

    def __init__(self, folder: Path) -> None:
        fake = FakePlc(folder, speed=1.0, watchdog_s=5.0, report_ms=100.0)
        self.plc: Plc = fake.plc
        self.events = fake.events
        self.now_s = 1e6
        self.folder = folder
        self.run(0.2)

    def run(self, seconds: float, *, beats: bool = True) -> None:
        """Let it cycle every 10 ms."""
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            if beats:
                self.plc.inputs["heartbeat"] = int(self.now_s * 10) % 1000
            self.plc.tick(self.now_s)

    def pulse(self, order: str) -> None:
        """An order that comes up and goes."""
        self.plc.inputs[order] = True
        self.run(0.15)
        self.plc.inputs[order] = False
        self.run(0.15)

    def load(self, text: bytes = PROGRAM) -> None:
        (self.folder / "a.nc").write_bytes(text)
        self.plc.inputs["program"] = "C:\\NC\\a.nc".replace("\\", "/")
        self.pulse("load")

    def until(self, condition: Callable[[], bool]) -> None:
        for _ in range(2000):
            if condition():
                return
            self.run(0.01)
        raise AssertionError(self.plc.shown)

    @property
    def state(self) -> object:
        return self.plc.shown["state"]


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_a_program_is_loaded_run_paused_and_done(bench: Bench) -> None:
    assert bench.state == IDLE
    bench.load()
    assert (bench.state, bench.plc.shown["loaded"]) == (READY, "C:/NC/a.nc")
    assert bench.plc.motion.state == "held"
    bench.pulse("start")
    assert (bench.state, bench.plc.shown["line"], bench.plc.shown["in_motion"]) == (RUNNING, 1, True)
    bench.until(lambda: bench.state == PAUSED)
    assert bench.plc.shown["line"] == 4, "that of the M0"
    bench.pulse("start")
    bench.until(lambda: bench.state == DONE)


def test_it_reports_when_its_line_began(bench: Bench) -> None:
    bench.load()
    bench.pulse("start")
    bench.until(lambda: bench.plc.shown["line"] == 2)
    seq, _, end_s = bench.plc.motion.executed[0]
    reported = bench.plc.shown["line_began"]
    assert isinstance(reported, float)
    assert seq == 0
    assert reported - bench.plc.motion.changed_s == pytest.approx(end_s - 0.0, abs=1e-6)
    bench.until(lambda: bench.state == PAUSED)
    assert bench.plc.shown["line_began"] == pytest.approx(bench.plc.shown["state_began"], abs=0.02)


def test_hold_beats_start_and_nothing_starts_while_it_is_on(bench: Bench) -> None:
    bench.load()
    bench.plc.inputs["hold"] = True
    bench.pulse("start")
    assert bench.state == READY
    bench.plc.inputs["hold"] = False
    bench.run(0.3)
    assert bench.state == READY, "letting go starts nothing"
    bench.pulse("start")
    bench.plc.inputs["hold"] = True
    bench.run(0.5)
    assert bench.state == HELD


def test_a_feed_hold_continues_on_release_as_machines_do(bench: Bench) -> None:
    bench.load()
    bench.pulse("start")
    bench.plc.press("feed hold", bench.now_s)
    bench.run(0.5)
    assert (bench.state, bench.plc.shown["feed_hold"]) == (HELD, True)
    bench.pulse("start")
    assert bench.state == HELD
    bench.plc.press("feed hold", bench.now_s)
    bench.run(0.3)
    assert bench.state == RUNNING


def test_a_missing_heartbeat_is_noticed(bench: Bench) -> None:
    bench.load()
    bench.pulse("start")
    bench.plc.press("feed hold", bench.now_s)
    bench.plc.press("feed hold", bench.now_s)
    bench.run(6.0, beats=False)
    assert bench.state in (HELD, PAUSED)
    bench.load(b"G1 X100 F60\nM2\n")
    bench.pulse("start")
    bench.run(6.0, beats=False)
    assert bench.state == HELD
    assert "watchdog" in bench.events


def test_a_program_that_it_cannot_read_is_an_alarm_until_a_reset(bench: Bench) -> None:
    bench.load(b"G1 X1 F60\n?what\nM2\n")
    assert (bench.state, bench.plc.shown["alarm"]) == (FAULT, 1)
    assert "block 1" in str(bench.plc.shown["alarm_text"])
    bench.pulse("start")
    assert bench.plc.motion.state == "idle"
    bench.pulse("reset")
    assert (bench.state, bench.plc.shown["alarm"]) == (IDLE, 0)
    bench.plc.inputs["program"] = "none.nc"
    bench.pulse("load")
    assert (bench.state, bench.plc.shown["alarm"]) == (FAULT, 2)


def test_an_emergency_stop_stays(bench: Bench) -> None:
    bench.load()
    bench.pulse("start")
    bench.plc.press("emergency stop", bench.now_s)
    bench.run(0.5)
    bench.pulse("reset")
    assert (bench.state, bench.plc.shown["alarm"]) == (FAULT, 99)
    assert bench.plc.motion.state == "held"


def test_lines_of_the_file_are_the_programs_blocks_without_those_put_in() -> None:
    loaded = PlcProgram.of(PROGRAM)
    assert loaded.blocks == 4
    assert loaded.blocks_of(loaded.inserted * 0).tolist() == [0.0, 0.0]
    lines = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert loaded.blocks_of(np.array(lines)).tolist() == [0, 1, 2, 2, 2, 3]


@pytest.mark.parametrize(
    ("pdu", "answer"),
    [
        (b"\x01\x00\x00\x00\x04", b"\x01\x01\x00"),
        (b"\x02\x00\x00\x00\x02", b"\x02\x01\x00"),
        (b"\x05\x00\x01\xff\x00", b"\x05\x00\x01\xff\x00"),
        (b"\x05\x00\x01\x12\x00", b"\x85\x03"),
        (b"\x05\x00\x09\xff\x00", b"\x85\x02"),
        (b"\x04\x00\x00\x00\x01", b"\x04\x02\x00\x00"),
        (b"\x04\x00\x60\x00\x01", b"\x84\x02"),
        (b"\x04\x00", b"\x84\x03"),
        (b"\x03\x00\x00\x00\x01", b"\x03\x02\x00\x02"),
        (b"\x03\x00\x01\x00\x01", b"\x83\x02"),
        (b"\x06\x00\x00\x00\x2a", b"\x06\x00\x00\x00\x2a"),
        (b"\x07\x00\x00\x00\x2a", b"\x87\x01"),
        (b"\x0f\x00\x00\x00\x02\x01\x02", b"\x0f\x00\x00\x00\x02"),
        (b"\x0f\x00\x03\x00\x02\x01\x02", b"\x8f\x02"),
        (b"\x0f\x00\x00\x00\x02", b"\x8f\x03"),
        (b"\x10\x00\x00\x00\x01\x02\x00\x2a", b"\x10\x00\x00\x00\x01"),
        (b"\x10\x00\x07\x00\x01\x02\x00\x2a", b"\x90\x02"),
    ],
)
def test_modbus_answers(bench: Bench, pdu: bytes, answer: bytes) -> None:
    assert ModbusServer(bench.plc).answer(pdu) == answer


LONG = b"G1 X1 F60\n" + b"G1 X2\nG1 X1\n" * (15 * LINES_A_CYCLE)


@pytest.mark.full
def test_a_long_program_is_loaded_while_the_controller_goes_on(bench: Bench) -> None:
    bench.load()
    (bench.folder / "a.nc").write_bytes(LONG)
    beats = []
    bench.plc.inputs["load"] = True
    for cycle in range(29):
        bench.plc.inputs["start"] = cycle % 2 == 0
        bench.run(0.01)
        assert bench.plc.motion.state == "idle", "it has no program to start yet, nor the one before"
        beats.append(bench.plc.shown["controller_heartbeat"])
    bench.plc.inputs["start"] = False
    bench.run(0.2)
    assert bench.state == READY
    assert beats[-1] - beats[0] == 2, "it reports ten times a second"
    assert bench.plc.motion.accepted == 30 * LINES_A_CYCLE + 1
    assert bench.events.count("program_loaded") == 2


@pytest.mark.parametrize("ends", ["reset", "emergency stop"])
def test_a_load_that_is_broken_off_leaves_no_program(bench: Bench, ends: str) -> None:
    (bench.folder / "a.nc").write_bytes(LONG)
    bench.plc.inputs.update(program="a.nc", load=True)
    bench.run(0.03)
    if ends == "reset":
        bench.pulse("reset")
    else:
        bench.plc.press(ends, bench.now_s)
    bench.run(1.0)
    assert (bench.state, bench.plc.shown["loaded"]) == (IDLE if ends == "reset" else FAULT, "")
    assert bench.events.count("program_loaded") == 0


def test_a_wrong_line_far_into_a_long_program_is_an_alarm_and_nothing_is_loaded(bench: Bench) -> None:
    bench.load(LONG + b"G1 Q1\n")
    bench.run(1.0)
    assert (bench.state, bench.plc.motion.accepted) == (FAULT, 0)
    assert f"block {30 * LINES_A_CYCLE + 1}: " in str(bench.plc.shown["alarm_text"])
