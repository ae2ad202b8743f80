"""One job in a closed loop without links: the recipe's own steps, and a plant with errors as the machine."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from polishd.commissioning.calibration.first_touch import as_touched, plan_touch
from polishd.config.cell import CellConfig, load_config
from polishd.config.study import Poses, Taken
from polishd.hookspecs import RemovalAnswer, RemovalModel, RemovalRequest
from polishd.model.errors import ComputeError, PlanRefused, PolishdError
from polishd.model.estimates import Diagnosis, Estimate, Finding, PassIndicators, PassSeries
from polishd.model.process import MeasuredTif
from polishd.model.program import Plan, Program
from polishd.model.states import Outcome
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.model.tolerance import part_holds
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.acceptance import forecast_of
from polishd.pipeline.build_recipe import make_recipe
from polishd.pipeline.decisions import (
    Accept,
    AnotherPass,
    Diverge,
    PassesUsed,
    Stalled,
    ToolWorn,
    decide,
    small_gain_finding,
)
from polishd.pipeline.dwell_step import require_certificate
from polishd.pipeline.precheck import read_programs
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import (
    EstimatesInUse,
    ExecutedPass,
    LearnResult,
    MeasureResult,
    PlanResult,
    ProgramTurn,
    SolveResult,
)
from polishd.plugin_loader import Hooks, plugins_of
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import read
from polishd.process.identification import residual_diagnosis
from polishd.process.identification.experiment_design import WANTED
from polishd.process.identification.findings import extend_series, findings
from polishd.process.metrology.absolute_poses import PartPose
from polishd.process.metrology.absolute_test import AbsoluteTestResult, SystemMap, separate_instrument
from polishd.process.metrology.instrument import apply_profile
from polishd.process.metrology.spectra import split_bands
from polishd.process.removal.contact import relative_removal
from polishd.process.removal.dynamic_tif import lean_azimuth_rad
from polishd.process.removal.measured_tif import tif_from_maps, volume_mm3_min
from polishd.process.removal.ripple import Ripple, sum_ripples
from polishd.process.robot import motion
from polishd.programs.make import own_program
from polishd.studies.plant_client import PlantProcess

# The instrument's error in a loop: the part is turned and shifted before its first pass to measure it.

WHOLE = 1e-6
"""Tolerance of a shift, parts of a sample: the plant moves a part by whole samples."""


def with_absolute_test(recipe: Recipe, plant: PlantProcess, poses: Poses) -> Recipe:
    """Return the recipe with the system map from those poses. MapError, ComputeError."""
    lay = [PartPose(*pose) for pose in poses]
    maps = [_measured(recipe, plant, pose) for pose in lay]
    pitch_mm = maps[0].grid.pitch_mm
    found = separate_instrument([one.height_nm for one in maps], lay, pitch_mm)
    instrument = maps[0].with_height(found.instrument_nm)
    return replace(recipe, system=SystemMap(instrument, AbsoluteTestResult.of(found)))


def with_certified_map(recipe: Recipe) -> Recipe:
    """The map treatment for the true part: without an instrument and the terms that the certificate removes."""
    without = recipe.accept == "bound_without_power"
    part = recipe.part.model_copy(update={"alignment": "power"}) if without else recipe.part
    job = recipe.job.model_copy(update={"accept_by": "figure"})
    return replace(recipe, part=part, job=job, instrument=None, system=None)


def _measured(recipe: Recipe, plant: PlantProcess, pose: PartPose) -> SurfaceMap:
    pitch_mm = float(plant.truth()[0]["pitch_mm"])
    shift = (pose.x_mm / pitch_mm, pose.y_mm / pitch_mm)
    if any(abs(one - round(one)) > WHOLE for one in shift):
        raise ComputeError(f"the pose {pose}: a simulated part is shifted by whole samples of {pitch_mm:g} mm")
    height, _ = plant.measure(angle_deg=pose.angle_deg, shift_px=(round(shift[0]), round(shift[1])))
    return apply_profile(SurfaceMap(height, pitch_mm), recipe.instrument)


# A spot on a witness part: a shop measures its tool with it before it polishes the first part.

Measure = Callable[[], SurfaceMap]
"""The witness part, as the instrument measures it."""
DEPTH_NM = 300.0
"""Nominal depth of the spot: a thousand times an interferometer's noise."""


@dataclass(frozen=True, slots=True)
class WitnessSpot:
    """A spot that was polished at rest at one point of a program, and its removal."""

    point: Program
    """That point alone."""
    tif: MeasuredTif

    def rate(self, recipe: Recipe) -> EstimatesInUse:
        """Return the estimate with which the recipe's model removes the volume of this spot."""
        first = steps.initial_estimates(recipe)
        modelled = float(_modelled_nm_s(recipe, self.point).sum()) * recipe.grid_mm**2 * 60e-6  # mm^3/min
        rate = Estimate(volume_mm3_min(self.tif) / modelled)
        return replace(first, removal=replace(first.removal, rate=rate))

    def spot(self, recipe: Recipe, measured_tif: RemovalModel) -> Recipe:
        """Return the recipe with this spot as its TIF, the same at each point."""
        return replace(recipe, model=measured_tif, tif=self.tif)


def polish_witness(plant: PlantProcess, recipe: Recipe, program: Program, measure: Measure) -> WitnessSpot:
    """Make a spot in the middle of the witness part, with the values of the program. ComputeError."""
    middle = int(np.argmin(np.hypot(*steps.in_part_frame(recipe, program).end_mm[:, :2].T)))
    point = _at_rest(program, middle)
    seconds = np.array([DEPTH_NM / float(_modelled_nm_s(recipe, point).max())])
    before = apply_profile(measure(), recipe.instrument)
    plant.polish(point, seconds, recipe.process.force_n, recipe.process.rpm)
    after = apply_profile(measure(), recipe.instrument)
    azimuth_deg = float(np.degrees(lean_azimuth_rad(steps.executed_surface(recipe, point))[0]))
    whole = _with_data(before, after)
    seen = (before.height_nm[whole], after.height_nm[whole])
    tif, _ = tif_from_maps(*seen, before.grid.pitch_mm, float(seconds[0]), azimuth_deg=azimuth_deg)
    return WitnessSpot(point, tif)


def _at_rest(program: Program, point: int) -> Program:
    """Return one timed point of it, at the end of its block."""
    one = slice(point, point + 1)
    end = program.end_mm[one]
    along = {name: getattr(program, name)[one] for name in ("line", "block", "axis", "time_s", "feed_mm_min")}
    return replace(program, start_mm=end, end_mm=end, **along)


def _modelled_nm_s(recipe: Recipe, point: Program) -> FloatArray:
    """Return (ny, nx) nm/s of that point, by the recipe's initial model."""
    return steps.effect_of(recipe, point, steps.process_grid(recipe)).removal_nm(np.ones(1))


def _with_data(before: SurfaceMap, after: SurfaceMap) -> tuple[slice, slice]:
    """Return rows and columns with data in both: the area around the part is no untouched surface."""
    both = before.valid & after.valid
    rows, columns = (np.flatnonzero(both.any(axis=axis)) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


_Executed = tuple[PlanResult, FloatArray, FloatArray]
"""A pass's plan, and (n,) s of each timed point: as executed, and with the true force and speed."""
GATE = "gate"
"""Outcome of a loop that the removal check stopped."""
TOOL = "tool"
"""Outcome of a loop that a finding about the tool stopped."""
ERROR = "error"
TOUCH_S = 1200.0
"""Longest contact of a first touch, as of `polishd calibrate first-touch`."""


@dataclass(frozen=True, slots=True)
class ClosedLoopResult:
    """One job: its measurements, and the truth."""

    scenario: str
    loop: str
    seed: int
    ended: str
    """An outcome of a job, or "gate", "tool" or "error"."""
    why: str
    """Reason of the outcome; empty where the outcome explains itself."""
    named: tuple[str, ...]
    """Its diagnosis of the machine: causes (`polishd.model.estimates`), and kinds of findings."""
    passes: int
    rms_nm: tuple[float, ...]
    """Measured RMS in the clear aperture, one for each map."""
    predicted_nm: tuple[float, ...]
    """Predicted RMS after each pass."""
    true_rms_nm: tuple[float, ...]
    """True RMS of the part at each of those maps, aligned as the map is."""
    came_nm: tuple[tuple[float, float, float], ...]
    """For each pass that the removal check accepted: predicted interval of the RMS, and measured RMS."""
    true_fits: bool
    """True if the part is truly within its tolerance at the end."""
    cpu_s: float
    """CPU time of this process, without the plant's."""
    ripple_nm: float | None = None
    """Forecast RMS of the ripple of all passes; None: there is no forecast, or the plant keeps no fine patch."""
    ripple_high_nm: float | None = None
    """Its 95 % value."""
    true_ripple_nm: float | None = None
    """RMS that the passes left in the fine patch, of periods below LINES_PERIOD line distances."""

    @property
    def accepted(self) -> bool:
        """True if the loop accepts the part."""
        return self.ended == Outcome.IN_TOLERANCE.value

    @property
    def falsely_accepted(self) -> bool:
        """True if the loop accepts a part that is out of tolerance."""
        return self.accepted and not self.true_fits


@dataclass(slots=True)
class _Account:
    """Results of a run, collected during it."""

    rms_nm: list[float] = field(default_factory=list)
    predicted_nm: list[float] = field(default_factory=list)
    true_rms_nm: list[float] = field(default_factory=list)
    named: list[str] = field(default_factory=list)
    came_nm: list[tuple[float, float, float]] = field(default_factory=list)
    true_fits: bool = False
    ripples: list[Ripple] = field(default_factory=list)
    """Forecast of each pass that was made."""

    @property
    def ripple(self) -> Ripple:
        """Forecast of the passes made."""
        return sum_ripples(self.ripples)

    def name(self, names: Iterable[str]) -> None:
        """Causes and findings, each once."""
        self.named += dict.fromkeys(name for name in names if name not in self.named)

    def add_pass(self, shown: PassIndicators) -> None:
        """Add a pass's result and its prediction."""
        if shown.expected_nm is not None and shown.seen_nm is not None:
            self.came_nm.append((*shown.expected_nm, shown.seen_nm))


@dataclass(frozen=True, slots=True)
class _Ended:
    """Return the result of the job."""

    how: str
    why: str = ""


LINES_PERIOD = 1.5


def _ripples(plant: PlantProcess, made: Ripple) -> tuple[float, float, float] | tuple[None, None, None]:
    """Return forecast, 95 % value and truth of the ripple, RMS in nm; None where one of them is not known."""
    own = [one for one in made.lines if one.direction == "across" and one.cause == "path"]
    patch = plant.patch() if own else None
    if patch is None:
        return None, None, None
    distance_mm, (removed, pitch_mm) = own[0].period_mm, patch
    everywhere = np.ones(removed.shape, dtype=np.bool_)
    short = split_bands(removed, everywhere, pitch_mm, (LINES_PERIOD * distance_mm,))[1]
    shown = Ripple(tuple(one for one in made.lines if one.period_mm < LINES_PERIOD * distance_mm))
    return shown.rms_nm, shown.rms_high_nm, float(short.std())


class ClosedLoop:
    """Runs a cell's job against one plant after the other."""

    def __init__(
        self,
        cell: Path,
        overrides: Mapping[str, Any],
        passes: int,
        *,
        raster: bool,
        witness: Taken | None = None,
        poses: Poses = (),
        learns: bool = True,
    ) -> None:
        """Read the cell's file with a loop's own values, and its programs or a raster. ConfigError, ProgramError.

        ``witness``: start value from a spot that the same machine made on another part; ``poses``: of the part in maps
        before the first pass, which measure the instrument's error; ``learns``: update the estimates after each pass.
        """
        self.config = load_config(cell, {"dwell.cross_check": "", **overrides})
        self.passes = passes
        self._learns = learns
        self._witness = witness
        self._poses = poses
        self._hooks = plugins_of(self.config)
        self._hooks.report.require()
        self._recipe = make_recipe(self.config, self._hooks)
        self._programs = (self._raster(),) if raster else _timed_by_feeds(self.config, self._recipe)

    def _raster(self) -> Program:
        text = own_program(self.config, f"raster over {self.config.outline()}")
        return read(dialect(self.config.program.format), text, "raster.rnc")

    def run(
        self, plant: PlantProcess, sections: Mapping[str, Any], scenario: str, loop: str, seed: int
    ) -> ClosedLoopResult:
        """Run one job, from its first map to its end, on the plant that this seed draws from SIM.toml's sections."""
        begun_s, account = time.process_time(), _Account()
        plant.new(sections, seed)
        try:
            recipe, begun = self._begun(plant, account)
            if self._witness:
                plant.new(sections, seed)
            if self._poses:
                recipe = with_absolute_test(recipe, plant, self._poses)
            ended = begun if isinstance(begun, _Ended) else self._job(recipe, plant, account).polish(begun)
        except PolishdError as error:
            ended = _Ended(ERROR, f"{type(error).__name__}: {error}")
        return ClosedLoopResult(
            scenario,
            loop,
            seed,
            ended.how,
            ended.why,
            tuple(account.named),
            max(len(account.rms_nm) - 1, 0),
            tuple(account.rms_nm),
            tuple(account.predicted_nm),
            tuple(account.true_rms_nm),
            tuple(account.came_nm),
            account.true_fits,
            time.process_time() - begun_s,
            *_ripples(plant, account.ripple),
        )

    def _begun(self, plant: PlantProcess, account: _Account) -> tuple[Recipe, EstimatesInUse | _Ended]:
        """Return the recipe and the estimate before the first pass: as configured, or from a witness. ComputeError."""
        recipe = self._recipe
        if self._witness == "touch":
            touch = replace(self._job(_remembering(as_touched(recipe)), plant, account), programs=(self._touch,))
            taught, why = touch.teach()
            account.rms_nm.clear()  # on the witness part
            account.true_rms_nm.clear()
            if why:
                return recipe, _Ended(GATE, why)
            later = replace(taught.believed, removal=recipe.model.later(taught.believed.removal, 0.0))
            return _remembering(recipe), later
        if self._witness:
            job = self._job(recipe, plant, _Account())
            witness = polish_witness(plant, recipe, self._programs[0], job.map)
            if self._witness == "rate":
                return _remembering(recipe), witness.rate(recipe)
            recipe = witness.spot(recipe, self._hooks.removal_models()["measured_tif"])
        return _remembering(recipe), steps.initial_estimates(recipe)

    @cached_property
    def _touch(self) -> Program:
        """Choose it once for all machines, before anything is known of them. ComputeError, ConfigError."""
        return plan_touch(self.config, as_touched(self._recipe), WANTED, TOUCH_S).program

    def _job(self, recipe: Recipe, plant: PlantProcess, account: _Account) -> _Job:
        return _Job(recipe, self._programs, self._hooks, self.config.part.id, self.passes, self._learns, plant, account)


@dataclass(frozen=True, slots=True)
class _Job:
    """One job on one plant."""

    recipe: Recipe
    programs: tuple[Program, ...]
    """They take turns from pass to pass."""
    hooks: Hooks
    part_id: str
    passes: int
    learns: bool
    plant: PlantProcess
    account: _Account

    def polish(self, believed: EstimatesInUse) -> _Ended:
        """As the daemon's cycle (``polishd.daemon.cycle``): measure, estimate, accept, solve, plan, run."""
        recipe, account = self.recipe, self.account
        series, shown = PassSeries(""), []
        before: MeasureResult | None = None
        last: _Executed | None = None
        while True:
            surface = self._measured(before)
            found: tuple[Finding, ...] = ()
            if before is not None and last is not None:
                surface, taught, why = self._updated(before, surface, last, believed)
                if why:
                    return _Ended(GATE, why)
                believed = taught.believed if self.learns else believed
                if taught.shown is not None:
                    account.add_pass(taught.shown)
                    shown.append(taught.shown)
                    series = extend_series(series, taught.shown)
                    found = findings(series, shown, recipe.finding)
                    account.name(one.kind for one in found)
            passes_left = self.passes - (len(account.rms_nm) - 1)
            match decide(recipe, account.rms_nm[:-1], surface, found, passes_left):
                case ToolWorn(why):
                    return _Ended(TOOL, why)
                case Accept() | Diverge() | Stalled() | PassesUsed() as decision:
                    return _Ended(decision.outcome.value)
                case AnotherPass():
                    pass
            turn = _turn(self.programs, 0 if last is None else _number(last[0]))
            program = self.programs[turn.number - 1]
            warm = None if last is None or len(self.programs) > 1 else last[0].kept
            solved = dwell_step.solve(recipe, program, surface, believed, warm)
            require_certificate(solved.dwell.certificate, recipe)
            plan = steps.rewrite(recipe, program, solved, program.name)
            planned = replace(self._planned(plan, solved, surface), program=turn)
            if small_gain_finding(recipe, planned.forecast):
                return _Ended(Outcome.STALLED.value)
            last = (planned, *self._execute(plan))
            account.ripples.append(planned.ripple)
            account.predicted_nm.append(solved.dwell.certificate.predicted_rms_nm)
            before = surface

    def teach(self) -> tuple[LearnResult, str]:
        """Run one pass; return the update from it, and why the operator must check it first; "" else."""
        recipe, program, before = self.recipe, self.programs[0], self._measured(None)
        believed = steps.initial_estimates(recipe)
        solved = dwell_step.solve(recipe, program, before, believed)
        plan = steps.rewrite(recipe, program, solved, program.name)
        last = (self._planned(plan, solved, before, ripple=False), *self._execute(plan))  # of a witness part
        return self._updated(before, self._measured(before), last, believed)[1:]

    def _updated(
        self, before: MeasureResult, surface: MeasureResult, last: _Executed, believed: EstimatesInUse
    ) -> tuple[MeasureResult, LearnResult, str]:
        """Return the map that counts, its estimates, and why the operator must check before the next pass; "" else."""
        taught, account = self._taught(before, surface, last, believed), self.account
        if taught.doubted:
            surface, again, moves = self._again(surface)
            account.name(one.cause for one in again)
            if moves:
                return surface, taught, "; ".join(one.words for one in moves)
            taught = self._taught(before, surface, last, believed, again)
        account.name(one.cause for one in taught.named)
        return surface, taught, taught.verdict.stop

    def map(self, wait_s: float = 0.0) -> SurfaceMap:
        """Measure the part so long after now."""
        return self._map(*self.plant.measure(wait_s), len(self.account.rms_nm))

    def _again(self, surface: MeasureResult) -> tuple[MeasureResult, tuple[Diagnosis, ...], tuple[Diagnosis, ...]]:
        """As the daemon: measure until two maps agree; return the last, its causes, and what the tolerance omits."""
        account, seen, moves = self.account, list[Diagnosis](), tuple[Diagnosis, ...]()
        for _ in range(residual_diagnosis.MAPS):
            account.rms_nm.pop()  # of one measurement, the last map counts
            account.true_rms_nm.pop()
            before, surface = surface, self._measured(surface, residual_diagnosis.WAIT_S)
            last, moves = moves, steps.map_changes(self.recipe, before, surface)
            seen += moves
            if not residual_diagnosis.is_settling(moves, last):
                break
        return surface, residual_diagnosis.largest_of_each_cause(seen), steps.harmful_changes(self.recipe, moves)

    def _measured(self, before: MeasureResult | None, wait_s: float = 0.0) -> MeasureResult:
        """Measure the part so long after now, and book its true figure."""
        recipe, plant, account = self.recipe, self.plant, self.account
        masks, lay = (None, None) if before is None else (before.masks, before.registration)
        surface = steps.condition(recipe, self.map(wait_s), masks, lay, account.ripple)
        truth, height = plant.truth(held=recipe.accept != "figure")  # what the certificate is of
        true = self._map(height, float(truth["pitch_mm"]), -1)
        truly = steps.condition(with_certified_map(recipe), true, surface.masks)
        account.rms_nm.append(surface.figure_nm)
        account.true_rms_nm.append(truly.figure_nm)
        account.true_fits = part_holds(truly.judged)
        return surface

    def _map(self, height_nm: FloatArray, pitch_mm: float, number: int) -> SurfaceMap:
        name = hashlib.sha256(height_nm.tobytes() + bytes([number % 256])).hexdigest()
        return SurfaceMap(height_nm, pitch_mm, part_id=self.part_id, sha256=name)

    def _taught(
        self,
        before: MeasureResult,
        after: MeasureResult,
        last: _Executed,
        believed: EstimatesInUse,
        again: tuple[Diagnosis, ...] | None = None,
    ) -> LearnResult:
        planned, executed_s, acting_s = last
        expected_nm = planned.certificate.predicted_rms_nm
        done = ExecutedPass(before, after, planned.asked_s, executed_s, acting_s, expected_nm, planned.forecast, again)
        return steps.learn(self.recipe, self.programs[_number(planned) - 1], done, believed)

    def _planned(self, plan: Plan, solved: SolveResult, surface: MeasureResult, *, ripple: bool = True) -> PlanResult:
        vetoes = [*steps.violations(self.recipe, plan), *self.hooks.check_plan(plan, self.recipe.envelope)]
        if vetoes:
            raise PlanRefused("; ".join(vetoes))
        acting = solved.answer.acting if ripple else None
        expected = forecast_of(self.recipe, surface, plan, solved.believed, acting)
        return PlanResult.of(plan, solved, steps.in_part_frame(self.recipe, plan.program), expected)

    def _execute(self, plan: Plan) -> tuple[FloatArray, FloatArray]:
        """(n,) seconds of each timed point, as the plant's robot moves, and with the true force and speed."""
        recipe, program, plant = self.recipe, plan.program, self.plant
        machines = plant.truth()[0]["machines"]
        robot = replace(
            steps.envelope_of(recipe, program),
            accel_mm_s2=float(machines["accel_mm_s2"]),
            block_overhead_s=float(machines["overhead_s"]),
        )
        seconds = motion.delivered_time_s(program, program.time_s, robot)
        acted = plant.polish(program, seconds, recipe.process.force_n, recipe.process.rpm)
        touched = np.where(acted["contact_s"] > 0.0, 1.0, np.nan)
        weight = relative_removal(recipe.process, acted["force_n"] * touched, acted["rpm"] * touched)
        return seconds, seconds * weight


def _remembering(recipe: Recipe) -> Recipe:
    """Its model caches its last effect: solve, plan and estimate of a pass use one effect."""
    model = recipe.model
    last: list[tuple[tuple[Any, ...], RemovalAnswer]] = []

    def effect(request: RemovalRequest) -> RemovalAnswer:
        key = (request.program.sha256, request.grid, request.correction, request.rate, request.beliefs)
        if not last or last[0][0] != key:
            last[:] = [(key, model.effect(request))]
        return last[0][1]

    return replace(recipe, model=replace(model, effect=effect))


def _turn(programs: Sequence[Program], before: int) -> ProgramTurn:
    """Return the program that follows the one of that number; 0: the first."""
    number = before % len(programs) + 1
    return ProgramTurn(number, programs[number - 1].name)


def _number(planned: PlanResult) -> int:
    return 1 if planned.program is None else planned.program.number


def _timed_by_feeds(config: CellConfig, recipe: Recipe) -> tuple[Program, ...]:
    programs = read_programs(config, recipe)
    for program in programs:
        if program.encoding == "dwell":
            raise ComputeError(f"{program.name}: dwells at rest. Study a loop with a program whose feeds are its times")
    return programs
