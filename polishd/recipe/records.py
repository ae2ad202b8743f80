"""What a cycle leaves in the run folder, and the arrays of it that the journal names."""

from __future__ import annotations

from dataclasses import asdict, fields

import numpy as np

from polishd.model.program import Plan
from polishd.model.surface import SurfaceMap
from polishd.process.gate import Verdict
from polishd.recipe import steps
from polishd.recipe.arrays import Arrays
from polishd.recipe.folder import RunFolder
from polishd.recipe.recipe import Recipe
from polishd.recipe.steps import Measured, Solved


def save_surface(folder: RunFolder, surface: SurfaceMap, measured: Measured) -> None:
    """The map's own file, and what is made of it on the process grid."""
    if surface.path is not None:
        folder.copy(surface.path, f"map{surface.path.suffix}")
    folder.arrays("surface.npz", surface_arrays(measured))
    folder.json("registration.json", measured.registration)


def surface_arrays(measured: Measured) -> Arrays:
    """What ``steps.load_measured`` makes a measurement of again."""
    return {
        "height_nm": np.where(measured.solve_mask, measured.height_nm, np.nan),
        "solve_mask": measured.solve_mask,
        "metric_mask": measured.metric_mask,
        "pitch_mm": measured.grid.pitch_mm,
        "lies": np.array([*measured.registration.shift_mm, measured.registration.rotation_deg]),
    }


def save_verdict(folder: RunFolder, verdict: Verdict, surface: Measured) -> None:
    """What the gate found and, where it stops, the maps that it compared: for the picture."""
    plain = {item.name: getattr(verdict, item.name) for item in fields(verdict)}
    maps = {key: value for key, value in plain.items() if isinstance(value, np.ndarray)}
    words = {key: value for key, value in plain.items() if key not in maps}
    folder.json("gate.json", {**words, "best": {**asdict(verdict.best), "name": verdict.best.name}})
    if verdict.stop:
        folder.arrays("gate.npz", {**maps, "metric_mask": surface.metric_mask, "pitch_mm": surface.grid.pitch_mm})


def save_plan(folder: RunFolder, recipe: Recipe, plan: Plan, solved: Solved) -> None:
    """Program, dwell and arrays of a plan, in the part's frame."""
    program = steps.in_part_frame(recipe, plan.program)
    if solved.curve:
        folder.json("curve.json", list(solved.curve))
    folder.bytes("program.rnc", plan.program.text)
    folder.table(
        "dwell.csv",
        {
            "point": np.arange(program.n),
            "line": program.line,
            "x_mm": program.end_mm[:, 0],
            "y_mm": program.end_mm[:, 1],
            "dwell_s": solved.dwell.time_s,
            "asked_s": solved.asked_s,
            "expected_s": plan.expected_time_s,
        },
    )
    folder.arrays("plan.npz", plan_arrays(recipe, plan, solved))


def plan_arrays(recipe: Recipe, plan: Plan, solved: Solved) -> Arrays:
    """A plan's arrays, in the part's frame: see docs/run-folder.md."""
    program = steps.in_part_frame(recipe, plan.program)
    return {
        "block": plan.program.block,
        "time_s": solved.dwell.time_s,
        "asked_s": solved.asked_s,
        "expected_s": plan.expected_time_s,
        "lower_s": solved.dwell.lower_s,
        "compliance_um_per_n": solved.answer.compliance_um_per_n,
        "gamma": solved.answer.gamma,
        "start_mm": program.start_mm,
        "end_mm": program.end_mm,
        "predicted_removal_nm": plan.predicted_removal_nm,
        "residual_nm": solved.dwell.residual_nm,
        "curve_s": np.array([row["total_s"] for row in solved.curve]),
        "curve_nm": np.array([row["rms_nm"] for row in solved.curve]),
    }
