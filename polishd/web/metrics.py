"""``GET /metrics``: the cell's figures for Prometheus, from the watcher and the journal.

A scrape sends no request to the daemon: the watcher reads it once for all clients. Units are Prometheus' base units, so
heights are in meters: 2 nm is 2e-09. An unknown value has no line, never its last value.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from prometheus_client.core import CollectorRegistry, CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4, generate_latest
from prometheus_client.registry import Collector
from starlette.requests import Request
from starlette.responses import Response

from polishd import __version__
from polishd.config.cell import CellConfig
from polishd.daemon.journal.history import naming_damage
from polishd.model.errors import PolishdError
from polishd.model.states import CyclePhase, Outcome
from polishd.model.tolerance import line_results
from polishd.web.api import Api
from polishd.web.http.users import HttpSession
from polishd.web.run_data import RunData
from polishd.web.watcher import OLD_S

log = logging.getLogger(__name__)

FRESH_S = 1.0
"""Time for which an answer serves all scrapes."""
M_PER_NM, BYTES_PER_MB, HZ_PER_RPM = 1e-9, 1e6, 1 / 60
STATES = ("starting", "idle", "changing", "polishing", "held", "finished")
"""States of a daemon; a test compares them with its table."""
OUTCOMES = (*(outcome.value for outcome in Outcome), "set_aside")
"""Exported from the first scrape on, at 0: a rate would miss a counter that appears at 1."""
READINGS = (
    ("force", "force_n", "polishd_force_newtons", "Force that the actuator measures.", 1.0),
    ("force", "setpoint_n", "polishd_force_setpoint_newtons", "Force setpoint of the actuator.", 1.0),
    ("sensed", "force_n", "polishd_sensed_force_newtons", "Force of the independent sensor.", 1.0),
    ("speed", "rpm", "polishd_spindle_speed_hertz", "Spindle, revolutions per second.", HZ_PER_RPM),
    ("robot", "buffer_s", "polishd_robot_buffer_seconds", "Motion that the robot has ahead.", 1.0),
)
"""Readings of the devices: device, field, metric, help, and factor to the metric's unit."""
AGES = (
    ("force", "polishd_force_age_seconds", "Age of the actuator's force reading."),
    ("sensed", "polishd_sensed_force_age_seconds", "Age of the independent sensor's force reading."),
    ("speed", "polishd_spindle_speed_age_seconds", "Age of the spindle's speed reading."),
    ("robot", "polishd_robot_age_seconds", "Age of the robot's position reading."),
)


@dataclass(frozen=True, slots=True, eq=False)  # the registry keeps it by its identity
class MetricsSnapshot(Collector):
    """Metric families of one moment."""

    cell: str
    state: Mapping[str, Any]
    """State of the watcher."""
    tally: Mapping[str, Any] | None
    """Counts of the journal; None: it cannot be read."""
    alarms: Iterable[Mapping[str, Any]] = ()

    def collect(self) -> Iterator[Metric]:
        """Yield each family once."""
        up = self.state["daemon"] == "up"
        yield _of("polishd_build_info", "Version of polishd, and the cell's name.",
                  {(__version__, self.cell): 1}, ("version", "cell"))  # fmt: skip
        yield _one("polishd_daemon_up", "1: the daemon answers; 0: none runs, or it is silent.", up)
        live = self.state["live"] if up else None
        if live is not None and "state" in live:  # a refusal has no such field
            passed_s = self.state["age_s"] or 0.0
            yield _one("polishd_daemon_answer_age_seconds", "How long ago the daemon answered.", passed_s)
            yield from _doing(live)
            yield from _readings(live.get("readings") or {}, passed_s)
            yield from _devices(live, passed_s)
            yield from _health(live.get("health") or {})
        yield _one("polishd_journal_readable", "1: the journal was read, or there is none yet.", self.tally is not None)
        if self.tally is not None:
            yield from _journal(self.tally, self.alarms)


class Metrics:
    """Metrics of one cell; one read of its journal a second serves all scrapes."""

    def __init__(self, config: CellConfig) -> None:
        self._cell, self._disk, self._state_dir = config.cell.name, RunData(config.state_dir), config.state_dir
        self._turn = asyncio.Lock()
        self._text, self._made_s = b"", float("-inf")

    async def answer(self, api: Api, _request: Request, _session: HttpSession) -> Response:
        """The metrics in the text format, version 0.0.4, which every Prometheus reads."""
        async with self._turn:
            if time.monotonic() - self._made_s >= FRESH_S:
                self._text = await asyncio.to_thread(self._render, api.watcher.state())
                self._made_s = time.monotonic()
        return Response(self._text, headers={"content-type": CONTENT_TYPE_PLAIN_0_0_4})

    def _render(self, state: Mapping[str, Any]) -> bytes:
        try:
            with naming_damage(self._state_dir):
                return _exposed(MetricsSnapshot(self._cell, state, self._disk.tally(), self._disk.alarms()))
        except PolishdError as error:
            log.warning("metrics without the journal: %s", error)
            return _exposed(MetricsSnapshot(self._cell, state, None))


def _exposed(found: MetricsSnapshot) -> bytes:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(found)
    return generate_latest(registry)


def _doing(live: Mapping[str, Any]) -> Iterator[Metric]:
    state, phase = live["state"], live.get("phase")
    yield _of("polishd_cell_state", "What the daemon does: 1 for the state that it is in.",
              {name: name == state for name in STATES}, ("state",))  # fmt: skip
    yield _of("polishd_cycle_phase", "Phase of the cycle: 1 for the one under way.",
              {one.value: one.value == phase for one in CyclePhase}, ("phase",))  # fmt: skip
    if live.get("cycle") is not None:
        yield _one("polishd_job_cycle", "Number of the cycle under way; the first is 0.", live["cycle"])
    yield _one("polishd_tool_pressing", "1: the tool is on the part.", bool(live.get("pressing")))
    yield _one(
        "polishd_devices_unsafe", "Devices that did not confirm that they are safe.", len(live.get("unsafe", ()))
    )


def _readings(readings: Mapping[str, Any], passed_s: float) -> Iterator[Metric]:
    for whose, field, name, what, per in READINGS:
        reading = readings.get(whose)
        # of an old one there is the age alone
        if reading is not None and reading.get(field) is not None and reading["age_s"] + passed_s <= OLD_S:
            yield _one(name, what, reading[field] * per)
    for whose, name, what in AGES:
        if readings.get(whose) is not None:
            yield _one(name, what, readings[whose]["age_s"] + passed_s)


def _devices(live: Mapping[str, Any], passed_s: float) -> Iterator[Metric]:
    ages = {name: age_s + passed_s for name, age_s in live.get("ages_s", {}).items() if age_s is not None}
    yield _of("polishd_device_heard_age_seconds", "How long ago each device last answered.", ages, ("device",))
    signals = {name: not facts["wrong"] for name, facts in live.get("signals", {}).items()}
    yield _of("polishd_signal_right", "1: the signal is within its limits.", signals, ("signal",))


def _health(health: Mapping[str, Mapping[str, Any]]) -> Iterator[Metric]:
    def disks(field: str) -> dict[str, float]:
        ends = "_disk_mb"
        return {name.removesuffix(ends): one[field] * BYTES_PER_MB for name, one in health.items() if ends in name}

    for name, ours, what, per in (
        ("loop_lag_s", "polishd_loop_lateness_seconds", "How late the daemon's loop was within the last minute.", 1.0),
        ("journal_s", "polishd_journal_unsaved_seconds", "How long the oldest row waits for its commit.", 1.0),
        ("memory_mb", "polishd_memory_available_bytes", "Memory that programs may still have.", BYTES_PER_MB),
    ):
        if name in health:
            yield _one(ours, what, health[name]["value"] * per)
    yield _of(
        "polishd_disk_free_bytes", "Room on the disks of the state and the run folder.", disks("value"), ("disk",)
    )
    yield _of("polishd_disk_needed_bytes", "What is still to be written there.", disks("limit"), ("disk",))
    fits = {name: one["fits"] for name, one in health.items()}
    yield _of("polishd_health_fits", "1: that figure of the computer is within its limit.", fits, ("figure",))


def _journal(tally: Mapping[str, Any], alarms: Iterable[Mapping[str, Any]]) -> Iterator[Metric]:
    parts = dict.fromkeys(OUTCOMES, 0) | {how.replace(" ", "_"): count for how, count in tally["parts"].items()}
    yield _counted("polishd_parts", "Parts whose job ended, by outcome; in_tolerance: accepted.", parts, "outcome")
    passes = {"done": 0} | {how.replace(" ", "_"): count for how, count in tally["passes"].items()}
    yield _counted("polishd_passes", "Passes that ended, by how.", passes, "how")
    severities = [one["severity"] for one in alarms]
    counts = {name: severities.count(name) for name in ("alarm", "warning")}
    yield _of("polishd_alarms", "Alarms that are not acknowledged.", counts, ("severity",))
    if (measured := tally["measured"]) is None:
        return
    yield _one("polishd_surface_rms_meters", "RMS of the last map of the last job.", measured["rms_nm"] * M_PER_NM)
    lines = line_results(measured)
    heights = {one.what: one for one in lines if one.unit == "nm"}
    counted = {what: one.counted * M_PER_NM for what, one in heights.items()}
    limits = {what: one.limit * M_PER_NM for what, one in heights.items()}
    yield _of(
        "polishd_tolerance_counted_meters", "What is held against each line that is a height.", counted, ("line",)
    )
    yield _of("polishd_tolerance_limit_meters", "The most that it may be.", limits, ("line",))
    shares = {one.what: one.excess for one in lines}
    yield _of("polishd_tolerance_used_ratio", "Of each line's limit; 1 and less: kept.", shares, ("line",))


def _one(name: str, what: str, value: float) -> Metric:
    return GaugeMetricFamily(name, what, value=float(value))


def _of(name: str, what: str, values: Mapping[Any, float], labels: tuple[str, ...]) -> Metric:
    family = GaugeMetricFamily(name, what, labels=labels)
    for key, value in values.items():
        family.add_metric(key if isinstance(key, tuple) else (key,), float(value))
    return family


def _counted(name: str, what: str, values: Mapping[str, int], label: str) -> Metric:
    family = CounterMetricFamily(name, what, labels=(label,))
    for key, value in values.items():
        family.add_metric((key,), value)
    return family
