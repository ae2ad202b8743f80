"""``polishd study``: a simulation without a cell, described by a file."""

from __future__ import annotations

import contextlib
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from polishd.config.study import CorrectionsStudy, LoopStudy, PassesStudy, PathsStudy, SpotsStudy, Study
from polishd.config.sweep import SweepStudy, load_swept
from polishd.model.errors import ConfigError
from polishd.pipeline.records import facts_of
from polishd.rendering.terminal import json_line, say, stderr, stdout
from polishd.studies import output
from polishd.studies.case_runner import closed_loop, looped, read, run_of
from polishd.studies.cases import Case, cases_of
from polishd.studies.corrections import ProgressReport, compare_corrections
from polishd.studies.engine import DaskCluster, Executor, LocalPool, work
from polishd.studies.options import StudyOptions
from polishd.studies.path_families import compare_paths
from polishd.studies.result_store import ResultStore, Rows, make_folder, read_table
from polishd.studies.spots import compute_spots, polish_evenly
from polishd.studies.summary import summarise
from polishd.util.extras import require_extra
from polishd.util.files import write_atomic

# A study of many cases, from its file to all rows: known cases are reused, the others are computed.


@dataclass(frozen=True, slots=True)
class StudyRows:
    """All rows of a study's cases, in order."""

    cases: Sequence[Case]
    rows: Rows


def run_cases(swept: SweepStudy, options: StudyOptions) -> StudyRows:
    """Check all cases, compute the unknown ones, and write ``cases.parquet`` whole, also after an error.

    ConfigError, ProgramError before any case is computed.
    """
    if options.out is not None:
        require_extra("The table of a study's cases (--out)", "studies")
    of_study = cases_of(swept)
    cases = of_study[: options.limit]
    first = swept.at(swept.points[0])
    if isinstance(first, LoopStudy):
        for name in first.controllers:  # with its program and its plugins
            with first.blame(f"controllers.{name}"):
                closed_loop(first, name)
    make_folder(options.out)  # a refused study leaves none
    kept = ResultStore(options.out)
    if others := kept.count_others(of_study):
        _say(f"{options.out}: {others} cases in this folder have other files, keys or versions, and are not reused")
    todo = [case for case in cases if kept.find(case) is None]
    try:
        if todo:
            with executor_of(options) as executor, _progress(first.title, len(cases), len(cases) - len(todo)) as bar:
                for done in work(swept.path, todo, executor, options.case_s, _say):
                    kept.add(done)
                    bar.advance(bar.task_ids[0])
    finally:
        kept.merge(of_study, swept.source.text)
    return StudyRows(cases, [row for case in cases for row in kept.table(case)])


def _say(words: str) -> None:
    """Print a line above the progress."""
    stderr.print(words, markup=False, highlight=False, soft_wrap=True)


def executor_of(options: StudyOptions) -> Executor:
    """Make the configured executor. ConfigError where the cluster is unreachable."""
    return LocalPool(options.workers) if options.scheduler is None else DaskCluster(options.scheduler)


@contextlib.contextmanager
def _progress(title: str, total: int, done: int) -> Iterator[Progress]:
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = Progress(*columns, TextColumn("remaining"), TimeRemainingColumn(), console=stderr, transient=True)
    bar.add_task(title, total=total, completed=done)
    with bar:
        yield bar


TABLE = "table.json"


@dataclass(frozen=True, slots=True)
class StudyResult:
    """Results of a study."""

    rows: list[dict[str, Any]] | dict[str, Any]
    tables: list[Table]
    notes: list[str]
    pictures: Mapping[str, output.Draw]
    """Pictures by file name."""
    pages: Mapping[str, str] = field(default_factory=dict)
    """Text pages by file name."""


def study_verb(study: Path, options: StudyOptions, *, as_json: bool) -> None:
    """Run a study: a JSON list or tables on stdout, pictures and ``table.json`` in ``out``. ConfigError."""
    swept, out = load_swept(study), options.out
    first = swept.at(swept.points[0])
    many = swept.is_sweep or isinstance(first, LoopStudy)
    for name in ("limit", "workers", "scheduler"):
        if getattr(options, name) is not None and not many:
            raise typer.BadParameter(f'--{name} goes with a [sweep] and with kind = "loop"; remove it')
    if many:
        answer = _of_many(first, run_cases(swept, options).rows, is_sweep=swept.is_sweep)
    else:
        make_folder(out)
        with stderr.status("reading") as status:
            answer = _answer(first, lambda words: status.update(f"{first.title}: {words}"))
    _give(answer, out, as_json=as_json)


def show_verb(folder: Path, *, as_json: bool) -> None:
    """Show the results in a study's folder so far: tables or JSON, and pictures. ConfigError."""
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


def _answer(study: Study, report_progress: ProgressReport) -> StudyResult:
    if isinstance(study, CorrectionsStudy):
        compared = compare_corrections(study, read, report_progress)
        rows = [facts_of(row) for row in compared.rows]
        shown = output.correction_tables(study.title, compared)
        return StudyResult(rows, shown, output.correction_notes(compared), output.of_corrections(compared))
    if isinstance(study, PathsStudy):
        paths = compare_paths(study, read, report_progress)
        rows = [facts_of(row) for row in paths.rows]
        return StudyResult(rows, [output.path_table(study.title, paths)], list(paths.notes), output.of_paths(paths))
    if isinstance(study, SpotsStudy):
        spots = compute_spots(study, report_progress)
        shown = output.spot_tables(study, spots)
        return StudyResult([row.as_json() for row in spots], shown, output.spot_notes(spots), output.of_spots(spots))
    assert isinstance(study, PassesStudy)  # noqa: S101  loops have many cases
    polished = polish_evenly(study, report_progress)
    shown = [output.passes_table(study, polished)]
    return StudyResult([polished.as_json()], shown, list(polished.notes), output.of_passes(polished))


def _of_many(study: Study, rows: Rows, *, is_sweep: bool) -> StudyResult:
    """Return for a sweep the summary of its rows; for loops alone one row for each scenario and loop."""
    if is_sweep or not isinstance(study, LoopStudy):
        return _summed(study.title, rows)
    found = looped([run_of(row) for row in rows], study.all_scenarios())
    shown = [output.loop_table(study.title, found), output.confusion_table(study.title, found)]
    pages = {output.FILE: output.confusion_page(found)}
    return StudyResult(found.as_json(), shown, output.loop_notes(found), output.of_loops(found), pages)


def _summed(title: str, rows: Rows) -> StudyResult:
    summary = summarise(rows)
    notes = [
        f"{summary.rows} rows; failed: an error, or not in tolerance at the job's end; medians of true RMS at that end",
        *output.error_notes(rows),
    ]
    return StudyResult(
        summary.as_json(), output.summary_tables(title, summary), notes, output.summary_pictures(summary)
    )


def _write(out: Path, answer: StudyResult) -> None:
    try:
        for name, draw in answer.pictures.items():
            write_atomic(out / name, draw())
        for name, text in answer.pages.items():
            write_atomic(out / name, text.encode())
        write_atomic(out / TABLE, (json.dumps(json.loads(json_line(answer.rows)), indent=1) + "\n").encode())
    except OSError as error:
        raise ConfigError(f"{out}: cannot write: {error.strerror}. Name a folder with --out") from error
