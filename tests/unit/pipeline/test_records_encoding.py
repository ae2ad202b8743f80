"""Records taken apart and put together again, and the bytes of their files."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass

import numpy as np
import pytest

from polishd.model.errors import ConfigError
from polishd.model.estimates import Estimate, Estimates
from polishd.pipeline.records import arrays_of, as_json, facts_of, npz, record_of, table

LEVEL = Estimate(0.0, unit="1/mm")


@dataclass(frozen=True)
class Field(Estimates):
    """Estimates of a third-party model."""

    tilt: Estimate = LEVEL
    modes: tuple[tuple[str, float], ...] = ()
    map_nm: np.ndarray | None = None


FIELD = Field(Estimate(0.9, 0.01), Estimate(1e-3, 2e-4, "1/mm"), (("coma", 0.5), ("trefoil", float("inf"))), np.eye(2))


def test_a_record_is_made_again_from_its_facts_as_json_and_its_arrays() -> None:
    again = record_of(Field, json.loads(as_json(facts_of(FIELD))), arrays_of(FIELD))
    assert facts_of(again) == facts_of(FIELD)
    assert np.array_equal(again.map_nm, FIELD.map_nm)
    assert isinstance(again.rate, Estimate)


def test_what_it_has_no_field_for_is_left_and_what_is_missing_is_the_default() -> None:
    assert record_of(Field, {"rate": {"value": 0.8}, "wear": 3}) == Field(Estimate(0.8))


def test_a_fact_of_another_kind_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"what was kept as Estimates cannot be read: .*value.*; finish the job with"):
        record_of(Estimates, {"rate": {"value": "fast"}})
    with pytest.raises(ConfigError, match=r"Estimate cannot be read: .*missing .* 'value'"):
        record_of(Estimate, {"sigma": 1.0})


def test_arrays() -> None:
    height = np.array([[1.5, np.nan], [-0.0, 1e300]])
    content = npz({"height": height, "mask": np.isfinite(height), "pitch": 0.5})
    with np.load(io.BytesIO(content)) as archive:
        back = dict(archive)
    assert set(back) == {"height", "mask", "pitch"}
    assert np.array_equal(back["height"], height, equal_nan=True)
    assert back["mask"].dtype == np.bool_
    assert float(back["pitch"]) == 0.5


def test_a_table() -> None:
    content = table({"seq": np.arange(2), "t_s": np.array([0.1, 123456.789]), "on": np.array([True, False])})
    assert content == b"seq,t_s,on\n0,0.1,1\n1,123456.789,0\n"


def test_a_table_of_nothing_has_its_header() -> None:
    assert table({"seq": np.zeros(0), "t_s": np.zeros(0)}).split() == [b"seq,t_s"]
