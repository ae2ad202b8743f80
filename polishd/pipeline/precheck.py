"""Checks before a map, and of a map before its dwell is solved, for problems that would be refused later."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Literal

import numpy as np

from polishd.config.cell import CellConfig
from polishd.hookspecs import RemovalAnswer
from polishd.model.errors import ComputeError, PlanRefused, ProgramError
from polishd.model.process import MeasuredCompliance, Moment
from polishd.model.program import Envelope, Plan, Program
from polishd.model.surface import FloatArray
from polishd.pipeline import steps
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult
from polishd.pipeline.steps import envelope_of, executed_surface
from polishd.process.dwell.problem import negligible_share, without_traces
from polishd.process.dwell.quadratic import choose_piston_nm
from polishd.process.frames import surface_normals
from polishd.process.metrology.tolerance import lines_below_cutoff
from polishd.process.removal import contact
from polishd.process.robot import motion
from polishd.process.robot.compliance import depth_ratio, path_compliance, require_dip
from polishd.process.toolpath.apertures import PathCoverage, coverage

IMPLAUSIBLE = 10.0
"""PV of a map in units of ``limits.max_removal_nm``, above which a wrong unit is likelier than such a part."""
SURE = 0.9
"""Share of the time for the whole volume at the largest rate: an optimum may leave some of the volume."""
ROOM = 1.2
"""Ratio of an advised limit to the known need."""


def precheck_plan(recipe: Recipe, program: Program, check_plan: Callable[[Plan, Envelope], Sequence[str]]) -> list[str]:
    """List why `plan` or `run` would refuse a program with any map: reach, landing, limits at the largest feed."""
    plan = shortest_time_s(recipe, program)
    found = [*steps.violations(recipe, plan), *check_plan(plan, recipe.envelope)]
    part = steps.executed_surface(recipe, program)
    try:
        path_compliance(
            part, recipe.process, recipe.robot, recipe.placement, options=recipe.options, optic=recipe.optic
        )
    except ComputeError as error:
        found.append(f"{program.name}: {error}")
    return found


@contextmanager
def blame_path(*legs: tuple[CellConfig, Recipe, Program]) -> Iterator[None]:
    """Turn a ComputeError of a program that robot, tool or part cannot follow into a ConfigError at a key."""
    try:
        yield
    except ComputeError as error:
        for config, recipe, program in legs:
            for key, advice, require in _path_needs(recipe, program):
                try:
                    require()
                except ComputeError as found:
                    raise config.error(key, f"{_at_line(program, found)}. {advice}") from error
        raise


def _at_line(program: Program, error: ComputeError) -> str:
    """The error at a timed point, with the line of the program in place of the point."""
    if error.point is None:
        return f"{program.name}: {error}"
    return f"{program.name}:{program.line[error.point]}: {str(error).removeprefix(f'point {error.point}: ')}"


def _path_needs(recipe: Recipe, program: Program) -> Iterator[tuple[str, str, Callable[[], object]]]:
    """Yield the needs of a path in the order in which each presupposes the ones before: key, advice and check."""
    process, robot, placement, optic, options = (
        recipe.process, recipe.robot, recipe.placement, recipe.optic, recipe.options
    )  # fmt: skip

    def compliance(moment: Moment) -> FloatArray:
        own = replace(options, moment=moment)
        part = executed_surface(recipe, program)
        return path_compliance(part, process, robot, placement, options=own, optic=optic).compliance_mm_per_n

    def middle_mm() -> FloatArray:
        part = steps.in_part_frame(recipe, program)
        return (part.start_mm + part.end_mm) / 2

    def gamma() -> FloatArray:
        depth_mm, curved = contact.hertz_depth_mm(process), curvature()
        deep = depth_mm if curved is None else depth_mm * curved.deeper
        return depth_ratio(compliance(options.moment), process, deep)

    def curvature() -> contact.CurvedContact | None:
        return contact.contact_on_curved_part(process, optic, middle_mm()[:, :2], contact=recipe.tif is None)

    yield "machine.max_feed_mm_s", "Correct it, or the program", lambda: envelope_of(recipe, program)
    advice = "Correct the part's form, or name the program of this part"
    yield "part.curvature_radius_mm", advice, lambda: surface_normals(placement, middle_mm(), optic)
    advice = "Use a smaller bonnet, or correct the part's radius of curvature"
    yield "process.tool_radius_mm", advice, curvature
    advice = "Set the dip of the program, or make the program with this dip"
    yield "process.dip_deg", advice, lambda: require_dip(executed_surface(recipe, program), process, placement, optic)
    key, advice = "part.origin_mm", "Move the part to where the robot reaches all of the path, or correct [kinematics]"
    if isinstance(robot, MeasuredCompliance):
        key, advice = "kinematics.table", "Measure the compliance there, too, or move the part (part.origin_mm)"
    yield key, advice, lambda: compliance("full")
    yield "compliance.moment", "Correct it", lambda: compliance(options.moment)
    yield "process.force_n", "Correct force, bonnet (process.tool_modulus_mpa) or the robot's stiffness", gamma


def require_limits(
    recipe: Recipe, program: Program, check_plan: Callable[[Plan, Envelope], Sequence[str]], answer: RemovalAnswer
) -> None:
    """PlanRefused where `plan` would refuse the program with any map: travel, or removal in its shortest times."""
    plan = shortest_time_s(recipe, program)
    removal_nm = without_traces(answer.removal_nm(plan.expected_time_s), negligible_share(answer.effect))
    plan = replace(plan, predicted_removal_nm=removal_nm, grid=answer.effect.grid)
    if found := check_plan(plan, recipe.envelope):
        first = f"{program.name}: plan would refuse it with any map. Correct the named key or the program:"
        raise PlanRefused("\n".join([first, *(f"  {one}" for one in found)]))


def program_warnings(recipe: Recipe, program: Program, removal_nm: float) -> list[str]:
    """Warn of what `run` refuses, and of a program that removes too much as it is: its times may be a template's."""
    found = [f"run will refuse: {one}" for one in steps.violations(recipe, shortest_time_s(recipe, program))]
    most_nm = recipe.envelope.max_removal_nm
    if removal_nm > most_nm:
        found.append(
            f"{program.name} as it is removes up to {removal_nm:.6g} nm, more than limits.max_removal_nm = "
            f"{most_nm:g} nm. Check process.preston (or process.tif) and its unit; a plan replaces the program's times."
        )
    return found


def shortest_time_s(recipe: Recipe, program: Program) -> Plan:
    """The program at the machine's largest feed, or at its own feed where dwells carry the time."""
    envelope = envelope_of(recipe, program)
    asked = np.zeros(program.n) if program.encoding == "dwell" else program.length_mm / envelope.max_feed_mm_s
    feed = program.max_feed_mm_min if program.encoding == "dwell" else 60 * envelope.max_feed_mm_s
    return Plan(
        program=replace(program, time_s=asked, max_feed_mm_min=feed),
        approach_blocks=int(program.block[0]),
        contact_blocks=int(program.block[-1]) + 1,
        expected_time_s=motion.least_time_s(program, envelope),
        predicted_removal_nm=np.zeros((1, 1)),
        segments=(),
    )


def check_pass(config: CellConfig, recipe: Recipe, program: Program) -> None:
    """ConfigError where no plan of this program can end within ``limits.max_pass_s``."""
    least = _least_s(recipe, program)
    if not least <= recipe.envelope.max_pass_s:
        raise config.error("limits.max_pass_s", _too_long(recipe, f"{program.name} at the largest feed takes", least))


def pass_words(recipe: Recipe, program: Program, answer: RemovalAnswer) -> str:
    """Describe the known times of a pass without a map, and its limit."""
    limit = recipe.envelope.max_pass_s
    clear = recipe.outline.contains(*steps.process_grid(recipe).axes_mm, recipe.part.edge_mm)
    mean = float(answer.removal_nm(np.full(program.n, limit / program.n))[clear].mean())
    own = float(motion.delivered_time_s(program, program.time_s, envelope_of(recipe, program)).sum())
    return (
        f"{_least_s(recipe, program):.0f} s at the largest feed, {own:.0f} s as programmed; "
        f"limits.max_pass_s = {limit:g} s removes {mean:.1f} nm everywhere"
    )


def tolerance_words(recipe: Recipe, answer: RemovalAnswer) -> str:
    """Describe each line of the tolerance with its limit, and the lines that this spot cannot correct."""
    parts = [f"{line.what} <= {line.limit:g} {line.unit}" for line in recipe.lines]
    if answer.transfer is not None:
        cutoff = answer.transfer.cutoff_period_mm
        parts += [
            f"{line.what} can only be left as it is: this spot corrects no period below {cutoff:.2f} mm"
            for line in lines_below_cutoff(recipe.lines, cutoff)
        ]
    return "; ".join(parts)


def require_path_time(recipe: Recipe, program: Program) -> None:
    """PlanRefused where the path alone exceeds the longest pass."""
    least = _least_s(recipe, program)
    if not least <= recipe.envelope.max_pass_s:
        raise PlanRefused(_too_long(recipe, f"{program.name} at the largest feed takes", least))


def require_removal_time(recipe: Recipe, measured: MeasureResult, answer: RemovalAnswer, lower_s: FloatArray) -> None:
    """PlanRefused where the volume to remove, at the largest rate on the path, exceeds the longest pass.

    This applies only to the least residual: the other choices of a dwell may take less time.
    """
    if recipe.dwell.objective != "least":
        return
    least = SURE * removal_time_s(measured, answer, lower_s)
    if not least <= recipe.envelope.max_pass_s:
        raise PlanRefused(_too_long(recipe, "what this map wants removed takes at least", least))


def doubt_of_heights(measured: MeasureResult, recipe: Recipe) -> str:
    """Return the advice to check the map's unit and sign first; empty where a pass may remove such heights."""
    facts, most_nm = measured.facts(), recipe.envelope.max_removal_nm
    if facts["pv_nm"] <= IMPLAUSIBLE * most_nm:
        return ""
    rms_nm, pv_nm = (facts[name] for name in ("rms_nm", "pv_nm"))
    return (
        f"the map has an RMS of {rms_nm:.4g} nm and a PV of {pv_nm:.4g} nm in the clear aperture, but one pass may "
        f"remove {most_nm:g} nm (limits.max_removal_nm). Check the unit and the sign of its heights first "
        "(polishd map FILE). If they are right: "
    )


def removal_time_s(measured: MeasureResult, answer: RemovalAnswer, lower_s: FloatArray) -> float:
    """Seconds in which the point with the largest rate would remove the volume wanted in the clear aperture."""
    clear = measured.metric_mask
    piston = choose_piston_nm(measured.height_nm, clear, answer.removal_nm(lower_s))
    rate = answer.effect.adjoint(clear.astype(np.float64))  # nm/s, summed over the samples
    most = float((rate if answer.divide_by is None else rate * answer.divide_by).max())
    return float((measured.height_nm[clear] + piston).sum()) / most


def _least_s(recipe: Recipe, program: Program) -> float:
    return float(motion.least_time_s(program, envelope_of(recipe, program)).sum())


def _too_long(recipe: Recipe, what: str, seconds: float) -> str:
    return (
        f"{what} {seconds:.0f} s, more than limits.max_pass_s = {recipe.envelope.max_pass_s:g} s; "
        f"set it to {math.ceil(ROOM * seconds):d} or more, or take a shorter path, a larger spot, or a budget "
        "(dwell.objective)"
    )


# Does a program belong to this part? A program of another part would polish it without supervision.

MOST_UNREACHED = 0.05
"""Share of the clear aperture: a program whose spots end at 97 % of a round part's radius misses more."""
LANDING_MM = 10.0
"""Width beyond the rim for turns and landing points, which are much of a small part's path."""
MOST_OUTSIDE = 0.5
"""Share of the path. A square raster on a round part, too large by a quarter of the radius, has less outside."""

Covers = Literal["aperture", "zone"]
"""Purpose of a program."""


def read_programs(config: CellConfig, recipe: Recipe) -> tuple[Program, ...]:
    """Read the programs of a tool, in the order in which they take turns from pass to pass.

    Raises ProgramError, or ConfigError where two have the same content (their passes would not differ), or are for
    different tools or frames of the controller (a cell states one pose of its programs on the part).
    """
    paths = [config.file("program.path", path) for path in config.program_paths]
    programs = tuple(steps.read_program(recipe, path) for path in paths)
    first, *later = (_names_of_controller(recipe, program) for program in programs) if len(programs) > 1 else (b"",)
    for number, program in enumerate(programs):
        same = next((other for other in programs[:number] if other.sha256 == program.sha256), None)
        if same is not None:
            raise config.error(
                "program.path",
                f"{program.name} has the same content as {same.name}; programs take turns so that the lines of their "
                "passes differ. Make one of them with another --phase or --seed, or remove it",
            )
    for program, names in zip(programs[1:], later, strict=True):
        if names != first:
            raise config.error(
                "program.path",
                f"{program.name} names another tool or frame of the controller than {programs[0].name}; programs that "
                "take turns have one pose on the part. Write both for the same tool and frame",
            )
    return programs


def _names_of_controller(recipe: Recipe, program: Program) -> bytes:
    """A short program for the tool and the frame that the program names; empty where it, or its format, names none."""
    if recipe.format.made_like is None:
        return b""
    try:
        make = recipe.format.made_like(program.text, program.name).make
    except ProgramError:
        return b""
    points, axes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]] * 2)
    return b"" if make is None else make(points, axes, 600.0, "sample")


def require_fit(config: CellConfig, recipe: Recipe, program: Program) -> str:
    """Describe the coverage of the program; ConfigError where it belongs to another part."""
    described, problem = judged(recipe, program, config.program.coverage)
    if problem:
        raise config.error("program.path", f"{described}{problem}")
    return described


def judged(recipe: Recipe, program: Program, covers: Covers) -> tuple[str, str]:
    """Describe the coverage of a program, and why it belongs to another part (empty where it may be this one's).

    ``zone``: the program leaves some of the clear aperture on purpose.
    """
    found = program_coverage(recipe, program)
    described = (
        f"{program.name} reaches {found.reach_mm:.1f} mm from the part's center, the part is {recipe.outline}; "
        f"the program leaves out {100 * found.unreachable:.1f} % of the clear aperture"
    )
    advice = "name the program of this part, or correct the part's outline ([part]) or program.offset_mm"
    if found.outside > MOST_OUTSIDE:
        away = f"{100 * found.outside:.0f} % of its path lies more than {LANDING_MM:g} mm beyond the part's rim"
        return described, f", and {away}: {advice}"
    if found.unreachable > MOST_UNREACHED and covers == "aperture":
        zone = 'use closer lines where it leaves gaps; for a program of a zone only, set program.coverage = "zone"'
        return described, f": {advice}; {zone}"
    return described, ""


def program_coverage(recipe: Recipe, program: Program) -> PathCoverage:
    """Coverage of the recipe's part by the program."""
    placed = steps.executed_surface(recipe, program)
    return coverage(
        placed.start_mm,
        placed.end_mm,
        spot_mm=_spot_mm(recipe),
        outline=recipe.outline,
        edge_mm=recipe.part.edge_mm,
        landing_mm=LANDING_MM,
    )


def _spot_mm(recipe: Recipe) -> float:
    """Radius of the spot: of the measured one's area, or of the contact on a rigid robot."""
    if recipe.tif is not None:
        return recipe.tif.pitch_mm * float(np.sqrt(np.count_nonzero(recipe.tif.rate_nm_s) / np.pi))
    return float(contact.contact_radius_mm(recipe.process, contact.hertz_depth_mm(recipe.process)))
