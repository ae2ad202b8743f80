"""Surface maps and the grids they live on."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

# How a map that polishd made came about: which verb, from which files; kept inside the map's own file.

MOST_DEPTH = 50
"""Steps one after the other."""
MOST_CHARACTERS = 2**20
SYSTEM_ERROR = "system error"
"""Role of the instrument's own error among the inputs of a step."""


@dataclass(frozen=True, slots=True)
class MapInput:
    """A map that went into another."""

    role: str
    """Role in the verb: "map", "system error", "left out", ..."""
    name: str
    """Name of its file, without folders."""
    sha256: str
    """Hash of its file's bytes."""
    history: MapStep | None = None
    """Processing step that made it; None: written by an instrument or another program."""


@dataclass(frozen=True, slots=True)
class MapStep:
    """The last thing that was done to a map; what was done before is the history of its inputs."""

    verb: str
    """Name of the ``polishd map`` verb."""
    version: str
    """Version of polishd."""
    options: Mapping[str, Any]
    """Options besides the maps, as JSON values."""
    inputs: tuple[MapInput, ...]
    uncertainty_nm: float | None = None
    """Standard deviation of a sample of the result, the median over the map; None: unknown."""

    @property
    def depth(self) -> int:
        """Number of successive steps."""
        return 1 + max((one.history.depth for one in self.inputs if one.history is not None), default=0)

    @property
    def steps(self) -> Iterator[MapStep]:
        """This one and all before it, of whatever input."""
        yield self
        for one in self.inputs:
            if one.history is not None:
                yield from one.history.steps

    @property
    def profiled(self) -> bool:
        """Return whether an instrument's profile was applied to it or to all its inputs."""
        before = [one.history is not None and one.history.profiled for one in self.inputs]
        return "profile" in self.options or (bool(before) and all(before))

    @property
    def less_system(self) -> bool:
        """Return whether the instrument's error was subtracted from it or from all inputs, or it is that error."""
        before = [one.history is not None and one.history.less_system for one in self.inputs]
        own = {"system", "result"} & set(self.options) or any(one.role == SYSTEM_ERROR for one in self.inputs)
        return bool(own) or (bool(before) and all(before))

    def to_json(self) -> str:
        """One line of ASCII, which every format can hold; ValueError where it is beyond what is read back."""
        if self.depth > MOST_DEPTH:
            raise ValueError(f"{self.depth} steps follow one another, more than {MOST_DEPTH}")
        text = json.dumps(asdict(self), allow_nan=False, separators=(",", ":"))
        if len(text) > MOST_CHARACTERS:
            raise ValueError(f"it takes {len(text)} characters, more than {MOST_CHARACTERS}")
        return text

    @classmethod
    def from_json(cls, text: str) -> MapStep:
        """Read the output of ``to_json``; ValueError for anything else."""
        from pydantic import TypeAdapter  # which the simulators, and most maps, can do without

        if len(text) > MOST_CHARACTERS:
            raise ValueError(f"it takes {len(text)} characters, more than {MOST_CHARACTERS}")
        step: MapStep = TypeAdapter(cls).validate_json(text)
        if step.depth > MOST_DEPTH:
            raise ValueError(f"{step.depth} steps follow one another, more than {MOST_DEPTH}")
        return step


FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
DateFrom = Literal["header", "file system", "guessed"]
"""Source of a map's date: its header, the file system, or a guess (the header has no plausible date)."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A regular grid in the part's frame, centred on the part's origin, row 0 at the top (largest y).

    ``ny`` rows, ``nx`` columns, square ``pitch_mm``; sample (row, col) is the centre of its cell.
    """

    ny: int
    nx: int
    pitch_mm: float

    @property
    def shape(self) -> tuple[int, int]:
        """``(ny, nx)``."""
        return (self.ny, self.nx)

    @property
    def x_mm(self) -> FloatArray:
        """Column coordinates, (nx,), ascending."""
        return np.asarray((np.arange(self.nx) - (self.nx - 1) / 2) * self.pitch_mm, dtype=np.float64)

    @property
    def y_mm(self) -> FloatArray:
        """Row coordinates, (ny,), descending: row 0 is the top."""
        return np.asarray(((self.ny - 1) / 2 - np.arange(self.ny)) * self.pitch_mm, dtype=np.float64)

    @property
    def axes_mm(self) -> tuple[FloatArray, FloatArray]:
        """Coordinates as a row (1, nx) and a column (ny, 1)."""
        return self.x_mm[None, :], self.y_mm[:, None]

    def radius_mm(self) -> FloatArray:
        """Distance of each sample from the origin, (ny, nx)."""
        return np.hypot(self.x_mm[None, :], self.y_mm[:, None])


class MaskCount(NamedTuple):
    """A mask that was laid over a map by hand, and what it holds of it."""

    mask: str
    """Path as given."""
    samples: int
    """With data that lie in it."""
    of: int
    """Samples with data that the map had."""


IN_UNITS = "pitches_in_its_unit"
"""Key in a map's ``factors``: pitches in x and y in a lateral unit that the file does not state."""


@dataclass(frozen=True, slots=True)
class SurfaceMap:
    """One interferometer map: surface (not wavefront) height, positive = high, NaN = no data.

    ``height_nm`` is (ny, nx), row 0 the top as displayed, x right, y up. ``pitch_mm`` is None where the file
    has no lateral scale; such a map can be shown, but not drive polishing.
    ``factors`` records each sign, scale and unit factor that the reader applied, once.
    ``unsaid`` names what the file does not say and the instrument's profile must, before the map may drive polishing:
    "pitch", "unit" (of heights: they are shown as if nm), "surface" (it may be a wavefront), "orientation".
    """

    height_nm: FloatArray
    pitch_mm: float | None
    part_id: str = ""
    instrument: str = ""
    taken_at: datetime | None = None
    """Best known date of the measurement; ``measured_at`` where ``date_from`` is the header."""
    date_from: DateFrom = "header"
    sha256: str = ""
    path: Path | None = None
    format: str = ""
    factors: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    unsaid: frozenset[str] = frozenset()
    doubts: Mapping[str, str] = field(default_factory=dict)
    """By a name in ``unsaid``: the warning that holds until it is answered."""
    orientation: str = "row 0 at the top, as displayed"
    """Turn of the file's sample order into this one."""
    fiducials_px: tuple[tuple[float, float], ...] = ()
    """(row, column) of the marks that the file lists, in this array's own pixels."""
    reader_version: int = 0
    pitches_mm: tuple[float, float] | None = None
    """Width and height of a pixel that is not square; ``pitch_mm`` is None then, until the map is resampled."""
    masks: tuple[MaskCount, ...] = ()
    """Masks of the operator; a sample outside any of them has no data."""
    history: MapStep | None = None
    """Processing by polishd; None: measured directly, or unknown."""

    @property
    def grid(self) -> Grid:
        """The map's own grid; raises ValueError where the file has no lateral scale."""
        if self.pitch_mm is None:
            raise ValueError("this map has no lateral scale (pitch_mm is None)")
        ny, nx = self.height_nm.shape
        return Grid(ny, nx, self.pitch_mm)

    @property
    def unscaled_pitches(self) -> tuple[float, float] | None:
        """Width and height of a pixel in a unit that the file does not state; None where it has a scale, or no such."""
        if self.pitch_mm is not None or self.pitches_mm is not None or IN_UNITS not in self.factors:
            return None
        wide, high = self.factors[IN_UNITS]
        return wide, high

    @property
    def measured_at(self) -> datetime | None:
        """When its header says that it was measured, UTC where that names no zone; None where no header says it."""
        at = self.taken_at if self.date_from == "header" else None
        return at.replace(tzinfo=UTC) if at is not None and at.tzinfo is None else at

    @property
    def valid(self) -> BoolArray:
        """True where there is data, (ny, nx)."""
        return np.isfinite(self.height_nm)

    def with_height(self, height_nm: FloatArray) -> SurfaceMap:
        """Return the measurement with other heights."""
        return replace(self, height_nm=height_nm)


@dataclass(frozen=True, slots=True)
class SurfaceStats:
    """Figures of a surface over a stated mask, mean removed; nm."""

    rms_nm: float
    pv_nm: float
    lsf_rms_nm: float
    band_rms_nm: float | None = None
    """RMS of the periods above the job's tolerance period; None where the whole surface counts."""
    samples: int = 0
