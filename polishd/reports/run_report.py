"""Run report: draws the pictures of a run or plan folder, and writes ``pictures/*.png`` and ``report.html``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from polishd.reports import pictures, run_pictures, wording
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
    "floor_nm": "mean removal of the machine's shortest times, nm",
    "cutoff_period_mm": "shorter periods are out of reach of this spot, mm",
    "notes": "notes",
}
"""Names of the fields of a dwell solution's optimality certificate."""

PAGE = "report.html"
PICTURES = "pictures"
GRID_NOTE = "The maps are averaged onto the process grid; the RMS is that of the samples in a map's file."


@dataclass(frozen=True, slots=True)
class DrawnSections:
    """Sections with pictures, by the page that they are on."""

    front: Sequence[DocumentSection] = ()
    figures: Sequence[DocumentSection] = ()
    details: Sequence[DocumentSection] = ()


def write_report(run_dir: Path) -> Path:
    """Write ``pictures/*.png`` and ``report.html`` into a run or plan folder; return the path of the page."""
    folder = read_folder(run_dir)
    album = Album(run_dir / PICTURES, folder.missing)
    with polishd_style():
        drawn = DrawnSections(
            front=front_sections(folder, album),
            figures=[spectra_section(folder, album)],
            details=[one for index in range(len(folder.cycles)) for one in cycle_sections(folder, index, album)],
        )
    target = run_dir / PAGE
    write_atomic(target, html(run_report_document(folder, drawn)).encode())
    return target


def run_report_document(folder: RunFolderReader, drawn: DrawnSections) -> ReportDocument:
    """Return the run report: a page with the result, a page with the figures, and the details.

    Args:
        folder: the facts, with what is missing.
        drawn: sections with pictures. Empty ones are left out.
    """
    rows = folder.rows()
    part = text(folder.summary.get("part_id")) or folder.path.name
    outcome = "planned" if folder.planned else text(folder.summary.get("outcome"))
    verdict = VERDICTS.get(outcome) or Verdict("plain", outcome.replace("_", " ").capitalize())
    kind = "plan" if folder.planned else "run"
    lists = (("Notes", notes_of(folder)), ("Missing from this report", folder.missing))
    notes = [DocumentSection(title, notes=notes) for title, notes in lists if notes]
    chapters = (
        Chapter(part, facts_of(folder), [*_requirement(folder), *_shown(drawn.front)], verdict),
        Chapter(
            "Figures", times_of(folder), [*_measurements(rows), *_shown(drawn.figures), *wording.ripple_section(rows)]
        ),
        Chapter("Details", (), [*notes, *_shown(drawn.details)]),
    )
    first, *others = chapters
    return ReportDocument(
        title=f"{part}: {kind} report",
        chapters=[first, *(chapter for chapter in others if chapter.sections)],
        footer=f"{kind} report by polishd {__version__}",
    )


def _shown(sections: Sequence[DocumentSection]) -> list[DocumentSection]:
    return [section for section in sections if section.pictures or section.tables or section.files]


def _requirement(folder: RunFolderReader) -> Iterator[DocumentSection]:
    """Yield the tolerance with the results of the first and of the last map; nothing without a summary."""
    rows = folder.rows()
    if not rows:
        return
    before = wording.results(rows[0]) if len(rows) > 1 else ()
    last = wording.results(rows[-1])
    yield from wording.requirement(last, f"cycles.{len(rows) - 1}.judged", before, "cycles.0.judged")


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
        ("outline", text(summary.get("outline"))),
        ("job", text(summary.get("job"))),
        ("reason", text(summary.get("reason"))),
        ("started", when(summary.get("started"))),
        ("ended", when(summary.get("ended"))),
    ]


def times_of(folder: RunFolderReader) -> list[tuple[str, str]]:
    """Return how the plans were made, and the elapsed time of each phase."""
    return [
        ("correction", text(folder.summary.get("correction"))),
        ("elapsed time", wording.phase_durations(folder.summary.get("phase_times_s"))),
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
    """Return the table of measurements; nothing without a summary."""
    columns = [column for column in COLUMNS if any(figure(row.get(column.key), column.form) for row in rows)]
    names = [wording.measurement(rows, index) for index in range(len(rows))]
    if not rows:
        return []
    cells = [(name, *(_cell(rows, index, column) for column in columns)) for index, name in enumerate(names)]
    table = Table(("measured", *(column.title for column in columns)), cells)
    note = (
        "In the clear aperture, mean removed. LSF: low spatial frequency (figure). Predicted, dwell and executed "
        "belong to the pass that follows the measurement in their row."
    )
    return [DocumentSection("Measurements", [table], [note])]


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

    def add(self, name: str, caption: str, draw: Callable[[], Figure]) -> None:
        """Draw, write ``name.png``, and keep the picture for the next ``take``."""
        try:
            content = png(draw())
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            self.missing.append(f"picture {name}: {type(error).__name__}: {error}")
            return
        self.folder.mkdir(exist_ok=True)
        write_atomic(self.folder / f"{name}.png", content)
        self.pictures.append(Picture(name, caption, content))

    def take(self) -> tuple[Picture, ...]:
        """Return the pictures since the last ``take``."""
        taken, self.pictures = tuple(self.pictures), []
        return taken


def front_sections(folder: RunFolderReader, album: Album) -> list[DocumentSection]:
    """Draw the first and the last map, or the map of a plan and what it predicts; and the RMS of each measurement."""
    rows, surfaces = folder.rows(), measured(folder)
    if folder.planned and surfaces:
        before = surfaces[0][1]
        album.add(
            "maps",
            pictures.MAPS_CAPTION,
            lambda: _predicted("Measured", before, folder.cycles[0]),
        )
    elif surfaces:
        some = [surfaces[0], *surfaces[1:][-1:]]
        caption = pictures.MAPS_CAPTION if len(some) > 1 else pictures.ONE_MAP_CAPTION
        maps = [
            surface.named(
                wording.measurement(rows, index).capitalize(),
                rms_nm=wording.number(rows[index], "rms_nm") if index < len(rows) else math.nan,
            )
            for index, surface in some
        ]
        album.add("maps", f"{caption} {GRID_NOTE}", lambda: pictures.maps_figure(maps, some[0][1].pitch_mm))
    title = "Before and after" if folder.planned or len(surfaces) > 1 else "The map"
    maps_section = DocumentSection(title, pictures=album.take())
    if len(rows) > 1:
        limit_nm = folder.summary.get("tolerance_nm") or wording.rms_limit(wording.results(rows[-1]))
        period = folder.summary.get("tolerance_period_mm") or 0.0
        name = f"measured, periods above {period:g} mm" if period > 0 else "measured"
        steps = run_pictures.convergence_steps(rows, period)
        album.add(
            "convergence", pictures.CONVERGENCE_CAPTION, lambda: pictures.convergence_figure(steps, limit_nm, name)
        )
    return [maps_section, DocumentSection("RMS in the clear aperture", pictures=album.take())]


def _predicted(name: str, before: ReportSurface, cycle: Cycle) -> Figure:
    predicted = before.named("Predicted", run_pictures.residual_of(cycle))
    return pictures.maps_figure([before.named(name), predicted], before.pitch_mm)


def spectra_section(folder: RunFolderReader, album: Album) -> DocumentSection:
    """Draw the spectrum of each measurement with the limits of the drawing and the ripple of the path."""
    rows, surfaces = folder.rows(), measured(folder)
    if surfaces:
        ripple_mm = [wording.number(one, "period_mm") for row in rows for one in wording.ripple(row)]
        album.add(
            "psd",
            f"{pictures.SPECTRA_CAPTION} Rings averaged over a sixth of an octave.",
            lambda: pictures.spectra_figure(
                {
                    wording.measurement(rows, index): run_pictures.smooth_spectrum(
                        surface.height_nm, surface.metric_mask, surface.pitch_mm
                    )
                    for index, surface in surfaces
                },
                wording.psd_limits(folder.summary),
                ripple_mm,
            ),
        )
    return DocumentSection("Power spectrum", pictures=album.take())


def measured(folder: RunFolderReader) -> list[tuple[int, ReportSurface]]:
    """Return the index and map of each cycle whose map can be read."""
    return [(index, cycle.surface) for index, cycle in enumerate(folder.cycles) if cycle.surface is not None]


def cycle_sections(folder: RunFolderReader, index: int, album: Album) -> list[DocumentSection]:
    """Draw a cycle: a pass between two measurements, or a measurement without a pass after it."""
    cycle, rows = folder.cycles[index], folder.rows()
    if cycle.plan is None:
        title = f"Measurement {wording.measurement(rows, index) if index else 'at the start'} ({cycle.name})"
        return [DocumentSection(title, files=cycle.files)]
    after = folder.cycles[index + 1].surface if index + 1 < len(folder.cycles) else None
    if not folder.planned:
        _draw_maps(cycle, after, album)
    _draw_path(folder, index, album)
    program = rows[index].get("program") if index < len(rows) else None  # where several take turns
    of_program = f" with {program}" if program else ""
    title = "Plan" if folder.planned else f"{wording.pass_after(rows, index)}{of_program} ({cycle.name})"
    tables = [] if cycle.certificate is None else [Table((), certificate_rows(cycle.certificate))]
    return [
        DocumentSection(title, pictures=album.take()),
        DocumentSection("Certificate of the dwell solution", tables, files=cycle.files),
    ]


def certificate_rows(certificate: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return names and values of an optimality certificate, known fields first."""
    keys = dict.fromkeys([*(key for key in CERTIFICATE if key in certificate), *certificate])
    return [(CERTIFICATE.get(key, key), plain(certificate[key])) for key in keys]


def _draw_maps(cycle: Cycle, after: ReportSurface | None, album: Album) -> None:
    """Draw prediction and map after the pass; without a map after it, the map before it and the prediction."""
    before, name = cycle.surface, f"{cycle.name}-maps"
    if after is not None:
        caption = "Residual that the plan predicted, the next map, and their difference, on one color scale."
        album.add(name, caption, lambda: run_pictures.prediction_picture(cycle, after))
    elif before is not None:
        caption = f"There is no map after the pass. {pictures.MAPS_CAPTION}"
        album.add(name, caption, lambda: _predicted("Before", before, cycle))
    else:
        album.missing.append(f"{cycle.name}: no map, so nothing to compare with")


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
        album.add(f"{name}-curve", caption, lambda: run_pictures.trade_off_picture(plan, predicted_nm))
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
