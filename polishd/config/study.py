"""A study's file: TOML into frozen models; each error names file, line and key, as for a cell's file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

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
    as_tuple,
)
from polishd.config.process_sections import PartDocument, ProcessDocument
from polishd.config.toml_loader import TomlDocument, TomlSource, did_you_mean, join_words, load_toml
from polishd.model.errors import ConfigError
from polishd.model.outline import Outline

PathShape = Literal["raster", "spiral", "concentric", "random", "adaptive"]
"""Paths that polishd makes."""

# A study of whole jobs against simulated plants, and its scenarios.

Taken = Literal["rate", "spot", "touch"]
"""Estimates that a loop takes over from a witness part: the volume rate of a spot, rate and shape of a spot, or all
estimates of a first touch (`polishd calibrate first-touch`)."""
Poses = tuple[tuple[float, float, float], ...]
"""(angle_deg, x_mm, y_mm) of the part in maps: counter-clockwise as displayed, then further right and up."""
_POSES: TypeAdapter[list[tuple[float] | tuple[float, float, float]]] = TypeAdapter(
    list[tuple[float] | tuple[float, float, float]], config=ConfigDict(allow_inf_nan=False)
)
AS_IT_IS = "nothing"
"""The scenario of a plant without changes."""


class Scenario(TomlDocument):
    """A fault of a plant: sections of SIM.toml that are laid over the study's."""

    what: Text
    """Description of the fault."""
    named: Texts = ()
    """Correct diagnoses, of which the loop must report at least one: causes, or kinds of findings. None: it must report
    nothing."""
    also: Texts = ()
    """Other diagnoses that the loop may report."""
    plant: Mapping[str, Mapping[str, Any]] = {}
    """Changed keys, by section of SIM.toml: `[plant.effects]`."""


class LoopStudy(TomlDocument):
    """Jobs in a closed loop: measure, solve, execute on a plant with its errors, and estimate."""

    kind: Literal["loop"]
    title: Text
    """Title of tables and pictures."""
    cell: Text = "cell.toml"
    """The cell's file: part, program, process, tolerance."""
    cell_with: Mapping[str, Any] = {}
    """Changes of the cell's file for all loops: values by dotted key."""
    plant: Text = "sim.toml"
    """The plant's file, as the simulator reads it."""
    plant_with: Mapping[str, Mapping[str, Any]] = {}
    """Changed keys for all scenarios, by section of SIM.toml: `[plant_with.plant]`."""
    scenarios: Texts = ()
    """Files of scenarios, or folders of such files. None: the plant without changes."""
    controllers: Annotated[Mapping[Name, Mapping[str, Any]], Field(min_length=1)]
    """Changes of the cell's file by loop: values by dotted key. Further keys: `witness = "rate"` or `"spot"` starts the
    loop with the estimate from a spot that the same machine polished on another part, `"touch"` with the estimates of
    a first touch there (`polishd calibrate first-touch`). `poses` are poses of the part (angle_deg, x_mm, y_mm) in maps
    before the first pass, which measure the instrument's error. `learns = false` compares estimates without using
    them."""
    seeds: Annotated[int, Field(ge=1, le=10_000)] = 20
    """Number of plants for each scenario and loop. All loops have the same plants. [1]"""
    first_seed: Annotated[int, Field(ge=0)] = 1
    """The first seed. [1]"""
    raster: bool = False
    """Use a new raster over the part, as `polishd demo`, instead of the cell's program."""
    passes: Annotated[int, Field(ge=1, le=100)] = 6
    """Largest number of passes of a job, instead of the cell's. [1]"""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Yield nothing: this study uses all keys."""
        yield from ()

    def loop(self, name: str) -> tuple[dict[str, Any], Taken | None, Poses, bool]:
        """Return a loop's changes of the cell's file, its witness, poses and ``learns``; raise ConfigError."""
        keys = {**self.cell_with, **self.controllers[name]}
        learns = keys.pop("learns", True)
        if not isinstance(learns, bool):
            raise self.error(f"controllers.{name}.learns", f"must be true or false, not {learns!r}")
        witness = keys.pop("witness", None)
        if witness not in {None, *get_args(Taken)}:
            raise self.error(
                f"controllers.{name}.witness", f'{witness!r} is not allowed; must be "rate", "spot" or "touch"'
            )
        try:
            poses = _POSES.validate_python(keys.pop("poses", []))
        except ValidationError:
            problem = "must be a list of [angle_deg, x_mm, y_mm], or [angle_deg] without a shift"
            raise self.error(f"controllers.{name}.poses", problem) from None
        return keys, witness, tuple((angle, *(shift or (0.0, 0.0))) for angle, *shift in poses), learns

    def file_of(self, key: Literal["cell", "plant"]) -> Path:
        """Return that file's path; raise ConfigError at its key if the file does not exist."""
        return self._there(key, self.cell if key == "cell" else self.plant)

    def _there(self, key: str, given: str) -> Path:
        path = self.resolve(given)
        if not path.exists():
            raise self.error(key, f"{path}: no such file; name an existing one")
        return path

    def all_scenarios(self) -> dict[str, Scenario]:
        """Return the scenarios by name; raise ConfigError for one that is wrong or missing."""
        found = {}
        for given in self.scenarios:
            path = self._there("scenarios", given)
            files = sorted(path.glob("*.toml")) if path.is_dir() else [path]
            if not files:
                raise self.error("scenarios", f"{given}: this folder has no .toml file; name one with scenarios")
            found.update({file.stem: load_scenario(file) for file in files})
        return found or {AS_IT_IS: Scenario(what="the plant without changes")}


def load_scenario(path: Path) -> Scenario:
    """Read a scenario's file; raise ConfigError with file, line and key."""
    return Scenario.of(*load_toml(path))


MOST_SAMPLES = 1_000_000
"""Largest number of samples, and of dwell points, of a study; more may exceed the memory."""


class SurfaceSection(ConfigSection):
    """The surface at the start: random from a seed, or a measured map."""

    file: Text | None = None
    """A measured map, read as a cell's, instead of `rms_nm` and `period_mm`."""
    rms_nm: Positive | None = None
    """RMS of a random surface in the clear aperture."""
    period_mm: Range | None = None
    """Shortest and longest period of a random surface."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of a random surface. The same seed gives the same surface. [1]"""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        drawn = self.rms_nm is not None and self.period_mm is not None
        if self.file is not None and (self.rms_nm is not None or self.period_mm is not None):
            raise ValueError("file: cannot be combined with rms_nm and period_mm; remove these, or the file")
        if self.file is None and not drawn:
            raise ValueError("rms_nm: a random surface needs rms_nm and period_mm = [low, high]; add them, or a file")
        if self.period_mm is not None and self.period_mm[0] <= 0:
            raise ValueError("period_mm: must be above 0; give the shortest and the longest period")
        return self


class PathSection(ConfigSection):
    """Dwell points at rest on a square lattice, over the aperture and an extension beyond it."""

    step_mm: Annotated[float, Field(gt=0, le=20)] = 1.0
    """Distance between dwell points."""
    extension_mm: Annotated[float, Field(ge=0, le=100)] = 2.0
    """Extension of the dwell points beyond the aperture."""


class SolveSection(ConfigSection):
    """Solution of the dwell: eq. 50 with ``t >= 0``."""

    regularisation_nm2_s2: NotNegative = 1e-9
    """P of eq. 50: weight of the squared dwell."""
    unreachable: ShareOrNone = 0.005
    """Share of the samples for which the mean removal may be too small. [1]"""
    kkt_tolerance: Share = 1e-5
    """KKT residual at which the solver stops. [1]"""
    cpu_limit_s: Seconds = 60.0
    """CPU seconds of each solve, which then returns its best result."""


class StudyFile(ProcessDocument):
    """Base of all studies."""

    title: Text
    """Title of tables and pictures."""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Yield (dotted key, reason) of keys in the file that this kind of study does not use."""
        for key in ("removal_model", "correction", "tif"):
            if key in self.process.model_fields_set:
                yield f"process.{key}", "a study uses its own corrections and the modeled spot"


class PartStudy(StudyFile, PartDocument):
    """Base of studies over a part: the part, its pose, the robot and the path."""

    path: PathSection = PathSection()

    def require_size(self) -> None:
        """Raise ConfigError if the study has too many dwell points or samples."""
        pitch = min(self.path.step_mm, self.process.grid_mm)
        wide, high = (2 * (half + self.path.extension_mm) / pitch for half in self.outline().half_mm)
        if wide * high > MOST_SAMPLES:
            problem = f"{wide * high:.3g} dwell points or samples; at most {MOST_SAMPLES:.0e} can be computed"
            raise self.error("path", problem)

    def free_rim(self) -> Outline | None:
        """Return the part's outline if its edge is free; None if the part sits in a flush ring."""
        return self.outline() if self.part.free_edge else None


class CorrectionsStudy(PartStudy):
    """Each correction on two plants (paper section IV-D)."""

    kind: Literal["corrections"]
    surface: SurfaceSection
    solve: SolveSection = SolveSection()
    lsf_period_mm: Positive = 33.0
    """Period above which `band_rms_nm` counts."""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Yield unused keys: also the desired form, if the surface is random."""
        yield from super().without_use()
        if self.surface.file is None and self.part.form is not None:
            yield "part.form", "a random surface is the error already, without the form"


class PassesStudy(PartStudy):
    """Passes of equal dwell (paper fig. 12)."""

    kind: Literal["passes"]
    passes: Annotated[int, Field(ge=1, le=1000)] = 10
    """Number of passes. [1]"""
    dwell_s: Positive = 0.01
    """Dwell at each point in each pass."""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Yield unused keys: also those about maps."""
        yield from super().without_use()
        for key in ("form", "alignment"):
            if key in self.part.model_fields_set:
                yield f"part.{key}", "this study has no map"


class FeedSection(ConfigSection):
    """Feeds and acceleration of the machine."""

    max_feed_mm_s: Positive = 50.0
    """Highest feed."""
    min_feed_mm_s: Positive = 0.5
    """Lowest feed."""
    accel_mm_s2: Positive = 800.0
    """Acceleration. The smallest radius of a bent path is that of the highest feed with this across the path."""

    @model_validator(mode="after")
    def _feeds_ordered(self) -> Self:
        if self.min_feed_mm_s >= self.max_feed_mm_s:
            raise ValueError("min_feed_mm_s: must be less than max_feed_mm_s; exchange or correct them")
        return self


class PathFamilySection(ConfigSection):
    """A path over the part, as of `polishd program make`."""

    shape: PathShape
    """Its shape."""
    pitch_mm: Positive
    """Distance of lines or turns."""
    direction_deg: float = 0.0
    """Direction of the first line."""
    cross_deg: float | None = None
    """Of `raster`: angle to a second raster of the same pass."""
    phases: Annotated[tuple[float, ...], BeforeValidator(as_tuple), Field(min_length=1, max_length=8)] = (0.0,)
    """A pass each, with its lines shifted by this share of the pitch; they share the removal. [1]"""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of `random`: the seed. [1]"""
    follows_removal: bool = False
    """Of `random`: lines lie denser where more is to be removed, as those of `adaptive` do."""


RadiusError = Annotated[float, Field(gt=-0.5, lt=0.5)]


class PathsStudy(PartStudy):
    """Families of paths against spots, lines and lags that differ from the model."""

    kind: Literal["paths"]
    surface: SurfaceSection
    solve: SolveSection = SolveSection()
    machine: FeedSection = FeedSection()
    families: Annotated[dict[Name, PathFamilySection], Field(min_length=1)]
    """The paths by name, each a table `[families.NAME]`. Rows are compared with the first one."""
    radius_errors: Annotated[tuple[RadiusError, ...], BeforeValidator(as_tuple), Field(min_length=1)] = (0.0, 0.03)
    """Errors of the true spot's radius, as shares of it: a row each. [1]"""
    lag_s: NotNegative = 0.02
    """Time constant with which the tool follows the path in a separate row; 0: no such row."""
    line_noise_um: NotNegative = 30.0
    """RMS of the tool's distance from the path, across and along, in a separate row; 0: no such row. [um]"""
    msf_period_mm: Range = (0.3, 3.0)
    """Periods of `msf_nm`; longer ones are low orders."""
    cell_mm: Positive = 0.1
    """Cells on which the true removal is summed: about a twentieth of the spot's radius."""

    def without_use(self) -> Iterator[tuple[str, str]]:
        """Yield unused keys: also the desired form, if the surface is random."""
        yield from super().without_use()
        if self.surface.file is None and self.part.form is not None:
            yield "part.form", "a random surface is the error already, without the form"

    def require_size(self) -> None:
        """Raise ConfigError if the study has too many samples, or a band of periods that its cells do not show."""
        super().require_size()
        wide, high = (2 * half / self.cell_mm for half in self.outline().half_mm)
        if wide * high > MOST_SAMPLES:
            raise self.error("cell_mm", f"{wide * high:.3g} cells; at most {MOST_SAMPLES:.0e} can be computed")
        if not 2 * self.cell_mm < self.msf_period_mm[0] < self.msf_period_mm[1]:
            problem = f"must rise from above two cells, {2 * self.cell_mm:g} mm; set a longer period or smaller cells"
            raise self.error("msf_period_mm", problem)


class SpotSection(ConfigSection):
    """One spot, and its values in the paper, if any."""

    size_mm: Positive
    """Size of the bonnet. The study computes it as a radius and as a diameter, because the paper leaves it open."""
    rpm: Speed
    """Speed of the spindle, instead of the process's."""
    force_n: Force
    """Force, instead of the process's."""
    dip_deg: Dip
    """Dip, instead of the process's."""
    paper_depth_error_percent: NotNegative | None = None
    """The paper's value for the depth, for comparison."""
    paper_volume_error_percent: NotNegative | None = None
    """The paper's value for the volume."""
    paper_jsd: NotNegative | None = None
    """The paper's Jensen-Shannon divergence. [1]"""


class SpotsStudy(StudyFile):
    """Spots polished at rest (paper Table III)."""

    kind: Literal["spots"]
    seconds: Positive = 60.0
    """Polishing time of each spot. [s]"""
    spots: Annotated[dict[Name, SpotSection], Field(min_length=1)]
    """The spots by name, each a table `[spots.NAME]`."""


Study = CorrectionsStudy | SpotsStudy | PassesStudy | PathsStudy | LoopStudy
KINDS: dict[str, type[Study]] = {
    "corrections": CorrectionsStudy,
    "spots": SpotsStudy,
    "passes": PassesStudy,
    "paths": PathsStudy,
    "loop": LoopStudy,
}


def load_study(path: Path) -> Study:
    """Read a study's file; raise ConfigError with one line per problem: ``FILE:LINE: key: problem; what to do``.

    For a file with a ``[sweep]``, `polishd.config.sweep.load_swept` reads all cases.
    """
    return study_of(*load_toml(path))


def study_of(raw: Mapping[str, Any], source: TomlSource) -> Study:
    """Validate a study's values, as ``load_study``."""
    kind = raw.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        near = did_you_mean(kind, KINDS) if isinstance(kind, str) else "."
        given = "is missing" if kind is None else f"{kind!r} is not allowed"
        raise ConfigError(source.error(("kind",), f"{given}; set one of {join_words(KINDS)}{near}"))
    study = KINDS[kind].of(raw, source)
    unused = [source.error(tuple(key.split(".")), f"{why}; remove it") for key, why in study.without_use()]
    if unused:
        raise ConfigError("\n".join(unused))
    if isinstance(study, PartStudy):
        study.require_size()
    return study
