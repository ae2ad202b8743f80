"""``polishd study``: a simulation without a cell, described by a file."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer
from rich.table import Table

from polishd.config.loop_study import LoopStudy
from polishd.config.study import CorrectionsStudy, PassesStudy, SpotsStudy, Study
from polishd.config.sweep_points import load_swept
from polishd.files import write_atomic
from polishd.model.errors import ConfigError
from polishd.recipe.encoding import facts_of
from polishd.show.tables import json_line, stderr, stdout
from polishd.show.terminal import say
from polishd.workbench.studies import confusion, pictures, tables
from polishd.workbench.studies.corrections import Tell, compare_corrections
from polishd.workbench.studies.kept import Rows, make_folder, read_table
from polishd.workbench.studies.loops import looped
from polishd.workbench.studies.options import StudyOptions
from polishd.workbench.studies.passes import polish_evenly
from polishd.workbench.studies.running import run_cases
from polishd.workbench.studies.spots import compute_spots
from polishd.workbench.studies.summary import summarise
from polishd.workbench.studies.summary_show import summary_pictures, summary_tables
from polishd.workbench.studies.working import read, run_of

TABLE = "table.json"


@dataclass(frozen=True, slots=True)
class StudyResult:
    """What a study came to."""

    rows: list[dict[str, Any]] | dict[str, Any]
    tables: list[Table]
    notes: list[str]
    pictures: Mapping[str, pictures.Draw]
    """By file name."""
    pages: Mapping[str, str] = field(default_factory=dict)
    """Text, likewise."""


def study_verb(study: Path, options: StudyOptions, *, as_json: bool) -> None:
    """Run a study: a JSON list or tables on stdout, pictures and ``table.json`` in ``out``. ConfigError."""
    swept, out = load_swept(study), options.out
    first = swept.at(swept.points[0])
    many = swept.is_sweep or isinstance(first, LoopStudy)
    for name in ("limit", "workers", "scheduler"):
        if getattr(options, name) is not None and not many:
            raise typer.BadParameter(f'--{name} goes with a [sweep] and with kind = "loop"; leave it out')
    if many:
        answer = _of_many(first, run_cases(swept, options).rows, is_sweep=swept.is_sweep)
    else:
        make_folder(out)
        with stderr.status("reading") as status:
            answer = _answer(first, lambda words: status.update(f"{first.title}: {words}"))
    _give(answer, out, as_json=as_json)


def show_verb(folder: Path, *, as_json: bool) -> None:
    """What a study has left in its folder, as far as it came: tables or JSON, and pictures beside. ConfigError."""
    rows, text = read_table(folder)
    title = str(tomllib.loads(text).get("title", "")) if text else ""
    make_folder(folder)
    _give(_summed(title or folder.name, rows), folder, as_json=as_json)


def _give(answer: StudyResult, out: Path | None, *, as_json: bool) -> None:
    if out is not None:
        _write(out, answer)
    if as_json:
        say(json_line(answer.rows))
        return
    for table in answer.tables:
        stdout.print(table)
    for note in answer.notes:
        stdout.print(note, markup=False, highlight=False)
    if out is not None:
        stdout.print(
            f"written to {out}: {', '.join([TABLE, *answer.pictures, *answer.pages])}", markup=False, soft_wrap=True
        )


def _answer(study: Study, tell: Tell) -> StudyResult:
    if isinstance(study, CorrectionsStudy):
        compared = compare_corrections(study, read, tell)
        rows = [facts_of(row) for row in compared.rows]
        shown = tables.correction_tables(study.title, compared)
        return StudyResult(rows, shown, tables.correction_notes(compared), pictures.of_corrections(compared))
    if isinstance(study, SpotsStudy):
        spots = compute_spots(study, tell)
        shown = tables.spot_tables(study, spots)
        return StudyResult([row.as_json() for row in spots], shown, tables.spot_notes(spots), pictures.of_spots(spots))
    assert isinstance(study, PassesStudy)  # noqa: S101  (loops are many)
    polished = polish_evenly(study, tell)
    shown = [tables.passes_table(study, polished)]
    return StudyResult([polished.as_json()], shown, list(polished.notes), pictures.of_passes(polished))


def _of_many(study: Study, rows: Rows, *, is_sweep: bool) -> StudyResult:
    """Of a sweep what its rows say together; of loops alone a row of each scenario and loop."""
    if is_sweep or not isinstance(study, LoopStudy):
        return _summed(study.title, rows)
    found = looped([run_of(row) for row in rows], study.all_scenarios())
    shown = [tables.loop_table(study.title, found), confusion.confusion_table(study.title, found)]
    pages = {confusion.FILE: confusion.confusion_page(found)}
    return StudyResult(found.as_json(), shown, tables.loop_notes(found), pictures.of_loops(found), pages)


def _summed(title: str, rows: Rows) -> StudyResult:
    summary = summarise(rows)
    notes = [
        f"{summary.rows} rows; failed: an error, or not in tolerance at the job's end; medians of true RMS at that end",
        *tables.error_notes(rows),
    ]
    return StudyResult(summary.as_json(), summary_tables(title, summary), notes, summary_pictures(summary))


def _write(out: Path, answer: StudyResult) -> None:
    try:
        for name, draw in answer.pictures.items():
            write_atomic(out / name, draw())
        for name, text in answer.pages.items():
            write_atomic(out / name, text.encode())
        write_atomic(out / TABLE, (json.dumps(json.loads(json_line(answer.rows)), indent=1) + "\n").encode())
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written to: {error.strerror}; name a folder with --out") from error
