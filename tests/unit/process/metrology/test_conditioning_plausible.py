"""Implausible dates and lateral scales are removed from a map of any reader."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap
from polishd.process.metrology.conditioning import drop_implausible
from polishd.process.metrology.instrument import apply_profile

NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)
WRITTEN = NOW - timedelta(hours=1)
MAP = SurfaceMap(np.zeros((40, 64)), 0.5, taken_at=NOW - timedelta(days=30))


def found(surface: SurfaceMap) -> SurfaceMap:
    return drop_implausible(surface, NOW, WRITTEN)


def test_a_map_that_may_be_is_as_it_was() -> None:
    assert found(MAP) is MAP
    assert MAP.measured_at == MAP.taken_at
    ahead = replace(MAP, taken_at=NOW + timedelta(hours=14))  # a local time without its zone
    assert found(ahead) is ahead


@pytest.mark.parametrize(
    ("at", "why"),
    [
        (datetime(1984, 12, 31, 23, tzinfo=UTC), "before 1985"),
        (datetime(1970, 1, 9), "before 1985"),  # noqa: DTZ001  as a plugin's reader may say it
    ],
)
def test_a_date_of_no_map_is_guessed(at: datetime, why: str) -> None:
    surface = found(replace(MAP, taken_at=at))
    assert (surface.date_from, surface.measured_at) == ("guessed", None)
    assert why in surface.warnings[0]


def test_a_date_ahead_is_warned_of_and_keeps_its_place_in_the_order() -> None:
    surface = found(replace(MAP, taken_at=NOW + timedelta(days=400)))
    assert surface.measured_at == NOW + timedelta(days=400)
    assert "in the future" in surface.warnings[0]


def test_where_the_header_says_nothing_the_file_system_does() -> None:
    surface = found(replace(MAP, taken_at=None))
    assert (surface.taken_at, surface.date_from, surface.measured_at) == (WRITTEN, "file system", None)
    assert surface.warnings == ()


def test_a_guess_stays_one() -> None:
    surface = replace(MAP, date_from="guessed")
    assert found(surface) is surface
    assert surface.measured_at is None


def test_a_date_without_a_zone_is_utc() -> None:
    assert replace(MAP, taken_at=datetime(2026, 1, 2, 3)).measured_at == datetime(2026, 1, 2, 3, tzinfo=UTC)  # noqa: DTZ001


@pytest.mark.parametrize(
    ("pitch_mm", "why"),
    [
        (312.6, "more than 20 m"),
        (np.inf, "more than 20 m"),
        (0.9e-6, "less than 1 nm"),
        (-0.5, "less"),
        (np.nan, "less"),
    ],
)
def test_a_scale_of_no_part_is_none(pitch_mm: float, why: str) -> None:
    surface = found(replace(MAP, pitch_mm=pitch_mm))
    assert (surface.pitch_mm, set(surface.unsaid)) == (None, {"pitch"})
    assert why in surface.warnings[0]
    looked_at = apply_profile(surface, Instrument("shop", pitch_mm=0.25))
    assert (looked_at.pitch_mm, looked_at.warnings) == (0.25, ())


@pytest.mark.parametrize("pitch_mm", [312.5, 1e-6])
def test_the_largest_and_the_smallest_scale(pitch_mm: float) -> None:
    assert found(replace(MAP, pitch_mm=pitch_mm)).pitch_mm == pitch_mm


def test_a_profile_cannot_give_such_a_scale_either() -> None:
    with pytest.raises(MapError, match=r"profile 'shop' gives it a pitch of 312\.6 mm.*more than 20 m"):
        apply_profile(replace(MAP, pitch_mm=None, unsaid=frozenset({"pitch"})), Instrument("shop", pitch_mm=312.6))
