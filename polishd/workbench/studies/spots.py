"""Spots polished at rest: the rows of the paper's Table III, computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from polishd.config.study import SpotSection, SpotsStudy
from polishd.process.spot_figures import SpotFigures, profile_divergence, spot_figures
from polishd.workbench.studies.paper import DIVERGENCE_BASE

READINGS = ("radius", "diameter")
"""What a spot's size is taken for; the paper does not say."""


@dataclass(frozen=True, slots=True)
class SpotRow:
    """One spot with its size read in one way, after the study's seconds."""

    name: str
    size_is: str
    section: SpotSection = field(repr=False)
    figures: SpotFigures = field(repr=False)
    removal_depth_nm: float
    """Deepest removal."""
    volume_mm3: float
    divergence: float
    """Jensen-Shannon divergence of the computed x profile from the computed y profile, to `DIVERGENCE_BASE`."""

    def as_json(self) -> dict[str, Any]:
        """All of it, profiles included."""
        figures = self.figures
        plain = ("depth_mm", "contact_radius_mm", "peak_pressure_mpa", "peak_nm_s", "volume_mm3_min")
        return {
            "name": self.name,
            "size_is": self.size_is,
            **self.section.model_dump(),
            **{key: getattr(figures, key) for key in (*plain, "dissipative_fraction", "pole_mm", "m_shaped")},
            "removal_depth_nm": self.removal_depth_nm,
            "volume_mm3": self.volume_mm3,
            "jsd_x_y": self.divergence,
            "jsd_base": DIVERGENCE_BASE,
            "profile_x": {"x_mm": figures.x_mm.tolist(), "rate_nm_s": figures.profile_x_nm_s.tolist()},
            "profile_y": {"y_mm": figures.y_mm.tolist(), "rate_nm_s": figures.profile_y_nm_s.tolist()},
        }


def compute_spots(study: SpotsStudy, tell: Callable[[str], None]) -> tuple[SpotRow, ...]:
    """A row for each spot and reading of its size; ConfigError for a spot that cannot be."""
    rows = []
    for reading in READINGS:
        for name in study.spots:
            tell(f"spot {name}, size is the {reading}")
            with study.blame(f"spots.{name}"):
                rows.append(compute_spot(study, name, reading))
    return tuple(rows)


def compute_spot(study: SpotsStudy, name: str, reading: str) -> SpotRow:
    """One row; ``reading`` is what its size is taken for."""
    section = study.spots[name]
    process = replace(
        study.tool_process(),
        tool_radius_mm=section.size_mm / (1 if reading == "radius" else 2),
        **section.model_dump(include={"rpm", "force_n", "dip_deg"}),
    )
    figures = spot_figures(process)
    return SpotRow(
        name=name,
        size_is=reading,
        section=section,
        figures=figures,
        removal_depth_nm=figures.peak_nm_s * study.seconds,
        volume_mm3=figures.volume_mm3_min * study.seconds / 60,
        divergence=profile_divergence(figures.profile_x_nm_s, figures.profile_y_nm_s, DIVERGENCE_BASE),
    )


def shape_words(rows: tuple[SpotRow, ...]) -> list[str]:
    """Which of the x profiles are M-shaped, a sentence for each reading of the size."""
    words = []
    for reading in READINGS:
        mine = [row for row in rows if row.size_is == reading]
        shaped = [row.name for row in mine if row.figures.m_shaped]
        nearest = min(mine, key=lambda row: row.figures.pole_mm / row.figures.contact_radius_mm)
        share = nearest.figures.pole_mm / nearest.figures.contact_radius_mm
        says = f"the x profile is M-shaped in {', '.join(shaped)}" if shaped else "no x profile is M-shaped"
        words.append(
            f"size = {reading}: {says}; it needs (R - d) tan(dip) < a, and the least is {share:.2f} a ({nearest.name})"
        )
    return words
