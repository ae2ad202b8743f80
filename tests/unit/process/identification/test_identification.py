"""A pass made by another model, and what identification reads from it: values, errors, outliers, choices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.errors import ComputeError
from polishd.process.identification.fit import own_noise
from polishd.process.identification.forward_model import build_forward_model
from polishd.process.identification.parameters import PriorKnowledge, RemovalMap, RemovalNoise
from tests.unit.process.identification.identified import (
    EVERYTHING,
    PROCESS,
    RADIUS_MM,
    Polished,
    all_parameters,
    disc,
    found,
    knowing,
    polished,
    seen,
    slower,
    spot,
)

ONE_WRONG = [
    ("", {"rate": 0.2}),
    ("offset", {"offset_x": 0.5, "offset_y": -0.4, "rate": -0.1}),
    pytest.param("field", {"field_2": 0.06, "field_3": -0.03, "field_4": 0.03}, marks=pytest.mark.slow),
    pytest.param("wear", {"wear": 0.3, "rate": 0.1}, marks=pytest.mark.slow),
    pytest.param("turn", {"turn": 4.0}, marks=pytest.mark.slow),
    pytest.param("width", {"width": 0.08}, marks=pytest.mark.slow),
    pytest.param("compliance", {"compliance": 0.25}, marks=pytest.mark.slow),
    pytest.param("exponent", {"exponent": 0.4}, marks=pytest.mark.slow),
    pytest.param("shift", {"shift_x": 0.3, "shift_y": -0.2}, marks=pytest.mark.slow),
    pytest.param("rotation", {"rotation": 0.4}, marks=pytest.mark.slow),
    pytest.param("power", {"power": 3.0, "piston": -20.0, "tilt_x": 8.0, "tilt_y": -5.0}, marks=pytest.mark.slow),
]
ALL_WRONG = {
    "rate": -0.1,
    "field_2": 0.04,
    "wear": 0.15,
    "offset_x": 0.4,
    "offset_y": 0.3,
    "turn": 2.0,
    "width": 0.05,
    "compliance": -0.15,
    "exponent": 0.2,
    "shift_x": -0.2,
    "shift_y": 0.1,
    "rotation": 0.2,
    "power": 2.0,
}


def hour() -> Polished:
    """A pass of an hour of contact, its gamma over 0.7 to 1."""
    one = polished(gamma_span=0.3)
    return slower(one, 3600 / one.time.sum())


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(("names", "truth"), ONE_WRONG)
def test_what_is_wrong_is_found_within_its_error(names: str, truth: dict[str, float]) -> None:
    result = hour().identified(truth, names)
    for one in result.estimates:
        assert abs(one.value - truth.get(one.parameter.name, 0.0)) < 3.5 * one.sigma, one.sentence
    for name, value in truth.items():
        assert result[name].confounding.decided, result[name].sentence
        assert abs(value) > 5 * result[name].sigma, "the pass shows it well"


@pytest.mark.slow
def test_all_of_it_wrong_at_once() -> None:
    result = hour().identified(ALL_WRONG, EVERYTHING)
    for one in result.estimates:
        assert abs(one.value - ALL_WRONG.get(one.parameter.name, 0.0)) < 3.5 * one.sigma, one.sentence


def normalised(one: Polished, names: str, seeds: range, share: float = 0.3) -> np.ndarray:
    """(seeds, k) errors over standard errors, the truth drawn from the prior (a share of the usual one)."""
    usual = knowing(names)
    prior = replace(usual, covariance=share**2 * usual.covariance)
    errors = []
    for seed in seeds:
        truth = np.random.default_rng(1000 + seed).normal(0.0, prior.sigma)
        result = one.identified(dict(zip(prior.names, truth, strict=True)), seed=seed, prior=prior)
        errors.append((result.learned.mean - truth) / result.learned.sigma)
    return np.array(errors)


@pytest.mark.slow
def test_errors_are_as_large_as_stated() -> None:
    errors = normalised(polished(), "offset compliance", range(5))
    assert 0.4 < (errors**2).mean() < 1.9  # of 35 normal squares: 4 standard deviations either way


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_errors_are_as_large_as_stated_over_fifty_passes() -> None:
    errors = normalised(hour(), "field wear offset width compliance exponent shift power", range(50))
    assert 0.8 < (errors**2).mean() < 1.2
    assert ((errors**2).mean(axis=0) < 1.9).all()
    assert ((errors**2).mean(axis=0) > 0.4).all()


@pytest.mark.full
def test_drop_outs_and_a_bump_are_left_out() -> None:
    one, truth = polished(), {"rate": 0.1, "offset_x": 0.3}
    clean = one.removed(truth)
    grid, mask = disc()
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    bump = 3 * np.exp(-((x - 6) ** 2 + (y + 4) ** 2) / 2 / 1.5**2)
    dots = np.zeros(mask.shape)
    dots[8, 10], dots[20, 25], dots[16, 5] = 400.0, -300.0, 90.0
    spoilt = replace(clean, removal_nm=clean.removal_nm + bump + dots)
    result = found(spoilt, one.blocks(), knowing("offset"))
    assert result.rejected[(bump > 1.5) | (dots != 0)].all()
    assert result.rejected.sum() < 0.1 * mask.sum()
    for name in ("rate", "offset_x", "offset_y"):
        assert abs(result[name].value - truth.get(name, 0.0)) < 4 * result[name].sigma, result[name].sentence


@pytest.mark.full
def test_clean_maps_lose_nothing() -> None:
    lost = [polished().identified({}, "", seed).rejected.sum() for seed in range(4)]
    assert lost == [0, 0, 0, 0]


@pytest.mark.parametrize("wide", [0.0, 2.0])
def test_noise_is_measured_with_its_area(wide: float) -> None:
    rng, mask = np.random.default_rng(3), np.ones((120, 120), dtype=bool)
    noise = rng.standard_normal(mask.shape)
    noise = ndimage.gaussian_filter(noise, wide, mode="wrap") if wide else noise
    seen_noise = own_noise(2.0 * noise / noise.std(), mask, RemovalNoise(0.1), 0.5)
    area = 4 * np.pi * wide**2 * 0.25 if wide else 0.25  # of the autocorrelation exp(-r^2 / 4 w^2)
    assert seen_noise.sigma_nm == pytest.approx(2.0, rel=0.05)
    assert seen_noise.area_mm2 == pytest.approx(area, rel=0.25)


def test_two_noises_count_each_over_its_area() -> None:
    both = RemovalNoise(3.0).with_another(RemovalNoise(4.0, 9.0), pitch_mm=2.0)
    assert both.sigma_nm == pytest.approx(5.0)
    # a mean over many samples has the sum of what each would leave of it
    assert both.sigma_nm**2 * both.area_mm2 == pytest.approx(9.0 * 4.0 + 16.0 * 9.0)


@pytest.mark.slow
def test_correlated_noise_widens_the_errors_as_it_should() -> None:
    one = polished()
    grid, mask = disc()
    errors = []
    for seed in range(10):
        noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(mask.shape), 1.5, mode="wrap")
        removed = one.removed({}, None)
        removed = RemovalMap(grid, removed.removal_nm + noise / noise.std() * 0.5, mask, RemovalNoise(0.1))
        result = found(removed, one.blocks(), knowing(""))
        errors.append(result["rate"].value / result["rate"].sigma)
    assert 0.2 < np.mean(np.square(errors)) < 2.6


@pytest.mark.slow
def test_the_derivatives_are_those_of_the_removal() -> None:
    one = polished()
    grid, mask = disc()
    model = build_forward_model(
        one.blocks(), grid, mask, spot(), PROCESS, parameters=all_parameters(), projection="linear", radius_mm=RADIUS_MM
    )
    theta = np.array([0.05 * min(p.sigma, 1.0) for p in all_parameters()])
    columns = model.columns(theta, model.lay(theta))
    for k, parameter in enumerate(all_parameters()):
        by = np.zeros(len(theta))
        by[k] = {"deg": 3.0, "mm": 0.15}.get(parameter.unit, 0.04 if parameter.name == "width" else 0.002)
        high, low = (model.removal_nm(at, model.lay(at, {})) for at in (theta + by, theta - by))
        slope = (high - low) / (2 * by[k])
        assert np.linalg.norm(columns[:, k] - slope) < 0.06 * np.linalg.norm(slope), parameter.name


@pytest.mark.slow
def test_the_projection_that_fits_is_found() -> None:
    one = polished(gamma_span=0.3)
    other = 0.85 + 0.1 * np.cos(one.place[:, 0] / 4) * np.sin(one.place[:, 1] / 6)
    prior = knowing("compliance")
    asked = found(one.removed({"rate": 0.05}), replace(one, gamma=other).blocks(normal=one.gamma), prior)
    assert asked.projection == "normal"
    assert asked.projection_rivals == ()
    assert asked["rate"].value == pytest.approx(0.05, abs=4 * asked["rate"].sigma)
    kept = found(one.removed({}), one.blocks(normal=other), prior)
    assert (kept.projection, kept.projection_rivals) == ("linear", ())


@pytest.mark.full
def test_projections_that_fit_alike_are_said_to() -> None:
    one = polished(gamma_span=0.002)
    result = found(one.removed({}), one.blocks(normal=one.gamma + 1e-5), knowing(""))
    assert (result.projection, result.projection_rivals) == ("linear", ("normal",))
    assert any("this map also fits" in line and "normal" in line for line in result.sentences)


def test_a_coarser_map_keeps_place_mean_and_noise() -> None:
    grid, mask = disc()
    whole = seen(np.where(mask, grid.x_mm[None, :] + 2 * grid.y_mm[:, None], np.nan), 0.3, None)
    coarse = replace(whole, removal_nm=whole.removal_nm).coarser(3)
    assert (coarse.grid.ny, coarse.grid.nx, coarse.grid.pitch_mm) == (11, 11, 3.0)
    plane = coarse.grid.x_mm[None, :] + 2 * coarse.grid.y_mm[:, None]
    inner = coarse.grid.radius_mm() < 10
    assert np.allclose(coarse.removal_nm[inner], plane[inner])
    assert coarse.noise.sigma_nm == pytest.approx(0.1)
    with pytest.raises(ComputeError, match="odd whole factor"):
        whole.coarser(2)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"noise": RemovalNoise(0.0)}, "noise of the removal map is 0 nm"),
        ({"mask": np.zeros((33, 33), dtype=bool)}, "0 samples have data"),
        ({"removal_nm": np.full((33, 33), np.nan)}, "not finite everywhere"),
        ({"removal_nm": np.zeros((3, 3))}, r"the grid is \(33, 33\)"),
    ],
)
def test_a_map_that_cannot_be(change: dict[str, object], said: str) -> None:
    one = polished()
    with pytest.raises(ComputeError, match=said):
        found(replace(one.removed({}), **change), one.blocks(), knowing(""))  # type: ignore[arg-type]


def test_blocks_that_cannot_be() -> None:
    one, prior = polished(), knowing("")
    removed, blocks = one.removed({}), one.blocks()
    with pytest.raises(ComputeError, match=f"{len(one.time)} times and 3 of rpm"):
        found(removed, replace(blocks, rpm=np.ones(3)), prior)
    with pytest.raises(ComputeError, match="no gamma is given for the projection 'linear'"):
        found(removed, replace(blocks, depth_ratio={"normal": one.gamma}), prior)
    with pytest.raises(ComputeError, match="point 0: the executed time is -1 s"):
        found(removed, replace(blocks, time_s=blocks.time_s - 1 - blocks.time_s), prior)
    with pytest.raises(ComputeError, match="no block was executed"):
        found(removed, replace(blocks, time_s=0 * blocks.time_s), prior)


@pytest.mark.full
def test_force_and_speed_count_as_they_were() -> None:
    one, prior = polished(), knowing("")
    half_speed = replace(one.blocks(), rpm=np.full(len(one.time), 500.0), force_n=np.full(len(one.time), np.nan))
    result = found(one.removed({"rate": float(np.log(0.5))}), half_speed, prior)
    assert result["rate"].value == pytest.approx(0.0, abs=4 * result["rate"].sigma)


def test_knowledge_has_no_other_names() -> None:
    known: PriorKnowledge = knowing("")
    with pytest.raises(KeyError, match="no parameter 'offset_x'; there are rate, piston"):
        known.at("offset_x")
