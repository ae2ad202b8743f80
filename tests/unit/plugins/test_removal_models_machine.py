"""What a pass's maps teach of the machine: the learner ``machine``, from evidence to beliefs."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from polishd.api import EstimateUpdate, Grid, MachineEstimates, MapPixels, PassEvidence, Program, RemovalRequest
from polishd.model.surface import FloatArray
from polishd.plugins.removal_models import learn_machine, modelled_spot_of
from polishd.process.identification.forward_model import ParameterAction
from polishd.process.metrology.resampling import Registration, resample_registered
from polishd.process.removal.dynamic_tif import effect_columns, lean_azimuth_rad
from polishd.process.removal.tif import HertzSpot
from polishd.process.robot.compliance import path_compliance
from tests.unit.plugins.test_removal_models import request

HALF_MM = 16.0
STEP_MM = 0.93
GRID = Grid(72, 72, 0.5)
NOISE_NM = 0.1


def raster() -> Program:
    """Lines along x with the spindle leaning inward, 0.93 mm apart: nearly two samples."""
    lines = np.arange(-HALF_MM, HALF_MM, STEP_MM)
    along = np.arange(-HALF_MM, HALF_MM, 1.0)
    x, y = (v.ravel() for v in np.meshgrid(along, lines))
    start = np.column_stack([x, y, np.zeros(x.size)])
    one, index = request().program, np.arange(x.size)
    end = start + np.array([1.0, 0.0, 0.0])
    axis = np.tile(one.axis[0], (x.size, 1))
    return replace(one, line=index + 1, block=index, start_mm=start, end_mm=end, axis=axis, time_s=np.ones(x.size))


def asked(learned: MachineEstimates | None = None) -> RemovalRequest:
    return request(program=raster(), grid=GRID, beliefs=learned or MachineEstimates())


@cache
def dwell_s() -> FloatArray:
    """(n,) as a solved dwell varies, over some millimetres."""
    x, y, _ = raster().end_mm.T
    return 0.3 * np.asarray(0.2 + 0.06 * np.sin(x / 3) * np.cos(y / 4) + 0.04 * np.cos(np.hypot(x - 4, y) / 2))


@cache
def seen(at: MapPixels, **truth: float) -> FloatArray:
    """(ny, nx) nm: the removal by squares finer than the learner's, on a map's own samples, brought to the grid."""
    program, acting = raster(), ParameterAction(truth)
    ask = asked()
    gamma = 1 - _compliance(ask) * ask.process.force_n / np.cos(np.radians(15.0)) / 0.14834891
    turn = np.radians(at.rotation_deg)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    lean = lean_azimuth_rad(program)
    ends = [acting.laid(end[:, :2], lean)[0] @ rotation + at.shift_mm for end in (program.start_mm, program.end_mm)]
    depth = acting.sunk(gamma)
    hours = np.cumsum(dwell_s()) / 3600
    columns = effect_columns(
        at.grid,
        acting.spot(HertzSpot(ask.process, 128)),
        (ends[0], ends[1]),
        lean + turn,
        depth_ratio=depth,
        factor=np.exp(acting.log_rate(depth, hours)),
    )
    removed = np.asarray(columns @ dwell_s()).reshape(at.grid.shape)
    noise = np.random.default_rng(5).normal(0.0, NOISE_NM, at.grid.shape)
    return resample_registered(removed + noise, at.grid, GRID, Registration(at.rotation_deg, at.shift_mm))


def _compliance(ask: RemovalRequest) -> FloatArray:
    path = path_compliance(ask.program, ask.process, ask.robot, ask.placement, options=ask.options, optic=ask.optic)
    return path.compliance_mm_per_n


def taught(at: MapPixels, with_pixels: bool = True, **truth: float) -> EstimateUpdate:
    """What the learner makes of a pass of which this is true."""
    return learn_machine(asked(), shown(seen(at, **truth), at if with_pixels else None), modelled_spot_of)


def shown(removal: FloatArray, pixels: MapPixels | None) -> PassEvidence:
    """That removal, as maps show it."""
    mask = GRID.radius_mm() < 13.0
    return PassEvidence(
        beliefs=MachineEstimates(),
        executed_s=dwell_s(),
        predicted_nm=np.where(mask, removal, np.nan),
        measured_nm=np.where(mask, removal - removal[mask].mean(), np.nan),
        mask=mask,
        pitch_mm=GRID.pitch_mm,
        tells_rate=True,
        rates=(0.6, 1.4),
        noise_nm=NOISE_NM,
        pixels=pixels,
    )


def off(lesson: EstimateUpdate, name: str, true: float = 0.0) -> float:
    """Return the error of a parameter in units of its standard error."""
    found: dict[str, Any] = lesson.found["parameters"][name]
    return abs(found["value"] - true) / found["sigma"]


HALF_A_SAMPLE = MapPixels(Grid(71, 71, 0.5))


@pytest.mark.full
def test_a_machine_as_it_is_configured_is_found_so_and_a_round_contact_does_not_turn() -> None:
    lesson = taught(HALF_A_SAMPLE)
    assert lesson.stop == ""
    assert isinstance(lesson.beliefs, MachineEstimates)
    assert dict(lesson.beliefs.applied) == {}
    assert lesson.beliefs.rate.value == pytest.approx(1.0, abs=0.1)
    for name in ("width", "compliance", "offset_x", "offset_y", "wear"):
        assert off(lesson, name) < 4, name
    assert "turn" not in lesson.found["parameters"]
    assert "turn" not in lesson.beliefs.mean


def test_what_cannot_be_identified_teaches_the_rate_and_stops_a_pass_that_was_made_to_teach() -> None:
    evidence = shown(seen(HALF_A_SAMPLE), HALF_A_SAMPLE)
    evidence = replace(evidence, mask=GRID.radius_mm() < 1.5)  # too few samples
    plain = learn_machine(asked(), evidence, modelled_spot_of)
    assert plain.stop == ""
    assert "the machine was not identified" in plain.notes[-1]
    touch = learn_machine(asked(), replace(evidence, must_tell=True), modelled_spot_of)
    assert "this pass was made for identification: check tool" in touch.stop


@pytest.mark.slow
def test_a_wider_spot_is_found_and_taken() -> None:
    lesson = taught(HALF_A_SAMPLE, width=0.05)
    assert off(lesson, "width", 0.05) < 4
    assert lesson.beliefs.applied == {"width": pytest.approx(0.05, abs=0.01)}
    assert any(re.match(r"width of \+[45]\.\d+ \+- [\d.]+ %: corrected", note) for note in lesson.notes), lesson.notes


@pytest.mark.slow
def test_a_map_that_was_turned_is_read_on_its_own_samples() -> None:
    lesson = taught(MapPixels(Grid(75, 75, 0.5), 3.0, (0.2, -0.1)), width=0.05)
    assert off(lesson, "width", 0.05) < 4
    assert off(lesson, "rotation") < 4


@pytest.mark.slow
def test_finer_samples_are_smeared_too() -> None:
    lesson = taught(MapPixels(Grid(175, 175, 0.2), 0.0, (0.06, -0.05)), width=0.05)
    assert off(lesson, "width", 0.05) < 3
    assert off(lesson, "compliance") < 3


@pytest.mark.slow
def test_who_does_not_know_the_samples_takes_their_smear_for_the_robot_s() -> None:
    lesson = taught(HALF_A_SAMPLE, with_pixels=False)
    assert isinstance(lesson.beliefs, MachineEstimates)
    assert set(lesson.beliefs.applied) == {"compliance"}
    assert abs(lesson.beliefs.applied["compliance"]) > 0.03
