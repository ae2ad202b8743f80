"""Makes a report of a folder: draws what can be drawn, says what cannot, and writes pictures and page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
from jinja2 import Template
from matplotlib.figure import Figure

from polishd.rendering.document import Picture, templates
from polishd.rendering.plots import png, polishd_style
from polishd.reports import run_pictures, wording
from polishd.reports.run_pictures import write_gate
from polishd.reports.run_reader import Cycle, ReportSurface, RunFolderReader, read_folder
from polishd.reports.wording import VERDICTS, Verdict, duration, figure, plain, text, when
from polishd.util.array_stream import Message
from polishd.util.files import write_atomic
from polishd.util.worker_main import AnswerFunction

# The page: one HTML file with its style and pictures inside, by ``report.html.jinja``.


class Column(NamedTuple):
    """A column of the table of measurements."""

    key: str
    title: str
    unit: str
    shape: str


COLUMNS: Sequence[Column] = (
    Column("pv_nm", "PV", "nm", ".1f"),
    Column("rms_nm", "RMS", "nm", ".2f"),
    Column("lsf_rms_nm", "LSF RMS", "nm", ".2f"),
    Column("band_rms_nm", "band RMS", "nm", ".2f"),
    Column("predicted_rms_nm", "predicted", "RMS nm", ".2f"),
    Column("expected_low_nm", "expected", "from, nm", ".2f"),
    Column("expected_high_nm", "9 of 10", "to, nm", ".2f"),
    Column("dwell_s", "dwell", "s", ",.0f"),
    Column("executed_s", "executed", "s", ",.0f"),
    Column("rate", "learned", "rate", ".3f"),
)

CERTIFICATE: Mapping[str, str] = {
    "solver": "solver",
    "stopped": "stopped because",
    "kkt_residual": "KKT residual (relative)",
    "bound_violation_s": "bound violation (s)",
    "gap": "above the least objective, at most (relative)",
    "gap_nm": "the same (nm)",
    "objective": "objective (nm²)",
    "predicted_rms_nm": "predicted RMS (nm)",
    "predicted_pv_nm": "predicted PV (nm)",
    "piston_nm": "mean removal asked for (nm)",
    "dwell_total_s": "total dwell (s)",
    "at_lower": "points at their least time",
    "at_upper": "points at their most time",
    "iterations": "iterations",
    "seconds": "time to solve (CPU s)",
    "cross_check": "cross-checked by",
    "cross_check_gap": "gap to the cross-check (relative)",
    "cutoff_period_mm": "periods below it are out of reach of this spot (mm)",
    "notes": "notes",
}


@dataclass(frozen=True, slots=True)
class ReportSection:
    """A part of the page."""

    title: str
    folder: str
    pictures: tuple[Picture, ...]
    certificate: Mapping[str, Any] | None = None
    files: tuple[str, ...] = ()

    @property
    def certified(self) -> list[tuple[str, Any]]:
        """Names and values of the certificate, known fields first."""
        held = self.certificate or {}
        keys = dict.fromkeys([*(key for key in CERTIFICATE if key in held), *held])
        return [(CERTIFICATE.get(key, key), held[key]) for key in keys]


def render(folder: RunFolderReader, sections: Sequence[ReportSection]) -> str:
    """The whole page."""
    rows, outcome = folder.rows(), "planned" if folder.planned else text(folder.summary.get("outcome"))
    return _template().render(
        folder=folder,
        part=text(folder.summary.get("part_id")) or folder.path.name,
        verdict=VERDICTS.get(outcome) or Verdict("plain", outcome.replace("_", " ").capitalize()),
        facts=facts_of(folder),
        rows=rows,
        columns=[column for column in COLUMNS if any(figure(row.get(column.key), column.shape) for row in rows)],
        lines=wording.lines(rows),
        notes=notes_of(folder),
        sections=sections,
    )


@cache
def _template() -> Template:
    page = templates(Path(__file__).parent)
    page.filters |= {"figure": figure, "plain": plain, "quote": quote, "text": text}
    page.globals |= {name: getattr(wording, name) for name in ("measurement", "interrupted", "share")}
    return page.get_template("report.html.jinja")


def facts_of(folder: RunFolderReader) -> list[tuple[str, str]]:
    """Names and values for the header; empty values are left out."""
    summary, rows = folder.summary, folder.rows()
    period = summary.get("tolerance_period_mm") or 0
    judged = "band_rms_nm" if period else "rms_nm"
    measured = [figure(row.get(judged), ".2f") for row in (rows[:1] + rows[-1:] if len(rows) > 1 else rows)]
    tolerance = figure(summary.get("tolerance_nm"), "g")
    of_periods = f", periods > {period:g} mm" if period else ""
    return [
        (f"RMS{of_periods}", f"{' → '.join(measured)} nm" if measured else ""),
        ("predicted RMS", f"{figure(rows[0].get('predicted_rms_nm'), '.2f')} nm" if folder.planned and rows else ""),
        ("tolerance", f"{tolerance} nm" if tolerance else wording.tolerance(rows)),
        ("accepted", wording.accepted(summary, rows)),
        ("passes", "" if folder.planned or not rows else wording.passes(rows)),
        ("process time", duration(rows, "dwell_s" if folder.planned else "executed_s")),
        ("time on the wall", wording.spent(summary.get("phase_times_s"))),
        ("correction", text(summary.get("correction"))),
        ("outline", text(summary.get("outline"))),
        ("job", text(summary.get("job"))),
        ("started", when(summary.get("started"))),
        ("ended", when(summary.get("ended"))),
    ]


def notes_of(folder: RunFolderReader) -> list[str]:
    """The summary's notes, those of each measurement and of what was learned by it, and what was found in passes."""
    notes = [text(note) for note in folder.summary.get("notes") or []]
    for index, row in enumerate(folder.rows()):
        learned = folder.cycles[index].notes if index < len(folder.cycles) else ()
        notes += [f"measurement {index}: {text(note)}" for note in (*(row.get("notes") or ()), *learned)]
        notes += [f"{wording.pass_after(folder.rows(), index)}: {text(found)}" for found in row.get("found") or ()]
    return notes


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
    tolerance = folder.summary.get("tolerance_nm") or wording.rms_limit(rows)
    surfaces = [(wording.measurement(rows, index).capitalize(), surface) for index, surface in measured(folder)]
    period = folder.summary.get("tolerance_period_mm") or 0.0
    if len(surfaces) > 1:
        caption = (
            "All measurements on the first one's colour scale, averaged onto the process grid: the RMS above a picture "
            "is without noise and raster ripple, the table's is of the map itself. Outlined: the clear aperture."
        )
        album.add("overview", caption, lambda: run_pictures.overview(surfaces))
    if len(rows) > 1:
        caption = "Measured RMS, and what each plan predicted for the measurement after it."
        album.add("trend", caption, lambda: run_pictures.rms_per_measurement(rows, tolerance, period), wide=False)
    if surfaces:
        lsf_mm = float(folder.summary.get("lsf_period_mm") or LSF_PERIOD_MM)
        caption = f"Averaged over directions; edge tapered. Figure (LSF) is left of the dotted line at {lsf_mm:g} mm."
        album.add("psd", caption, lambda: run_pictures.spectra(surfaces, lsf_mm), wide=False)
    return ReportSection("The whole run" if not folder.planned else "Surface", "", album.take())


def measured(folder: RunFolderReader) -> list[tuple[int, ReportSurface]]:
    """Cycles whose map can be shown, with their index."""
    return [(index, cycle.surface) for index, cycle in enumerate(folder.cycles) if cycle.surface is not None]


def cycle_section(folder: RunFolderReader, index: int, album: Album) -> ReportSection:
    """One cycle: a pass between two measurements, or a measurement that no pass followed."""
    cycle = folder.cycles[index]
    if cycle.plan is None:
        last_measurement(folder, index, album)
        at = wording.measurement(folder.rows(), index)
        return ReportSection(
            f"Measurement {at if index else 'at the start'}", cycle.name, album.take(), None, cycle.files
        )
    after = folder.cycles[index + 1].surface if index + 1 < len(folder.cycles) else None
    surface_pictures(cycle, after, album)
    path_pictures(folder, index, album)
    title = "Plan" if folder.planned else wording.pass_after(folder.rows(), index)
    return ReportSection(title, "" if folder.planned else cycle.name, album.take(), cycle.certificate, cycle.files)


def last_measurement(folder: RunFolderReader, index: int, album: Album) -> None:
    """The map that ended the run."""
    surface = folder.cycles[index].surface
    if surface is not None:
        first = measured(folder)[0][1]
        caption = "The same map on the first map's colour scale and on its own."
        album.add(f"{folder.cycles[index].name}-maps", caption, lambda: run_pictures.measured_only(surface, first))


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
            f"{cycle.name}-maps",
            caption,
            lambda: run_pictures.before_and_after(before, predicted(cycle, before), "Predicted"),
        )
        return
    caption = (
        "Measured before and after the pass on one colour scale, and after it on its own. Outlined: the clear aperture."
    )
    album.add(f"{cycle.name}-maps", caption, lambda: run_pictures.before_and_after(before, after, "After"))
    caption = "What the plan said would remain, what the next map shows, and the difference, on one colour scale."
    album.add(f"{cycle.name}-prediction", caption, lambda: run_pictures.prediction(cycle, after))


def predicted(cycle: Cycle, before: ReportSurface) -> ReportSurface:
    """The plan's residual as if it had been measured."""
    return ReportSurface(run_pictures.residual_of(cycle), before.metric_mask, before.pitch_mm)


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
        album.add(f"{cycle.name}-compliance", caption, lambda: run_pictures.compliance_and_gamma(plan))
    caption = "Solved dwell over the part (values above the 99.5th percentile in the last colour), and its spread."
    album.add(f"{cycle.name}-dwell", caption, lambda: run_pictures.dwell(plan))
    if plan.get("curve_s", np.empty(0)).size:
        caption = "Each point is an optimum with a certificate of its own; more time buys less and less."
        stand = float(plan["time_s"].sum()), float((cycle.certificate or {}).get("predicted_rms_nm", np.nan))
        curve = plan["curve_s"], plan["curve_nm"]
        album.add(
            f"{cycle.name}-curve", caption, lambda: run_pictures.residual_against_time(*curve, *stand), wide=False
        )
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
    album.add(f"{cycle.name}-executed", caption, lambda: run_pictures.executed(plan, done_s))


def start_worker() -> tuple[dict[str, Any], AnswerFunction]:
    """Prepare a worker process to draw reports."""
    return {}, _answer


def _answer(request: Mapping[str, Any], _: Mapping[str, Any]) -> Message:
    """Draw the report of a folder, or the picture of a failed removal check."""
    folder = Path(request["folder"])
    if request["draw"] == "gate":
        write_gate(folder)
    else:
        write_report(folder)
    return {}, {}
