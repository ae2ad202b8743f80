"""Records of the steps of a cycle: one schema for the journal, its store, the run folder, and their readers.

Records have ``files`` for people (docs/reference/run-folder.md). One that a later run needs has ``facts``,
which the journal's rows hold as JSON, and is loaded from them and from the arrays of its ``.npz``.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self, TypeVar, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from polishd.hookspecs import RemovalAnswer
from polishd.model.dwell import DwellSolution, OptimalityCertificate, WarmStart
from polishd.model.errors import ConfigError
from polishd.model.estimates import UNTAUGHT, Diagnosis, Estimate, Estimates, PassIndicators
from polishd.model.program import IntArray, Plan, Program
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceStats
from polishd.model.text import printable
from polishd.model.tolerance import LineResult
from polishd.process.identification.findings import UNEXPLAINED, Forecast
from polishd.process.identification.removal_check import RemovalCheckResult
from polishd.process.metrology.conditioning import Masks
from polishd.process.metrology.resampling import Registration
from polishd.process.removal.ripple import NO_RIPPLE, Ripple, sum_ripples

# What a record is made of, arrays and facts, and both as the bytes of a file.

Arrays = Mapping[str, NDArray[Any] | float]
T = TypeVar("T")
ROWS = 4096
"""Of a table, that are written at once."""


def arrays_of(record: Any) -> dict[str, NDArray[Any]]:
    """The arrays of a dataclass, by field."""
    return {name: value for name, value in _values(record).items() if isinstance(value, np.ndarray)}


def facts_of(record: Any) -> dict[str, Any]:
    """The other fields of a dataclass as JSON values, except tuples."""
    return {
        name: asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
        for name, value in _values(record).items()
        if not isinstance(value, np.ndarray)
    }


def record_of(cls: type[T], facts: Mapping[str, Any], arrays: Mapping[str, Any] = MappingProxyType({})) -> T:
    """Restore a dataclass from ``facts_of`` and ``arrays_of``, also from JSON; ignore unknown fields.

    ConfigError where a field is missing or has another type: another polishd or plugin wrote it.
    """
    hints = get_type_hints(cls)
    try:
        found = {name: TypeAdapter(hints[name]).validate_python(fact) for name, fact in facts.items() if name in hints}
        return cls(**found, **{name: value for name, value in arrays.items() if name in hints})
    except (TypeError, ValidationError) as error:
        problem = str(error).replace("\n", " ")
        raise ConfigError(
            f"what was kept as {cls.__name__} cannot be read: {problem}; finish the job with the polishd and the "
            "plugins that wrote it, or give job.id a new name"
        ) from error


def npz(arrays: Arrays) -> bytes:
    """Named arrays as one compressed .npz."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **{key: np.asarray(value) for key, value in arrays.items()})
    return buffer.getvalue()


def table(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Return columns as CSV with a header line; floats with nine significant digits."""
    found = [np.asarray(column, dtype=np.float64) for column in columns.values()]
    row = ",".join(["%.9g"] * len(found)) + "\n"
    buffer = io.BytesIO()
    buffer.write((printable(",".join(columns)) + "\n").encode())
    for first in range(0, len(found[0]) if found else 0, ROWS):  # numbers as Python's objects a piece at a time
        numbers = np.column_stack([column[first : first + ROWS] for column in found])
        buffer.write((row * len(numbers) % tuple(numbers.ravel().tolist())).encode())
    return buffer.getvalue()


def as_json(content: Any) -> bytes:
    """Write a JSON object or a dataclass as JSON. TypeError for other values."""
    plain = asdict(content) if is_dataclass(content) and not isinstance(content, type) else content
    return (json.dumps(plain, indent=2, default=_plain) + "\n").encode()


def _values(record: Any) -> dict[str, Any]:
    return {item.name: getattr(record, item.name) for item in fields(record)}


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"not JSON: {type(value).__name__}")


CENTRED = Registration()
FIGURES = ("rms_nm", "pv_nm", "lsf_rms_nm", "band_rms_nm")
PASS_FIGURES = ("predicted_rms_nm", "dwell_s", "rate")

Stored = Mapping[str, NDArray[Any]]
"""Arrays read from a file."""


@dataclass(frozen=True, slots=True)
class MeasureResult:
    """One measurement on the process grid, with the masks that are frozen over all cycles."""

    grid: Grid
    height_nm: FloatArray
    """(ny, nx), mean over the clear aperture removed; finite inside ``solve_mask``, 0 outside."""
    solve_mask: BoolArray
    metric_mask: BoolArray
    stats: SurfaceStats
    sha256: str
    registration: Registration = CENTRED
    """Position of the part in the map."""
    spikes: int = 0
    """Number of samples that were removed as spikes."""
    notes: tuple[str, ...] = ()
    """Notes for people on the leveling, and on figures that are near their limits."""
    judged: tuple[LineResult, ...] = ()
    """Each line of the tolerance."""
    map_grid: Grid | None = None
    """The map's own samples; None: of a job of an earlier polishd."""
    system: str = ""
    """sha256 of the instrument's system map that was subtracted; empty: none."""

    @property
    def masks(self) -> Masks:
        """Frozen masks for the following maps."""
        return Masks(self.solve_mask, self.metric_mask)

    @property
    def figure_nm(self) -> float:
        """The RMS that must not grow: of the short tolerance's periods, where there are any."""
        return tolerated_nm(self.facts())

    def facts(self) -> dict[str, Any]:
        """Figures and all other fields that are no arrays."""
        judged = [one.facts() for one in self.judged]
        rest = {"spikes": self.spikes, "notes": list(self.notes), "sha256": self.sha256, "judged": judged}
        rest["system"] = self.system
        return {**asdict(self.stats), **rest, "registration": asdict(self.registration)}

    def arrays(self) -> Arrays:
        """Arrays of ``surface.npz``."""
        return {
            "height_nm": np.where(self.solve_mask, self.height_nm, np.nan),
            "solve_mask": self.solve_mask,
            "metric_mask": self.metric_mask,
            "pitch_mm": self.grid.pitch_mm,
            "lies": np.array([*self.registration.shift_mm, self.registration.rotation_deg]),
            **({} if self.map_grid is None else {"map_grid": np.array([*self.map_grid.shape, self.map_grid.pitch_mm])}),
        }

    def files(self) -> dict[str, bytes]:
        """By name: see docs/reference/run-folder.md."""
        return {"surface.npz": npz(self.arrays()), "registration.json": as_json(self.registration)}

    @classmethod
    def load(cls, arrays: Stored, facts: Mapping[str, Any], register_by: str) -> Self:
        """Restore a record from arrays and facts.

        ``register_by`` is the instrument's method: a job of an earlier polishd kept the registration as an array or
        not at all.
        """
        height = np.asarray(arrays["height_nm"], dtype=np.float64)
        x, y, turn = map(float, arrays.get("lies", np.zeros(3)))
        lies = {"registration": Registration(turn, (x, y), by=register_by)}
        return record_of(
            cls,
            {**lies, **facts, "stats": record_of(SurfaceStats, facts)},
            {
                "grid": Grid(height.shape[0], height.shape[1], float(arrays["pitch_mm"])),
                "height_nm": np.nan_to_num(height),
                "solve_mask": np.asarray(arrays["solve_mask"], dtype=np.bool_),
                "metric_mask": np.asarray(arrays["metric_mask"], dtype=np.bool_),
                "map_grid": _grid(arrays.get("map_grid")),
            },
        )


def _grid(stored: NDArray[Any] | None) -> Grid | None:
    return None if stored is None else Grid(int(stored[0]), int(stored[1]), float(stored[2]))


@dataclass(frozen=True, slots=True)
class EstimatesInUse:
    """Estimates of the removal (the model's own record) and of the machine."""

    removal: Estimates = UNTAUGHT
    block_overhead_s: float = 0.0
    """Time that a block takes beyond its motion."""
    unexplained: float = UNEXPLAINED
    """RMS of a pass's removal that no rate explains, relative to its removal."""
    ripple: float = 0.0
    """RMS that a pass leaves below the resolution of the process grid, relative to its removal."""

    @property
    def rate(self) -> float:
        """Removal rate, relative to the model's."""
        return self.removal.rate.value

    def facts(self) -> dict[str, Any]:
        """The common numbers and all estimates of the model."""
        numbers = {"rate": self.rate, "block_overhead_s": self.block_overhead_s, "unexplained": self.unexplained}
        numbers["ripple"] = self.ripple
        return {**numbers, "removal": asdict(self.removal)}

    @classmethod
    def load(cls, facts: Mapping[str, Any], initial: Estimates) -> Self:
        """Restore estimates from facts; ``initial`` has the model's type. An earlier polishd kept only two values."""
        if "removal" in facts:
            removal = record_of(type(initial), {**facts_of(initial), **facts["removal"]})
        else:
            removal = replace(initial, rate=Estimate(float(facts["rate"])))
        shares = float(facts.get("unexplained", UNEXPLAINED)), float(facts.get("ripple", 0.0))
        return cls(removal, float(facts["block_overhead_s"]), *shares)


@dataclass(frozen=True, slots=True)
class ExecutedPass:
    """A pass with the data that the learning step needs."""

    before: MeasureResult
    after: MeasureResult
    asked_s: FloatArray
    """(n,) time that was written into the program."""
    executed_s: FloatArray
    """(n,) time that each timed point had."""
    acting_s: FloatArray | None = None
    """(n,) time for the same removal at the process's own force and speed; None: the executed time."""
    predicted_rms_nm: float | None = None
    """RMS that the plan predicted; None: unknown."""
    forecast: Forecast | None = None
    """Distribution of the RMS that the map is expected to show; None: a pass of an earlier polishd."""
    again: tuple[Diagnosis, ...] | None = None
    """Diagnoses from the changes between maps since the pass; None: there was only one map."""

    @property
    def acted_s(self) -> FloatArray:
        """(n,) ``acting_s``, or the executed times where force and speed are unknown."""
        return self.executed_s if self.acting_s is None else self.acting_s


@dataclass(frozen=True, slots=True)
class LearnResult:
    """Result of the learning step, or the reason why the estimates stay."""

    believed: EstimatesInUse
    verdict: RemovalCheckResult
    grid: Grid
    found: Mapping[str, Any] | None = None
    """Details of the removal model (``EstimateUpdate.found``); None where the removal check stops."""
    notes: tuple[str, ...] = ()
    shown: PassIndicators | None = None
    """Indicators of the process; None where the removal check stops."""
    named: tuple[Diagnosis, ...] = ()
    """Diagnoses: failed assumptions of the loop."""

    @property
    def doubted(self) -> bool:
        """Estimates stay until a second map, without a pass in between, separates the effect of the pass."""
        return any(one.again for one in self.named)

    def files(self) -> dict[str, bytes]:
        """Result of the removal check with the new estimates or, where it stops, with the maps that it compared."""
        words = facts_of(self.verdict)
        words["best"]["name"] = self.verdict.best.name
        words["named"] = [{**asdict(one), "words": one.words} for one in self.named]
        files = {"gate.json": as_json(words)}
        if self.found is None:
            mask = np.isfinite(self.verdict.predicted_nm)
            maps = {**arrays_of(self.verdict), "metric_mask": mask, "pitch_mm": np.array(self.grid.pitch_mm)}
            return {**files, "gate.npz": npz(maps)}
        shown = None if self.shown is None else asdict(self.shown)
        believed = {**self.believed.facts(), "notes": self.notes}
        learned = {"beliefs": believed, **self.found, "named": words["named"], "shown": shown, "notes": self.notes}
        return {**files, "learned.json": as_json(learned)}


@dataclass(frozen=True, slots=True)
class SolveResult:
    """A dwell solution with its inputs."""

    dwell: DwellSolution
    answer: RemovalAnswer
    """Its effect stays in the process that solved (`CachedEffect`)."""
    asked_s: FloatArray
    """(n,) time to write into the program: the dwell less the block overhead."""
    expected_s: FloatArray
    """(n,) time that the machine is expected to deliver."""
    believed: EstimatesInUse
    curve: tuple[Mapping[str, Any], ...] = ()
    """Residual against time, on request: each row is a certified optimum."""

    def files(self) -> dict[str, bytes]:
        """Files that are kept also for an unused dwell."""
        curve = {"curve.json": as_json(list(self.curve))} if self.curve else {}
        return {"certificate.json": as_json(self.dwell.certificate), **curve}


@dataclass(frozen=True, slots=True)
class ProgramTurn:
    """The program of a pass, where several take turns."""

    number: int
    """Its place in `program.path`, from 1."""
    name: str
    """Name of its file."""


@dataclass(frozen=True, slots=True)
class PlanResult:
    """Record of a plan, for the learning step and the warm start of the next cycle.

    Its arrays are those of ``plan.npz``, by name; points are in the part's frame.
    """

    certificate: OptimalityCertificate
    believed: EstimatesInUse
    """Estimates that the solve used."""
    state: Stored
    """Warm start of its solver, by name."""
    block: IntArray
    """(n,) sequence number of each timed point's block."""
    time_s: FloatArray
    """(n,) solved dwell."""
    asked_s: FloatArray
    """(n,) time written into the program."""
    expected_s: FloatArray
    """(n,) time that the machine is expected to deliver."""
    lower_s: FloatArray
    """(n,) least time that motion allows."""
    compliance_um_per_n: FloatArray
    gamma: FloatArray
    start_mm: FloatArray
    end_mm: FloatArray
    predicted_removal_nm: FloatArray
    """(ny, nx) removal expected of the pass."""
    residual_nm: FloatArray
    """(ny, nx) surface expected after it."""
    curve_s: FloatArray
    curve_nm: FloatArray
    forecast: Forecast | None = None
    """Forecast for the next map; None: a pass of an earlier polishd."""
    tool: str = ""
    """Tool of the plan; empty: the cell has one tool."""
    program: ProgramTurn | None = None
    """Program of the plan; None: the tool has one."""
    figures: Mapping[str, Any] = field(default_factory=dict)
    """Figures of the plan for an operator (``PlanFigures``); empty: a pass of an earlier polishd, or not needed."""

    @classmethod
    def of(
        cls,
        plan: Plan,
        solved: SolveResult,
        part: Program,
        forecast: Forecast,
        tool: str = "",
        *,
        program: ProgramTurn | None = None,
    ) -> Self:
        """Record a plan from its solution, its program in the part's frame, its forecast, its tool and its turn."""
        dwell, answer = solved.dwell, solved.answer
        return cls(
            certificate=dwell.certificate,
            believed=solved.believed,
            state=dwell.state,
            block=part.block,
            time_s=dwell.time_s,
            asked_s=solved.asked_s,
            expected_s=plan.expected_time_s,
            lower_s=dwell.lower_s,
            compliance_um_per_n=answer.compliance_um_per_n,
            gamma=answer.gamma,
            start_mm=part.start_mm,
            end_mm=part.end_mm,
            predicted_removal_nm=plan.predicted_removal_nm,
            residual_nm=dwell.residual_nm,
            curve_s=np.array([row["total_s"] for row in solved.curve]),
            curve_nm=np.array([row["rms_nm"] for row in solved.curve]),
            forecast=replace(forecast, floor_nm=dwell.certificate.floor_nm),
            tool=tool,
            program=program,
        )

    @property
    def ripple(self) -> Ripple:
        """Ripple that the pass adds; empty: unknown."""
        return NO_RIPPLE if self.forecast is None else self.forecast.ripple

    @property
    def predicted_rms_nm(self) -> float:
        """RMS expected after the pass: of the process grid, and of the ripple that its cells average away."""
        return float(np.hypot(self.certificate.predicted_rms_nm, self.ripple.finer_nm))

    @property
    def kept(self) -> WarmStart:
        """Warm start for the next solve."""
        return WarmStart(self.time_s, self.state)

    def facts(self) -> dict[str, Any]:
        """Facts of the pass for the journal."""
        certificate = asdict(self.certificate)
        total = {"predicted_rms_nm": self.predicted_rms_nm, "dwell_s": float(self.expected_s.sum())}
        expected = None if self.forecast is None else self.forecast.facts()
        tool = {"tool": self.tool} if self.tool else {}
        turn = {} if self.program is None else {"program": asdict(self.program)}
        shown = {"plan_figures": dict(self.figures)} if self.figures else {}
        known = {"certificate": certificate, **total, "forecast": expected}
        return {**known, **tool, **turn, **shown, **self.believed.facts()}

    def start(self) -> Arrays:
        """A separate file of the store, small compared with the plan's."""
        return {"time_s": self.time_s, **self.state}

    def files(self) -> dict[str, bytes]:
        """By name: see docs/reference/run-folder.md. A block is the line before the one of its number."""
        columns = {
            "point": np.arange(self.block.size),
            "line": self.block + 1,
            "x_mm": self.end_mm[:, 0],
            "y_mm": self.end_mm[:, 1],
            "dwell_s": self.time_s,
            "asked_s": self.asked_s,
            "expected_s": self.expected_s,
        }
        return {"plan.npz": npz(arrays_of(self)), "dwell.csv": table(columns)}

    @classmethod
    def load(cls, arrays: Stored, start: Stored, facts: Mapping[str, Any], initial: Estimates) -> Self:
        """Restore a plan from ``plan.npz``, the file of ``start``, and the facts of its pass."""
        state = {name: value for name, value in start.items() if name != "time_s"}
        rest = {"certificate": record_of(OptimalityCertificate, facts["certificate"]), "state": state}
        expected = facts.get("forecast")
        rest["forecast"] = None if expected is None else record_of(Forecast, expected)
        rest["tool"] = facts.get("tool", "")
        turn = facts.get("program")
        rest["program"] = None if turn is None else record_of(ProgramTurn, turn)
        rest["figures"] = facts.get("plan_figures", {})
        return record_of(cls, {}, {**arrays, **rest, "believed": EstimatesInUse.load(facts, initial)})


def made_ripple(passes: Iterable[Mapping[str, Any]]) -> Ripple:
    """Return the ripple of passes that were made, from their facts; an interrupted pass counts as a whole one."""
    made = list(passes)
    found = [record_of(Ripple, (facts.get("forecast") or {}).get("ripple") or {}) for facts in made]
    tools = {facts.get("tool") for facts in made}
    if len(tools) > 1:  # where the spot of one leaves crests, that of another may leave valleys
        found = [one.without_phase() for one in found]
    return sum_ripples(found)


def tolerated_nm(facts: Mapping[str, Any]) -> float:
    """Of a measurement's facts the RMS that may not get worse: of the short tolerance's periods, where it has any."""
    return float(facts["rms_nm"] if facts["band_rms_nm"] is None else facts["band_rms_nm"])


def figures(measured: Mapping[str, Any], planned: Mapping[str, Any] | None) -> dict[str, Any]:
    """Of the facts of both, what a summary's entry says; None for a pass that never was."""
    forecast = (planned or {}).get("forecast") or {}
    return {
        **{key: measured[key] for key in FIGURES},
        "judged": measured.get("judged", []),
        "system": measured.get("system", ""),
        **{key: None if planned is None else float(planned[key]) for key in PASS_FIGURES},
        **{f"expected_{end}_nm": forecast.get(f"{end}_nm") for end in ("low", "high")},
        "ripple": forecast.get("ripple", {}).get("lines", []),
    }
