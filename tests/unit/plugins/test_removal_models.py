"""The plugin's model from a request to its answer."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pluggy
import pytest

from polishd import hookspecs
from polishd.api import ComputeError, Grid, HybridRobot, Placement, Program, RemovalModel, RemovalRequest, ToolProcess
from polishd.plugins import removal_models

DIP = np.radians(15.0)


def request(**changes: Any) -> RemovalRequest:
    """Three dwells and one move on a part before the shipped robot, spindle leaning inward."""
    xy = np.array([[0.0, 0.0], [20.0, 0.0], [0.0, -20.0], [1.0, -20.0]])
    end = np.column_stack([xy, np.zeros(4)])
    start = end.copy()
    start[3, 0] = 0.0
    lean = np.sin(DIP) * np.array([-300.0, 220.0]) / np.hypot(300.0, 220.0)
    axis = np.tile([*lean, np.cos(DIP)], (4, 1))
    index = np.arange(4)
    moves = Program(b"", "", "p", "rs274", "feed", index + 1, index, start, end, axis, np.ones(4), 4, 600.0)
    placement = Placement((300.0, 220.0, 2315.0), np.diag([1.0, -1.0, -1.0]))
    whole = RemovalRequest(moves, Grid(61, 61, 1.0), ToolProcess(), HybridRobot(), placement, "exact", 1.0)
    return dataclasses.replace(whole, **changes)


def the_model() -> RemovalModel:
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    manager.register(removal_models)
    manager.check_pending()
    ((model,),) = manager.hook.polishd_removal_models()
    return model


def test_it_is_found_by_its_name_and_can_go_to_the_worker() -> None:
    model = the_model()
    assert model.name == "hertz_preston"
    assert removal_models.POLISHD_API == hookspecs.API_VERSION
    assert pickle.loads(pickle.dumps(model)) == model
    answer = pickle.loads(pickle.dumps(model.effect(request())))
    assert answer.effect.n == 4


def test_the_answer_belongs_to_the_points_and_the_grid() -> None:
    answer = the_model().effect(request())
    assert answer.effect.grid == Grid(61, 61, 1.0)
    assert answer.gamma.shape == answer.compliance_um_per_n.shape == (4,)
    removal = answer.effect.removal_nm(np.array([0.0, 10.0, 0.0, 0.0]))
    assert removal.max() == removal[30, 49:53].max() > 500
    assert any("gamma" in note for note in answer.notes)
    assert "depth 0.14835 mm, radius 1.7225 mm" in answer.notes[0]


def test_gamma_follows_from_the_compliance_whatever_the_correction() -> None:
    answers = [the_model().effect(request(correction=c)) for c in ("exact", "none", "linear", "power")]
    for answer in answers:
        want = 1 - answer.compliance_um_per_n * 1e-3 * 12 / np.cos(DIP) / 0.14834891
        np.testing.assert_allclose(answer.gamma, want, rtol=1e-6)
        assert ((answer.gamma > 0.83) & (answer.gamma < 0.92)).all()
    volumes = np.array([a.effect.matrix.sum(axis=0) for a in answers])
    gamma = answers[0].gamma
    np.testing.assert_allclose(volumes[1:] / volumes[1], [gamma**0, gamma, gamma**1.5], rtol=1e-9)
    np.testing.assert_allclose(volumes[0] / volumes[1], gamma**1.5, rtol=3e-3)


def test_exact_changes_the_shape_and_linear_does_not() -> None:
    none, linear, exact = (
        the_model().effect(request(correction=c)).effect.matrix.toarray() for c in ("none", "linear", "exact")
    )
    none, linear, exact = (m[:, 0] / m[:, 0].sum() for m in (none, linear, exact))
    np.testing.assert_allclose(linear, none, rtol=1e-12)
    assert np.abs(exact - none).max() > 0.02 * none.max()


def test_the_learned_rate_scales_the_effect_only() -> None:
    one, half = the_model().effect(request()), the_model().effect(request(rate=0.5))
    np.testing.assert_allclose(half.effect.matrix.toarray(), 0.5 * one.effect.matrix.toarray(), rtol=1e-12)
    np.testing.assert_array_equal(half.gamma, one.gamma)


def test_an_empty_program_has_an_empty_effect() -> None:
    moves = request().program
    none = {name: getattr(moves, name)[:0] for name in ("line", "block", "start_mm", "end_mm", "axis", "time_s")}
    answer = the_model().effect(request(program=dataclasses.replace(moves, **none)))
    assert answer.effect.n == 0
    assert answer.effect.removal_nm(np.empty(0)).shape == (61, 61)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rate": 0.0}, r"learned removal rate is 0 \(relative\)"),
        ({"rate": np.nan}, "learned removal rate is nan"),
        ({"grid": Grid(5, 5, 0.0)}, "grid's pitch is 0 mm"),
        ({"grid": Grid(0, 5, 1.0)}, "0 rows and 5 columns"),
        ({"process": ToolProcess(force_n=-1.0)}, "force_n is -1 N"),
        ({"process": ToolProcess(dip_deg=95.0)}, "dip_deg is 95 deg"),
        ({"process": ToolProcess(dip_deg=10.0)}, "point 0: .*dip is 15 deg, the process says 10"),
        ({"correction": "pointwise"}, "'pointwise' has no effect matrix"),
        ({"robot": HybridRobot(a_stiffness_n_mm_per_rad=1e5)}, "point 0: .*um/N, at 12 N takes all"),
        ({"placement": Placement((0.0, 0.0, 0.0), np.diag([1.0, -1.0, -1.0]))}, "point 0: .*out of the workspace"),
    ],
)
def test_what_cannot_be_is_refused_by_name_value_and_point(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        the_model().effect(request(**changes))
