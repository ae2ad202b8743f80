"""The parameters that a removal map is read for, and what is known of them from pass to pass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from polishd.model.surface import FloatArray

Scope = Literal["map", "mount", "tool", "cell"]
"""What a parameter belongs to, and with what it begins anew: a map, a mounted part, a tool, or never."""
FIELD_ORDER = 3
"""Largest radial order of the rate's field."""
INSTRUMENT = ("piston", "tilt_x", "tilt_y", "power")
"""What two maps may differ by without removal, in Noll's order; ``astigmatism_45``, ``astigmatism_0`` may follow."""
ABERRATIONS = (*INSTRUMENT, "astigmatism_45", "astigmatism_0")
LARGE_NM = 300.0
"""Prior of piston and tilt: more than any map of a part has, less than what costs digits."""
DRIFT_NM = 3.0
"""Prior RMS of power and astigmatism by which two maps of one part differ."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of the process. Of each, 0 is the process as it is configured."""

    name: str
    unit: str
    sigma: float
    """Standard deviation of what is expected before anything was measured."""
    scope: Scope
    use: float = 0.0
    """By how much it walks at random in an hour of contact; in n hours by sqrt(n) times this."""
    rest: float = 0.0
    """Likewise in a day."""
    extension: str | None = None
    """The extension of the model that it comes with; None: it is always fitted."""
    words: str = ""
    """For people."""


@dataclass(frozen=True, slots=True)
class PriorKnowledge:
    """What is known of k parameters: normal, with this mean and covariance."""

    parameters: tuple[Parameter, ...]
    mean: FloatArray
    """(k,) in the parameters' units."""
    covariance: FloatArray
    """(k, k)"""
    odds: Mapping[str, float] = field(default_factory=dict)
    """By projection of the compliance (or another choice): natural logarithm of its odds, up to a constant."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def sigma(self) -> FloatArray:
        """(k,) standard errors."""
        return np.sqrt(np.diag(self.covariance))

    def at(self, name: str) -> int:
        """Index of a parameter; KeyError where it is not among them."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(f"no parameter {name!r}; there are {', '.join(self.names)}") from None


def usual_parameters(instrument: Iterable[str] = INSTRUMENT, *, turns: bool = True) -> tuple[Parameter, ...]:
    """All of them, with the priors of docs/identification.md.

    Args:
        instrument: what maps may differ by.
        turns: whether the spot has a shape that turns. A sphere's contact is round: its turn is an offset of what it
            removes, and all else of it smaller than what laying it on samples costs.
    """
    turn = Parameter("turn", "deg", 5.0, "tool", 0.1, 0.1, "turn", "spot's turn about the normal")
    return (
        Parameter("rate", "1", 0.3, "tool", 0.02, 0.03, None, "removal rate, natural logarithm"),
        *_field(),
        Parameter("wear", "1/h", 0.5, "tool", 0.05, 0.0, "wear", "loss of rate an hour of contact"),
        Parameter("offset_x", "mm", 1.0, "tool", 0.01, 0.01, "offset", "spot's offset across the lean"),
        Parameter("offset_y", "mm", 1.0, "tool", 0.01, 0.01, "offset", "spot's offset along the lean"),
        *((turn,) if turns else ()),
        Parameter("width", "1", 0.1, "tool", 0.01, 0.0, "width", "spot's width, natural logarithm"),
        Parameter("compliance", "1", 0.3, "cell", 0.005, 0.005, "compliance", "scale of the compliance, natural log."),
        Parameter("exponent", "1", 0.5, "cell", 0.0, 0.005, "exponent", "gamma's exponent, beside the spot's own"),
        Parameter("shift_x", "mm", 0.3, "mount", 0.0, 0.0, "shift", "seat or registration, along x"),
        Parameter("shift_y", "mm", 0.3, "mount", 0.0, 0.0, "shift", "seat or registration, along y"),
        Parameter("rotation", "deg", 0.3, "mount", 0.0, 0.0, "rotation", "seat or registration, turned"),
        *(_aberration(name) for name in instrument),
    )


def unlearned(parameters: Sequence[Parameter]) -> PriorKnowledge:
    """Before anything was measured: all of them 0, each with its prior."""
    prior = np.array([p.sigma for p in parameters])
    return PriorKnowledge(tuple(parameters), np.zeros(len(prior)), np.diag(prior**2))


def advanced(
    known: PriorKnowledge, contact_h: float, days: float = 0.0, anew: Iterable[Scope] = ("map",)
) -> PriorKnowledge:
    """What is known when the next pass begins.

    A tool that wears loses its rate (``rate -= contact_h * wear``, exactly, with the covariance). Each parameter walks
    at random by its own use and rest, up to its prior; those of the scopes ``anew`` begin again.

    Args:
        known: after a pass.
        contact_h: h that the tool was in contact in it.
        days: since.
        anew: scopes of what was changed; "map" always is.
    """
    step = np.eye(len(known.mean))
    if {"rate", "wear"} <= set(known.names):
        step[known.at("rate"), known.at("wear")] = -contact_h
    mean, covariance = step @ known.mean, step @ known.covariance @ step.T
    prior = np.array([p.sigma**2 for p in known.parameters])
    walk = np.array([p.use**2 * contact_h + p.rest**2 * days for p in known.parameters])
    covariance = covariance + np.diag(np.clip(prior - np.diag(covariance), 0.0, walk))
    new = np.array([p.scope in {"map", *anew} for p in known.parameters])
    mean[new], covariance[new, :], covariance[:, new] = 0.0, 0.0, 0.0
    covariance[new, new] = prior[new]
    return replace(known, mean=mean, covariance=covariance)


def _field() -> Iterable[Parameter]:
    """Zernike terms 2 ... of Noll's order over the unit circle, RMS 1 there: the relative rate's own RMS."""
    term = 2
    for order in range(1, FIELD_ORDER + 1):
        for _ in range(order + 1):
            words = f"rate over the part, Zernike term {term}"
            yield Parameter(f"field_{term}", "1", 0.1 / order, "cell", 0.01, 0.005, f"field {order}", words)
            term += 1


def _aberration(name: str) -> Parameter:
    sigma = LARGE_NM if name in INSTRUMENT[:3] else DRIFT_NM
    return Parameter(name, "nm", sigma, "map", words=f"{name.replace('_', ' ')} between the maps, RMS")
