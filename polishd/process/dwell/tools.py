"""Several tools over one part, from arrays: one convex problem for all, and which of them are worth their change.

For tools once chosen the dwells of all are one problem (``R = [R_1, R_2, ...]``), with one certificate. Which tools to
take is not convex, as a change takes its time whole: each choice among them is solved, and the shortest is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from polishd.model.dwell import OptimalityCertificate
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell.arrays import DwellCase, array_problem, default_solve
from polishd.process.dwell.budget import Goal, to_goal, within_budget
from polishd.process.dwell.curve import CurvePoint, Row, Solve, solved
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.setup import regularisation_from_rho
from polishd.process.robot.refusal import require_number
from polishd.process.several import split, together

MOST_TOOLS = 5
"""31 choices among them: more would be solved for hours."""


@dataclass(frozen=True, slots=True)
class ArrayTool:
    """A tool, and where it may dwell: of a `DwellCase` what is its own."""

    name: str
    tif_nm_s: FloatArray
    """(ky, kx) removal rate, as in a `DwellCase`."""
    tif_pitch_mm: float
    points_mm: FloatArray | None = None
    """(n, 2); None: a square lattice of ``step_mm``."""
    step_mm: float = 1.0
    lower_s: float | FloatArray = 0.0
    upper_s: float | FloatArray = np.inf
    change_s: float = 0.0
    """Machine time that it takes to have it on the spindle and the part before it, whatever it then does."""


@dataclass(frozen=True, slots=True)
class ToolDwell:
    """What one tool does."""

    tool: ArrayTool
    points_mm: FloatArray
    """(n, 2) x and y, in the map's coordinates."""
    time_s: FloatArray
    """(n,)."""
    removal_nm: FloatArray
    """(ny, nx)."""


@dataclass(frozen=True, slots=True)
class ToolsDwell:
    """What `dwell_of_tools` gives."""

    passes: tuple[ToolDwell, ...]
    """Of the tools taken, in the order in which they were given."""
    problem: DwellProblem
    """The one that was solved, of their points one after another."""
    certificate: OptimalityCertificate
    """Of all together."""
    residual_nm: FloatArray
    """(ny, nx) after the last of them, mean removed in the clear aperture; NaN outside the mask."""
    total_s: float
    """Dwell and changes."""
    tried: tuple[Row, ...]
    """Each choice of tools: ``tools``, ``total_s``, ``rms_nm``, ``slope_urad``, ``kkt_residual``; or ``refused``."""


def dwell_of_tools(
    case: DwellCase,
    tools: Sequence[ArrayTool],
    *,
    budget_s: float | None = None,
    target_rms_nm: float | None = None,
    target_slope_urad: float | None = None,
    within_s: float = 600.0,
    solve: Solve | None = None,
) -> ToolsDwell:
    """The dwells of several tools that together bring a map down, and which tools to take for it.

    Without a goal all tools are taken, and the residual is the least. With a target it is the choice of the least
    machine time, with a budget that of the least residual.

    Args:
        case: the map, and what counts of it; its own TIF, points and bounds are not used.
        tools: at most MOST_TOOLS, in the order in which they polish.
        budget_s: most machine time, changes included.
        target_rms_nm: residual RMS in the clear aperture to reach.
        target_slope_urad: RMS of the residual's slope to reach as well, or alone. The dwell is the shortest for its
            residual; of those the one with the least time is taken whose slope is good enough.
        within_s: CPU seconds for each solve.
        solve: another solver than `default_solve`.

    Raises:
        ComputeError: as `dwell_from_arrays`; a goal that no choice of tools reaches, with what each came to.
    """
    goal = Goal(target_rms_nm, target_slope_urad)
    if budget_s is not None and goal.wanted:
        raise ComputeError("budget_s and a target are two ways to the same thing: give one")
    if not 0 < len(tools) <= MOST_TOOLS:
        raise ComputeError(f"{len(tools)} tools: give one to {MOST_TOOLS}")
    for tool in tools:
        require_number(f"change_s of {tool.name}", tool.change_s, "s", above=-1e-9)
    run = partial(default_solve, within_s=within_s) if solve is None else solve
    alone = [_problem_of(case, tool) for tool in tools]
    free = budget_s is None and not goal.wanted
    rows, best = list[Row](), None
    for chosen in [tuple(range(len(tools)))] if free else _choices(len(tools)):
        names, change_s = [tools[k].name for k in chosen], sum(tools[k].change_s for k in chosen)
        problem = _joined([alone[k][0] for k in chosen], case)
        try:
            found = _found(problem, run, goal, None if budget_s is None else budget_s - change_s)
        except ComputeError as refused:
            rows.append({"tools": names, "refused": str(refused)})
            continue
        rows.append(_row(found, names, change_s))
        score = found.rms_nm if budget_s is not None else found.total_s + change_s
        if best is None or score < best[0]:
            best = score, chosen, found, change_s
    if best is None:
        told = "\n".join(f"  {', '.join(row['tools'])}: {row['refused']}" for row in rows)  # type: ignore[arg-type]
        raise ComputeError(f"no choice of tools gets there:\n{told}")
    _, chosen, found, change_s = best
    own = [(tools[k], *alone[k]) for k in chosen]
    return ToolsDwell(
        passes=tuple(_passes(own, found.solution.time_s)),
        problem=found.problem,
        certificate=found.solution.certificate,
        residual_nm=found.solution.residual_nm,
        total_s=found.total_s + change_s,
        tried=tuple(rows),
    )


def _case_of(case: DwellCase, tool: ArrayTool) -> DwellCase:
    own = ("tif_nm_s", "tif_pitch_mm", "points_mm", "step_mm", "lower_s", "upper_s")
    return replace(case, **{name: getattr(tool, name) for name in own})


def _problem_of(case: DwellCase, tool: ArrayTool) -> tuple[DwellProblem, FloatArray]:
    try:
        return array_problem(_case_of(case, tool))
    except ComputeError as error:
        raise ComputeError(f"{tool.name}: {error}") from error


def _choices(count: int) -> Iterator[tuple[int, ...]]:
    for size in range(1, count + 1):
        yield from combinations(range(count), size)


def _joined(problems: Sequence[DwellProblem], case: DwellCase) -> DwellProblem:
    """One problem of all; the same map for each, so that the piston of the highest floor holds for all."""
    effect = together([problem.effect for problem in problems])
    first = problems[0]
    highest = max(problems, key=lambda problem: float(problem.target_nm[first.solve_mask].mean()))
    return replace(
        highest,
        effect=effect,
        lower_s=np.concatenate([problem.lower_s for problem in problems]),
        upper_s=np.concatenate([problem.upper_s for problem in problems]),
        regularisation=regularisation_from_rho(effect, first.solve_mask, case.rho),
    )


def _found(problem: DwellProblem, run: Solve, goal: Goal, budget_s: float | None) -> CurvePoint:
    if goal.wanted:
        return to_goal(problem, goal, run)
    return solved(problem, run) if budget_s is None else within_budget(problem, budget_s, run)


def _row(found: CurvePoint, names: list[str], change_s: float) -> Row:
    return {
        "tools": names,
        "total_s": found.total_s + change_s,
        "rms_nm": found.rms_nm,
        "slope_urad": found.slope_urad,
        "kkt_residual": found.solution.certificate.kkt_residual,
        "gap": found.solution.certificate.gap,
    }


def _passes(own: Sequence[tuple[ArrayTool, DwellProblem, FloatArray]], time_s: FloatArray) -> Iterator[ToolDwell]:
    times = split(time_s, [len(points) for _, _, points in own])
    for (tool, problem, points), own_s in zip(own, times, strict=True):
        yield ToolDwell(tool, points, own_s, problem.effect.removal_nm(own_s))
