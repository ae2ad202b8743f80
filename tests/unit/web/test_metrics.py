"""``GET /metrics``: off unless asked for; what the library's parser reads of it; what is not known has no line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.model.errors import ConfigError
from polishd.model.events import CellHeld
from polishd.model.states import DaemonState, Outcome
from polishd.web import routes
from polishd.web.http.users import Role
from polishd.web.metrics import OUTCOMES, STATES, Metrics, MetricsSnapshot
from tests.unit.web.page_server import LIVE, Served, served

READINGS = {
    "force": {"force_n": 19.5, "setpoint_n": 20.0, "age_s": 0.02},
    "speed": {"rpm": 600.0, "age_s": 9.0},
    "sensed": None,
    "robot": {"state": "running", "executed": 7, "buffer_s": 4.5, "age_s": 0.1},
}
HEALTH = {
    "loop_lag_s": {"name": "loop_lag_s", "value": 0.004, "limit": 0.1, "fits": True},
    "state_disk_mb": {"name": "state_disk_mb", "value": 5000.0, "limit": 64.0, "fits": True},
    "memory_mb": {"name": "memory_mb", "value": 10.0, "limit": 300.0, "fits": False},
}
ALL: dict[str, Any] = {
    **LIVE,
    "cycle": 2,
    "phase": "run",
    "pressing": True,
    "readings": READINGS,
    "ages_s": {"robot": 0.1},
    "signals": {"slurry": {"text": "1.2 l/min", "wrong": ""}, "vacuum": {"text": "0 kPa", "wrong": "too low"}},
    "health": HEALTH,
    "unsafe": ["spindle"],
}
JUDGED = [
    {"what": "RMS", "value": 1.5, "limit": 2.0, "unit": "nm", "bound": 1.8},
    {"what": "slope RMS over 2 mm", "value": 3.0, "limit": 1.0, "unit": "urad"},
]
TALLY = {
    "parts": {"in_tolerance": 3, "set aside": 1},
    "passes": {"done": 8},
    "measured": {"rms_nm": 1.5, "judged": JUDGED},
}


def samples(families: Any) -> dict[tuple[str, ...], float]:
    """Each sample by its name and the values of its labels."""
    return {(one.name, *one.labels.values()): one.value for family in families for one in family.samples}


def seen(daemon: str = "up", age_s: float = 0.5) -> dict[tuple[str, ...], float]:
    state = {"daemon": daemon, "age_s": age_s, "live": ALL}
    return samples(MetricsSnapshot("cell 7", state, TALLY, [{"severity": "warning"}]).collect())


@pytest.fixture
def metered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    def load(path: Path) -> CellConfig:
        path.write_text(path.read_text().replace("[web] ", "[web]\nmetrics = true\n# "))
        return load_config(path)

    monkeypatch.setattr("tests.unit.web.page_server.load_config", load)
    with served(tmp_path) as found:
        yield found


def test_figures_are_in_base_units_with_their_ages() -> None:
    found = seen()
    assert found["polishd_daemon_up",] == 1
    assert found["polishd_cell_state", "polishing"] == 1
    assert found["polishd_cell_state", "held"] == 0
    assert found["polishd_cycle_phase", "run"] == 1
    assert found["polishd_job_cycle",] == 2
    assert found["polishd_force_newtons",] == 19.5
    assert found["polishd_force_age_seconds",] == pytest.approx(0.52)
    assert found["polishd_device_heard_age_seconds", "robot"] == pytest.approx(0.6)
    assert (found["polishd_signal_right", "slurry"], found["polishd_signal_right", "vacuum"]) == (1, 0)
    assert found["polishd_loop_lateness_seconds",] == 0.004
    assert found["polishd_disk_free_bytes", "state"] == 5e9
    assert found["polishd_health_fits", "memory_mb"] == 0
    assert found["polishd_devices_unsafe",] == 1
    assert found["polishd_surface_rms_meters",] == pytest.approx(1.5e-9)
    assert found["polishd_tolerance_counted_meters", "RMS"] == pytest.approx(1.8e-9), "the bound, as it is judged"
    assert found["polishd_tolerance_limit_meters", "RMS"] == pytest.approx(2e-9)
    assert found["polishd_tolerance_used_ratio", "slope RMS over 2 mm"] == 3
    assert ("polishd_tolerance_limit_meters", "slope RMS over 2 mm") not in found, "an angle is no length"
    assert (found["polishd_parts_total", "set_aside"], found["polishd_parts_total", "in_tolerance"]) == (1, 3)
    assert found["polishd_parts_total", "stalled"] == 0, "there before the first one"
    assert (found["polishd_alarms", "warning"], found["polishd_alarms", "alarm"]) == (1, 0)


def test_what_is_old_has_its_age_and_no_value() -> None:
    found = seen()
    assert ("polishd_spindle_speed_hertz",) not in found
    assert found["polishd_spindle_speed_age_seconds",] == 9.5
    late = seen(age_s=3.0)
    assert ("polishd_force_newtons",) not in late
    assert late["polishd_force_age_seconds",] == pytest.approx(3.02)


@pytest.mark.parametrize("daemon", ["silent", "none"])
def test_without_a_daemon_nothing_is_reported_as_if_live(daemon: str) -> None:
    found = seen(daemon)
    assert found["polishd_daemon_up",] == 0
    assert not [key for key in found if key[0].startswith(("polishd_force", "polishd_cell_state", "polishd_device"))]
    assert found["polishd_parts_total", "in_tolerance"] == 3, "the journal is there all the same"


def test_a_daemon_that_refuses_gives_no_values() -> None:
    state = {"daemon": "up", "age_s": 0.1, "live": {"ok": False, "error": "unknown verb 'live'"}}
    found = samples(MetricsSnapshot("cell 7", state, TALLY).collect())
    assert ("polishd_cell_state", "polishing") not in found
    assert found["polishd_parts_total", "in_tolerance"] == 3


def test_names_are_those_of_the_daemon() -> None:
    assert set(STATES) == set(DaemonState)
    assert set(OUTCOMES) == {*Outcome, "set_aside"}


def test_it_is_off_unless_asked_for(tmp_path: Path) -> None:
    with served(tmp_path) as web:
        assert web.ask("GET", "/metrics").status_code == 404


def test_a_token_of_any_role_may_scrape_and_no_other_client(metered: Served) -> None:
    assert metered.ask("GET", "/metrics", None).status_code == 401
    for role in Role:
        assert metered.ask("GET", "/metrics", role).status_code == 200


def test_the_librarys_parser_reads_it_and_the_journal_is_counted(metered: Served) -> None:
    with Journal.open(metered.config.state_dir, job="demo", part_id="P", terms={}) as journal:
        journal.record_event(CellHeld(error="a fault", kind="LinkError"))
        journal.record_outcome(Outcome.STALLED)
        journal.flush()
    said = metered.ask("GET", "/metrics", Role.WATCH)
    assert said.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    families = list(text_string_to_metric_families(said.text))
    assert all(family.documentation and family.type in {"gauge", "counter"} for family in families)
    found = samples(families)
    assert found["polishd_parts_total", "stalled"] == 1
    assert found["polishd_alarms", "warning"] == 1
    assert found["polishd_journal_readable",] == 1


def test_one_look_serves_all_for_a_second(metered: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[str] = []
    real = Metrics._render

    def look(self: Metrics, state: Any) -> bytes:
        looks.append(state["daemon"])
        return real(self, state)

    monkeypatch.setattr(Metrics, "_render", look)
    monkeypatch.setattr("polishd.web.metrics.FRESH_S", 3600.0)
    for _ in range(20):
        assert metered.ask("GET", "/metrics", Role.WATCH).status_code == 200
    assert len(looks) == 1
    assert not metered.daemon.asked, "the daemon was asked nothing for it"


def test_a_journal_that_cannot_be_read_is_said_and_the_rest_is_reported(metered: Served) -> None:
    (metered.config.state_dir / JOURNAL_NAME).write_bytes(b"no database" * 100)
    found = samples(text_string_to_metric_families(metered.ask("GET", "/metrics", Role.WATCH).text))
    assert found["polishd_journal_readable",] == 0
    assert ("polishd_daemon_up",) in found
    assert ("polishd_parts_total", "stalled") not in found


def test_a_missing_library_is_said_at_the_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    cell.write_text(cell.read_text().replace("[web] ", "[web]\nmetrics = true\n# "))
    monkeypatch.setitem(sys.modules, "polishd.web.metrics", None)
    with pytest.raises(
        ConfigError, match=r"web.metrics: GET /metrics needs prometheus-client.*pip install 'polishd\[metrics\]'"
    ):
        routes.application(load_config(cell))
