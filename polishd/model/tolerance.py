"""What a drawing allows of a surface: lines of a figure and its limit, and what was measured beside each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, Self

Figure = Literal["rms", "pv", "slope_rms", "slope_max", "psd", "A", "B", "C", "RMSt", "RMSi", "RMSa"]
"""The last six are those of ISO 10110-5; what each is: docs/tolerance.md."""

WORDS = {"rms": "RMS", "pv": "PV", "slope_rms": "slope RMS", "slope_max": "slope"}
NORMS = frozenset({"rms", "RMSt", "RMSi", "RMSa"})
"""An RMS over the same samples: a map's noise of r nm RMS changes it by r at most, whatever the noise looks like."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the drawing: a figure over stated periods, and the most that it may be."""

    figure: Figure
    limit: float
    above_mm: float = 0.0
    """Periods above this count; 0: all shorter ones, too."""
    below_mm: float | None = None
    """Periods below this count; None: all longer ones, too."""
    integration_mm: float | None = None
    """Of a slope."""
    exponent: float = 0.0
    """Of a PSD, whose upper line is ``limit / f**exponent``, f in 1/mm."""

    @property
    def unit(self) -> str:
        """Of figure and limit."""
        return {"slope_rms": "urad", "slope_max": "urad", "psd": "nm^2 mm^2"}.get(self.figure, "nm")

    @property
    def what(self) -> str:
        """In words, without the limit: "RMS of periods 1 to 5 mm"."""
        words = WORDS.get(self.figure, f"3/{self.figure}" if len(self.figure) == 1 else self.figure)
        if self.figure == "psd":
            words = f"PSD x f^{self.exponent:g}" if self.exponent else "PSD"
        if self.integration_mm is not None:
            words += f" over {self.integration_mm:g} mm"
        return words + self._periods()

    def _periods(self) -> str:
        if self.below_mm is None:
            return f" of periods above {self.above_mm:g} mm" if self.above_mm else ""
        if not self.above_mm:
            return f" of periods below {self.below_mm:g} mm"
        return f" of periods {self.above_mm:g} to {self.below_mm:g} mm"


@dataclass(frozen=True, slots=True)
class Judged:
    """What was measured of a line."""

    what: str
    value: float
    limit: float
    unit: str
    uncertainty: float | None = None
    """By how much the instrument's repeatability may have changed it, at most; None: not known."""

    @property
    def holds(self) -> bool:
        """Whether it is within its limit, as it was measured."""
        return self.value <= self.limit

    @property
    def excess(self) -> float:
        """Measured over allowed."""
        return self.value / self.limit

    @property
    def unsure(self) -> bool:
        """Whether the instrument's own uncertainty could have it the other way."""
        return self.uncertainty is not None and abs(self.value - self.limit) <= self.uncertainty

    def facts(self) -> dict[str, Any]:
        """For summary, journal and events: its fields, and whether it ``holds``."""
        return {**asdict(self), "holds": self.holds}

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """From them again."""
        return cls(**{item.name: facts[item.name] for item in fields(cls)})

    def __str__(self) -> str:
        """One line: ``RMS 2.31 nm of 2 nm allowed``."""
        sigma = "" if self.uncertainty is None else f" +- {self.uncertainty:.2g}"
        return f"{self.what} {self.value:.3g}{sigma} {self.unit} of {self.limit:g} {self.unit} allowed"


def judged_of(measured: Mapping[str, Any]) -> tuple[Judged, ...]:
    """Of a measurement's facts; none of one of an earlier polishd."""
    told: Iterable[Mapping[str, Any]] = measured.get("judged") or ()
    return tuple(map(Judged.of, told))


def worst(judged: Sequence[Judged]) -> Judged | None:
    """The line that is the farthest beyond its limit, or the nearest to it; None of none."""
    return max(judged, key=lambda one: one.excess, default=None)


def holds(judged: Sequence[Judged]) -> bool:
    """Whether a part is what its drawing wants: all lines hold, and there is one."""
    return bool(judged) and all(one.holds for one in judged)
