"""Track times of the first touch, against the information of each track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.identification.experiment_design import design_track_times, knowledge_after_pass
from polishd.process.identification.forward_model import ForwardModel, build_forward_model
from polishd.process.identification.parameters import PriorKnowledge
from tests.unit.process.identification.identified import PROCESS, RADIUS_MM, Polished, disc, knowing, polished, spot

NOISE_NM = 0.3
PLACES = np.array([[-8.0, 0.0], [8.0, 0.0], [0.0, -8.0], [0.0, 8.0], [-8.0, 0.0], [8.0, 0.0]])
LEANS = np.array([0.0, 0.0, 0.0, 0.0, np.pi, np.pi])
"""Six tracks of two points; the last two are the first ones with the lean the other way round."""


def tracks(seconds: FloatArray | None = None) -> Polished:
    place = np.repeat(PLACES, 2, axis=0) + np.tile([[-1.0, 0.0], [1.0, 0.0]], (6, 1))
    time = np.repeat(np.ones(6) if seconds is None else seconds, 2) / 2
    whole = polished()
    return replace(whole, place=place, time=time, azimuth=np.repeat(LEANS, 2), gamma=np.full(12, 0.85))


def model_of(one: Polished, known: PriorKnowledge) -> ForwardModel:
    grid, mask = disc()
    shown = {"parameters": known.parameters, "projection": "linear", "radius_mm": RADIUS_MM}
    return build_forward_model(one.blocks(), grid, mask, spot(), PROCESS, **shown)  # type: ignore[arg-type]


def chosen(names: str, wanted: dict[str, float], **limits: float) -> FloatArray:
    known = knowing(names)
    return design_track_times(
        model_of(tracks(), known),
        np.repeat(np.arange(6), 2),
        known,
        noise_nm=NOISE_NM,
        wanted=wanted,
        step_s=np.full(6, 0.5),
        most_s=np.full(6, limits.get("most_s", 50.0)),
        most_nm=limits.get("most_nm", 1e6),
        within_s=limits.get("within_s", 1e6),
    )


def test_what_is_wanted_is_reached_and_not_much_more() -> None:
    seconds = chosen("", {"rate": 0.01})
    some = seconds > 0
    known = knowing("")
    reached = knowledge_after_pass(model_of(tracks(seconds), known), known, NOISE_NM)
    assert reached.sigma[reached.at("rate")] <= 0.01
    less = tracks(np.where(some, np.maximum(seconds - 0.5, 0.0), 0.0))
    short = knowledge_after_pass(model_of(less, known), known, NOISE_NM)
    assert short.sigma[short.at("rate")] > 0.01, "a step less on each track would not do"


def test_an_offset_is_distinguished_from_a_shift_by_leaning_both_ways() -> None:
    seconds = chosen("offset shift", {"offset_x": 0.05, "offset_y": 0.05})
    assert seconds[LEANS == 0.0].sum() > 0
    assert seconds[LEANS > 0.0].sum() > 0
    known = knowing("offset shift")
    both = knowledge_after_pass(model_of(tracks(seconds), known), known, NOISE_NM)
    one = knowledge_after_pass(model_of(tracks(np.where(LEANS == 0.0, 20.0, 0.0)), known), known, NOISE_NM)
    assert both.sigma[both.at("offset_x")] <= 0.05
    assert one.sigma[one.at("offset_x")] > 0.2, "however long with one lean"


def test_a_gradient_is_determined_by_distant_places() -> None:
    seconds = chosen("field_2", {"rate": np.inf, "field_2": 0.01})
    assert seconds[PLACES[:, 0] < 0].sum() > 0
    assert seconds[PLACES[:, 0] > 0].sum() > 0


def test_limits_hold() -> None:
    assert chosen("", {"rate": 1e-6}, within_s=3.0).sum() <= 3.0
    assert chosen("", {"rate": 1e-6}, most_s=1.0).max() <= 1.0
    seconds, known = chosen("", {"rate": 1e-6}, most_nm=40.0), knowing("")
    model = model_of(tracks(seconds), known)
    theta = np.zeros(len(known.mean))
    assert 0.0 < model.removal_nm(theta, model.lay(theta)).max() <= 40.0 * 1.01


def test_nothing_is_polished_for_what_is_known() -> None:
    assert not chosen("", {"rate": 0.5}).any()
