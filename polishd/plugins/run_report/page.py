"""The page: one HTML file with its style and pictures inside, by ``report.html.jinja``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from jinja2 import Template

from polishd.plugins.run_report.folder import RunFolderReader
from polishd.show import words
from polishd.show.sheet import Picture
from polishd.show.sheet_html import templates
from polishd.show.words import VERDICTS, Verdict, duration, figure, plain, text, when


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
        lines=words.lines(rows),
        notes=notes_of(folder),
        sections=sections,
    )


@cache
def _template() -> Template:
    page = templates(Path(__file__).parent)
    page.filters |= {"figure": figure, "plain": plain, "quote": quote, "text": text}
    page.globals |= {name: getattr(words, name) for name in ("measurement", "interrupted", "share")}
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
        ("tolerance", f"{tolerance} nm" if tolerance else words.tolerance(rows)),
        ("accepted", words.accepted(summary, rows)),
        ("passes", "" if folder.planned or not rows else words.passes(rows)),
        ("process time", duration(rows, "dwell_s" if folder.planned else "executed_s")),
        ("time on the wall", words.spent(summary.get("phase_times_s"))),
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
        notes += [f"{words.pass_after(folder.rows(), index)}: {text(found)}" for found in row.get("found") or ()]
    return notes
