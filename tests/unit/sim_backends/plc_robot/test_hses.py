"""The simulated controller's High-Speed Ethernet Server, datagram by datagram."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import pytest

from polishd.sim_backends.plc_robot.hses import HsesServer
from tests.fakes.plc_robot import FakePlc

JOB = ["/JOB", "//NAME POLISH", "//POS", "///RECTAN", "C00000=0,0,60,180,0,0", "C00001=9,0,60,180,0,0", "//INST", "NOP"]
JOB += ["MOVL C00001 V=1.0", "TIMER T=1.00", "MOVL C00000 V=1.0", "PAUSE", "END"]
NAME = b"POLISH".ljust(32, b"\0")
ON = struct.pack("<I", 1)
OFF = struct.pack("<I", 2)


class Controller:
    """The server with a clock of the test."""

    def __init__(self, folder: Path) -> None:
        (folder / "POLISH.JBI").write_text("\r\n".join([*JOB, ""]))
        self.now_s = time.monotonic()  # at which the fake has had its first cycle
        self.plc = FakePlc(folder, speed=1.0, watchdog_s=8.0).plc
        self.plc.goes_on = False
        self.server = HsesServer(self.plc, lambda: self.now_s)

    def passes(self, seconds: float, *, beats: bool = True) -> None:
        """Let so much time pass, cycle by cycle, with or without a client's heartbeat."""
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self.plc.inputs["heartbeat"] = int(self.plc.inputs["heartbeat"]) + beats
            self.plc.tick(self.now_s)

    def ask(
        self, command: int, instance: int = 1, attribute: int = 0, service: int = 1, data: bytes = b"", *, more: int = 0
    ) -> tuple[int, int, bytes]:
        """Status, added status and data; ``more``: error of the size in the header."""
        head = struct.pack("<4sHHBBBBI8s", b"YERC", 32, len(data) + more, 3, 1, 0, 9, 0, b"99999999")
        found = self.server.answer(head + struct.pack("<HHBBH", command, instance, attribute, service, 0) + data)
        assert (found[:4], found[10], found[11], found[24]) == (b"YERC", 1, 9, service | 0x80)
        assert struct.unpack_from("<H", found, 6)[0] == len(found) - 32
        return found[25], struct.unpack_from("<H", found, 28)[0], found[32:]

    def order(self, command: int, data: bytes = ON, instance: int = 1) -> int:
        """Added status of an order; 0 where it is taken."""
        return self.ask(command, instance, 1, 0x10, data)[1]

    def select(self, name: bytes = NAME, line: int = 0) -> int:
        return self.ask(0x87, 1, 0, 2, name + struct.pack("<I", line))[1]

    @property
    def bits(self) -> tuple[int, int]:
        one, two = struct.unpack("<II", self.ask(0x72)[2])
        return one, two

    @property
    def line(self) -> int:
        return int(struct.unpack_from("<I", self.ask(0x73)[2], 32)[0])


@pytest.fixture
def controller(tmp_path: Path) -> Controller:
    found = Controller(tmp_path)
    found.passes(0.1)
    return found


def selected(controller: Controller) -> Controller:
    assert controller.select() == 0
    controller.passes(0.1)
    return controller


def test_a_job_from_its_selection_to_its_end(controller: Controller) -> None:
    selected(controller)
    assert (controller.bits, controller.line, controller.ask(0x73)[2][:32]) == ((0xC2, 0x40), 0, NAME)
    assert controller.order(0x86) == 0
    controller.passes(1.0)
    assert (controller.bits, controller.line) == ((0xCA, 0x40), 1)
    assert controller.order(0x86) == 0x2010, "it moves"
    assert controller.select() == 0x2010
    controller.passes(8.5)
    assert controller.line == 2
    controller.passes(12.0)
    assert (controller.bits[0], controller.line) == (0xC2, 4), "it stands at PAUSE"
    assert controller.order(0x86) == 0
    controller.passes(0.1)
    assert (controller.bits[0], controller.line) == (0xC2, 0), "ended, and back at its top"
    assert controller.order(0x86) == 0
    controller.passes(0.1)
    assert (controller.bits[0], controller.line) == (0xCA, 1), "it begins again"


def test_what_refuses_a_start(controller: Controller) -> None:
    assert controller.order(0x86) == 0x4060, "no job"
    selected(controller)
    assert controller.order(0x83) == 0
    assert controller.order(0x86) == 0x2050
    assert controller.order(0x83, OFF) == 0
    for button, added, bits in (("feed hold", 0x2020, (0xC2, 0x42)), ("manual", 0x2080, (0x22, 0x40))):
        controller.plc.press(button, controller.now_s)
        assert (controller.bits, controller.order(0x86)) == (bits, added)
        controller.plc.press(button, controller.now_s)
    controller.plc.press("emergency stop", controller.now_s)
    controller.passes(0.1)
    assert (controller.bits, controller.order(0x86)) == ((0xC2, 0x00), 0x2070)


def test_an_external_hold_while_the_heartbeat_is_silent(controller: Controller) -> None:
    selected(controller)
    assert controller.order(0x86) == 0
    controller.passes(8.5, beats=False)
    assert (controller.bits[1], controller.order(0x86)) == (0x44, 0x2040)
    assert controller.ask(0x7C, 10, 1, 0x10, struct.pack("<i", 5))[0] == 0
    controller.passes(0.1)
    assert (controller.bits[1], controller.order(0x86)) == (0x40, 0)


def test_a_hold_that_is_released_at_once_counts(controller: Controller) -> None:
    selected(controller)
    assert controller.order(0x86) == 0
    controller.passes(0.5)
    assert controller.order(0x83) == controller.order(0x83, OFF) == 0
    controller.passes(0.5)
    assert controller.bits[0] == 0xC2


def test_a_feed_hold_that_is_released_waits_for_a_start(controller: Controller) -> None:
    selected(controller)
    assert controller.order(0x86) == 0
    controller.passes(0.5)
    for _ in range(2):
        controller.plc.press("feed hold", controller.now_s)
        controller.passes(0.5)
    assert controller.bits == (0xC2, 0x40)


def test_an_alarm_that_is_reset(controller: Controller, tmp_path: Path) -> None:
    (tmp_path / "POLISH.JBI").write_text("/JOB\n//NAME POLISH\nNOP\nJUMP *A\nEND\n")
    selected(controller)
    code, _, kind, _, text = struct.unpack("<III16s32s", controller.ask(0x70)[2])
    assert (controller.bits[1], code, kind, b"JUMP" in text) == (0x50, 1, 1, True)
    assert controller.order(0x86) == controller.select() == 0x2060
    assert controller.order(0x82) == controller.order(0x82, instance=2) == 0
    controller.passes(0.1)
    assert controller.bits[1] == 0x40


def test_elements_of_a_record_and_codes_of_what_is_wrong(controller: Controller) -> None:
    selected(controller)
    assert controller.ask(0x73, attribute=4, service=0x0E)[2] == struct.pack("<I", 10000)
    assert controller.ask(0x73, attribute=5, service=0x0E)[0] == 0x09
    assert controller.ask(0x73, service=0x10)[0] == 0x08
    assert controller.ask(0x77)[0] == 0x08
    assert controller.ask(0x72, instance=2)[0] == controller.ask(0x7A, 100, 1, 0x0E)[0] == 0x28
    assert controller.ask(0x7C, 1, 1, 0x10, b"\1\0")[1] == 0xB003
    assert controller.order(0x83, struct.pack("<I", 3)) == controller.select(line=7) == 0xB004
    assert controller.order(0x84, struct.pack("<I", 3), 2) == 0xB004
    assert controller.select(b"OTHER".ljust(32, b"\0")) == controller.select(b"POLISH.JBI".ljust(32, b"\0")) == 0x4040
    assert controller.ask(0x72, more=1)[1] == 0xE4A7
    for junk in (b"", b"YERC", b"X" * 40, controller.server.answer(b"YERC" + bytes(28))):
        assert controller.server.answer(junk) == b""
