"""Makes a report of a folder: draws what can be drawn, says what cannot, and writes pictures and page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from polishd.files import write_atomic
from polishd.plugins.run_report import along_path, maps, trend
from polishd.plugins.run_report.folder import Cycle, ReportSurface, RunFolderReader, read_folder
from polishd.plugins.run_report.page import ReportSection, render
from polishd.show import words
from polishd.show.sheet import Picture
from polishd.show.style import png, polishd_style

PAGE = "report.html"
PICTURES = "pictures"

LSF_PERIOD_MM = 33.0
"""Where the summary does not say."""


def write_report(run_dir: Path) -> Path:
    """Write ``pictures/*.png`` and ``report.html`` into a run or plan folder; returns the page's path."""
    folder = read_folder(run_dir)
    album = Album(run_dir / PICTURES, folder.missing)
    with polishd_style():
        sections = [
            whole_run(folder, album),
            *(cycle_section(folder, index, album) for index in range(len(folder.cycles))),
        ]
    target = run_dir / PAGE
    write_atomic(target, render(folder, sections).encode())
    return target


@dataclass(slots=True)
class Album:
    """Draws pictures one at a time and keeps them as files; one that cannot be drawn is listed as missing."""

    folder: Path
    missing: list[str]
    pictures: list[Picture] = field(default_factory=list)

    def add(self, name: str, caption: str, draw: Callable[[], Figure], *, wide: bool = True) -> None:
        """Draw, save as ``name.png``, and remember for the next ``take``."""
        try:
            content = png(draw())
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            self.missing.append(f"picture {name}: {type(error).__name__}: {error}")
            return
        self.folder.mkdir(exist_ok=True)
        write_atomic(self.folder / f"{name}.png", content)
        self.pictures.append(Picture(name, caption, content, wide=wide))

    def take(self) -> tuple[Picture, ...]:
        """The pictures since the last ``take``."""
        taken, self.pictures = tuple(self.pictures), []
        return taken


def whole_run(folder: RunFolderReader, album: Album) -> ReportSection:
    """Pictures of all measurements together; a plan has only one, and its spectrum."""
    rows = folder.rows()
    tolerance = folder.summary.get("tolerance_nm") or words.rms_limit(rows)
    surfaces = [(words.measurement(rows, index).capitalize(), surface) for index, surface in measured(folder)]
    period = folder.summary.get("tolerance_period_mm") or 0.0
    if len(surfaces) > 1:
        caption = (
            "All measurements on the first one's colour scale, averaged onto the process grid: the RMS above a picture "
            "is without noise and raster ripple, the table's is of the map itself. Outlined: the clear aperture."
        )
        album.add("overview", caption, lambda: maps.overview(surfaces))
    if len(rows) > 1:
        caption = "Measured RMS, and what each plan predicted for the measurement after it."
        album.add("trend", caption, lambda: trend.rms_per_measurement(rows, tolerance, period), wide=False)
    if surfaces:
        lsf_mm = float(folder.summary.get("lsf_period_mm") or LSF_PERIOD_MM)
        caption = f"Averaged over directions; edge tapered. Figure (LSF) is left of the dotted line at {lsf_mm:g} mm."
        album.add("psd", caption, lambda: trend.spectra(surfaces, lsf_mm), wide=False)
    return ReportSection("The whole run" if not folder.planned else "Surface", "", album.take())


def measured(folder: RunFolderReader) -> list[tuple[int, ReportSurface]]:
    """Cycles whose map can be shown, with their index."""
    return [(index, cycle.surface) for index, cycle in enumerate(folder.cycles) if cycle.surface is not None]


def cycle_section(folder: RunFolderReader, index: int, album: Album) -> ReportSection:
    """One cycle: a pass between two measurements, or a measurement that no pass followed."""
    cycle = folder.cycles[index]
    if cycle.plan is None:
        last_measurement(folder, index, album)
        at = words.measurement(folder.rows(), index)
        return ReportSection(
            f"Measurement {at if index else 'at the start'}", cycle.name, album.take(), None, cycle.files
        )
    after = folder.cycles[index + 1].surface if index + 1 < len(folder.cycles) else None
    surface_pictures(cycle, after, album)
    path_pictures(folder, index, album)
    title = "Plan" if folder.planned else words.pass_after(folder.rows(), index)
    return ReportSection(title, "" if folder.planned else cycle.name, album.take(), cycle.certificate, cycle.files)


def last_measurement(folder: RunFolderReader, index: int, album: Album) -> None:
    """The map that ended the run."""
    surface = folder.cycles[index].surface
    if surface is not None:
        first = measured(folder)[0][1]
        caption = "The same map on the first map's colour scale and on its own."
        album.add(f"{folder.cycles[index].name}-maps", caption, lambda: maps.measured_only(surface, first))


def surface_pictures(cycle: Cycle, after: ReportSurface | None, album: Album) -> None:
    """Maps before and after the pass; where no map followed, the predicted residual stands in."""
    before = cycle.surface
    if before is None:
        album.missing.append(f"{cycle.name}: no map, so nothing to compare with")
        return
    if after is None:
        caption = (
            "Measured before the pass, and what the plan predicts after it, on one colour scale and on its own. "
            "No map follows."
        )
        album.add(
            f"{cycle.name}-maps", caption, lambda: maps.before_and_after(before, predicted(cycle, before), "Predicted")
        )
        return
    caption = (
        "Measured before and after the pass on one colour scale, and after it on its own. Outlined: the clear aperture."
    )
    album.add(f"{cycle.name}-maps", caption, lambda: maps.before_and_after(before, after, "After"))
    caption = "What the plan said would remain, what the next map shows, and the difference, on one colour scale."
    album.add(f"{cycle.name}-prediction", caption, lambda: maps.prediction(cycle, after))


def predicted(cycle: Cycle, before: ReportSurface) -> ReportSurface:
    """The plan's residual as if it had been measured."""
    return ReportSurface(maps.residual_of(cycle), before.metric_mask, before.pitch_mm)


def path_pictures(folder: RunFolderReader, index: int, album: Album) -> None:
    """What varies along the path. Compliance is shown again only where it differs from the cycle before."""
    cycle = folder.cycles[index]
    plan = cycle.plan
    if plan is None:
        return
    earlier = folder.cycles[index - 1].plan if index else None
    keys = ("compliance_um_per_n", "gamma")
    if earlier is None or not all(np.array_equal(plan.get(key), earlier.get(key)) for key in keys):  # type: ignore[arg-type]
        caption = "What the robot's compliance does to the depth of contact, along the path and over the part."
        album.add(f"{cycle.name}-compliance", caption, lambda: along_path.compliance_and_gamma(plan))
    caption = "Solved dwell over the part (values above the 99.5th percentile in the last colour), and its spread."
    album.add(f"{cycle.name}-dwell", caption, lambda: along_path.dwell(plan))
    if plan.get("curve_s", np.empty(0)).size:
        caption = "Each point is an optimum with a certificate of its own; more time buys less and less."
        stand = float(plan["time_s"].sum()), float((cycle.certificate or {}).get("predicted_rms_nm", np.nan))
        curve = plan["curve_s"], plan["curve_nm"]
        album.add(f"{cycle.name}-curve", caption, lambda: trend.residual_against_time(*curve, *stand), wide=False)
    if cycle.executed is None:
        return
    done_s = cycle.executed.per_point(plan)
    if done_s is None:
        blocks = cycle.executed.seq.size
        album.missing.append(
            f"{cycle.name}: {blocks} blocks in contact were executed, {plan['expected_s'].size} planned"
        )
        return
    caption = "Time that the robot took beside the time that the plan expected of it."
    album.add(f"{cycle.name}-executed", caption, lambda: along_path.executed(plan, done_s))
