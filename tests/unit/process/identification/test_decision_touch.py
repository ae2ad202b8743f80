"""What is stated of a machine after a pass of few tracks: intervals that hold, though rate and field cancel there."""

from __future__ import annotations

import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import pytest
from scipy import stats

from polishd.pipeline.steps import TOUCH_MISS_MM
from polishd.process.identification.decision import LOGARITHMS, EstimatedShift, decide, estimates_after_pass
from polishd.process.identification.parameters import PriorKnowledge
from tests.unit.process.identification.identified import EVERYTHING, Polished, disc, knowing, polished, removal

SPREAD = {"rate": 0.15, "offset_x": 0.2, "offset_y": 0.2, "width": 0.02, "compliance": 0.1}
"""Standard deviations of machines; of each term of the field 0.03."""
TRACKS_MM = (("y", 8.0), ("x", -9.0), ("y", -6.0))


def touch() -> Polished:
    """Three tracks, each of a few points across."""
    one = polished(lean="turning")
    at = dict(zip("xy", one.place.T, strict=True))
    near = np.any([np.abs(at[way] - place) < 0.6 for way, place in TRACKS_MM], axis=0)
    return Polished(one.place[near], 0.6 * one.time[near], one.azimuth[near], one.gamma[near])


def machine(known: PriorKnowledge, seed: int) -> Mapping[str, float]:
    rng = np.random.default_rng(seed)
    sigma = {name: SPREAD.get(name, 0.03 if name.startswith("field") else 0.0) for name in known.names}
    return {name: float(rng.normal()) * one for name, one in sigma.items()}


def in_use(known: PriorKnowledge, truth: Mapping[str, float], hours: float, seed: int) -> Mapping[str, float]:
    """Return the machine after hours of contact: worn, and with a random walk (docs/explanation/identification.md)."""
    rng = np.random.default_rng([seed, 1])
    after = {p.name: truth[p.name] + float(rng.normal()) * p.use * hours**0.5 for p in known.parameters}
    return {**after, "rate": after["rate"] - hours * truth.get("wear", 0.0)}


def of_the_prior(known: PriorKnowledge, seed: int) -> Mapping[str, float]:
    """A machine of those that the priors expect: of these an interval of 95 % is to hold in 95 %."""
    draws = np.random.default_rng([seed, 2]).normal(size=len(known.parameters))
    return {p.name: p.sigma * float(draw) for p, draw in zip(known.parameters, draws, strict=True)}


def removed_evenly(known: PriorKnowledge, machine: Mapping[str, float]) -> float:
    """Return the removal of an even pass that begins now, with its initial rate and a correctly placed part."""
    own = {p.name for p in known.parameters if p.scope in {"tool", "cell"}} - {"wear"}
    return float(removal(polished(time="even"), {k: v for k, v in machine.items() if k in own})[disc()[1]].sum())


STATED = re.compile(r"([+-]?\d[\d.e+-]*) \+- (\d[\d.e+-]*)")


def off_in_words(one: EstimatedShift, truth: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    """Yield for each value in a note its name and the machine's deviation in units of the printed error."""
    true = np.array([truth[name] for name in one.parts])
    if one.name in LOGARITHMS:
        true = np.expm1(true)
    true = true * (100 if "%" in one.words else 1)
    lengths = [(f"note: {one.name}", float(np.linalg.norm(true)))] if len(true) > 1 else []
    names = [*lengths, *((f"note: {name}", value) for name, value in zip(one.parts, true, strict=True))]
    for (name, value), (printed, error) in zip(names, STATED.findall(one.words), strict=True):
        yield name, (float(printed) - value) / float(error)


FAR = 6.0
"""Errors that no statement is off: those of a first touch were 5 to 9 once."""
KINDS = ("rate", "note: ", "learned: ")


class Held:
    """Counts of 95 % intervals that held, by statement."""

    def __init__(self) -> None:
        self.off: dict[str, list[float]] = defaultdict(list)

    def add(self, name: str, off: float) -> None:
        assert np.isfinite(off), (name, off)
        self.off[name].append(off)

    def of(self, kind: str) -> tuple[int, int]:
        """How many held, and how many there are, of the statements of this name, or of all in KINDS that begin so."""
        own = [kind] if kind not in KINDS else [name for name in self.off if name.startswith(kind)]
        off = [one for name in own for one in self.off[name]]
        return int((np.abs(off) < 1.96).sum()), len(off)

    def share(self, kind: str) -> float:
        held, count = self.of(kind)
        return held / count

    def too_rare(self, least: float = 0.90) -> dict[str, tuple[int, int]]:
        """Statements that hold less often than that, by more than chance (one in a thousand)."""
        every = {name: self.of(name) for name in self.off}
        return {name: one for name, one in every.items() if stats.binom.cdf(*one, least) < 0.001}

    def farthest(self) -> tuple[float, str]:
        """Largest deviation of a statement in its standard errors, and its name."""
        return max((max(map(abs, off)), name) for name, off in self.off.items())

    def __str__(self) -> str:
        lines = []
        for kind in (*KINDS, *sorted(self.off.keys() - {"rate"})):
            held, count = self.of(kind)
            low, high = stats.binomtest(held, count).proportion_ci(0.95, "exact")
            lines.append(f"{kind}: {held} of {count}, {held / count:.1%} [{low:.1%}, {high:.1%}]")
        return "\n".join(lines)


def stated(
    machines: int, known: PriorKnowledge, drawn: Callable[[PriorKnowledge, int], Mapping[str, float]]
) -> tuple[Held, int]:
    """Return the statements about machines whose touch needs no operator, and the number of touches.

    What is stated of the rate is compared with what an even pass removes after the touch's contact, for which machines
    walk and wear as is reckoned with. Notes are read as they are printed, those of touches that stop, too.
    """
    one, held = touch(), Held()
    hours, kept = float(one.time.sum()) / 3600, 0
    for seed in itertools.count():
        truth = drawn(known, seed)
        found = one.identified(truth, seed=seed, prior=known)
        decision = decide(found, misses_mm=TOUCH_MISS_MM)
        for each in (*decision.corrected, *decision.left):
            for name, off in off_in_words(each, truth):
                held.add(name, off)
        if decision.stops:
            continue
        for estimate in found.estimates:
            if estimate.parameter.scope != "map":
                name = estimate.parameter.name
                held.add(f"learned: {name}", (estimate.value - truth[name]) / estimate.sigma)
        taken = [each.name for each in decision.corrected if each.name != "rate"]
        estimates = estimates_after_pass(found.learned, taken, hours, (0.1, 10.0), found.volume)
        assert estimates.rate.sigma is not None
        believed = removed_evenly(known, {**estimates.applied, "rate": float(np.log(estimates.rate.value))})
        off = np.log(believed / removed_evenly(known, in_use(known, truth, hours, seed)))
        held.add("rate", float(off) / (estimates.rate.sigma / estimates.rate.value))
        kept += 1
        if kept == machines:
            return held, seed + 1
    raise AssertionError("seeds do not end")


@pytest.mark.parametrize(
    "machines",
    [pytest.param(8, marks=pytest.mark.full), pytest.param(200, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])],
)
def test_what_is_stated_of_a_touch_holds(machines: int) -> None:
    """Machines as the priors expect, with all parameters that a cell fits: figures of docs/explanation/estimates.md."""
    held, touches = stated(machines, knowing(f"{EVERYTHING} power"), of_the_prior)
    print(f"{machines} machines of {touches}\n{held}")
    assert touches < 2.5 * machines, "most machines need no person"
    assert held.too_rare() == {}, str(held)
    assert held.farthest() < (FAR,), str(held)
    if machines >= 100:
        for kind in KINDS:
            assert 0.90 <= held.share(kind) <= 0.98, str(held)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_what_is_stated_of_machines_that_differ_by_less_than_the_priors_allow_holds_at_least_as_often() -> None:
    """What is stated of the rate over the part is mostly its field's prior: of these machines it is too careful."""
    held, touches = stated(200, knowing("field offset width compliance"), machine)
    print(f"200 machines of {touches}\n{held}")
    assert held.too_rare() == {}, str(held)
    assert held.farthest() < (FAR,), str(held)
    assert all(held.share(kind) >= 0.90 for kind in KINDS), str(held)


@pytest.mark.full
def test_what_is_left_out_draws_nothing_that_is_corrected_far_from_where_it_was_found() -> None:
    """Of this machine two terms of the field are uncertain each, and certain together: a compliance of 4 came of it."""
    one, known = touch(), knowing("field offset width compliance")
    found = one.identified(machine(known, 21), seed=21, prior=known)
    decision = decide(found)
    assert {"compliance", "field 2", "field 3"} <= {each.name for each in decision.corrected}
    taken = [each.name for each in decision.corrected if each.name != "rate"]
    estimates = estimates_after_pass(found.learned, taken, 0.0, (0.1, 10.0), found.volume)
    at = found["compliance"]
    assert abs(estimates.applied["compliance"] - at.value) < at.sigma
