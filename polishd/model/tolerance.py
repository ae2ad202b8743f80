"""Drawing tolerances of a surface: lines with a figure and its limit, and the measured results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, Self

Figure = Literal["rms", "pv", "slope_rms", "slope_max", "psd", "A", "B", "C", "RMSt", "RMSi", "RMSa"]
"""The last six are those of ISO 10110-5; what each is: docs/reference/tolerance.md."""

WORDS = {"rms": "RMS", "pv": "PV", "slope_rms": "slope RMS", "slope_max": "slope"}
NORMS = frozenset({"rms", "RMSt", "RMSi", "RMSa"})
"""An RMS over the same samples: a map's noise of r nm RMS changes it by r at most, whatever the noise looks like."""

Accept = Literal["figure", "bound", "bound_without_power"]
"""By what an RMS is accepted: as measured; by the bound of the part's own; by that of its figure without power."""


@dataclass(frozen=True, slots=True)
class ToleranceLine:
    """One line of the drawing: a figure over stated periods, and the most that it may be."""

    figure: Figure
    limit: float
    above_mm: float = 0.0
    """Periods above this count; 0: all shorter ones, too."""
    below_mm: float | None = None
    """Periods below this count; None: all longer ones, too."""
    integration_mm: float | None = None
    """Exponent of a slope."""
    exponent: float = 0.0
    """Exponent of a PSD, whose upper line is ``limit / f**exponent``, f in 1/mm."""

    @property
    def unit(self) -> str:
        """Unit of figure and limit."""
        return {"slope_rms": "urad", "slope_max": "urad", "psd": "nm^2 mm^2"}.get(self.figure, "nm")

    @property
    def what(self) -> str:
        """Description without the limit: "RMS of periods 1 to 5 mm"."""
        words = WORDS.get(self.figure, f"3/{self.figure}" if len(self.figure) == 1 else self.figure)
        if self.figure == "psd":
            words = f"PSD x f^{self.exponent:g}" if self.exponent else "PSD"
        if self.integration_mm is not None:
            words += f" over {self.integration_mm:g} mm"
        return words + self._periods()

    @property
    def bounded(self) -> bool:
        """Return whether the figure has a bound: an RMS over the long periods, where the instrument has errors."""
        return self.figure == "rms" and self.below_mm is None

    def _periods(self) -> str:
        if self.below_mm is None:
            return f" of periods above {self.above_mm:g} mm" if self.above_mm else ""
        if not self.above_mm:
            return f" of periods below {self.below_mm:g} mm"
        return f" of periods {self.above_mm:g} to {self.below_mm:g} mm"


@dataclass(frozen=True, slots=True)
class LineResult:
    """Measured result of a line."""

    what: str
    value: float
    limit: float
    unit: str
    uncertainty: float | None = None
    """Largest error by the instrument's repeatability; None: unknown."""
    bound: float | None = None
    """95 % upper bound of the true figure, by which the line is judged; None: judged by the measured value."""
    with_ripple: float | None = None
    """Measured value with the forecast ripple of the path that the map does not show; None: there is none."""
    with_ripple_high: float | None = None
    """The same with the ripple's 95 % value."""
    removed: str = ""
    """Term that the bound leaves out because the instrument's error is undetermined: "power"; empty: none."""

    @property
    def counted(self) -> float:
        """Return the value that is compared with the limit: the bound where there is one, with the hidden ripple."""
        if self.bound is not None:
            return self.bound
        return self.value if self.with_ripple is None else self.with_ripple

    @property
    def holds(self) -> bool:
        """Return whether that value is within the limit."""
        return self.counted <= self.limit

    @property
    def excess(self) -> float:
        """Return that value over the limit."""
        return self.counted / self.limit

    @property
    def guard(self) -> float | None:
        """The guard band: by how much the bound is above what was measured; None without one."""
        return None if self.bound is None else self.bound - self.value

    @property
    def unsure(self) -> bool:
        """Return whether uncertainty of instrument or ripple could reverse the result; a bound contains both."""
        if self.bound is not None:
            return False
        near = self.uncertainty is not None and abs(self.counted - self.limit) <= self.uncertainty
        return near or self.counted <= self.limit < (self.with_ripple_high or 0.0)

    @property
    def bound_words(self) -> str:
        """``at most 1.8 nm truly (95 %), guard band 1.3 nm, power removed``; empty without a bound."""
        if self.bound is None or self.guard is None:
            return ""
        removed = f", {self.removed} removed" if self.removed else ""
        return f"at most {self.bound:.3g} {self.unit} truly (95 %), guard band {self.guard:.2g} {self.unit}{removed}"

    @property
    def ripple_words(self) -> str:
        """``2.41 with ripple that the map does not show (up to 2.6)``; empty where that is no difference."""
        if self.with_ripple is None or self.with_ripple_high is None:
            return ""
        if f"{self.with_ripple_high:.3g}" == f"{self.value:.3g}":
            return ""
        return f"{self.with_ripple:.3g} with ripple that the map does not show (up to {self.with_ripple_high:.3g})"

    def facts(self) -> dict[str, Any]:
        """For summary, journal and events: its fields, the ``guard`` band, and whether it ``holds``."""
        return {**asdict(self), "guard": self.guard, "holds": self.holds}

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """Read a result from its facts; those of an earlier polishd have no bound."""
        return cls(**{item.name: facts[item.name] for item in fields(cls) if item.name in facts})

    def __str__(self) -> str:
        """One line: ``RMS 2.31 nm of 2 nm allowed``."""
        sigma = "" if self.uncertainty is None else f" +- {self.uncertainty:.2g}"
        bound = f", {self.bound_words}," if self.bound is not None else ""
        bound += f", {self.ripple_words}," if self.ripple_words else ""
        return f"{self.what} {self.value:.3g}{sigma} {self.unit}{bound} of {self.limit:g} {self.unit} allowed"


def line_results(measured: Mapping[str, Any]) -> tuple[LineResult, ...]:
    """Read the results of a measurement record; empty for a record of an earlier polishd."""
    rows: Iterable[Mapping[str, Any]] = measured.get("judged") or ()
    return tuple(map(LineResult.of, rows))


def worst_line(judged: Sequence[LineResult]) -> LineResult | None:
    """The line that is the farthest beyond its limit, or the nearest to it; None of none."""
    return max(judged, key=lambda one: one.excess, default=None)


def part_holds(judged: Sequence[LineResult]) -> bool:
    """Return whether a part meets its drawing: all lines hold, and there is at least one."""
    return bool(judged) and all(one.holds for one in judged)
