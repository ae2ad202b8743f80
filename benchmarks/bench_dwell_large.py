"""Dwell solves of full-size optics to a relative objective gap of 1e-6: ours, and other solvers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache, partial

from benchmarks import dwell_peers as peers
from benchmarks.bench_dwell import Goal, lbfgsb
from benchmarks.dwell_cases import Case, build
from benchmarks.harness import Progress, Row, Runner, cpu_seconds, peak_mb, race
from polishd.plugins import dwell_solvers
from polishd.process.dwell import douglas_rachford
from polishd.process.dwell.problem import DwellProblem
from polishd.process.removal.convolution import ConvolutionEffect

GAP = 1e-6
SMALL = Case(50, 5, 1e-4)
LARGE = (Case(450, 1.7, 1e-4), Case(450, 10, 3e-4), Case(450, 20, 3e-4))
QUICK_CAP_S = 30.0
"""Limit for a peer that has never finished within it."""
CAP_S = 240.0
MOST_MB = 400.0
MOST_QP_ENTRIES = 3_000_000
"""Elements of R above which no QP backend runs: the factor alone would be tens of gigabytes."""


def rows(progress: Progress) -> Iterator[Row]:
    """Cold starts with one spot times gamma; then the cost of the exact spots, a warm start and memory."""
    for case in (SMALL, *LARGE):
        progress(f"dwell, large: preparing {case.name}")
        yield cold(case, *prepared(case), progress)
    for case in LARGE:
        yield transforms(case, progress)
        yield dynamic(case, progress)
        yield warm(case, progress)
    yield memory(LARGE[0])


@cache
def prepared(case: Case, rank: int = 0, change: float = 0.0) -> tuple[DwellProblem, Goal]:
    """The problem, and the objective to reach."""
    problem = build(case, rank, change)
    return problem, peers.reference(problem, GAP)


def cold(case: Case, problem: DwellProblem, goal: Goal, progress: Progress) -> Row:
    """CPU seconds, all from the lower bound."""
    f = peers.lean(problem)
    others: dict[str, Runner] = {"scipy L-BFGS-B (m = 10)": partial(lbfgsb, problem, f, goal)}
    slow: dict[str, Runner] = {}
    if case in (SMALL, LARGE[0]):  # the others with as many points add nothing new
        slow = {
            "projected Newton-CG": partial(peers.newton, problem, f, goal),
            "scipy lsq_linear": partial(peers.lsq_linear, problem, f, goal),
        }
        slow |= {
            f"qpsolvers {name}": partial(peers.backend, problem, name, goal, QUICK_CAP_S)
            for name in dwell_solvers.installed()
        }
    too_large = entries(problem) > MOST_QP_ENTRIES
    capped: dict[str, float | None] = {}
    for name, run in slow.items():
        progress(f"{case.name}: does {name} finish?")
        if (too_large and name.startswith("qpsolvers")) or not finishes(run):
            capped[name] = None
        else:
            others[name] = run
    row = race(
        f"dwell solve, {case.name}, {problem.effect.n} points, gap {GAP:g}",
        partial(peers.ours, problem, f.value, goal),
        others,
        progress=progress,
        peer_cap_s=CAP_S,
    )
    return replace(row, peers={**row.peers, **capped})


def finishes(run: Runner) -> bool:
    """True if a peer finishes within `QUICK_CAP_S`; a peer that runs out of memory does not."""
    try:
        return cpu_seconds(run, QUICK_CAP_S) is not None
    except RuntimeError:
        return False


def entries(problem: DwellProblem) -> float:
    """Approximate number of nonzeros of the effect's matrix."""
    effect = problem.effect
    assert isinstance(effect, ConvolutionEffect)
    return effect.n * (2 * effect.corner[0] + 1) ** 2 * 0.785


def transforms(case: Case, progress: Progress) -> Row:
    """Ours beside only the transforms of its iterations, one after the other: the ratio shall be 1/1.3."""
    progress(f"transforms alone, {case.name}")
    problem, goal = prepared(case)
    value = peers.lean(problem).value
    times = peers.iterations(problem, value, goal)
    peers.transforms(problem, 1)  # compiled before the race
    alone = partial(peers.transforms, problem, times)
    return race(f"dwell solve and its transforms, {case.name}", partial(peers.ours, problem, value, goal),
                {"its transforms alone": alone}, progress=progress)  # fmt: skip


def dynamic(case: Case, progress: Progress) -> Row:
    """Each point's own spot at rank 3 beside one spot times gamma: the ratio shall be at least 1/2.2."""
    progress(f"dynamic spot, {case.name}")
    exact, static = (
        partial(peers.ours, problem, peers.lean(problem).value, goal)
        for problem, goal in (prepared(case, rank=3), prepared(case))
    )
    return race(f"dynamic spot of rank 3, {case.name}", exact, {"ours, one spot": static}, progress=progress)


def warm(case: Case, progress: Progress) -> Row:
    """Convolutions after gamma moved by up to 1 %, from the last solution's state: the ratio shall be at least 5."""
    progress(f"warm start, {case.name}")
    (before, _), (after, goal) = prepared(case), prepared(case, change=0.01)
    value = peers.lean(after).value
    started = replace(after, warm=douglas_rachford.solve(before, 600.0))
    again, anew = (2.0 * peers.iterations(problem, value, goal) for problem in (started, after))
    return Row(f"warm start, gamma moved 1 %, {case.name}", again, {"cold": anew}, "convolutions")


def memory(case: Case) -> Row:
    """Most memory that a solve to a KKT residual of 1e-6 takes beyond its problem."""
    problem, goal = prepared(case)
    f = peers.lean(problem)
    of_ours = peak_mb(lambda: douglas_rachford.solve(problem, 600.0))
    if of_ours > MOST_MB:
        raise RuntimeError(f"{of_ours:.0f} MB are more than {MOST_MB:g} MB")
    rest: Mapping[str, float] = {"scipy L-BFGS-B (m = 10)": peak_mb(partial(lbfgsb, problem, f, goal))}
    return Row(f"dwell solve, {case.name}, memory", of_ours, rest, "MB")
