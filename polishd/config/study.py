"""A study's file: TOML into frozen models, each error with its file, line and key, as a cell's configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from polishd.config.document import load_toml
from polishd.config.loop_study import LoopStudy
from polishd.config.physics import PartDocument, ProcessDocument
from polishd.config.places import TomlSource, did_you_mean, join_words
from polishd.config.values import (
    ConfigSection,
    Dip,
    Force,
    Name,
    NotNegative,
    Positive,
    Range,
    Seconds,
    Share,
    ShareOrNone,
    Speed,
    Text,
)
from polishd.model.errors import ConfigError
from polishd.model.outline import Outline

MOST_SAMPLES = 1_000_000
"""Samples, and dwell points, of a study: beyond it the machine's memory decides, not the file."""


class SurfaceSection(ConfigSection):
    """The surface at the start: drawn from a seed, or a measured map."""

    file: Text | None = None
    """A measured map, read as a cell's; instead of `rms_nm` and `period_mm`."""
    rms_nm: Positive | None = None
    """RMS of a drawn surface, in the clear aperture."""
    period_mm: Range | None = None
    """Shortest and longest period of a drawn surface."""
    seed: Annotated[int, Field(ge=0)] = 1
    """What a drawn surface is drawn from: the same number gives the same surface. [1]"""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        drawn = self.rms_nm is not None and self.period_mm is not None
        if self.file is not None and (self.rms_nm is not None or self.period_mm is not None):
            raise ValueError("file: a measured map has its own RMS and periods; drop rms_nm and period_mm, or the file")
        if self.file is None and not drawn:
            raise ValueError("rms_nm: a drawn surface needs rms_nm and period_mm = [low, high]; add them, or a file")
        if self.period_mm is not None and self.period_mm[0] <= 0:
            raise ValueError("period_mm: must be above 0; give the shortest and the longest period")
        return self


class PathSection(ConfigSection):
    """Dwell points at rest on a square lattice, over the aperture and an extension beyond it."""

    step_mm: Annotated[float, Field(gt=0, le=20)] = 1.0
    """Distance of the dwell points."""
    extension_mm: Annotated[float, Field(ge=0, le=100)] = 2.0
    """How far beyond the aperture they go."""


class SolveSection(ConfigSection):
    """How the dwell is solved: eq. 50 with ``t >= 0``."""

    regularisation_nm2_s2: NotNegative = 1e-9
    """Of eq. 50, its P: weight of the squared dwell."""
    unreached: ShareOrNone = 0.005
    """Share of the samples for which the mean removal may be too little. [1]"""
    kkt_tolerance: Share = 1e-5
    """KKT residual to stop at. [1]"""
    within_s: Seconds = 60.0
    """CPU seconds for each solve; the best so far is taken."""


class StudyFile(ProcessDocument):
    """What all studies share."""

    title: Text
    """What the tables and pictures are headed with."""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Dotted keys of the file that this kind of study has no use for, and why."""
        for key in ("removal_model", "correction", "tif"):
            if key in self.process.model_fields_set:
                yield f"process.{key}", "a study has its own corrections, and its spot is the modelled one"


class PartStudy(StudyFile, PartDocument):
    """What the studies over a part share: the part, its place, the robot and the path."""

    path: PathSection = PathSection()

    def require_size(self) -> None:
        """ConfigError where it would be more than a study can hold."""
        pitch = min(self.path.step_mm, self.process.grid_mm)
        wide, high = (2 * (half + self.path.extension_mm) / pitch for half in self.outline().half_mm)
        if wide * high > MOST_SAMPLES:
            said = f"{wide * high:.3g} dwell points or samples; at most {MOST_SAMPLES:.0e} can be studied"
            raise self.error("path", said)

    def free_rim(self) -> Outline | None:
        """The part's outline where its rim is free; None: the part sits in a flush ring."""
        return self.outline() if self.part.rim == "free" else None


class CorrectionsStudy(PartStudy):
    """Every correction against two plants (paper section IV-D)."""

    kind: Literal["corrections"]
    surface: SurfaceSection
    solve: SolveSection = SolveSection()
    lsf_period_mm: Positive = 33.0
    """Period above which `band_rms_nm` counts."""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Of what is said of a map where the surface is drawn, the nominal form."""
        yield from super().without_use()
        if self.surface.file is None and self.part.nominal is not None:
            yield "part.nominal", "a drawn surface is the error already, less the form wanted"


class PassesStudy(PartStudy):
    """Passes of equal dwell (paper fig. 12)."""

    kind: Literal["passes"]
    passes: Annotated[int, Field(ge=1, le=1000)] = 10
    """How many. [1]"""
    dwell_s: Positive = 0.01
    """At each point, in each pass."""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """What is said of maps."""
        yield from super().without_use()
        for key in ("nominal", "alignment"):
            if key in self.part.model_fields_set:
                yield f"part.{key}", "this study has no map"


class SpotSection(ConfigSection):
    """One spot, and what the paper prints of it, if anything."""

    size_mm: Positive
    """Size of the bonnet; the study computes it as a radius and as a diameter, as the paper does not say which."""
    rpm: Speed
    """Speed of the spindle, instead of the process's."""
    force_n: Force
    """Force, instead of the process's."""
    dip_deg: Dip
    """Dip, instead of the process's."""
    paper_depth_error_percent: NotNegative | None = None
    """What the paper prints for the depth, to stand beside."""
    paper_volume_error_percent: NotNegative | None = None
    """What it prints for the volume."""
    paper_jsd: NotNegative | None = None
    """Jensen-Shannon divergence that it prints. [1]"""


class SpotsStudy(StudyFile):
    """Spots polished at rest (paper Table III)."""

    kind: Literal["spots"]
    seconds: Positive = 60.0
    """How long each spot is polished. [s]"""
    spots: Annotated[dict[Name, SpotSection], Field(min_length=1)]
    """The spots by name, each a table `[spots.NAME]`."""


Study = CorrectionsStudy | SpotsStudy | PassesStudy | LoopStudy
KINDS: dict[str, type[Study]] = {
    "corrections": CorrectionsStudy,
    "spots": SpotsStudy,
    "passes": PassesStudy,
    "loop": LoopStudy,
}


def load_study(path: Path) -> Study:
    """Read a study's TOML; ConfigError with one line per problem: ``FILE:LINE: key: what is wrong; what to do``.

    Of one with a ``[sweep]``, `polishd.config.sweep_points.load_swept` reads all cases.
    """
    return study_of(*load_toml(path))


def study_of(raw: Mapping[str, Any], source: TomlSource) -> Study:
    """The same of a file's values, and the text that says where they stand."""
    kind = raw.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        near = did_you_mean(kind, KINDS) if isinstance(kind, str) else "."
        given = "is missing" if kind is None else f"{kind!r} is not allowed"
        raise ConfigError(source.error(("kind",), f"{given}; must be one of {join_words(KINDS)}{near}"))
    study = KINDS[kind].of(raw, source)
    unused = [source.error(tuple(key.split(".")), f"{why}; drop it") for key, why in study.without_use()]
    if unused:
        raise ConfigError("\n".join(unused))
    if isinstance(study, PartStudy):
        study.require_size()
    return study
