"""What is stated of a machine after a pass of few tracks: intervals that hold, though rate and field cancel there."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from polishd.process.identification.beliefs import beliefs_of
from polishd.process.identification.decision import decide
from polishd.process.identification.parameters import Knowledge
from tests.unit.process.identified import Polished, disc, knowing, polished, removal

SPREAD = {"rate": 0.15, "offset_x": 0.2, "offset_y": 0.2, "width": 0.02, "compliance": 0.1}
"""Standard deviations of machines; of each term of the field 0.03."""
TRACKS_MM = (("y", 8.0), ("x", -9.0), ("y", -6.0))


def touch() -> Polished:
    """Three tracks, each of a few points across."""
    one = polished(lean="turning")
    at = dict(zip("xy", one.place.T, strict=True))
    near = np.any([np.abs(at[way] - place) < 0.6 for way, place in TRACKS_MM], axis=0)
    return Polished(one.place[near], 0.6 * one.time[near], one.azimuth[near], one.gamma[near])


def machine(known: Knowledge, seed: int) -> Mapping[str, float]:
    rng = np.random.default_rng(seed)
    sigma = {name: SPREAD.get(name, 0.03 if name.startswith("field") else 0.0) for name in known.names}
    return {name: float(rng.normal()) * one for name, one in sigma.items()}


@pytest.mark.parametrize(
    "machines",
    [pytest.param(12, marks=pytest.mark.full), pytest.param(200, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])],
)
def test_what_is_stated_of_a_touch_holds(machines: int) -> None:
    """Of the rate: how much an even pass over the whole part removes; these machines do not walk after the touch."""
    one, known, held = touch(), knowing("field offset width compliance"), list[tuple[float, float]]()
    even, mask, hours = polished(time="even"), disc()[1], 0.0
    for seed in range(machines):
        truth = machine(known, seed)
        found = one.identified(truth, seed=seed, prior=known)
        taken = [each.name for each in decide(found).corrected if each.name != "rate"]
        told = beliefs_of(found.learned, taken, hours, (0.1, 10.0), found.volume)
        assert told.rate.sigma is not None
        believed = {**told.applied, "rate": float(np.log(told.rate.value))}
        off = np.log(removal(even, believed)[mask].sum() / removal(even, truth)[mask].sum())
        z_rate = off / (told.rate.sigma / told.rate.value)
        z_offset = (found["offset_x"].value - truth["offset_x"]) / found["offset_x"].sigma
        held.append((float(z_rate), float(z_offset)))
    within = (np.abs(held) < 1.96).mean(axis=0)
    assert np.isfinite(held).all(), held
    if machines < 100:
        assert (within >= 0.75).all(), held
    else:
        assert ((within >= 0.90) & (within <= 0.98)).all(), within


@pytest.mark.full
def test_what_is_left_out_draws_nothing_that_is_corrected_far_from_where_it_was_found() -> None:
    """Of this machine two terms of the field are uncertain each, and certain together: a compliance of 4 came of it."""
    one, known = touch(), knowing("field offset width compliance")
    found = one.identified(machine(known, 21), seed=21, prior=known)
    decision = decide(found)
    assert {"compliance", "field 2", "field 3"} <= {each.name for each in decision.corrected}
    taken = [each.name for each in decision.corrected if each.name != "rate"]
    told = beliefs_of(found.learned, taken, 0.0, (0.1, 10.0), found.volume)
    at = found["compliance"]
    assert abs(told.applied["compliance"] - at.value) < at.sigma
