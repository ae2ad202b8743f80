"""The TIF and the compliance of a cell, as tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from rich.table import Table

from polishd.config.cell import CellConfig, load_config
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.pipeline import steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.plugin_loader import load_cell
from polishd.process.removal.contact import hertz_depth_mm
from polishd.process.removal.measured_tif import SpotFigures, map_nm_s, measured_figures, spot_figures
from polishd.process.robot.compliance import ComplianceField, compliance_field, depth_ratio, path_compliance
from polishd.process.robot.placement import PlacementSearch, PlacementTask, placement_fragment, search_placement
from polishd.rendering.map_plots import color_bar, profiles, value_map
from polishd.rendering.plots import BLUE, ORANGE, figure, png, polishd_style, save_picture
from polishd.rendering.terminal import emit, key_table

# Pictures of the physics: a removal spot with its profiles, the compliance over the workspace and along a program.

PANEL_IN = 2.9


def spot_picture(figures: SpotFigures, spot: tuple[FloatArray, FloatArray], title: str) -> bytes:
    """PNG: the spot in the tool's frame, and its two profiles; ``spot`` is (m,) mm and (m, m) nm/s, row 0 the top."""
    with polishd_style():
        page = figure(7.6, 3.4)
        left, right = page.subplots(1, 2)
        x, rate = spot
        value_map(left, rate, float(x[1] - x[0]), title, "nm/s")
        left.set_ylabel("y (direction of the spindle's tilt), mm")
        lines = {
            "along x": (figures.x_mm, figures.profile_x_nm_s),
            "along y": (figures.y_mm, figures.profile_y_nm_s),
        }
        profiles(right, lines, "profiles through the center", ylabel="nm/s")
        right.set_ylim(0, None)
        return png(page)


def compliance_picture(field: ComplianceField, program: tuple[FloatArray, FloatArray] | None) -> bytes:
    """PNG: a panel for each plane of the workspace; below, compliance and gamma along a program (both (n,))."""
    with polishd_style():
        count = len(field.z_mm)
        page = figure(max(PANEL_IN * count, 6.0), 3.1 * (1 if program is None else 2))
        parts = page.subfigures(1 if program is None else 2, 1, squeeze=False)[:, 0]
        _planes(parts[0], field)
        if program is not None:
            _along(parts[1].subplots(), *program)
        return png(page)


def _planes(part: Any, field: ComplianceField) -> None:
    panels = part.subplots(1, len(field.z_mm), squeeze=False)[0]
    scale = float(np.nanmin(field.compliance_um_per_n)), float(np.nanmax(field.compliance_um_per_n))
    extent_mm = (field.x_mm[0], field.x_mm[-1], field.y_mm[0], field.y_mm[-1])
    images = []
    for axes, plane, z in zip(panels, field.compliance_um_per_n, field.z_mm, strict=True):
        look: dict[str, Any] = {"scale": scale, "extent_mm": extent_mm, "bar": False}
        images.append(value_map(axes, plane[::-1], 1.0, f"z = {z:.0f} mm", **look))
        if axes is not panels[0]:
            axes.set_ylabel("")
    color_bar(images, "um/N")


def _along(axes: Axes, compliance_um_per_n: FloatArray, gamma: FloatArray) -> None:
    axes.plot(compliance_um_per_n, color=BLUE)
    axes.set(title="along the program", xlabel="timed point")
    axes.set_ylabel("um/N", color=BLUE)
    other = axes.twinx()
    other.plot(gamma, color=ORANGE)
    other.set_ylabel("gamma", color=ORANGE)


# ``polishd tif`` and ``polishd compliance``: removal and compliance of a cell.

PICTURE_SAMPLES = 120
"""Samples across the picture of a spot."""


def tif_verb(cell: Path, ratio: float, out: Path | None, *, as_json: bool) -> None:
    """Show the TIF of the cell's process at a depth ratio, or its measured TIF if the cell uses one."""
    config = load_config(cell)
    process, tif = config.tool_process(), config.measured_tif()
    if tif is not None and config.process.removal_model == "measured_tif":
        figures = measured_figures(tif, process)
        side = (np.arange(tif.rate_nm_s.shape[1]) - (tif.rate_nm_s.shape[1] - 1) / 2) * tif.pitch_mm
        ratio, spot = tif.depth_ratio, (side, tif.rate_nm_s)
    else:
        figures = spot_figures(process, ratio)
        spot = map_nm_s(process, ratio, 2 * figures.contact_radius_mm / PICTURE_SAMPLES)
    if out is not None:
        save_picture(out, spot_picture(figures, spot, f"TIF at gamma {ratio:g}"))
    plain = ("depth_mm", "contact_radius_mm", "peak_pressure_mpa", "peak_nm_s", "volume_mm3_min")
    answer = {
        "depth_ratio": ratio,
        **{name: getattr(figures, name) for name in plain},
        "dissipative_fraction": figures.dissipative_fraction,
        "m_shaped": figures.m_shaped,
        "profile_x": {"x_mm": figures.x_mm, "rate_nm_s": figures.profile_x_nm_s},
        "profile_y": {"y_mm": figures.y_mm, "rate_nm_s": figures.profile_y_nm_s},
    }
    emit(answer, as_json=as_json, table=lambda: _tif_table(config, figures, ratio), lines=_file_lines(out))


def _file_lines(out: Path | None) -> list[str]:
    return [] if out is None else [f"written to {out}"]


def _tif_table(config: CellConfig, figures: SpotFigures, ratio: float) -> Table:
    shape = "M-shaped" if figures.m_shaped else "one maximum"
    rows = [
        ("removal model", config.process.removal_model),
        ("gamma", f"{ratio:g}"),
        ("depth", f"{figures.depth_mm:.5f} mm"),
        ("contact radius", f"{figures.contact_radius_mm:.4f} mm"),
        ("peak pressure", f"{figures.peak_pressure_mpa:.4f} MPa"),
        ("peak", f"{figures.peak_nm_s:.4g} nm/s"),
        ("volume", f"{figures.volume_mm3_min:.4g} mm3/min"),
        ("dissipative fraction", f"{figures.dissipative_fraction:.3g} (shift of the pressure / contact radius)"),
        ("x profile", f"{shape}; the axis meets the part {figures.pole_mm:.3g} mm from the center"),
    ]
    return key_table(f"{config.cell.name}: TIF", rows)


def compliance_verb(cell: Path, program: Path | None, out: Path | None, *, as_json: bool) -> None:
    """Show the compliance over the workspace and, if a program is given, along it."""
    config, hooks = load_cell(cell)
    field = compliance_field(
        config.robot_model(), config.tool_process(), config.placement(), config.compliance_options()
    )
    answer: dict[str, Any] = {
        "workspace": {
            **_ranges(field.compliance_um_per_n, field.gamma),
            "places": field.places,
            "out_of_reach": field.out_of_reach,
            "undefined": field.undefined,
        }
    }
    rows = _workspace_rows(answer["workspace"])
    along = None
    if program is not None:
        recipe = make_recipe(config, hooks)
        read = steps.executed_surface(recipe, steps.read_program(recipe, program))
        found = path_compliance(
            read, recipe.process, recipe.robot, recipe.placement, options=recipe.options, optic=recipe.optic
        )
        gamma = depth_ratio(found.compliance_mm_per_n, recipe.process, hertz_depth_mm(recipe.process))
        along = (found.compliance_mm_per_n * 1e3, gamma)
        answer["program"] = {
            "name": read.name,
            "points": len(gamma),
            **_ranges(*along),
            "jumps": found.jumps,
            "fallbacks": found.fallbacks,
        }
        rows += [*_program_rows(answer["program"]), *(("note", note) for note in found.notes)]
    if out is not None:
        save_picture(out, compliance_picture(field, along))
    title = f"{config.cell.name}: compliance ({config.compliance.projection})"
    emit(answer, as_json=as_json, table=lambda: key_table(title, rows), lines=_file_lines(out))


def _ranges(compliance_um_per_n: FloatArray, gamma: FloatArray) -> dict[str, dict[str, float | None]]:
    return {"compliance_um_per_n": _range(compliance_um_per_n), "gamma": _range(gamma)}


def _range(values: FloatArray) -> dict[str, float | None]:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return dict.fromkeys(("min", "max", "mean"))
    return {"min": float(finite.min()), "max": float(finite.max()), "mean": float(finite.mean())}


def _workspace_rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    rows = [
        ("over the workspace", f"{_range_text(found['compliance_um_per_n'])} um/N"),
        ("gamma there", _range_text(found["gamma"])),
        ("places", f"{found['places']}, {found['out_of_reach']} of them out of reach"),
    ]
    if found["undefined"]:
        rows.append(("undefined", f"{found['undefined']} places: eq. 41 as printed has complex eigenvalues there"))
    return rows


def _program_rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    compliance = f"{_range_text(found['compliance_um_per_n'])} um/N at {found['points']} timed points"
    return [(f"along {found['name']}", compliance), ("gamma there", _range_text(found["gamma"]))]


def _range_text(figures: Mapping[str, float | None]) -> str:
    if figures["mean"] is None:
        return "none"
    return f"{figures['min']:.3f} to {figures['max']:.3f}, mean {figures['mean']:.3f}"


# ``polishd compliance --place``: where the part lies best.

SHOWN = 3


def placement_verb(cell: Path, within_mm: float, removal_nm: float, out: Path | None, *, as_json: bool) -> None:
    """Search the place of the part at which gamma changes least over it, and say what that is worth."""
    config, _ = load_cell(cell)
    task = PlacementTask(
        robot=config.robot_model(),
        process=config.tool_process(),
        placement=config.placement(),
        options=config.compliance_options(),
        outline=config.outline(),
        alignment=config.part.alignment,
        optic=config.optic(),
        removal_nm=removal_nm,
    )
    found = search_placement(task, within_mm)
    if not found.reached:
        raise ComputeError(
            f"the robot reaches the part at none of {found.refused} places within {within_mm:g} mm, with "
            f"{task.margins.around_mm:g} mm around it. To do: move part.origin_mm, or search --within more"
        )
    if out is not None:
        save_picture(out, placement_picture(found))
    best = found.reached[0]
    fragment = placement_fragment(best, task.placement, task.robot)
    answer = {
        "present": None if found.present is None else asdict(found.present),
        "best": [asdict(one) for one in found.reached[:SHOWN]],
        "gain_nm": found.gain_nm,
        "removal_nm": removal_nm,
        "tried": len(found.reached) + found.refused,
        "refused": found.refused,
        "toml": fragment,
    }
    emit(
        answer,
        as_json=as_json,
        table=lambda: _placement_table(config, found),
        lines=[*_gain_lines(found), "", *fragment.splitlines(), *_file_lines(out)],
    )


def _placement_table(config: CellConfig, found: PlacementSearch) -> Table:
    table = Table(title=f"{config.cell.name}: where gamma changes least over the part")
    for head in ("place", "origin, mm", "part's turn", "flange's turn", "gamma, mean", "its range", "error, nm"):
        table.add_column(head, justify="left" if head == "place" else "right")
    rows = [("now", found.present), *((f"{k}.", one) for k, one in enumerate(found.reached[:SHOWN], 1))]
    for name, one in rows:
        if one is None:
            table.add_row(name, "out of reach with the margins", *[""] * 5)
            continue
        origin = ", ".join(f"{v:.6g}" for v in one.origin_mm)
        turns = f"{one.turn_deg:g} deg", f"{one.flange_turn_deg:g} deg"
        table.add_row(name, origin, *turns, f"{one.gamma_mean:.4f}", f"{one.gamma_range:.5f}", f"{one.error_nm:.4f}")
    return table


def _gain_lines(found: PlacementSearch) -> list[str]:
    heading = f"error: RMS that {found.removal_nm:g} nm mean removal without correction leaves of gamma's change"
    if found.gain_nm is None:
        return [heading]
    return [heading, f"the best place is worth {found.gain_nm:.4f} nm; with process.correction on, less than that"]


def placement_picture(found: PlacementSearch) -> bytes:
    """PNG: the places that keep the margins, seen from above, coloured by their error; the least lies on top."""
    with polishd_style():
        page = figure(5.6, 4.4)
        axes = page.subplots()
        x, y, _ = np.array([one.origin_mm for one in found.reached]).T
        error = np.array([one.error_nm for one in found.reached])
        order = np.argsort(-error)
        shown = axes.scatter(x[order], y[order], c=error[order], s=36, cmap="viridis")
        best = found.reached[0]
        axes.plot(*best.origin_mm[:2], "s", mfc="none", color=ORANGE, ms=12, label="best")
        if found.present is not None:
            axes.plot(*found.present.origin_mm[:2], "o", mfc="none", color=BLUE, ms=12, label="now")
        axes.set(title="places of the part, from above (the least error of each)", xlabel="x, mm", ylabel="y, mm")
        axes.set_aspect("equal", "datalim")
        axes.legend(loc="upper right")
        page.colorbar(shown, label="error, nm")
        return png(page)
