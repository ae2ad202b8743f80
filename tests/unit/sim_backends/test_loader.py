"""The simulated loader: its arm, and its line against the document's vectors."""

from __future__ import annotations

from typing import Any

import pytest

from polishd.config.simulator_devices import LoaderFaults
from polishd.sim_backends.common.wire import NumberedSlave
from polishd.sim_backends.loader import ANOTHER, DROPPED, FAULT, IDLE, JAMMED, MOVING, STOPPED, LoaderArm, answering
from tests.vectors import vectors

LINES = {name: line.encode() for name, line in vectors("loader").items()}


class Bench:
    """An arm with a manual clock."""

    def __init__(self, seat: str = "P-1", **changes: Any) -> None:
        self.reported: list[str] = []
        self.seats: list[str] = []
        values: dict[str, Any] = {"load_s": 2.0, "unload_s": 1.0} | changes
        self.arm = LoaderArm(lambda name, *_, **__: self.reported.append(name), self.seats.append, 0.0, seat, **values)

    def after(self, seconds: float, *, requested: bool = True) -> int:
        """Advance the arm by this time and return its state."""
        if requested:
            self.arm.on_request()
        self.arm.step(self.arm.now_s + seconds)
        return self.arm.state

    def change(self, part: str) -> None:
        assert self.arm.unload() == ""
        assert self.after(1.0) == IDLE
        assert self.arm.load(part) == ""
        self.after(2.0)


def test_a_part_goes_and_another_comes() -> None:
    bench = Bench()
    bench.change("P-2")
    assert (bench.arm.seat, bench.arm.seen, bench.seats) == ("P-2", "P-2", ["", "P-2"])
    assert bench.reported == ["loader_moves", "loader_clear"] * 2


def test_a_part_that_is_there_stays() -> None:
    bench = Bench()
    assert (bench.arm.load("P-1"), bench.arm.state, bench.seats) == ("", IDLE, [])


def test_it_takes_its_time_and_refuses_others_meanwhile() -> None:
    bench = Bench(seat="")
    assert bench.arm.load("P-2") == ""
    assert bench.after(1.9) == MOVING
    assert (bench.arm.load("P-3"), bench.arm.unload(), bench.arm.seat) == ("busy", "busy", "")
    assert bench.after(0.2) == IDLE
    assert bench.arm.seat == "P-2"


def test_stopped_it_waits_and_goes_on() -> None:
    bench = Bench(seat="")
    bench.arm.load("P-2")
    bench.after(1.5)
    bench.arm.stop()
    assert bench.after(60.0) == STOPPED
    bench.arm.load("P-2")
    assert bench.after(0.4) == MOVING
    assert bench.after(0.2) == IDLE


def test_what_it_carries_may_go_back() -> None:
    bench = Bench(seat="")
    bench.arm.load("P-2")
    bench.after(1.5)
    bench.arm.stop()
    assert bench.arm.unload() == ""
    assert bench.after(1.0) == IDLE
    assert (bench.arm.seat, bench.seats) == ("", [""])


def test_without_requests_it_stops() -> None:
    bench = Bench(seat="", load_s=60.0)
    bench.arm.load("P-2")
    assert bench.after(4.9, requested=False) == MOVING
    assert bench.after(0.2, requested=False) == STOPPED
    assert "watchdog" in bench.reported


def test_refusals() -> None:
    bench = Bench(store=("P-1", "P-2"))
    assert (bench.arm.load("P-9"), bench.arm.load("P-2")) == ("part", "occupied")
    assert Bench(seat="").arm.unload() == ""


@pytest.mark.parametrize(("fault", "bit"), [("dropped", DROPPED), ("jammed", JAMMED)])
def test_a_fault_stays_until_it_is_reset_and_comes_once(fault: str, bit: int) -> None:
    bench = Bench(seat="", faults=LoaderFaults(**{fault: ("P-2",)}))
    bench.arm.load("P-2")
    assert bench.after(2.0) == FAULT
    assert (bench.arm.fault, bench.arm.seat, bench.arm.load("P-2"), bench.arm.unload()) == (bit, "", "fault", "fault")
    bench.arm.reset()
    bench.arm.load("P-2")
    assert bench.after(2.0) == IDLE
    assert bench.arm.seat == "P-2"


@pytest.mark.parametrize(("fault", "says"), [("wrong", ANOTHER), ("wrong_part_unnoticed", "P-2")])
def test_another_part(fault: str, says: str) -> None:
    bench = Bench(faults=LoaderFaults(**{fault: ("P-2",)}))
    bench.change("P-2")
    assert (bench.arm.seat, bench.arm.seen) == (ANOTHER, says)
    bench.change("P-3")
    assert (bench.arm.seat, bench.arm.seen) == ("P-3", "P-3")


def test_its_line_is_that_of_the_document() -> None:
    bench = Bench(seat="", store=("lens 7",))
    slave = NumberedSlave(answering(bench.arm, 3))

    def ask(name: str) -> list[bytes]:
        return [answer.rstrip() for answer in slave.feed(LINES[name] + b"\r\n")]

    assert ask("load") == [LINES["ok"]]
    bench.after(2.0)
    assert ask("status_request") == [LINES["status"]]
    bench.arm.seat = "P-1"
    (occupied,) = slave.feed(b"garbage\r\n" + LINES["load"] + b"\r\n")
    assert b"ERR,occupied," in occupied
    assert list(slave.feed(LINES["load"].replace(b"lens", b"lend") + b"\r\n")) == [], "its checksum is wrong"
