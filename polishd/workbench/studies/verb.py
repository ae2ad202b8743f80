"""``polishd study``: a simulation without a cell, described by a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer
from rich.table import Table

from polishd.config.loop_study import LoopStudy
from polishd.config.study import CorrectionsStudy, PassesStudy, SpotsStudy, Study, load_study
from polishd.files import require_writable, write_atomic
from polishd.hooks.loader import load_own
from polishd.model.errors import ConfigError
from polishd.model.surface import SurfaceMap
from polishd.recipe.encoding import facts_of
from polishd.recipe.files import read_map
from polishd.show.tables import stderr, stdout
from polishd.workbench.studies import confusion, pictures, tables
from polishd.workbench.studies.corrections import Tell, compare_corrections
from polishd.workbench.studies.kept import Kept
from polishd.workbench.studies.loops import run_loops
from polishd.workbench.studies.options import StudyOptions
from polishd.workbench.studies.passes import polish_evenly
from polishd.workbench.studies.spots import compute_spots

TABLE = "table.json"


@dataclass(frozen=True, slots=True)
class Answer:
    """What a study came to."""

    rows: list[dict[str, Any]]
    tables: list[Table]
    notes: list[str]
    pictures: Mapping[str, pictures.Draw]
    """By file name."""
    pages: Mapping[str, str] = field(default_factory=dict)
    """Text, likewise."""


def study_verb(study: Path, options: StudyOptions, *, as_json: bool) -> None:
    """Run a study: a JSON list or tables on stdout, pictures and ``table.json`` in ``out``. ConfigError."""
    loaded, out = load_study(study), options.out
    for name in ("limit", "jobs"):
        if getattr(options, name) is not None and not isinstance(loaded, LoopStudy):
            raise typer.BadParameter(f'--{name} goes with a study of kind = "loop"; leave it out')
    if out is not None:
        _make_folder(out)
    with stderr.status("reading") as status:
        answer = _answer(loaded, options, lambda words: status.update(f"{loaded.title}: {words}"))
        if out is not None:
            status.update(f"{loaded.title}: drawing")
            _write(out, answer)
    if as_json:
        typer.echo(json.dumps(answer.rows))
        return
    for table in answer.tables:
        stdout.print(table)
    for note in answer.notes:
        stdout.print(note, markup=False, highlight=False)
    if out is not None:
        stdout.print(
            f"written to {out}: {', '.join([TABLE, *answer.pictures, *answer.pages])}", markup=False, soft_wrap=True
        )


def _answer(study: Study, options: StudyOptions, tell: Tell) -> Answer:
    if isinstance(study, CorrectionsStudy):
        compared = compare_corrections(study, _read, tell)
        rows = [facts_of(row) for row in compared.rows]
        shown = tables.correction_tables(study.title, compared)
        return Answer(rows, shown, tables.correction_notes(compared), pictures.of_corrections(compared))
    if isinstance(study, SpotsStudy):
        spots = compute_spots(study, tell)
        shown = tables.spot_tables(study, spots)
        return Answer([row.as_json() for row in spots], shown, tables.spot_notes(spots), pictures.of_spots(spots))
    if isinstance(study, PassesStudy):
        return _of_passes(study, tell)
    looped = run_loops(study, tell, seeds=options.limit, jobs=options.jobs, kept=Kept(options.out))
    shown = [tables.loop_table(study.title, looped), confusion.confusion_table(study.title, looped)]
    pages = {confusion.FILE: confusion.confusion_page(looped)}
    return Answer(looped.as_json(), shown, tables.loop_notes(looped), pictures.of_loops(looped), pages)


def _of_passes(study: PassesStudy, tell: Tell) -> Answer:
    polished = polish_evenly(study, tell)
    shown = [tables.passes_table(study, polished)]
    return Answer([polished.as_json()], shown, list(polished.notes), pictures.of_passes(polished))


def _read(path: Path) -> SurfaceMap:
    return read_map(path, load_own().surface_readers().values())


def _make_folder(out: Path) -> None:
    """Before anything is computed: a folder that cannot be made is no news for the end."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        require_writable(out)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be made: {error.strerror}; name a folder with --out") from error


def _write(out: Path, answer: Answer) -> None:
    try:
        for name, draw in answer.pictures.items():
            write_atomic(out / name, draw())
        for name, text in answer.pages.items():
            write_atomic(out / name, text.encode())
        write_atomic(out / TABLE, (json.dumps(answer.rows, indent=1) + "\n").encode())
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written to: {error.strerror}; name a folder with --out") from error
