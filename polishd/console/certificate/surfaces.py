"""The first and the last map of a run, made again from their files as the daemon judged them: one surface, one figure.

The figures are those of the map's own samples over the clear aperture. They must be those of the journal; where they
cannot be made again, or come out otherwise, only the journal's are told, and why is said.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.profile import InstrumentProfile, load_profile
from polishd.console.certificate.sources import PROFILE, CertificateRun, Row, sha256_of
from polishd.hooks.loader import load_plugins
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.process import metrics
from polishd.process.absolute import AbsoluteTestResult, SystemMap
from polishd.process.registration.record import Registration
from polishd.recipe import figuring
from polishd.recipe.encoding import record_of
from polishd.recipe.files import read_map
from polishd.workbench.maps.figures import figured
from polishd.workbench.maps.report_figures import MapReportData, MapReportOptions, reported

SAME = 1e-6
"""Relative: figures that were made again from the same file may differ by so much, on another processor."""
HSF_MM = 0.12
TERMS = 36
E_LINE_NM = 546.07


@dataclass(frozen=True, slots=True)
class ReconstructedMap:
    """A map with all its figures."""

    cycle: int
    reported: MapReportData
    figure_nm: FloatArray
    """(ny, nx) on the map's own samples, without what is alignment; NaN outside the clear aperture."""
    clear: BoolArray
    """(ny, nx) the clear aperture there."""
    pitch_mm: float
    source: SurfaceMap
    """As its file gives it."""

    def beyond_nm(self, cutoff_mm: float) -> float:
        """RMS of the periods below that."""
        return float(metrics.split_bands(self.figure_nm, self.clear, self.pitch_mm, (cutoff_mm,))[1][self.clear].std())


def profile_of(run: CertificateRun) -> InstrumentProfile | None:
    """The instrument's, as it was; None where the cell named none."""
    path = run.path / PROFILE
    return load_profile(path) if path.exists() else None


class MapReconstructor:
    """Makes maps of one run again, and keeps the reasons of what cannot be."""

    def __init__(self, run: CertificateRun, wavelength_nm: float) -> None:
        self.left_out: list[str] = []
        self._run = run
        self._terms = run.rows.terms
        self._wavelength_nm = wavelength_nm
        self._readers = load_plugins(self._terms["plugins.load"]).surface_readers()

    def surface(self, measured: Row) -> ReconstructedMap | None:
        """That measurement's map; None, with the reason kept, where it cannot be had."""
        name = f"cycle-{measured['cycle']:02d}"
        try:
            found = self._found(measured)
        except PolishdError as error:
            self.left_out.append(f"figures of the map in {name}: {error}")
            return None
        if wrong := _otherwise(found, measured["stats"]):
            self.left_out.append(f"figures of the map in {name}: {wrong}")
            return None
        self.left_out += [f"{name}: {reason}" for reason in found.reported.answer["left_out"]]
        return found

    def _found(self, measured: Row) -> ReconstructedMap:
        run, cycle, stats = self._run, measured["cycle"], measured["stats"]
        path = run.file(cycle, "map")
        if path is None:
            raise ConfigError(f"{run.cycle(cycle)}: the map's file is not there")
        profile = profile_of(run)
        instrument = None if profile is None else profile.instrument
        source = read_map(path, self._readers.values())
        lies = record_of(Registration, stats.get("registration") or {})
        lying = figuring.map_on_part(source, instrument, self._system(profile, stats.get("system") or ""))
        clean, _ = figuring.of_part(lying, self._terms["instrument.spike_mads"], self._nominal(), lies)
        grid, mask = _aperture(run, cycle)
        alignment = self._terms["part.alignment"]
        figure, clear = figuring.figure_of(clean, grid, mask, lies, alignment)
        lsf_mm = float(self._terms["job.lsf_period_mm"])
        edges = (lsf_mm, HSF_MM) if lsf_mm > HSF_MM else (lsf_mm,)
        asked = MapReportOptions(self._wavelength_nm, "fringe", TERMS, alignment=alignment)
        made = reported(figured(clean.with_height(figure), 0, edges, alignment), asked)
        return ReconstructedMap(cycle, made, figure, clear, clean.grid.pitch_mm, source)

    def _nominal(self) -> SurfaceMap | None:
        named = self._terms.get("part.nominal")
        if not named:
            return None
        path = self._named(named["file"], named["sha256"], "the form wanted (part.nominal)")
        return read_map(path, self._readers.values())

    def _system(self, profile: InstrumentProfile | None, sha256: str) -> SystemMap | None:
        if not sha256:
            return None
        if profile is None or profile.system is None:
            raise ConfigError(f"{PROFILE}: does not name the system map that was taken off ({sha256[:12]}…)")
        path = self._named(profile.system.map, sha256, "the instrument's system map")
        surface = read_map(path, self._readers.values())
        if surface.history is None:
            raise ConfigError(f"{path}: does not say how sure its terms are")
        return SystemMap(surface, AbsoluteTestResult.load(surface.history.options["told"]))

    def _named(self, name: str, sha256: str, what: str) -> Path:
        """A file that lies beside the cell or its profile: found by its name, believed by its content."""
        cell = self._run.cell
        places = [self._run.path / name, Path(name)]
        if cell is not None:
            places.append(cell.resolve(name))
            places += [] if cell.profile_path is None else [cell.profile_path.parent / name]
        for path in places:
            if path.is_file() and sha256_of(path) == sha256:
                return path
        raise ConfigError(
            f"{what}, {name} (sha256 {sha256[:12]}…), is not at hand; put it into the run folder, or name CELL.toml"
        )


def _aperture(run: CertificateRun, cycle: int) -> tuple[Grid, BoolArray]:
    """The process grid, and the clear aperture on it."""
    path = run.cycle(cycle) / "surface.npz"
    surface = run.surface(cycle)
    if surface is None:
        raise ConfigError(f"{path}: is not there, or cannot be read: nobody knows the clear aperture")
    ny, nx = surface.height_nm.shape
    return Grid(ny, nx, surface.pitch_mm), surface.metric_mask


def _otherwise(found: ReconstructedMap, stats: Mapping[str, Any]) -> str:
    """In what a map that was made again is not what the journal says of it; empty where it is."""
    bands = found.reported.answer["bands"]
    made = {
        "rms_nm": found.reported.answer["rms_nm"],
        "pv_nm": found.reported.answer["pv_nm"],
        "lsf_rms_nm": bands[0]["rms_nm"] if bands else math.nan,
        "samples": int(np.count_nonzero(found.clear)),
    }
    apart = [
        f"{key} comes out as {value:.9g}, and the journal has {stats[key]:.9g}"
        for key, value in made.items()
        if value is not None and not math.isclose(value, stats[key], rel_tol=SAME, abs_tol=SAME)
    ]
    return f"{'; '.join(apart)}: another polishd measured it" if apart else ""


def as_one_source(found: ReconstructedMap, stats: Mapping[str, Any]) -> ReconstructedMap:
    """The same with the journal's own digits of the figures that it has: no figure is told twice."""
    answer = dict(found.reported.answer)
    answer |= {key: stats[key] for key in ("rms_nm", "pv_nm")}
    if answer["bands"]:
        answer["bands"] = [{**answer["bands"][0], "rms_nm": stats["lsf_rms_nm"]}, *answer["bands"][1:]]
    return replace(found, reported=replace(found.reported, answer=answer))
