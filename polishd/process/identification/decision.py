"""Decision about an identified shift: corrected in the next plan where it is small and certain, else a stop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.estimates import Estimate, MachineEstimates
from polishd.model.surface import FloatArray
from polishd.model.text import with_error
from polishd.process.identification.identify import (
    IdentificationResult,
    condition_on_zero,
    indices_without,
    length_error,
)
from polishd.process.identification.parameters import (
    PriorKnowledge,
    initial_knowledge,
    knowledge_before_pass,
    usual_parameters,
)
from polishd.process.identification.removal_check import MAX_SHIFT_MM

CERTAIN = 3.0
"""Standard errors by which a corrected shift must differ from 0."""
LIMITS = {"rate": 0.4, "turn": 5.0, "width": 0.2, "compliance": 0.5}
"""Largest correction without the operator, by extension, in its parameters' units."""
UPWARDS = ("compliance",)
"""Extensions that are only limited upwards: an actuator may compensate all of the robot's compliance."""
PLACE = ("offset", "shift", "rotation")
LOGARITHMS = ("rate", "width", "compliance")
"""Extensions whose parameter is a natural logarithm; messages state the change in percent."""
PLAIN = ("exponent",)
"""Parameters without a percentage."""
LOOK = "check tool, seat and map before the next pass"


@dataclass(frozen=True, slots=True)
class EstimatedShift:
    """An applied extension, or the rate."""

    name: str
    size: float
    """Length of its parameters' vector."""
    sigma: float
    """Standard error of the length."""
    unit: str
    new: float
    """Length of the change against the pass's plan, as far as it is limited."""
    parts: Mapping[str, float] = field(default_factory=dict)
    """The vector, by parameter."""
    error: float = 0.0
    """Stated standard error of the length: with all extensions, and with the change by leaving some out."""
    errors: Mapping[str, float] = field(default_factory=dict)
    """Values of each parameter."""

    @property
    def stated_error(self) -> float:
        """Stated standard error of the length, at least that of the applied one."""
        return max(self.error, self.sigma)

    @property
    def words(self) -> str:
        """Return size, unit and error as text; of a vector its length and each parameter."""
        if len(self.parts) == 1:
            (value,) = self.parts.values()
            slope = float(np.exp(value)) if self.name in LOGARITHMS else 1.0
            stated = with_error(self._value(value), self.stated_error * slope * self._scale, "+")
            return f"{self.name} of {stated} {self._unit}".rstrip()
        size = with_error(self.size * self._scale, self.stated_error * self._scale)
        listed = ", ".join(
            f"{name} {with_error(value * self._scale, self.errors[name] * self._scale, '+')}"
            for name, value in self.parts.items()
        )
        return f"{self.name} of {size} {self._unit} ({listed})"

    def words_of(self, limit: float) -> str:
        """Return a limit in the unit of ``words``."""
        return f"{self._value(limit):.3g} {self._unit}".rstrip()

    @property
    def _unit(self) -> str:
        return self.unit if self.unit != "1" else "" if self.name in PLAIN else "%"

    @property
    def _scale(self) -> float:
        return 100.0 if self._unit == "%" else 1.0

    def _value(self, value: float) -> float:
        """Return the relative change of a logarithmic parameter, else the value itself."""
        return (float(np.expm1(value)) if self.name in LOGARITHMS else value) * self._scale


@dataclass(frozen=True, slots=True)
class ShiftDecision:
    """Shifts that the next plan corrects, those that it ignores, and the reasons to stop."""

    corrected: tuple[EstimatedShift, ...]
    left: tuple[EstimatedShift, ...]
    """Identified, but not certain."""
    stops: tuple[str, ...]


def decide(
    found: IdentificationResult,
    limits: Mapping[str, float] = LIMITS,
    certain: float = CERTAIN,
    misses_mm: float = MAX_SHIFT_MM,
) -> ShiftDecision:
    """Decide about each applied extension and the rate.

    A change against the plan that exceeds its limit by more than chance stops. Any other shift is corrected where it is
    ``certain`` standard errors from 0. The ignored shifts together must be compatible with 0, or the corrected ones
    would have to compensate them. Offset, shift and rotation stop by their sum, beyond ``misses_mm``: a distorted robot
    or image gives large values of each with opposite signs.
    """
    corrected, left, stops = [], [], []
    sizes = _sizes(found)
    miss, sigma = found.displaced_mm
    if miss - 2 * sigma > misses_mm:
        place = [one for one in sizes if one.name in PLACE]
        by = " and ".join(one.words + _or_else(found, one.name) for one in place)
        stated = with_error(miss, max(sigma, found.displaced_error_mm))
        word = f"the spot acts {stated} mm off the planned position, more than {misses_mm:g}"
        stops.append(f"{word}, by {by}: {LOOK}")
    for one in sizes:
        limit = limits.get(one.name, np.inf)
        if one.new - 2 * one.sigma > limit:
            stops.append(f"{one.words}{_or_else(found, one.name)}, more than {one.words_of(limit)}: {LOOK}")
        elif one.size >= certain * one.sigma:
            corrected.append(one)
        else:
            left.append(one)
    while (most := _most_needed(found, left, certain)) is not None:
        left.remove(most)
        corrected.append(most)
    return ShiftDecision(tuple(corrected), tuple(left), tuple(stops))


def _most_needed(found: IdentificationResult, left: list[EstimatedShift], certain: float) -> EstimatedShift | None:
    """Return the extension that is least likely 0; None where all of them together may be 0.

    The threshold is the chance of a number ``certain`` standard errors off. Two shifts may be uncertain alone and
    certain together: ignored, they would move a compliance of -0.2 to +1.4.
    """
    own = [one for one in left if one.name in found.extensions]
    chance = 2 * scipy.stats.norm.sf(certain)
    if not own or _log_chance_of_none(found, own) >= np.log(chance):
        return None
    return min(own, key=lambda one: _log_chance_of_none(found, [one]))


def _log_chance_of_none(found: IdentificationResult, these: list[EstimatedShift]) -> float:
    """Return the log probability of these values if all are 0, with their correlation."""
    applied = found.applied
    own = [applied.at(name) for one in these for name in one.parts]
    mean, covariance = applied.mean[own], applied.covariance[np.ix_(own, own)]
    return float(scipy.stats.chi2.logsf(mean @ np.linalg.solve(covariance, mean), len(own)))


def _or_else(found: IdentificationResult, name: str) -> str:
    """Return the extensions of rivals without this one that the best model lacks."""
    best, rivals = found.comparison.best.extensions, found.comparison.rivals
    others = {other for one in rivals if name not in one.extensions for other in one.extensions - best}
    return f" (or {', '.join(sorted(others))}: this pass cannot separate them)" if others else ""


def _sizes(found: IdentificationResult) -> list[EstimatedShift]:
    applied = found.applied
    groups = {"rate": [applied.at("rate")]} if "rate" in applied.names else {}
    for name in sorted(found.extensions):
        groups[name] = [k for k, p in enumerate(applied.parameters) if p.extension == name]
    sizes = []
    for name, own in groups.items():
        vector = applied.mean[own]
        size = float(np.linalg.norm(vector))
        along = vector / size if size > 0 else np.ones(len(own)) / np.sqrt(len(own))
        sigma = float(np.sqrt(along @ applied.covariance[np.ix_(own, own)] @ along))
        new = vector - [found.counted.get(applied.names[k], 0.0) for k in own]
        beyond = np.maximum(np.minimum(new, vector), 0.0) if name in UPWARDS else new
        unit, beyond_size = applied.parameters[own[0]].unit, float(np.linalg.norm(beyond))
        parts = {applied.names[k]: float(value) for k, value in zip(own, vector, strict=True)}
        mean, covariance = found.learned.mean[own], found.learned.covariance[np.ix_(own, own)]
        each = np.hypot(np.sqrt(np.diag(covariance)), vector - mean)
        error = float(each[0]) if len(own) == 1 else length_error(size, mean, covariance)
        errors = {one: float(value) for one, value in zip(parts, each, strict=True)}
        sizes.append(EstimatedShift(name, size, sigma, unit, beyond_size, parts, error, errors))
    return sizes


# Conversion between the record that a job keeps and the prior of the next pass.


def knowledge_from_estimates(beliefs: MachineEstimates, *, turns: bool) -> PriorKnowledge:
    """Return the next pass's prior (`usual_parameters`); ComputeError where the stored parameters differ."""
    known = initial_knowledge(usual_parameters(turns=turns))
    if not beliefs.mean:
        return known
    if tuple(beliefs.mean) != known.names:
        raise ComputeError(
            f"the stored estimates have the parameters {', '.join(beliefs.mean)}, this polishd has "
            f"{', '.join(known.names)}. Finish the job with the polishd that began it, or set a new job.id"
        )
    return PriorKnowledge(
        known.parameters, np.array(list(beliefs.mean.values())), np.array(beliefs.covariance), dict(beliefs.odds)
    )


def estimates_for_next_part(beliefs: MachineEstimates, days: float) -> MachineEstimates:
    """Return the estimates for a job ``days`` after the last pass, without those of a mounted part.

    ComputeError as of `knowledge_from_estimates`.
    """
    known = knowledge_from_estimates(beliefs, turns="turn" in beliefs.mean)
    if not beliefs.mean:
        return beliefs
    after = knowledge_before_pass(known, 0.0, max(days, 0.0), anew=("mount",))
    of_part = {p.name for p in known.parameters if p.scope in {"map", "mount"}}
    walked = known.parameters[known.at("rate")].rest * max(days, 0.0) ** 0.5
    sigma = None if beliefs.rate.sigma is None else float(np.hypot(beliefs.rate.sigma, beliefs.rate.value * walked))
    rate = replace(beliefs.rate, sigma=sigma)
    return replace(
        beliefs,
        rate=rate,
        applied={name: value for name, value in beliefs.applied.items() if name not in of_part},
        mean=dict(zip(after.names, after.mean.tolist(), strict=True)),
        covariance=tuple(tuple(row) for row in after.covariance.tolist()),
    )


def estimates_after_pass(
    learned: PriorKnowledge, taken: Iterable[str], contact_h: float, rates: tuple[float, float], volume: FloatArray
) -> MachineEstimates:
    """Return the estimates after a pass of ``contact_h`` in contact.

    Args:
        learned: knowledge after the pass.
        taken: extensions for the plans; the parameters of the others are 0, and the rest is conditioned on that.
        contact_h: of the pass.
        rates: limits of the rate.
        volume: (k,) of `IdentificationResult`: the rate's stated error is that of the next pass's total removal.

    The next pass may have another program: on the tracks of a first touch rate and field cancel, over a part they do
    not. So the stated error also covers an even pass with all extensions, and the change by leaving some out.
    """
    out = indices_without(learned.parameters, frozenset(taken))
    mean, covariance = condition_on_zero(learned.mean, learned.covariance, out)
    known = knowledge_before_pass(learned, contact_h)
    plan = knowledge_before_pass(PriorKnowledge(learned.parameters, mean, covariance), contact_h)
    applied = {
        p.name: float(value)
        for p, value in zip(plan.parameters, plan.mean, strict=True)
        if p.extension is not None and p.extension in taken
    }
    rate = plan.at("rate")
    value = float(np.clip(np.exp(plan.mean[rate]), *rates))
    even = np.where([name.startswith("field_") for name in known.names], 0.0, volume)
    moved = float(even @ (mean - learned.mean))
    sigma = max(np.sqrt(volume @ plan.covariance @ volume), np.hypot(np.sqrt(even @ known.covariance @ even), moved))
    return MachineEstimates(
        rate=Estimate(value, value * float(sigma)),
        applied=applied,
        mean=dict(zip(known.names, known.mean.tolist(), strict=True)),
        covariance=tuple(tuple(row) for row in known.covariance.tolist()),
        odds=dict(known.odds),
        pass_h=contact_h,
    )
