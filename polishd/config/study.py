"""A study's file: TOML into frozen models, each error with its file, line and key, as a cell's configuration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from polishd.config.fields import (
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
    Texts,
)
from polishd.config.process_sections import PartDocument, ProcessDocument
from polishd.config.toml_loader import TomlDocument, TomlSource, did_you_mean, join_words, load_toml
from polishd.model.errors import ConfigError
from polishd.model.outline import Outline

# A study of whole jobs against simulated plants, and the files of what may be wrong with one.

Taken = Literal["rate", "spot", "touch"]
"""What a loop takes over from a witness part: a spot's volume rate alone, or its shape with it, or all that a first
touch teaches (`polishd calibrate first-touch`)."""
Poses = tuple[tuple[float, float, float], ...]
"""(angle_deg, x_mm, y_mm) of the part in maps: counter-clockwise as displayed, then further right and up."""
_POSES: TypeAdapter[list[tuple[float] | tuple[float, float, float]]] = TypeAdapter(
    list[tuple[float] | tuple[float, float, float]], config=ConfigDict(allow_inf_nan=False)
)
AS_IT_IS = "nothing"
"""The scenario of a plant as its file has it."""


class Scenario(TomlDocument):
    """What is wrong with a plant: sections of SIM.toml that are laid over the study's."""

    what: Text
    """What is wrong, in words."""
    named: Texts = ()
    """What the loop may rightly say of it, and must say some of: causes, or kinds of findings; none: nothing."""
    also: Texts = ()
    """What it may say besides, and need not."""
    plant: Mapping[str, Mapping[str, Any]] = {}
    """By section of SIM.toml, the keys that differ: `[plant.effects]`."""


class LoopStudy(TomlDocument):
    """Jobs in a closed loop: measured, solved, executed by a plant with its errors, and learned from."""

    kind: Literal["loop"]
    title: Text
    """What the tables and pictures are headed with."""
    cell: Text = "cell.toml"
    """The cell's file: part, program, process, tolerance."""
    cell_with: Mapping[str, Any] = {}
    """What all loops have otherwise than that file: values by dotted key."""
    plant: Text = "sim.toml"
    """The plant's, as the simulator reads it."""
    plant_with: Mapping[str, Mapping[str, Any]] = {}
    """By section of SIM.toml, the keys that differ in all scenarios: `[plant_with.plant]`."""
    scenarios: Texts = ()
    """Files of scenarios, or folders of them; none: the plant as its file has it."""
    controllers: Annotated[Mapping[Name, Mapping[str, Any]], Field(min_length=1)]
    """By name, what that loop has otherwise than the cell's file: values by dotted key. And `witness = "rate"`
    or `"spot"`: what it begins with of a spot that the same machine has polished on another part; `"touch"`: it
    begins with what the first touch of `polishd calibrate first-touch` has taught there. `poses`: how the part lies
    (angle_deg, x_mm, y_mm) in maps before the first pass, which tell the instrument's own error. `learns = false`:
    what its passes teach is judged, and not taken over."""
    seeds: Annotated[int, Field(ge=1, le=10_000)] = 20
    """How many plants a scenario and loop; all loops meet the same ones. [1]"""
    first_seed: Annotated[int, Field(ge=0)] = 1
    """The first of them. [1]"""
    raster: bool = False
    """Take a raster of one's own over the part, as `polishd demo` does, instead of the cell's program."""
    passes: Annotated[int, Field(ge=1, le=100)] = 6
    """Most passes of a job, instead of the cell's. [1]"""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Nothing is."""
        yield from ()

    def loop(self, name: str) -> tuple[dict[str, Any], Taken | None, Poses, bool]:
        """What it has otherwise than the cell's file by dotted key, its witness, poses and ``learns``; ConfigError."""
        keys = {**self.cell_with, **self.controllers[name]}
        learns = keys.pop("learns", True)
        if not isinstance(learns, bool):
            raise self.error(f"controllers.{name}.learns", f"must be true or false, not {learns!r}; mend it")
        witness = keys.pop("witness", None)
        if witness not in {None, *get_args(Taken)}:
            raise self.error(
                f"controllers.{name}.witness", f'{witness!r} is nothing to begin with; it is "rate", "spot" or "touch"'
            )
        try:
            poses = _POSES.validate_python(keys.pop("poses", []))
        except ValidationError:
            wanted = "a list of [angle_deg, x_mm, y_mm]: the last two left out, the part is not shifted"
            raise self.error(f"controllers.{name}.poses", f"is not {wanted}") from None
        return keys, witness, tuple((angle, *(shift or (0.0, 0.0))) for angle, *shift in poses), learns

    def file_of(self, key: Literal["cell", "plant"]) -> Path:
        """That file; ConfigError with the place of its key where it is not there."""
        return self._there(key, self.cell if key == "cell" else self.plant)

    def _there(self, key: str, given: str) -> Path:
        path = self.resolve(given)
        if not path.exists():
            raise self.error(key, f"{path}: no such file; name one that is there")
        return path

    def all_scenarios(self) -> dict[str, Scenario]:
        """By name, those of its files and folders; ConfigError for one that is wrong, or not there."""
        found = {}
        for given in self.scenarios:
            path = self._there("scenarios", given)
            files = sorted(path.glob("*.toml")) if path.is_dir() else [path]
            if not files:
                raise self.error("scenarios", f"{given}: no .toml file is in this folder; name one that has scenarios")
            found.update({file.stem: load_scenario(file) for file in files})
        return found or {AS_IT_IS: Scenario(what="the plant as its file has it")}


def load_scenario(path: Path) -> Scenario:
    """One scenario's file; ConfigError with file, line and key."""
    return Scenario.of(*load_toml(path))


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
    unreachable: ShareOrNone = 0.005
    """Share of the samples for which the mean removal may be too little. [1]"""
    kkt_tolerance: Share = 1e-5
    """KKT residual to stop at. [1]"""
    cpu_limit_s: Seconds = 60.0
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
        return self.outline() if self.part.free_edge else None


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
        if self.surface.file is None and self.part.form is not None:
            yield "part.form", "a drawn surface is the error already, less the form wanted"


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
        for key in ("form", "alignment"):
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

    Of one with a ``[sweep]``, `polishd.config.sweep.load_swept` reads all cases.
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
