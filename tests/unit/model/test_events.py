"""The records of what happens."""

from __future__ import annotations

import json

import pytest

from docs.reference.code_tables import event_row
from polishd.model import events
from polishd.model.devices import DeviceIdentity
from polishd.model.events import EVENTS, CellOpened, Event, MapMeasured, PassEnded
from polishd.model.states import Outcome
from polishd.model.surface import SurfaceStats


def test_every_kind_is_listed_once() -> None:
    defined = [kind for kind in vars(events).values() if isinstance(kind, type) and issubclass(kind, Event)]
    assert set(EVENTS) == set(defined) - {Event}
    assert len({kind.name for kind in EVENTS}) == len(EVENTS)


def test_data_is_json_with_the_fields_of_records_one_by_one() -> None:
    stats = SurfaceStats(rms_nm=1.5, pv_nm=9.0, lsf_rms_nm=1.0)
    event = MapMeasured(cycle=2, stats=stats, spikes=3, notes=("tilted",), run_dir="run")
    facts = json.loads(json.dumps(event.facts()))
    assert (facts["name"], facts["cycle"], facts["data"]["rms_nm"], facts["data"]["spikes"]) == (
        "map_measured",
        2,
        1.5,
        3,
    )
    assert set(facts["data"]) == {
        "rms_nm", "pv_nm", "lsf_rms_nm", "band_rms_nm", "samples", "judged", "spikes", "notes", "run_dir"
    }  # fmt: skip
    assert PassEnded(executed_s=1.0).facts() == {"name": "pass_ended", "cycle": None, "data": {"executed_s": 1.0}}


def test_opened_has_a_key_for_each_device() -> None:
    data = CellOpened(devices={"robot.left": DeviceIdentity("Acme", "arm", "7", "1.0")}).data
    assert data == {"robot.left": {"vendor": "Acme", "model": "arm", "serial": "7", "firmware": "1.0", "boot_id": ""}}


@pytest.mark.parametrize("outcome", Outcome)
def test_the_outcomes_are_reported(outcome: Outcome) -> None:
    assert f"`{outcome.value}`" in event_row(events.RunFolderCompleted)[2]
