"""Run report: draws the pictures of a run or plan folder, and writes ``pictures/*.png`` and ``report.html``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from polishd import __version__
from polishd.rendering.document import (
    DASH,
    Cell,
    Chapter,
    DocumentSection,
    Picture,
    ReportDocument,
    ReportValue,
    Table,
    Verdict,
    html,
)
from polishd.rendering.plots import png, polishd_style
from polishd.rendering.scales import PERCENTILE
from polishd.reports import run_pictures, wording
from polishd.reports.run_pictures import write_removal_check
from polishd.reports.run_reader import Cycle, ReportSurface, RunFolderReader, read_folder
from polishd.reports.wording import VERDICTS, duration, figure, plain, text, when
from polishd.util.array_stream import Message
from polishd.util.files import write_atomic
from polishd.util.worker_main import AnswerFunction


class Column(NamedTuple):
    """A column of the table of measurements."""

    key: str
    title: str
    form: str


COLUMNS: Sequence[Column] = (
    Column("pv_nm", "PV, nm", ".1f"),
    Column("rms_nm", "RMS, nm", ".2f"),
    Column("lsf_rms_nm", "LSF RMS, nm", ".2f"),
    Column("band_rms_nm", "band RMS, nm", ".2f"),
    Column("predicted_rms_nm", "predicted RMS, nm", ".2f"),
    Column("expected_low_nm", "expected from, nm", ".2f"),
    Column("expected_high_nm", "9 of 10 to, nm", ".2f"),
    Column("dwell_s", "dwell, s", ",.0f"),
    Column("executed_s", "executed, s", ",.0f"),
    Column("rate", "estimated rate", ".3f"),
)

CERTIFICATE: Mapping[str, str] = {
    "solver": "solver",
    "stopped": "stopped because",
    "kkt_residual": "KKT residual (relative)",
    "bound_violation_s": "bound violation, s",
    "gap": "above the least objective, at most (relative)",
    "gap_nm": "above the least objective, at most, nm",
    "objective": "objective, nm²",
    "predicted_rms_nm": "predicted RMS, nm",
    "predicted_pv_nm": "predicted PV, nm",
    "piston_nm": "mean removal, nm",
    "dwell_total_s": "total dwell, s",
    "at_lower": "points at their lower bound",
    "at_upper": "points at their upper bound",
    "iterations": "iterations",
    "seconds": "time to solve, CPU s",
    "cross_check": "cross-checked by",
    "cross_check_gap": "gap to the cross-check (relative)",
    "cutoff_period_mm": "shorter periods are out of reach of this spot, mm",
    "notes": "notes",
}
"""Names of the fields of a dwell solution's optimality certificate."""

PAGE = "report.html"
PICTURES = "pictures"
LSF_PERIOD_MM = 33.0
"""If the summary has no ``lsf_period_mm``."""


def write_report(run_dir: Path) -> Path:
    """Write ``pictures/*.png`` and ``report.html`` into a run or plan folder; return the path of the page."""
    folder = read_folder(run_dir)
    album = Album(run_dir / PICTURES, folder.missing)
    with polishd_style():
        sections = [run_section(folder, album)]
        for index in range(len(folder.cycles)):
            sections += cycle_sections(folder, index, album)
    target = run_dir / PAGE
    write_atomic(target, html(run_report_document(folder, sections)).encode())
    return target


def run_report_document(folder: RunFolderReader, sections: Sequence[DocumentSection]) -> ReportDocument:
    """Return the run report.

    Args:
        folder: the facts, with what is missing.
        sections: those with pictures, from ``run_section`` and ``cycle_sections``. Empty ones are left out.
    """
    part = text(folder.summary.get("part_id")) or folder.path.name
    outcome = "planned" if folder.planned else text(folder.summary.get("outcome"))
    lists = (("Notes", notes_of(folder)), ("Missing from this report", folder.missing))
    chapter = Chapter(
        title=part,
        facts=facts_of(folder),
        sections=[
            *_measurements(folder.rows()),
            *(DocumentSection(title, notes=notes) for title, notes in lists if notes),
            *(section for section in sections if section.pictures or section.tables or section.files),
        ],
        verdict=VERDICTS.get(outcome) or Verdict("plain", outcome.replace("_", " ").capitalize()),
    )
    kind = "plan" if folder.planned else "run"
    return ReportDocument(f"{part}: {kind} report", [chapter], f"{kind} report by polishd {__version__}")


def facts_of(folder: RunFolderReader) -> list[tuple[str, str]]:
    """Return names and values of the header."""
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
        ("elapsed time", wording.phase_durations(summary.get("phase_times_s"))),
        ("correction", text(summary.get("correction"))),
        ("outline", text(summary.get("outline"))),
        ("job", text(summary.get("job"))),
        ("started", when(summary.get("started"))),
        ("ended", when(summary.get("ended"))),
    ]


def notes_of(folder: RunFolderReader) -> list[str]:
    """Return the notes of the summary, of each measurement, of the estimates after it, and the findings of a pass."""
    rows = folder.rows()
    notes = [text(note) for note in folder.summary.get("notes") or []]
    for index, row in enumerate(rows):
        estimated = folder.cycles[index].notes if index < len(folder.cycles) else ()
        notes += [f"measurement {index}: {text(note)}" for note in (*(row.get("notes") or ()), *estimated)]
        notes += [f"{wording.pass_after(rows, index)}: {text(found)}" for found in row.get("found") or ()]
    return notes


def _measurements(rows: wording.Rows) -> list[DocumentSection]:
    """Return the table of measurements, and that of the tolerance's lines; nothing without a summary."""
    columns = [column for column in COLUMNS if any(figure(row.get(column.key), column.form) for row in rows)]
    names = [wording.measurement(rows, index) for index in range(len(rows))]
    if not rows:
        return []
    cells = [(name, *(_cell(rows, index, column) for column in columns)) for index, name in enumerate(names)]
    tables = [Table(("measured", *(column.title for column in columns)), cells)]
    if lines := wording.lines(rows):
        tables.append(Table(("tolerance", "limit", *names, "the last measurement is within"), lines))
    note = (
        "In the clear aperture, mean removed. LSF: low spatial frequency (figure). Predicted, dwell and executed "
        "belong to the pass that follows the measurement in their row."
    )
    return [DocumentSection("Measurements", tables, [note])]


def _cell(rows: wording.Rows, index: int, column: Column) -> Cell:
    value = rows[index].get(column.key)
    shown = figure(value, column.form)
    if column.key == "executed_s" and wording.interrupted(rows[index]):
        return f"{shown or DASH}; {wording.share(rows[index])}"
    return ReportValue(shown, f"cycles.{index}.{column.key}", float(value)) if value is not None and shown else DASH


@dataclass(slots=True)
class Album:
    """Draws pictures and writes them as files. A picture that cannot be drawn is listed as missing."""

    folder: Path
    missing: list[str]
    pictures: list[Picture] = field(default_factory=list)

    def add(self, name: str, caption: str, draw: Callable[[], Figure], *, wide: bool = True) -> None:
        """Draw, write ``name.png``, and keep the picture for the next ``take``."""
        try:
            content = png(draw())
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            self.missing.append(f"picture {name}: {type(error).__name__}: {error}")
            return
        self.folder.mkdir(exist_ok=True)
        write_atomic(self.folder / f"{name}.png", content)
        self.pictures.append(Picture(name, caption, content, wide=wide))

    def take(self) -> tuple[Picture, ...]:
        """Return the pictures since the last ``take``."""
        taken, self.pictures = tuple(self.pictures), []
        return taken


def run_section(folder: RunFolderReader, album: Album) -> DocumentSection:
    """Draw all measurements together. A plan has one measurement, of which only the spectrum is drawn."""
    rows = folder.rows()
    limit_nm = folder.summary.get("tolerance_nm") or wording.rms_limit(rows)
    surfaces = [(wording.measurement(rows, index).capitalize(), surface) for index, surface in measured(folder)]
    period = folder.summary.get("tolerance_period_mm") or 0.0
    if len(surfaces) > 1:
        caption = (
            "All measurements on the color scale of the first, averaged onto the process grid. The RMS above a picture "
            "excludes noise and raster ripple; the RMS in the table is that of the map. Line: the clear aperture."
        )
        album.add("overview", caption, lambda: run_pictures.overview_picture(surfaces))
    if len(rows) > 1:
        caption = (
            "Measured RMS, and what each plan predicted for the measurement after it. Dashed: an interrupted pass, for "
            "which nothing is predicted."
        )
        album.add("trend", caption, lambda: run_pictures.convergence_picture(rows, limit_nm, period), wide=False)
    if surfaces:
        lsf_mm = float(folder.summary.get("lsf_period_mm") or LSF_PERIOD_MM)
        caption = f"Averaged over directions; edge tapered. Figure (LSF) is left of the dotted line at {lsf_mm:g} mm."
        lines_mm = sorted(
            {round(run_pictures.number(one, "period_mm"), 3) for row in rows for one in row.get("ripple") or ()}
        )
        caption += " Further dotted lines: periods of the path's ripple." if lines_mm else ""
        album.add("psd", caption, lambda: run_pictures.spectra_picture(surfaces, [lsf_mm, *lines_mm]), wide=False)
    return DocumentSection("Surface" if folder.planned else "The whole run", pictures=album.take())


def measured(folder: RunFolderReader) -> list[tuple[int, ReportSurface]]:
    """Return the index and map of each cycle whose map can be read."""
    return [(index, cycle.surface) for index, cycle in enumerate(folder.cycles) if cycle.surface is not None]


def cycle_sections(folder: RunFolderReader, index: int, album: Album) -> list[DocumentSection]:
    """Draw a cycle: a pass between two measurements, or a measurement without a pass after it."""
    cycle, rows = folder.cycles[index], folder.rows()
    if cycle.plan is None:
        _draw_last_map(folder, index, album)
        title = f"Measurement {wording.measurement(rows, index) if index else 'at the start'} ({cycle.name})"
        return [DocumentSection(title, pictures=album.take(), files=cycle.files)]
    after = folder.cycles[index + 1].surface if index + 1 < len(folder.cycles) else None
    _draw_maps(cycle, after, album)
    _draw_path(folder, index, album)
    title = "Plan" if folder.planned else f"{wording.pass_after(rows, index)} ({cycle.name})"
    tables = [] if cycle.certificate is None else [Table((), certificate_rows(cycle.certificate))]
    ripple = ripple_table(rows[index]) if index < len(rows) else None
    return [
        DocumentSection(title, pictures=album.take()),
        *([] if ripple is None else [DocumentSection("Ripple that the path adds", [ripple])]),
        DocumentSection("Certificate of the dwell solution", tables, files=cycle.files),
    ]


def ripple_table(row: Mapping[str, Any]) -> Table | None:
    """Return the harmonics that a pass adds, and their sum; None where there is no forecast."""
    lines = [one for one in row.get("ripple") or () if isinstance(one, dict)]
    if not lines:
        return None
    keys = ("period_mm", "amplitude_nm", "rms_nm", "rms_high_nm")
    cells = [(plain(one.get("direction")), *(f"{run_pictures.number(one, key):.2f}" for key in keys)) for one in lines]
    whole = [f"{math.sqrt(sum(run_pictures.number(one, key) ** 2 for one in lines)):.2f}" for key in keys[2:]]
    head = ("direction", "period, mm", "amplitude, nm", "RMS, nm", "RMS with the spot's radius off, nm")
    return Table(head, [*cells, ("all", "", "", *whole)])


def certificate_rows(certificate: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return names and values of an optimality certificate, known fields first."""
    keys = dict.fromkeys([*(key for key in CERTIFICATE if key in certificate), *certificate])
    return [(CERTIFICATE.get(key, key), plain(certificate[key])) for key in keys]


def _draw_last_map(folder: RunFolderReader, index: int, album: Album) -> None:
    surface = folder.cycles[index].surface
    if surface is not None:
        first = measured(folder)[0][1]
        caption = "The same map on the color scale of the first map and on its own scale."
        album.add(f"{folder.cycles[index].name}-maps", caption, lambda: run_pictures.last_map_picture(surface, first))


def _draw_maps(cycle: Cycle, after: ReportSurface | None, album: Album) -> None:
    """Draw the maps before and after the pass. Without a map after it, the predicted residual is drawn."""
    before = cycle.surface
    if before is None:
        album.missing.append(f"{cycle.name}: no map, so nothing to compare with")
        return
    name = f"{cycle.name}-maps"
    if after is None:
        caption = (
            "Measured before the pass, and predicted after it, on one color scale and on its own. There is no map "
            "after the pass."
        )

        def predicted() -> Figure:
            residual = ReportSurface(run_pictures.residual_of(cycle), before.metric_mask, before.pitch_mm)
            return run_pictures.pass_picture(before, residual, "Predicted")

        album.add(name, caption, predicted)
        return
    caption = (
        "Measured before and after the pass on one color scale, and after it on its own. Line: the clear aperture."
    )
    album.add(name, caption, lambda: run_pictures.pass_picture(before, after, "After"))
    caption = "Residual that the plan predicted, the next map, and their difference, on one color scale."
    album.add(f"{cycle.name}-prediction", caption, lambda: run_pictures.prediction_picture(cycle, after))


def _draw_path(folder: RunFolderReader, index: int, album: Album) -> None:
    """Draw what varies along the path. Compliance is drawn only if it differs from that of the cycle before."""
    cycle = folder.cycles[index]
    plan, name = cycle.plan, cycle.name
    if plan is None:
        return
    earlier = folder.cycles[index - 1].plan if index else None
    keys = ("compliance_um_per_n", "gamma")
    if earlier is None or not all(np.array_equal(plan.get(key), earlier.get(key)) for key in keys):  # type: ignore[arg-type]
        caption = "Effect of the robot's compliance on the depth of contact, along the path and over the part."
        album.add(f"{name}-compliance", caption, lambda: run_pictures.compliance_picture(plan))
    caption = f"Dwell over the part (the colors end at the {PERCENTILE:g}th percentile), and its distribution."
    album.add(f"{name}-dwell", caption, lambda: run_pictures.dwell_picture(plan))
    if plan.get("curve_s", np.empty(0)).size:
        caption = "Each point is an optimum with its own certificate. More time removes less and less."
        predicted_nm = float((cycle.certificate or {}).get("predicted_rms_nm", np.nan))
        album.add(f"{name}-curve", caption, lambda: run_pictures.trade_off_picture(plan, predicted_nm), wide=False)
    if cycle.executed is None:
        return
    executed_s = cycle.executed.per_point(plan)
    if executed_s is None:
        blocks, planned = cycle.executed.seq.size, plan["expected_s"].size
        album.missing.append(f"{name}: {blocks} blocks in contact were executed, {planned} planned")
        return
    caption = "Time that the robot took and time that the plan expected."
    album.add(f"{name}-executed", caption, lambda: run_pictures.executed_picture(plan, executed_s))


def start_worker() -> tuple[dict[str, Any], AnswerFunction]:
    """Prepare a worker process to draw reports."""
    return {}, _answer


def _answer(request: Mapping[str, Any], _: Mapping[str, Any]) -> Message:
    """Draw the report of a folder, or the picture of a failed removal check."""
    folder = Path(request["folder"])
    if request["draw"] == "gate":
        write_removal_check(folder)
    else:
        write_report(folder)
    return {}, {}
