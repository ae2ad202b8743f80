"""Dwell problems on the nodes of a grid: small parts, real spots, effects as convolutions and as matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from polishd.model.process import ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm, regularisation_from_rho
from polishd.process.removal.convolution import ConvolutionEffect, convolution_effect
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.tif import HertzSpot
from tests.unit.process.gaussian import rough
from tests.unit.process.moves import program

PAPER = ToolProcess()


def resting(radius_mm: float) -> Program:
    """Points at rest 1 mm apart on a disc and half a spot beyond it, the spindle leaning along x."""
    reach = int(radius_mm) + 2
    x, y = np.meshgrid(np.arange(-reach, reach + 1.0), np.arange(-reach, reach + 1.0))
    on = np.hypot(x, y) <= radius_mm + 1.0
    points = np.column_stack([x[on], y[on]])
    return program(points, points)


def gamma_of(points: Program) -> FloatArray:
    """A depth ratio that changes by 8 points over the part."""
    return np.asarray(0.87 + 0.04 * np.sin(points.end_mm[:, 0] / 9 + points.end_mm[:, 1] / 15))


def lattice_problem(radius_mm: float = 14.0, seed: int = 0, tolerance: float = 1e-3, rho: float = 1e-4) -> DwellProblem:
    """A disc whose deepest hundredth cannot be reached: the bound of no dwell holds somewhere."""
    n = 2 * int(radius_mm) + 5
    grid = Grid(n, n, 1.0)
    points = resting(radius_mm)
    gamma = gamma_of(points)
    effect = convolution_effect(grid, HertzSpot(PAPER), points, gamma, np.ones(points.n), tolerance=tolerance)
    solve, metric = grid.radius_mm() <= radius_mm, grid.radius_mm() <= radius_mm - 3
    height = rough(grid, seed=seed)
    piston = choose_piston_nm(height, solve, np.zeros(grid.shape), 0.02)
    return DwellProblem(
        effect=effect,
        target_nm=height + piston,
        solve_mask=solve,
        metric_mask=metric,
        lower_s=np.zeros(points.n),
        upper_s=np.full(points.n, np.inf),
        regularisation=regularisation_from_rho(effect, solve, rho),
    )


def as_matrix(problem: DwellProblem) -> DwellProblem:
    """Return the problem with the effect's columns written out."""
    effect = problem.effect
    assert isinstance(effect, ConvolutionEffect)
    columns = np.stack([effect.removal_nm(row).ravel() for row in np.eye(effect.n)], axis=1)
    columns[np.abs(columns) < 1e-12 * columns.max()] = 0.0
    return replace(problem, effect=SparseEffect(effect.grid, sparse.csr_array(columns)))


def plant(problem: DwellProblem, radius_mm: float = 14.0) -> SparseEffect:
    """What really acts: each point's own spot."""
    points = resting(radius_mm)
    grid = problem.effect.grid
    return SparseEffect(grid, effect_matrix(grid, HertzSpot(PAPER), points, gamma_of(points), np.ones(points.n)))
