"""Tolerances: each ``[[tolerance]]`` gives the lines that a surface must meet (docs/reference/tolerance.md)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.cell_sections import JobSection
from polishd.config.fields import ConfigSection, Positive, Text, as_tuple
from polishd.config.toml_loader import TomlDocument, load_toml
from polishd.model.tolerance import Figure, ToleranceLine

FIGURES: dict[str, Figure] = {
    "rms_nm": "rms",
    "pv_nm": "pv",
    "slope_rms_urad": "slope_rms",
    "slope_max_urad": "slope_max",
    "psd_nm2_mm2": "psd",
}
GOES_WITH = {
    "periods_above_mm": (*FIGURES,),
    "periods_below_mm": (*FIGURES,),
    "integration_mm": ("slope_rms_urad", "slope_max_urad"),
    "exponent": ("psd_nm2_mm2",),
    "wavelength_nm": ("iso10110",),
}
"""Keys that refine a figure, and the figures that they refine."""
_NUMBER = r"(\d+(?:[.,]\d+)?|-)"
_FORM = re.compile(rf"(?:3/\s*)?{_NUMBER}\s*(?:\(\s*{_NUMBER}\s*(?:/\s*{_NUMBER}\s*)?\))?")
_RMS = re.compile(rf"RMS([tia])\s*<\s*{_NUMBER}")
_EXAMPLE = '"3/200(50/20)", with "-" for no limit, and "RMSi < 5" after a ";"'


class ToleranceSection(ConfigSection):
    """One line of the drawing: a figure in the clear aperture with its limit.

    A part is accepted when it meets all lines.
    """

    rms_nm: Positive | None = None
    """Largest RMS about the mean."""
    pv_nm: Positive | None = None
    """Largest peak to valley."""
    slope_rms_urad: Positive | None = None
    """Largest RMS of the slope's magnitude, over `integration_mm`. [urad]"""
    slope_max_urad: Positive | None = None
    """Largest magnitude of the slope, over `integration_mm`. [urad]"""
    psd_nm2_mm2: Positive | None = None
    """A of the limit `A / f^exponent` of the radially averaged two-dimensional PSD, f in 1/mm. [nm^2 mm^2]"""
    iso10110: Text | None = None
    """The form tolerance in the notation of ISO 10110-5, in nm of surface: `3/A(B/C)`, `-` for no limit, and RMSt, RMSi
    or RMSa after it: `3/200(50/-); RMSi < 5`."""
    periods_above_mm: Positive | None = None
    """Only periods above this count. Left out: all shorter ones count, too."""
    periods_below_mm: Positive | None = None
    """Only periods below this count. Left out: all longer ones count, too."""
    integration_mm: Positive | None = None
    """Distance of the two samples of a slope."""
    exponent: Annotated[float, Field(ge=0, le=10)] | None = None
    """Exponent of the PSD's limit. Left out: 0, a constant limit. [1]"""
    wavelength_nm: Positive | None = None
    """Unit of `iso10110`: fringe spacings of half this wavelength, as in drawings before 2015. Left out: nm."""

    @property
    def lines(self) -> tuple[ToleranceLine, ...]:
        """Tolerance lines of a surface: one line, or one for each limit of `iso10110`."""
        if self.iso10110 is not None:
            scale = 1.0 if self.wavelength_nm is None else self.wavelength_nm / 2
            return tuple(ToleranceLine(figure, limit * scale) for figure, limit in notation(self.iso10110).items())
        key, figure = next((key, figure) for key, figure in FIGURES.items() if getattr(self, key) is not None)
        above, below = self.periods_above_mm or 0.0, self.periods_below_mm
        return (ToleranceLine(figure, getattr(self, key), above, below, self.integration_mm, self.exponent or 0.0),)

    @model_validator(mode="after")
    def _is_one_line(self) -> Self:
        known = (*FIGURES, "iso10110")
        named = [key for key in known if getattr(self, key) is not None]
        if len(named) != 1:
            there = f"has {', '.join(named)}" if named else "has none"
            raise ValueError(
                f"each [[tolerance]] has one of {', '.join(known)}; this one {there}. Write one header for each line"
            )
        for key, figures in GOES_WITH.items():
            if getattr(self, key) is not None and named[0] not in figures:
                raise ValueError(f"{key}: needs {' or '.join(figures)}, not {named[0]}; remove it")
        self._require_whole(named[0])
        if self.iso10110 is not None:
            notation(self.iso10110)
        return self

    def _require_whole(self, figure: str) -> None:
        above, below = self.periods_above_mm, self.periods_below_mm
        if figure.startswith("slope") and self.integration_mm is None:
            raise ValueError(f"integration_mm: is missing; {figure} depends on it: add it")
        if figure == "psd_nm2_mm2" and (above is None or below is None):
            missing = "periods_above_mm" if above is None else "periods_below_mm"
            raise ValueError(f"{missing}: is missing; a PSD's limit needs two periods: add both")
        if above is not None and below is not None and above >= below:
            raise ValueError(f"periods_below_mm: {below:g} leaves no period above {above:g}; exchange or correct them")


class ToleranceFile(TomlDocument):
    """A file with a drawing's tolerance lines."""

    tolerance: Annotated[tuple[ToleranceSection, ...], BeforeValidator(as_tuple), Field(min_length=1)]
    """The lines; at least one."""


def load_tolerance(path: Path) -> tuple[ToleranceLine, ...]:
    """Read a file of ``[[tolerance]]`` sections only; raise ConfigError with file and line."""
    raw, source = load_toml(path)
    return tuple(line for section in ToleranceFile.of(raw, source).tolerance for line in section.lines)


def lines_of(job: JobSection, drawing: tuple[ToleranceLine, ...]) -> tuple[ToleranceLine, ...]:
    """Return a part's tolerance lines: the one line of the job's short form, or the drawing's lines."""
    if job.tolerance_nm is None:
        return drawing
    return (ToleranceLine("rms", job.tolerance_nm, job.tolerance_period_mm),)


def notation(text: str) -> dict[Figure, float]:
    """Return the limits by figure of a form tolerance of ISO 10110-5, in its unit; raise ValueError if it is none."""
    first, *rest = (part.strip() for part in text.split(";"))
    found: dict[Figure, str | None] = {}
    if form := _FORM.fullmatch(first):
        found = {"A": form[1], "B": form[2], "C": form[3]}
    else:
        rest.insert(0, first)
    named: dict[str, Figure] = {"t": "RMSt", "i": "RMSi", "a": "RMSa"}
    for part in rest:
        rms = _RMS.fullmatch(part)
        if rms is None or named[rms[1]] in found:
            raise ValueError(f"iso10110: {text!r} is not a form tolerance of ISO 10110-5; write {_EXAMPLE}")
        found[named[rms[1]]] = rms[2]
    limits = {figure: float(value.replace(",", ".")) for figure, value in found.items() if value not in {None, "-"}}
    if not limits or min(limits.values()) <= 0:
        raise ValueError(f"iso10110: {text!r} has no limit above 0; write {_EXAMPLE}")
    return limits
