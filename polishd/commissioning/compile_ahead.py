"""``polishd doctor --compile``: compile everything that large programs and dwell problems need, and keep it.

Without this, the first large plan of a user waits for the compiler. Small problems, just above the sizes at which
compiled code is used, run through the same functions as a plan: so exactly what a plan needs is compiled.
"""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import polishd
from polishd.model.errors import DeviceError
from polishd.model.process import ToolProcess
from polishd.model.program import program_of_points
from polishd.model.surface import Grid
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import read, rewrite
from polishd.plugins.rnc_robot.gcode.jit import LARGE_BYTES
from polishd.process.dwell import alternating_directions, douglas_rachford
from polishd.process.dwell.douglas_rachford import COMPILED_NODES
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import regularisation_from_rho
from polishd.process.removal.combined_effect import COMPILED_BLOCKS
from polishd.process.removal.convolution import sum_of_convolutions
from polishd.process.removal.effect import Effect
from polishd.process.removal.spread_effect import spread_effect
from polishd.process.removal.tif import hertz_spot
from polishd.rendering.terminal import emit
from polishd.util.jit import cache_folder, has_compiler

COMPILED_PARTS = ("process", "plugins/rnc_robot/gcode", "util/jit.py")
"""Sources of compiled code, and of all that calls it."""
WITHIN_S = 600.0
"""CPU seconds of a dwell, far more than the compiler needs."""
LOOSE = 0.5
"""KKT residual that a few steps reach."""
NOT_KEPT, TO_DO = "compiled code cannot be kept", "Set XDG_CACHE_HOME to a folder of this user"
LEAN_RAD = np.radians(15.0)
"""Lean of the tool."""


@dataclass(frozen=True, slots=True)
class CompileResult:
    """Result of a run: what is kept, and where."""

    functions: int
    """Versions of functions that this run compiled; 0: all were kept already."""
    cpu_s: float
    folder: Path


def compile_verb(*, as_json: bool) -> None:
    """Compile, and print what is kept where. DeviceError where nothing can be kept."""
    if not has_compiler():
        emit(
            {"functions": 0, "cpu_s": 0.0, "folder": None},
            as_json=as_json,
            lines=["nothing to compile: the extra fast is not installed. To use it, run: pip install 'polishd[fast]'"],
        )
        return
    found = compile_ahead()
    emit(
        {"functions": found.functions, "cpu_s": found.cpu_s, "folder": str(found.folder)},
        as_json=as_json,
        lines=[
            f"compiled {found.functions} functions in {found.cpu_s:.0f} s of CPU, kept in {found.folder}"
            if found.functions
            else f"all functions are compiled already, kept in {found.folder}"
        ],
    )


def compile_ahead() -> CompileResult:
    """Compile what is not kept yet. Takes about 15 CPU seconds. DeviceError where nothing can be kept."""
    begun_s = time.process_time()
    folder = _writable_folder()
    before = set(folder.rglob("*.nbc"))
    for work in (_rewrite_programs, _solve_moving, _solve_resting):
        work()
    _marker(folder).touch()
    functions = len(set(folder.rglob("*.nbc")) - before)
    return CompileResult(functions, time.process_time() - begun_s, folder)


def is_compiled_ahead() -> bool:
    """Return whether `compile_ahead` has run for these sources, this numba and this processor."""
    try:
        return _marker(cache_folder()).exists()
    except RuntimeError:  # the account has no home
        return False


def _writable_folder() -> Path:
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError) as error:
        raise DeviceError(f"{NOT_KEPT}: {error}. {TO_DO}") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise DeviceError(f"{NOT_KEPT}: no permission to write into {folder}. {TO_DO}")
    return folder


def _marker(folder: Path) -> Path:
    """File that says that everything is compiled; another one for other sources or another processor."""
    import numba
    from llvmlite import binding

    digest = hashlib.sha256(f"{numba.__version__} {binding.get_host_cpu_name()}".encode())
    root = Path(polishd.__file__).parent
    for part in COMPILED_PARTS:
        for source in sorted((root / part).rglob("*.py")) or [root / part]:
            digest.update(source.read_bytes())
    return folder / f"compiled-{digest.hexdigest()[:16]}"


# One small problem of each kind.


def _rewrite_programs() -> None:
    """Programs with the time in feeds, in dwells and in inverse time, with other times and to another encoding."""
    profile = dialect("rs274")
    for block in ("G1 X{} F60\n", "G1 X{} F60\nG4 P0.25\n", "G93\nG1 X{} F60\n"):
        lines = "".join(block.format(1 + i % 2) for i in range(LARGE_BYTES // 10))
        program = read(profile, f"G21 G90\nG0 X0 Y0 Z0\n{lines}M2\n".encode(), "compile")
        rewrite(profile, program, program.time_s * 1.5)
        if program.encoding == "feed":
            for encoding in ("dwell", "inverse"):
                rewrite(profile, program, program.time_s * 1.5, encoding)


def _solve_moving() -> None:
    """A moving tool without a matrix: as many blocks as compiled code wants, on a small part."""
    process = ToolProcess(tool_radius_mm=400.0)
    grid = Grid(40, 40, 1.0)
    side = int(np.ceil(np.sqrt(COMPILED_BLOCKS))) + 1
    along = np.linspace(-15.0, 15.0, side)
    y, x = np.repeat(along, side), np.concatenate([along[:: (-1) ** line] for line in range(side)])
    points = np.column_stack([x, y, np.zeros(side**2)])
    gamma = np.linspace(0.8, 0.9, len(points) - 1)
    axis = np.tile([np.sin(LEAN_RAD), 0.0, np.cos(LEAN_RAD)], (len(gamma), 1))
    program = program_of_points("compile", "feed", points[:-1], points[1:], axis)
    effect = spread_effect(grid, hertz_spot(process, grid.pitch_mm), program, gamma, np.ones(program.n), tolerance=1e-2)
    alternating_directions.solve(_problem(effect, grid), WITHIN_S, LOOSE)


def _solve_resting() -> None:
    """Points at rest on all nodes of a grid: as many nodes as compiled code wants."""
    side = int(np.ceil(np.sqrt(COMPILED_NODES)))
    grid = Grid(side, side, 1.0)
    node, kernel = np.divmod(np.arange(side**2), side), np.outer(*(np.hanning(9)[1:-1],) * 2)
    effect = sum_of_convolutions(grid, node, kernel[None], np.ones((side**2, 1)))
    douglas_rachford.solve(_problem(effect, grid), WITHIN_S, LOOSE)


def _problem(effect: Effect, grid: Grid) -> DwellProblem:
    """Remove a bump that the effect reaches."""
    bump = effect.removal_nm(np.ones(effect.n))
    mask = bump > bump.max() / 2
    lower, upper = np.zeros(effect.n), np.full(effect.n, np.inf)
    target = bump * (1 + grid.radius_mm() / grid.radius_mm().max())
    return DwellProblem(effect, target, mask, mask, lower, upper, regularisation_from_rho(effect, mask, 1e-4))
