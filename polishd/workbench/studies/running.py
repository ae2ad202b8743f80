"""A study of many cases, from its file to all rows: those known are taken, the others are computed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from polishd.config.loop_study import LoopStudy
from polishd.config.sweep_points import SweepStudy
from polishd.show.tables import stderr
from polishd.workbench.studies.case import Case
from polishd.workbench.studies.cases import cases_of
from polishd.workbench.studies.engine import work
from polishd.workbench.studies.executors import DaskCluster, Executor, LocalPool
from polishd.workbench.studies.kept import ResultStore, Rows, make_folder
from polishd.workbench.studies.options import StudyOptions
from polishd.workbench.studies.working import closed_loop


@dataclass(frozen=True, slots=True)
class StudyRows:
    """All rows of a study's cases, in their order."""

    cases: Sequence[Case]
    rows: Rows


def run_cases(swept: SweepStudy, options: StudyOptions) -> StudyRows:
    """Check all cases, compute those that are not known, and write ``cases.parquet`` whole, whatever ends it.

    ConfigError, ProgramError before anything is computed.
    """
    of_study = cases_of(swept)
    cases = of_study[: options.limit]
    first = swept.at(swept.points[0])
    if isinstance(first, LoopStudy):
        for name in first.loops:  # its program and its plugins, too
            with first.blame(f"loops.{name}"):
                closed_loop(first, name)
    make_folder(options.out)  # what is refused leaves none
    kept = ResultStore(options.out)
    if others := kept.count_others(of_study):
        _say(f"{options.out}: {others} cases there are of other files, keys or versions than now, and are not taken")
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
    """A line above the progress."""
    stderr.print(words, markup=False, highlight=False, soft_wrap=True)


def executor_of(options: StudyOptions) -> Executor:
    """Where it runs, as asked. ConfigError where that cluster cannot be reached."""
    return LocalPool(options.workers) if options.scheduler is None else DaskCluster(options.scheduler)


@contextlib.contextmanager
def _progress(title: str, total: int, done: int) -> Iterator[Progress]:
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = Progress(*columns, TextColumn("remaining"), TimeRemainingColumn(), console=stderr, transient=True)
    bar.add_task(title, total=total, completed=done)
    with bar:
        yield bar
