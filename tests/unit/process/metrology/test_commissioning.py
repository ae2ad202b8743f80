"""An artefact proves a profile, or names what is wrong with it."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from polishd.model.errors import ConfigError, MapError
from polishd.model.instrument import Instrument
from polishd.model.surface import Grid, SurfaceMap
from polishd.process.frames import ORIENTATIONS, ArrayOrientation
from polishd.process.metrology.commissioning import ArtefactBump, artefact_heights, prove_profile, require_asymmetric
from polishd.process.metrology.instrument import apply_profile
from tests.unit.process.metrology.placed_parts import BUMPS, on_part

GRID = Grid(216, 212, 0.5)


def artefact(turn_deg: float = 0.0, shift_mm: tuple[float, float] = (0, 0), seed: int = 0) -> np.ndarray:
    """The artefact as it lies in a map, with noise, drop-outs, piston and tilt."""
    rng = np.random.default_rng(seed)
    x, y = on_part(GRID, turn_deg, shift_mm)
    height = np.zeros(GRID.shape)
    for b in BUMPS:
        a = np.radians(b.angle_deg)
        u, v = (x - b.x_mm) * np.cos(a) + (y - b.y_mm) * np.sin(a), (y - b.y_mm) * np.cos(a) - (x - b.x_mm) * np.sin(a)
        height += b.height_nm * np.exp(-(u**2) / (2 * b.sigma_x_mm**2) - v**2 / (2 * b.sigma_y_mm**2))
    height += rng.normal(0, 2, GRID.shape) + 300 + 0.5 * x - 0.2 * y
    return np.where((np.hypot(x, y) < 50) & (rng.random(GRID.shape) > 0.01), height, np.nan)


def test_the_heights_are_the_bumps() -> None:
    grid = Grid(101, 101, 1.0)
    height = artefact_heights((ArtefactBump(10, 20, 6, 3, 200, 90), ArtefactBump(-30, 0, 2, 2, -50)), grid)
    assert height[50 - 20, 50 + 10] == pytest.approx(200)
    assert height[50 - 26, 50 + 10] == pytest.approx(200 * np.exp(-0.5))  # the long axis was turned upright
    assert height[50, 20] == pytest.approx(-50, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_true_map_proves_the_profile(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = rng.uniform(-4, 4), tuple(rng.uniform(-3, 3, 2))
    proof = prove_profile(SurfaceMap(artefact(turn, shift, seed), 0.5), BUMPS)
    assert proof.correlation > 0.99
    assert proof.next_best < 0.9
    assert proof.next_best_name in {way.name + sign for way in ORIENTATIONS for sign in ("", " and negated")}
    assert proof.scale == pytest.approx(1, abs=0.01)
    assert proof.shift_mm == pytest.approx(shift, abs=0.03)
    assert proof.turn_deg == pytest.approx(turn, abs=0.1)
    assert proof.pitch_ratio == pytest.approx(1, abs=0.003)


@pytest.mark.parametrize("shift", [(7.0, 0.0), (-4.5, 4.5), (0.0, -12.0)])
def test_an_artefact_beside_its_place_proves_nothing(shift: tuple[float, float]) -> None:
    with pytest.raises(MapError, match=r"mm from its place, and 5 mm are allowed|does not show the artefact"):
        prove_profile(SurfaceMap(artefact(0.0, shift), 0.5), BUMPS)


@pytest.mark.parametrize(
    "bumps",
    [(ArtefactBump(20, 8, 4, 4, 100),), (ArtefactBump(18, -6, 5, 5, -80), ArtefactBump(-9, 20, 7, 4, 120, 60)), BUMPS],
)
@pytest.mark.parametrize(("power_nm", "astigmatism_nm"), [(40.0, 0.0), (-40.0, 20.0), (15.0, -30.0)])
def test_the_form_of_the_base_does_not_count(
    bumps: tuple[ArtefactBump, ...], power_nm: float, astigmatism_nm: float
) -> None:
    """With piston and tilt alone taken off, such a base made the bumps 3 % too small, or not to be found at all."""
    x, y = np.meshgrid(GRID.x_mm / 53, GRID.y_mm / 53)
    base = power_nm * (x**2 + y**2) + astigmatism_nm * (x**2 - y**2 + x * y)
    noise = np.random.default_rng(2).normal(0, 2, GRID.shape)
    proof = prove_profile(SurfaceMap(artefact_heights(bumps, GRID) + base + noise, 0.5), bumps)
    assert (proof.pitch_ratio, proof.scale) == pytest.approx((1, 1), abs=0.01)


@pytest.mark.one_of_each
@pytest.mark.parametrize("way", ORIENTATIONS, ids=lambda way: way.name)
@pytest.mark.parametrize("was", [ORIENTATIONS[0], ORIENTATIONS[5]], ids=lambda way: way.name)
def test_the_message_gives_the_profile_that_is_right(way: ArrayOrientation, was: ArrayOrientation) -> None:
    """Whatever way the instrument has it and the profile says: what the message says to set then proves it."""
    raw = SurfaceMap(np.asarray(-2 * way.turn(artefact(1.0))), 0.5)
    profile = Instrument("shop", mirror=was.mirror, rotation_deg=was.rotation_deg)
    with pytest.raises(MapError, match=r"negated and [12]\.\d+ times as high") as refused:
        prove_profile(apply_profile(raw, profile), BUMPS)
    said = dict(re.findall(r"(mirror|rotation_deg|sign|factor) = ([-\w.]+)", str(refused.value)))
    values = {key: json.loads(value) for key, value in said.items()}
    mended = replace(profile, **values)
    assert mended.factor == 0.5
    assert prove_profile(apply_profile(raw, mended), BUMPS).correlation > 0.99


@pytest.mark.one_of_each
@pytest.mark.parametrize("pitch", [0.25, 0.4, 0.485, 0.515, 1.0])
def test_a_wrong_pitch_is_measured(pitch: float) -> None:
    with pytest.raises(MapError, match=r"times as large: set pitch_mm") as refused:
        prove_profile(SurfaceMap(artefact(), pitch), BUMPS)
    assert float(str(refused.value).split("pitch_mm = ")[1].split()[0]) == pytest.approx(0.5, rel=0.003)


@pytest.mark.parametrize("factor", [0.5, 0.94, 1.06, 2.0])
def test_a_wrong_height_is_measured(factor: float) -> None:
    with pytest.raises(MapError, match="times as high: set factor") as refused:
        prove_profile(SurfaceMap(factor * artefact(), 0.5), BUMPS)
    said = float(str(refused.value).split("factor = ")[1].split()[0])
    assert said == pytest.approx(1 / factor, rel=0.01)


def test_small_errors_are_within_tolerance() -> None:
    assert prove_profile(SurfaceMap(1.03 * artefact(), 0.505), BUMPS).scale == pytest.approx(1.03, abs=0.01)
    with pytest.raises(MapError, match="times as high"):
        prove_profile(SurfaceMap(1.07 * artefact(), 0.5), BUMPS)


@pytest.mark.full
def test_another_artefact_is_refused() -> None:
    other = np.random.default_rng(3).normal(0, 30, GRID.shape)
    with pytest.raises(MapError, match="does not show the artefact"):
        prove_profile(SurfaceMap(other, 0.5), BUMPS)
    with pytest.raises(MapError, match="does not show the artefact"):
        prove_profile(SurfaceMap(artefact(25.0), 0.5), BUMPS)


def test_what_holds_nothing_is_refused() -> None:
    with pytest.raises(MapError, match="no lateral scale"):
        prove_profile(SurfaceMap(artefact(), None), BUMPS)
    with pytest.raises(MapError, match="no data"):
        prove_profile(SurfaceMap(np.full((50, 50), np.nan), 0.5), BUMPS)
    with pytest.raises(MapError, match="does not show"):
        prove_profile(SurfaceMap(np.zeros((50, 50)), 0.5), BUMPS)


@pytest.mark.parametrize(
    "bumps",
    [
        (ArtefactBump(0, 0, 5, 5, 100),),
        (ArtefactBump(0, 0, 8, 4, 100, 30),),
        (ArtefactBump(20, 0, 5, 5, 100), ArtefactBump(-20, 0, 5, 5, 60)),
        (ArtefactBump(20, 0, 5, 5, 100), ArtefactBump(-20, 0, 5, 5, -100)),
        (ArtefactBump(20, 8, 5, 3, 100, 20), ArtefactBump(-20, -8, 5, 3, 100, 20)),
    ],
)
def test_symmetric_artefacts_are_refused(bumps: tuple[ArtefactBump, ...]) -> None:
    with pytest.raises(ConfigError, match="looks like itself"):
        require_asymmetric(bumps)
    with pytest.raises(ConfigError, match="looks like itself"):
        prove_profile(SurfaceMap(artefact(), 0.5), bumps)


@pytest.mark.parametrize("bumps", [(), (ArtefactBump(1, 2, 0, 3, 100),), (ArtefactBump(1, 2, 3, 3, 0),)])
def test_bumps_must_be_bumps(bumps: tuple[ArtefactBump, ...]) -> None:
    with pytest.raises(ConfigError, match="needs bumps"):
        require_asymmetric(bumps)


def test_the_artefact_of_the_tests_is_asymmetric() -> None:
    require_asymmetric(BUMPS)
