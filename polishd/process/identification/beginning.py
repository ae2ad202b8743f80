"""Where a fit begins: at what was known, or, where that does not fit at all, where the spot is found by looking."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.identification.forward import ForwardModel
from polishd.process.identification.parameters import PriorKnowledge
from polishd.process.identification.passes import RemovalMap
from polishd.process.identification.residual import without_plane

LOST = 0.3
"""Of how a removal varies: where what was known leaves more, at whatever rate, its slopes may lead astray."""
SHOWS = 3.0
"""Standard deviations of the noise that a removal has to leave to be anything that could be found elsewhere."""
MOVES = 10
"""Steps of the spot that are gone at most: five millimetres and more, of any tool."""
PLACES = (("offset_x", "offset_y"), ("shift_x", "shift_y"))
"""Parameters by which a spot may be elsewhere, in the tool's frame or in the part's."""


def beginning(model: ForwardModel, removed: RemovalMap, prior: PriorKnowledge) -> FloatArray:
    """(k,) parameters to begin a fit at: the prior's mean, moved step by step to where the removal is."""
    here, measured = prior.mean, without_plane(removed.removal_nm[removed.mask], removed.mask)
    left_nm = _left_nm(model, here, measured)
    if left_nm < max(LOST * float(measured.std()), SHOWS * removed.noise.sigma_nm):
        return here
    ways = [_walked(model, here, left_nm, measured, place) for place in PLACES if set(place) <= set(prior.names)]
    return min(ways, key=lambda way: way[1], default=(here, left_nm))[0]


def _walked(
    model: ForwardModel, here: FloatArray, left_nm: float, measured: FloatArray, place: tuple[str, str]
) -> tuple[FloatArray, float]:
    """From here downhill, a step of the spot at a time: (k,) parameters, and what they leave."""
    for _ in range(MOVES):
        looked = [(there, _left_nm(model, there, measured)) for there in _beside(model, here, place)]
        there, less_nm = min(looked, key=lambda one: one[1])
        if less_nm >= left_nm:
            break
        here, left_nm = there, less_nm
    return here, left_nm


def _beside(model: ForwardModel, here: FloatArray, place: tuple[str, str]) -> Iterator[FloatArray]:
    """(k,) parameters with the spot a step further along each axis."""
    names = [p.name for p in model.parameters]
    for name in place:
        for way in (-1, 1):
            there = here.copy()
            there[names.index(name)] += way * model.step_mm(here)
            yield there


def _left_nm(model: ForwardModel, theta: FloatArray, measured: FloatArray) -> float:
    """RMS of a removal (N,), levelled, less what these parameters make of it at the best rate."""
    modelled = without_plane(model.matrix(theta) @ model.block_s(theta), model.mask)
    rate = max(float(modelled @ measured) / float(modelled @ modelled), 0.0)
    return float(np.sqrt(np.mean((measured - rate * modelled) ** 2)))
