"""The simulated force sensor and monitor: their readings, their faults, and their lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from polishd.config.simulator_devices import SEVEN, SimForceSensorSection, SimSignal
from polishd.config.simulator_faults import FaultSection
from polishd.sim_backends import force_sensor as sensor_device
from polishd.sim_backends import monitor as monitor_device
from polishd.sim_backends.common.framing import body
from polishd.sim_backends.common.wire import NumberedSlave
from polishd.sim_backends.force_sensor import FAULT, MEASURING, TARING, LoadCell
from polishd.sim_backends.monitor import Inputs
from polishd.sim_backends.plant.world import Timeline
from tests.unit.sim_backends.vectors import vectors


class Bench:
    """A load cell with a manual clock."""

    def __init__(self, **config: Any) -> None:
        self.reported: list[str] = []
        whole = SimForceSensorSection(**{"noise_n": 0.0, **config})
        self.cell = LoadCell(whole, np.random.default_rng(1), lambda name, *_, **__: self.reported.append(name), 100.0)
        self.answer = sensor_device.answering(self.cell, 3)

    def after(self, seconds: float) -> float:
        """Reading so much later, N."""
        for _ in range(round(seconds / 0.01)):
            self.cell.step(self.cell.now_s + 0.01)
        return float(self.answer("F?").split(",")[3])

    def suffers(self, what: str, **keys: float) -> FaultSection:
        """From now on."""
        fault = FaultSection.model_validate({"device": "force_sensor", "what": what, "at_s": 0.0, **keys})
        self.cell.suffer(fault, True)
        return fault

    def tared(self) -> Bench:
        assert self.answer("TARE") == "OK"
        self.after(0.5)
        return self


def test_it_carries_its_tool_until_it_is_tared() -> None:
    bench = Bench()
    assert bench.after(0.1) == 6.0
    assert bench.answer("TARE") == "OK"
    assert (bench.cell.state, bench.answer("TARE")) == (TARING, "ERR,busy,it tares")
    assert bench.after(0.5) == 0.0
    assert (bench.cell.state, bench.reported) == (MEASURING, ["sensor_tared"])


def test_it_feels_what_acts_a_little_later() -> None:
    bench = Bench(latency_s=0.05).tared()
    bench.cell.feel(bench.cell.now_s, 12.0)
    assert bench.after(0.03) == 0.0
    assert bench.after(0.04) == 12.0
    bench.cell.feel(bench.cell.now_s, 0.0)
    assert bench.after(0.03) == 12.0
    assert bench.after(0.1) == 0.0


def test_each_conversion_has_a_number() -> None:
    bench = Bench()
    bench.after(0.1)
    before = bench.cell.count
    bench.after(0.5)
    assert bench.cell.count - before == pytest.approx(50, abs=2)


def pressed() -> Bench:
    bench = Bench().tared()
    bench.cell.feel(bench.cell.now_s, 12.0)
    bench.after(0.5)
    return bench


def test_a_drift_stays_where_it_has_come_to() -> None:
    bench = pressed()
    drift = bench.suffers("drift", drift_n_s=2.0)
    assert bench.after(1.0) == pytest.approx(14.0, abs=0.1)
    bench.cell.suffer(drift, False)
    assert bench.after(1.0) == pytest.approx(14.0, abs=0.1)


def test_one_that_is_frozen_goes_on_converting() -> None:
    bench = pressed()
    freeze = bench.suffers("freeze")
    bench.cell.feel(bench.cell.now_s, 0.0)
    before = bench.cell.count
    assert bench.after(0.5) == 12.0
    assert bench.cell.count > before
    bench.cell.suffer(freeze, False)
    assert bench.after(0.1) == 0.0


def test_one_that_is_halted_answers_with_old_conversions() -> None:
    bench = pressed()
    bench.suffers("halt")
    bench.cell.feel(bench.cell.now_s, 0.0)
    before = bench.cell.count
    assert bench.after(0.5) == 12.0
    assert bench.cell.count == before


def test_one_that_saturates_does_not_say_so_and_one_beyond_its_range_does() -> None:
    bench = pressed()
    bench.suffers("saturate", limit_n=10.0)
    assert bench.after(0.1) == pytest.approx(4.0), "with 6 N of tool"
    bench = Bench(range_n=15.0).tared()
    bench.cell.feel(bench.cell.now_s, 12.0)
    bench.after(0.2)
    assert (bench.cell.state, bench.cell.fault) == (FAULT, 1)
    assert bench.answer("TARE") == "ERR,fault,a fault is set"
    bench.cell.feel(bench.cell.now_s, 0.0)
    bench.after(0.2)
    assert bench.cell.state == MEASURING


def test_one_that_lies_or_spikes_reads_what_does_not_act() -> None:
    bench = pressed()
    lie = bench.suffers("lie", factor=0.5, offset_n=1.0)
    assert bench.after(0.1) == pytest.approx(7.0)
    bench.cell.suffer(lie, False)
    assert bench.after(0.1) == pytest.approx(12.0)
    bench.suffers("spike", force_n=40.0)
    assert bench.after(0.1) == pytest.approx(52.0)


# the monitor


def inputs(**signals: SimSignal) -> tuple[Inputs, list[str]]:
    reported: list[str] = []
    whole = {**SEVEN, **signals}
    return Inputs(whole, np.random.default_rng(1), lambda name, *_, **__: reported.append(name), 100.0), reported


def test_the_seven_are_as_they_should_be() -> None:
    found, _ = inputs()
    assert 1.3 < float(found.reading("slurry_flow")) < 1.7
    assert [found.reading(name) for name in ("guard_closed", "emergency_stop_clear", "cell_empty")] == ["ON"] * 3


def test_a_flow_stops_after_so_long_in_contact() -> None:
    found, reported = inputs(slurry_flow=SimSignal(value=1.5, changes_to=0.0, after_s=2.0))
    found.step(200.0)
    assert (found.reading("slurry_flow"), reported) == ("1.5000", [])
    found.touching = True
    found.step(201.9)
    assert found.reading("slurry_flow") == "1.5000"
    found.step(202.1)
    assert (found.reading("slurry_flow"), reported) == ("0.0000", ["signal_changes"])
    found.step(300.0)
    assert found.reading("slurry_flow") == "0.0000"


def test_a_guard_opens_for_a_while_at_the_press_of_a_button() -> None:
    found, reported = inputs(guard_closed=SimSignal(value=True, changes_to=False, duration_s=1.0))
    found.step(200.0)
    found.press()
    assert (found.reading("guard_closed"), reported) == ("OFF", ["signal_changes"])
    found.step(201.5)
    assert found.reading("guard_closed") == "ON"


def test_a_transducer_may_break() -> None:
    found, _ = inputs(chuck_vacuum=SimSignal(value=82.0, changes_to="?"))
    found.press()
    assert found.reading("chuck_vacuum") == "?"


# their lines, by the documents' vectors


def test_the_force_sensor_answers_as_the_document_says() -> None:
    lines = {name: line.encode() for name, line in vectors("force_sensor").items()}
    bench = Bench().tared()
    bench.cell.count, bench.cell.reading_n = 1024, bench.cell.zero_n + 12.004
    slave = NumberedSlave(bench.answer)
    assert list(slave.feed(lines["force_request"] + b"\r\n")) == [lines["force"] + b"\r\n"]
    assert list(slave.feed(lines["tare"] + b"\r\n")) == [lines["ok"] + b"\r\n"]
    assert list(slave.feed(b"$12,ID?*65\r\n$12,")) == []
    known = NumberedSlave(sensor_device.answering(bench.cell, 3)).answer("ID?")
    assert known == body(lines["identity"]).split(",", 1)[1]  # type: ignore[union-attr]


def test_the_monitor_answers_as_the_document_says() -> None:
    lines = {name: line.encode() for name, line in vectors("monitor").items()}
    found, _ = inputs(slurry_flow=SimSignal(value=1.25))
    slave = NumberedSlave(monitor_device.answering(found, 2))
    assert list(slave.feed(lines["list_request"] + b"\r\n")) == [lines["list"] + b"\r\n"]
    (value,) = slave.feed(lines["value_request"] + b"\r\n")
    assert body(value.rstrip()) == "9,V,slurry_flow,1.2500"
    answer = monitor_device.answering(found, 2)
    assert (answer("LS?,7"), answer("V?,guard_closed")) == ("LS,7", "V,guard_closed,ON")
    assert answer("V?,nothing") == body(lines["refused"]).split(",", 1)[1]  # type: ignore[union-attr]
    assert answer("WHAT") == "ERR,unknown,no such request"


def test_a_tool_that_stays_goes_on_pressing_when_its_actuator_is_gone() -> None:
    for stays, acts_n in ((True, 12.0), (False, 0.0)):
        force = Timeline()
        force.connect(0.0)
        force.push([(1.0, 12.0)], 2.0)
        force.disconnect(2.0, stays=stays)
        assert force.at(np.array([1.5, 9.0])).tolist() == [12.0, acts_n]
        force.connect(10.0)
        assert force.at(np.array([11.0])).tolist() == [0.0], "powered up, it is at rest"
