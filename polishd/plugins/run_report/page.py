"""The page: one HTML file with its style and pictures inside."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from polishd.plugins.run_report import naming
from polishd.plugins.run_report.folder import RunFolder
from polishd.plugins.run_report.values import duration, escape, figure, plain, text, when

VERDICTS: Mapping[str, tuple[str, str]] = {
    "in_tolerance": ("good", "In tolerance"),
    "cycles_used": ("bad", "Not in tolerance: all passes used"),
    "diverged": ("bad", "Diverged: the surface got worse"),
    "stopped": ("bad", "Stopped before the end"),
    "failed": ("bad", "Ended by an error: see the notes"),
    "planned": ("plain", "Plan: nothing was moved"),
}
UNFINISHED = ("bad", "Unfinished: there is no summary")

COLUMNS: Sequence[tuple[str, str, str]] = (
    ("pv_nm", "PV<br>nm", ".1f"),
    ("rms_nm", "RMS<br>nm", ".2f"),
    ("lsf_rms_nm", "LSF RMS<br>nm", ".2f"),
    ("band_rms_nm", "band RMS<br>nm", ".2f"),
    ("predicted_rms_nm", "predicted<br>RMS nm", ".2f"),
    ("dwell_s", "dwell<br>s", ",.0f"),
    ("executed_s", "executed<br>s", ",.0f"),
    ("rate", "learned<br>rate", ".3f"),
)

CERTIFICATE: Mapping[str, str] = {
    "solver": "solver",
    "stopped": "stopped because",
    "kkt_residual": "KKT residual (relative)",
    "bound_violation_s": "bound violation (s)",
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
    "notes": "notes",
}


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawn picture and what it shows."""

    name: str
    caption: str
    content: bytes
    wide: bool = True


@dataclass(frozen=True, slots=True)
class Section:
    """A part of the page."""

    title: str
    folder: str
    pictures: tuple[Picture, ...]
    certificate: Mapping[str, Any] | None = None
    files: tuple[str, ...] = ()


def render(folder: RunFolder, sections: Sequence[Section]) -> str:
    """The whole page."""
    title = f"{text(folder.summary.get('part_id')) or folder.path.name}: {'plan' if folder.planned else 'run'} report"
    style = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    parts = [
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>",
        header(folder),
        cycle_table(folder),
        listing("Notes", notes_of(folder)),
        listing("Missing from this report", folder.missing),
        *(section_html(section) for section in sections),
        "</main>\n</body>\n</html>\n",
    ]
    return "\n".join(part for part in parts if part)


def header(folder: RunFolder) -> str:
    """Verdict, part and job, and the figures that matter."""
    summary = folder.summary
    outcome = text(summary.get("outcome"))
    known = VERDICTS.get(outcome, ("plain", outcome.replace("_", " ").capitalize())) if outcome else UNFINISHED
    kind, verdict = VERDICTS["planned"] if folder.planned else known
    facts = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in facts_of(folder) if value
    )
    part = text(summary.get("part_id")) or folder.path.name
    badge = f'<p class="verdict {kind}">{escape(verdict)}</p>'
    return f"<header>\n{badge}\n<h1>{escape(part)}</h1>\n<dl>{facts}</dl>\n</header>"


def facts_of(folder: RunFolder) -> list[tuple[str, str]]:
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
        ("tolerance", f"{tolerance} nm" if tolerance else ""),
        ("passes", "" if folder.planned or not rows else naming.passes(rows)),
        ("process time", duration(rows, "dwell_s" if folder.planned else "executed_s")),
        ("correction", text(summary.get("correction"))),
        ("job", text(summary.get("job"))),
        ("started", when(summary.get("started"))),
        ("ended", when(summary.get("ended"))),
    ]


def notes_of(folder: RunFolder) -> list[str]:
    """The summary's notes, and those of each measurement and of what was learned by it."""
    notes = [text(note) for note in folder.summary.get("notes") or []]
    for index, row in enumerate(folder.rows()):
        learned = folder.cycles[index].notes if index < len(folder.cycles) else ()
        notes += [f"measurement {index}: {text(note)}" for note in (*(row.get("notes") or ()), *learned)]
    return notes


def cycle_table(folder: RunFolder) -> str:
    """A row per measurement; columns that hold nothing at all are left out."""
    rows = folder.rows()
    if not rows:
        return ""
    columns = [column for column in COLUMNS if any(figure(row.get(column[0]), column[2]) for row in rows)]
    head = "".join(f'<th scope="col">{label}</th>' for _, label, _ in columns)
    body = []
    for index, row in enumerate(rows):
        cells = "".join(f"<td>{figure(row.get(key), shape) or '–'}{_torn(row, key)}</td>" for key, _, shape in columns)
        body.append(f'<tr><th scope="row">{naming.measurement(rows, index)}</th>{cells}</tr>')
    note = (
        "In the clear aperture, mean removed. LSF: low spatial frequency (figure). "
        "Predicted, dwell and executed belong to the pass that follows the measurement in their row."
    )
    head = f'<thead><tr><th scope="col">measured</th>{head}</tr></thead>'
    table = f'<table class="cycles">{head}<tbody>{"".join(body)}</tbody></table>'
    return f'<div class="scroll">{table}</div>\n<p class="note">{note}</p>'


def _torn(row: Mapping[str, Any], key: str) -> str:
    return f"<br>{naming.share(row)}" if key == "executed_s" and naming.interrupted(row) else ""


def section_html(section: Section) -> str:
    """A section with its pictures, certificate and files."""
    pictures = "\n".join(figure_html(picture) for picture in section.pictures)
    folder = f" <small>{escape(section.folder)}</small>" if section.folder else ""
    inside = [pictures, certificate_html(section.certificate), files_html(section.files)]
    if not any(inside):
        return ""
    return (
        f"<section>\n<h2>{escape(section.title)}{folder}</h2>\n"
        + "\n".join(part for part in inside if part)
        + "\n</section>"
    )


def figure_html(picture: Picture) -> str:
    """A picture inside the page."""
    data = base64.b64encode(picture.content).decode("ascii")
    kind = "wide" if picture.wide else "half"
    caption = escape(picture.caption)
    return (
        f'<figure class="{kind}"><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def certificate_html(certificate: Mapping[str, Any] | None) -> str:
    """The dwell solution's certificate, known fields first."""
    if not certificate:
        return ""
    names = [
        *(key for key in CERTIFICATE if key in certificate),
        *(key for key in certificate if key not in CERTIFICATE),
    ]
    rows = "".join(
        f'<tr><th scope="row">{escape(CERTIFICATE.get(key, key))}</th><td>{escape(plain(certificate[key]))}</td></tr>'
        for key in names
    )
    title = "<summary>Certificate of the dwell solution</summary>"
    return f"<details open>{title}<table><tbody>{rows}</tbody></table></details>"


def files_html(files: Sequence[str]) -> str:
    """Links to the files beside the page."""
    links = ", ".join(f'<a href="{quote(name)}">{escape(Path(name).name)}</a>' for name in files)
    return f'<p class="note">Files: {links}</p>' if links else ""


def listing(title: str, entries: Sequence[Any]) -> str:
    """A titled list, or nothing."""
    if not entries:
        return ""
    items = "".join(f"<li>{escape(text(entry))}</li>" for entry in entries)
    return f'<section class="list">\n<h2>{escape(title)}</h2>\n<ul>{items}</ul>\n</section>'
