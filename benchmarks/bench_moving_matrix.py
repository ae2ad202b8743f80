"""From the path to the dwell of a moving tool, without a matrix and with one, including the making of the effect."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.bench_dwell import Goal
from benchmarks.bench_dwell import ours as newton
from benchmarks.bench_moving import CAP_S, CASES, Part, of, reached
from benchmarks.harness import Progress, Row, Runner, race
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.effect import SparseEffect


def rows(progress: Progress) -> Iterator[Row]:
    """The case whose matrix fits into memory."""
    case = CASES[0]
    progress(f"moving, by a matrix: preparing phi {case.diameter_mm:g} mm, spot {case.radius_mm:g} mm")
    part = Part(case)
    by_matrix = part.of(matrix(part))  # a separate problem: the effect without a matrix differs slightly
    goal = reached(newton_cg.solve(by_matrix, 3600.0, 1e-8))
    peers: dict[str, Runner] = {"a matrix, projected Newton-CG": partial(made_and_newton, part, by_matrix, goal)}
    name = f"effect and dwell of a moving tool, {part.name}"
    yield race(name, partial(made_and_ours, part), peers, progress=progress, peer_cap_s=CAP_S)


def matrix(part: Part) -> SparseEffect:
    one = np.ones(part.program.n)
    return SparseEffect(part.grid, effect_matrix(part.grid, part.case.spot, part.program, part.gamma, one))


def made_and_ours(part: Part) -> None:
    of(replace(part.problem, effect=part.without()), part.goal)


def made_and_newton(part: Part, problem: DwellProblem, goal: Goal) -> None:
    made = replace(problem, effect=matrix(part))
    newton(made, quadratic(made), goal)
