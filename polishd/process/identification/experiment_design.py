"""Optimal design of track times: the most information on a machine in the least contact time.

The information of a pass is the Fisher information of its removal (`ForwardModel.columns`), and the covariance after it
the inverse of that and the prior's. Tracks are given time where that takes most off the errors that are still larger
than wanted, for each second in contact (a greedy A-optimal design; V. V. Fedorov, Theory of Optimal Experiments, 1972).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.process.identification.forward_model import ForwardModel
from polishd.process.identification.parameters import ABERRATIONS, PriorKnowledge

WANTED: Mapping[str, float] = MappingProxyType(
    {"rate": 0.005, "offset_x": 0.02, "offset_y": 0.02, "turn": 0.5, "width": 0.005, "compliance": 0.05}
)
"""Standard errors wanted of a first touch, in the parameters' units, ..."""
FIELD_WANTED = 0.003
"""... and for each term of the rate's field."""
WORTH = 0.01
"""Least relative progress of a step towards the goal."""
MOST_STEPS = 400


def design_track_times(
    model: ForwardModel,
    track: IntArray,
    known: PriorKnowledge,
    *,
    noise_nm: float,
    wanted: Mapping[str, float],
    step_s: FloatArray,
    most_s: FloatArray,
    most_nm: float,
    within_s: float,
) -> FloatArray:
    """Return (C,) seconds of C tracks, 0 where a track is not worth its time.

    Args:
        model: of the blocks of all tracks, each with the time that it has of a second on its track.
        track: (n,) which track each block of ``model.blocks`` is of; -1: of none.
        known: before the touch, with the model's parameters.
        noise_nm: standard error of a sample of the removal; what is wanted of a smooth removal is that much smaller.
        wanted: standard errors by parameter; of others nothing is wanted.
        step_s: (C,) by how much a track's time grows at a time.
        most_s: (C,) most time on a track.
        most_nm: deepest removal anywhere, of all tracks together.
        within_s: most time in all.
    """
    theta = np.zeros(len(known.mean))
    laid = model.lay(theta)
    count = len(step_s)
    own = np.array([name not in ABERRATIONS for name in known.names])
    each = np.stack([model.columns(theta, laid, model.weight_s * (track == c)) * own for c in range(count)])
    depth = each[:, :, known.at("rate")]
    fixed = model.columns(theta, laid, 0 * model.weight_s)
    precision, goal = _inverse(known.covariance), _goals(known, wanted)
    seconds, total = np.zeros(count), fixed
    before = _left(total, precision, noise_nm, goal)
    for _ in range(MOST_STEPS):
        deeper = (total[:, known.at("rate")] + step_s[:, None] * depth).max(axis=1)
        open_ = (seconds + step_s <= most_s) & (seconds.sum() + step_s <= within_s) & (deeper <= most_nm)
        if before <= 0.0 or not open_.any():
            break
        left = np.full(count, np.inf)
        for c in np.flatnonzero(open_):
            left[c] = _left(total + step_s[c] * each[c], precision, noise_nm, goal)
        best = int(np.argmax((before - left) / step_s))
        if before - left[best] < WORTH * before:
            break
        seconds[best] += step_s[best]
        total, before = total + step_s[best] * each[best], float(left[best])
    return seconds


def knowledge_after_pass(model: ForwardModel, known: PriorKnowledge, noise_nm: float) -> PriorKnowledge:
    """Return the knowledge after a pass of the model's blocks that confirms the present estimate."""
    theta = np.zeros(len(known.mean))
    columns = model.columns(theta, model.lay(theta))
    return replace(known, covariance=_inverse(_inverse(known.covariance) + columns.T @ columns / noise_nm**2))


def _goals(known: PriorKnowledge, wanted: Mapping[str, float]) -> FloatArray:
    """(k,) variance wanted of each parameter, inf where none is."""
    fields = {name: FIELD_WANTED for name in known.names if name.startswith("field_")}
    every = {**fields, **wanted}
    return np.array([every.get(name, np.inf) for name in known.names]) ** 2


def _left(columns: FloatArray, precision: FloatArray, noise_nm: float, goal: FloatArray) -> float:
    """Return the distance from the goal: log of variance over goal where above 1, summed; 0 is reached."""
    variance = np.diag(_inverse(precision + columns.T @ columns / noise_nm**2))
    return float(np.log(np.maximum(variance / goal, 1.0)).sum())


def _inverse(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
