"""The fine patch and its shares on cells: nothing lost, nothing counted twice, turned the right way."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.process.removal import contact
from polishd.process.removal.tif import MOST_PATCH, PATCH, HertzSpot, hertz_spot, rotate_spot
from polishd.process.removal.tif_family import PathBlocks, effect_row
from tests.unit.process.area_reference import overlap

PAPER = ToolProcess()
DEPTH = contact.hertz_depth_mm(PAPER)


def moments(patch: np.ndarray, radius: float) -> tuple[float, float]:
    """Centre of the removal in the part's x and y, mm, of one patch whose row 0 is the top."""
    place = radius * ((np.arange(PATCH) + 0.5) * 2 / PATCH - 1)
    return float((patch * place).sum() / patch.sum()), float((patch * -place[:, None]).sum() / patch.sum())


@pytest.mark.parametrize("dip", [0.0, 3.0, 15.0, 45.0])
def test_the_patch_holds_the_volume_of_its_depth(dip: float) -> None:
    process = dataclasses.replace(PAPER, dip_deg=dip)
    gamma = np.array([0.82, 0.9, 1.0])
    patch = HertzSpot(process).patch(gamma, np.array([0.0, 1.0, 4.0]))
    want = contact.volume_rate_nm_mm2_s(process, gamma * DEPTH)
    np.testing.assert_allclose(patch.sum(axis=(1, 2)), want, rtol=1e-12)
    assert (patch >= 0).all()


def test_each_square_holds_what_a_fine_sum_over_it_holds() -> None:
    azimuth, fine = 0.7, 40
    radius = float(contact.contact_radius_mm(PAPER, DEPTH))
    place = radius * ((np.arange(PATCH * fine) + 0.5) * 2 / (PATCH * fine) - 1)
    right, up = place[None, :], -place[:, None]
    lean = np.array([np.cos(azimuth), np.sin(azimuth)])
    y, x = lean[0] * right + lean[1] * up, lean[1] * right - lean[0] * up
    shift = float(contact.dissipative_shift_mm(PAPER, DEPTH))
    rate = contact.removal_rate_nm_s(PAPER, DEPTH, x + shift, y)  # the patch is centred on the pressure
    want = rate.reshape(PATCH, fine, PATCH, fine).sum(axis=(1, 3)) * (2 * radius / PATCH / fine) ** 2
    got = HertzSpot(PAPER).patch(np.ones(1), np.array([azimuth]))[0]
    assert np.abs(got - want).max() < 1e-3 * want.max()


def test_finer_squares_are_of_the_same_spot() -> None:
    depth, azimuth = np.array([0.85]), np.array([0.7])
    coarse, fine = (HertzSpot(PAPER, n).patch(depth, azimuth)[0] for n in (PATCH, 2 * PATCH))
    assert fine.shape == (2 * PATCH, 2 * PATCH)
    whole = fine.reshape(PATCH, 2, PATCH, 2).sum(axis=(1, 3))
    assert abs(whole - coarse).max() < 1e-3 * coarse.max()
    assert fine.sum() == pytest.approx(coarse.sum(), rel=1e-12)


@pytest.mark.parametrize("azimuth", [0.0, 1.0, 2.5, -2.0])
def test_the_centre_of_removal_lies_where_the_spindle_leans(azimuth: float) -> None:
    radius = float(contact.contact_radius_mm(PAPER, DEPTH))
    x, y = moments(HertzSpot(PAPER).patch(np.ones(1), np.array([azimuth]))[0], radius)
    assert np.hypot(x, y) > 0.05
    assert np.arctan2(y, x) == pytest.approx(azimuth, abs=0.01)


@given(st.floats(-20, 20), st.floats(0.2, 4.0), st.sampled_from([0.1, 0.25, 0.5, 1.0, 3.0, 20.0]))
def test_the_cells_share_out_each_square_and_keep_its_place(centre: float, radius: float, pitch: float) -> None:
    first, share = overlap(np.array([centre]), np.array([radius]), pitch)
    np.testing.assert_allclose(share[0].sum(axis=0), 1.0, atol=1e-9)
    assert (share >= 0).all()
    edges = (first[0] + np.arange(share.shape[1] + 1)) * pitch
    side = 2 * radius / PATCH
    for j in (0, PATCH // 2, PATCH - 1):
        low = centre - radius + j * side
        want = [max(0.0, min(b, low + side) - max(a, low)) / side for a, b in pairwise(edges)]
        np.testing.assert_allclose(share[0, :, j], want, atol=1e-9)


def test_patches_of_several_sizes_share_one_window() -> None:
    first, share = overlap(np.array([0.3, 5.0]), np.array([0.5, 1.7]), 1.0)
    assert first.tolist() == [-1.0, 3.0]
    assert share.shape == (2, 5, PATCH)
    np.testing.assert_allclose(share.sum(axis=(1, 2)), PATCH, rtol=1e-12)


def test_the_hertz_spot_is_as_wide_as_its_contact() -> None:
    gamma = np.array([0.25, 1.0])
    radius = float(contact.contact_radius_mm(PAPER, DEPTH))
    np.testing.assert_allclose(HertzSpot(PAPER).half_width_mm(gamma), [radius / 2, radius], rtol=1e-12)
    np.testing.assert_allclose(HertzSpot(PAPER).step_mm(gamma), [radius / 4, radius / 2], rtol=1e-12)


def test_the_resolved_force_makes_the_hertz_spot_wider() -> None:
    resolved = dataclasses.replace(PAPER, normal_force="resolved")
    wide, narrow = (HertzSpot(p).half_width_mm(np.ones(1))[0] for p in (resolved, PAPER))
    assert wide / narrow == pytest.approx(np.cos(np.radians(15)) ** (-1 / 3), rel=1e-9)


@pytest.mark.parametrize("azimuth", [0.0, 0.4, 3.0, -1.9])
def test_the_tools_frame_is_right_handed_with_y_where_the_spindle_leans(azimuth: float) -> None:
    x, y = rotate_spot(1.0, 0.0, np.array([azimuth]))[0], rotate_spot(0.0, 1.0, np.array([azimuth]))[0]
    np.testing.assert_allclose(y, [np.cos(azimuth), np.sin(azimuth)], atol=1e-15)
    assert x[0] * y[1] - x[1] * y[0] == pytest.approx(1.0)


def test_the_offset_of_the_hertz_spot_holds_the_dissipative_shift() -> None:
    azimuth = np.array([0.0, 2.0])
    moved = dataclasses.replace(PAPER, spot_offset_mm=(0.3, -0.1))
    shift = contact.dissipative_shift_mm(PAPER, DEPTH)
    np.testing.assert_allclose(HertzSpot(PAPER).offset_mm(np.ones(2), azimuth), rotate_spot(shift, 0.0, azimuth))
    np.testing.assert_allclose(HertzSpot(moved).offset_mm(np.ones(2), azimuth), rotate_spot(0.3 + shift, -0.1, azimuth))


def test_squares_are_a_quarter_of_a_cell_where_the_spot_is_large() -> None:
    large = dataclasses.replace(PAPER, tool_radius_mm=200.0, force_n=120.0)  # a contact of 8 mm radius
    assert [hertz_spot(PAPER, pitch).squares for pitch in (0.2, 0.5, 1.0)] == [69, PATCH, PATCH]
    assert [hertz_spot(large, pitch).squares for pitch in (0.2, 1.0, 3.0)] == [MOST_PATCH, 64, PATCH]
    with pytest.raises(ComputeError, match=r"the grid's pitch is 0 mm"):
        hertz_spot(PAPER, 0.0)


@pytest.mark.full
def test_more_squares_bring_a_large_spot_nearer_to_what_very_many_give() -> None:
    large = dataclasses.replace(PAPER, tool_radius_mm=200.0, force_n=120.0)
    places = np.random.default_rng(0).uniform(-8, 8, (60, 2))
    blocks = PathBlocks(places, places, np.linspace(0, 6, 60), np.full(60, 0.9), np.ones(60))
    coarse, chosen, truth = (
        effect_row(spot, blocks, np.zeros(2), 0.5)
        for spot in (HertzSpot(large), hertz_spot(large, 0.5), HertzSpot(large, 512))
    )
    assert np.abs(coarse - truth).max() > 0.02 * truth.max()
    assert np.abs(chosen - truth).max() < 0.006 * truth.max()
