"""``polishd map absolute``: separate the instrument's own error from the part, by turned and shifted maps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from polishd.maps.arithmetic import draw_maps
from polishd.maps.convert import require_target, store, stored_lines
from polishd.maps.map_files import (
    MapSource,
    distinguish_names,
    history_step,
    mask_lines,
    mask_records,
    printable,
    require_picture,
)
from polishd.maps.options import AbsoluteOptions
from polishd.maps.stitch import one_pitch, require_lines
from polishd.model.errors import ConfigError, MapError
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.metrology.absolute_poses import PartPose, family_names, reference_for, term_name
from polishd.process.metrology.absolute_test import (
    AbsoluteSolution,
    AbsoluteTestResult,
    PlaceError,
    separate_instrument,
)
from polishd.process.metrology.instrument import same_system
from polishd.process.metrology.statistics import pv_rms
from polishd.rendering.terminal import emit, figure_table

LISTED = 4
"""Radial order up to which the table lists each term."""
OFF_PX = 2.0
"""Distance between the middle of a map's data and its pose above which a note is made."""
WORSE = 5.0
"""Ratio of the terms' noise to the samples' noise above which a note is made."""
MOUNT = (
    "what turns with the part, as a mount's print or its clamping, counts as part; what does not, as gravity, counts "
    "as instrument"
)
SHIFTED = "a part that is no flat and no sphere shows coma where it is shifted, which counts as instrument"
SENSELESS = "these maps fit angles of either sense: see on a mark that the part turned counter-clockwise as displayed"


@dataclass(frozen=True, slots=True)
class AbsoluteTestOutput:
    """Separated maps of part and instrument."""

    found: AbsoluteSolution
    instrument: SurfaceMap
    part: SurfaceMap
    answer: dict[str, Any]
    """Answer for ``--json``."""

    def show(self, *, as_json: bool, more: Sequence[str] = ()) -> None:
        """Print the result on stdout; for people with ``more`` lines below."""
        lines = [*_lines(self.answer), *more]
        emit(self.answer, as_json=as_json, table=lambda: _table(self.answer), lines=lines)


def absolute_verb(files: Sequence[Path], asked: AbsoluteOptions, *, as_json: bool) -> None:
    """Separate part and instrument, and write both on request."""
    source = MapSource.by(asked, system=False)  # the system error is the result here
    _require_targets(files, asked, source)
    poses = poses_of(asked, files)
    apart = separate_maps([source.read(path) for path in files], poses, asked, source)
    targets = (("instrument", apart.instrument, asked.out_instrument), ("part", apart.part, asked.out_part))
    for key, surface, target in targets:
        if target is not None:
            apart.answer[key] |= store(surface, target, source)
    stored = any("out" in apart.answer[key] for key, _, _ in targets)
    apart.show(as_json=as_json, more=[] if stored else ["not written: --out-instrument S.x3p would"])
    if asked.picture is not None:
        drawn = [replace(apart.instrument, path=Path("instrument")), replace(apart.part, path=Path("part"))]
        draw_maps(asked.picture, drawn, as_json=as_json)


def separate_maps(
    surfaces: Sequence[SurfaceMap], poses: Sequence[PartPose], asked: AbsoluteOptions, source: MapSource
) -> AbsoluteTestOutput:
    """Separate part and instrument of maps in memory. MapError."""
    axis = None if asked.axis is None else _numbers("--axis", asked.axis, 2)
    pitch = one_pitch(surfaces)
    _require_one_instrument(surfaces)
    found = separate_instrument(
        [one.height_nm for one in surfaces],
        poses,
        pitch,
        degree=asked.order,
        axis_px=None if axis is None else _pixel(axis, surfaces[0], pitch),
        noise_nm=asked.noise,
        place=PlaceError(asked.angle_error, asked.shift_error),
    )
    names = distinguish_names([one.path or f"map {number}" for number, one in enumerate(surfaces, 1)])
    answer = _answer(found, names, pitch)
    answer["masks"] = [{"path": str(one.path), "masks": mask_records(one)} for one in surfaces if one.masks]
    return AbsoluteTestOutput(found, *_made(surfaces, names, found, source), answer)


def _require_targets(files: Sequence[Path], asked: AbsoluteOptions, source: MapSource) -> None:
    targets = [target for target in (asked.out_instrument, asked.out_part) if target is not None]
    for target in targets:
        require_target(target, files, source, force=asked.force)
    if len({target.absolute() for target in targets}) < len(targets):
        raise ConfigError(f"{targets[0]}: is named by --out-instrument and --out-part; name two files")
    require_picture(asked.picture)


def poses_of(asked: AbsoluteOptions, files: Sequence[Path]) -> list[PartPose]:
    """Pose of each file, from the options or the list; without files, one for each angle."""
    if (asked.angles is None) == (asked.at is None) or (asked.at is not None and asked.shifts is not None):
        raise typer.BadParameter("give the part's poses by --angles (with --shifts where it was shifted), or by --at")
    if asked.at is not None:
        from polishd.config.table_files import read_poses

        listed = read_poses(asked.at)
        require_lines(files, listed, asked.at, "file,angle_deg")
        return [PartPose(*listed[path.name]) for path in files]
    count = len(files) or len((asked.angles or "").split(","))
    angles = _numbers("--angles", asked.angles or "", count)
    words = (asked.shifts or ":".join(["0,0"] * count)).split(":")
    if len(words) != count:
        raise typer.BadParameter(f"--shifts has {len(words)} shifts for {count} maps: x,y of each, with : between")
    shifts = [_numbers("--shifts", word, 2) for word in words]
    return [PartPose(angle, *shift) for angle, shift in zip(angles, shifts, strict=True)]


def _numbers(option: str, text: str, count: int) -> list[float]:
    """Parse this number of finite values, separated by commas."""
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise typer.BadParameter(f"{option} {text!r}: {count} numbers with commas between, one a map or coordinate")
    return values


def _pixel(axis_mm: Sequence[float], surface: SurfaceMap, pitch_mm: float) -> tuple[float, float]:
    """(row, column) of a position in mm from the map's center."""
    rows, columns = surface.height_nm.shape
    return (rows - 1) / 2 - axis_mm[1] / pitch_mm, (columns - 1) / 2 + axis_mm[0] / pitch_mm


def _require_one_instrument(surfaces: Sequence[SurfaceMap]) -> None:
    first = surfaces[0]
    for one in surfaces:
        if one.instrument and first.instrument and not same_system(one.instrument, first.instrument):
            raise MapError(f"{one.path} is of the instrument {one.instrument!r}, {first.path} of {first.instrument!r}: "
                         "their errors differ; give maps of one instrument")  # fmt: skip


def _answer(found: AbsoluteSolution, names: Sequence[str], pitch_mm: float) -> dict[str, Any]:
    design, solution = found.design, found.solution
    rows, columns = found.instrument_nm.shape
    row, column, _ = found.circle_px
    share = {(one.n, one.m): one.share for one in design.unknown}
    terms = [
        {"n": n, "m": m, "name": term_name(n, m), "instrument_nm": float(own), "sigma_nm": float(sigma),
         "part_nm": float(part), "unknown": share.get((n, m), 0.0)}
        for (n, m), own, sigma, part in zip(
            design.terms, solution.instrument_nm, found.sigma_nm, solution.part_nm, strict=True)
    ]  # fmt: skip
    angles = sorted({pose.angle_deg for pose in design.poses})
    return {
        "maps": [
            {"name": name, "angle_deg": pose.angle_deg, "shift_mm": [pose.x_mm, pose.y_mm], "left_nm": left}
            for name, pose, left in zip(names, design.poses, found.left_nm, strict=True)
        ],
        "order": design.degree,
        "terms": terms,
        "unknown": family_names(share),
        "demanded": {family_names([term])[0]: reference_for(*term, angles) for term in share},
        "noise_nm": found.noise_nm,
        "rest_noise_nm": found.rest_noise_nm,
        "hidden_share": found.hidden_share,
        "hidden_rest_nm": found.hidden_rest_nm,
        "misfit": found.misfit,
        "sense_told": found.sense,
        "sample_uncertainty_nm": found.uncertainty_nm,
        "axis_mm": [(column - (columns - 1) / 2) * pitch_mm, ((rows - 1) / 2 - row) * pitch_mm],
        "radius_mm": design.radius_mm,
        "rows": rows,
        "cols": columns,
        "pitch_mm": pitch_mm,
        "instrument": _figures(found.instrument_nm),
        "part": _figures(found.part_nm),
        "notes": _notes(found, names, pitch_mm),
    }


def _figures(height_nm: FloatArray) -> dict[str, Any]:
    there = np.isfinite(height_nm)
    pv, rms = pv_rms(height_nm, there)
    return {"samples": int(np.count_nonzero(there)), "pv_nm": pv, "rms_nm": rms}


def _notes(found: AbsoluteSolution, names: Sequence[str], pitch_mm: float) -> list[str]:
    notes = [MOUNT]
    if any(pose.x_mm or pose.y_mm for pose in found.design.poses):
        notes.append(SHIFTED)
    if not found.sense:
        notes.append(SENSELESS)
    off = [f"{name} {away:.3g} mm" for name, away in zip(names, found.decentre_mm, strict=True)
           if away > OFF_PX * pitch_mm]  # fmt: skip
    if found.rest_noise_nm is not None and found.noise_nm > WORSE * found.rest_noise_nm:
        notes.append(f"terms differ from map to map by {found.noise_nm / found.rest_noise_nm:.2g} times what samples "
                     "do: angles or shifts are wrong, the set-up drifted, or the air moved")  # fmt: skip
    if off:
        notes.append(f"the middle of the data is not where the pose puts it: {', '.join(off)}; see the shifts' signs, "
                     "the axis and the masks")  # fmt: skip
    return notes


def _made(
    surfaces: Sequence[SurfaceMap], names: Sequence[str], found: AbsoluteSolution, source: MapSource
) -> tuple[SurfaceMap, SurfaceMap]:
    """Maps of instrument and part, with the properties of the first map and the newest date."""
    times = [one.measured_at for one in surfaces if one.measured_at is not None]
    whole = replace(surfaces[0], taken_at=max(times, default=None), date_from="header", fiducials_px=(), masks=())
    unknown = family_names((one.n, one.m) for one in found.design.unknown)
    said: dict[str, Any] = {
        "poses": [f"{name} {pose}" for name, pose in zip(names, found.design.poses, strict=True)],
        "order": found.design.degree,
    }
    inputs = [("map", one) for one in surfaces]
    instrument = replace(whole, part_id="").with_height(found.instrument_nm)
    part = whole.with_height(found.part_nm)
    own = {"result": "instrument", "without": unknown, "terms": AbsoluteTestResult.of(found).facts()}
    return (
        history_step(instrument, "absolute", inputs, source, found.uncertainty_nm, **said, **own),
        history_step(part, "absolute", inputs, source, **said, result="part", holds_of_the_instrument=unknown),
    )


def _table(answer: Mapping[str, Any]) -> Table:
    low = sorted((one for one in answer["terms"] if one["n"] <= LISTED), key=lambda one: (one["n"], abs(one["m"])))
    rows = [(one["name"], _nm(one["instrument_nm"]), _sure(one), _nm(one["part_nm"])) for one in low]
    above = [one for one in answer["terms"] if one["n"] > LISTED]
    if above:
        sums = (math.hypot(*(one[key] for one in above)) for key in ("instrument_nm", "sigma_nm", "part_nm"))
        own, sigma, part = (f"{value:.4f}" for value in sums)
        rows.append((f"orders {LISTED + 1} to {answer['order']}, RMS", own, sigma, part))
    return figure_table("absolute", ("term, nm RMS", "instrument", "sigma", "part"), rows)


def _nm(value: float) -> str:
    return f"{round(value, 4) + 0.0:+.4f}"


def _sure(term: Mapping[str, Any]) -> str:
    if term["unknown"] > 0.5:
        return "unknown"
    mixed = f" and {term['unknown']:.0%} unknown" if term["unknown"] else ""
    return f"{term['sigma_nm']:.4f}{mixed}"


def _lines(answer: Mapping[str, Any]) -> list[str]:
    masked = answer["masks"]
    figures = (f"{what}: PV {answer[what]['pv_nm']:.3f}, RMS {answer[what]['rms_nm']:.3f} nm over "
               f"{answer[what]['samples']} samples" for what in ("instrument", "part"))  # fmt: skip
    left = ", ".join(f"{one['name']} {one['left_nm']:.3f}" for one in answer["maps"])
    unknown = ", ".join(answer["unknown"]) or "nothing"
    rest = answer["hidden_rest_nm"]
    needs = dict.fromkeys(answer["demanded"].values())
    wanted = {what: [name for name, need in answer["demanded"].items() if need == what] for what in needs}
    lines = [
        *mask_lines(distinguish_names([record["path"] for record in masked]), masked),
        *figures,
        f"terms that neither explains, nm RMS: {left}",
        f"noise {answer['noise_nm']:.4f} nm a sample",
        f"a sample of the instrument's map is known to {answer['sample_uncertainty_nm']:.4f} nm, less what is unknown",
        f"unknown, and left in the part: {unknown}",
        f"and of waves above order {answer['order']} {answer['hidden_share']:.0%} in square, {rest:.3f} nm RMS",
        *(f"needs {what}: {', '.join(names)}" for what, names in wanted.items()),
        *(f"note: {printable(note)}" for note in answer["notes"]),
    ]
    stored = [line for what in ("instrument", "part") if "out" in answer[what] for line in stored_lines(answer[what])]
    return [*lines, *stored]
