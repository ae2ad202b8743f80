"""The results of a study's cases: a journal with one line for each case, merged into one Parquet file at the end."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from polishd.model.errors import ConfigError
from polishd.studies.cases import Case, versions
from polishd.studies.engine import FinishedCase
from polishd.util.extras import require_extra
from polishd.util.files import require_writable, unwritable_message, whole_file, write_atomic

JOURNAL = "cases.jsonl"
TABLE = "cases.parquet"
OVER = "over."
"""Prefix of the name of a column that is a key of the study."""
OWN = ("case", "point", "scenario", "loop", "seed", "error", "tries", "wall_s", "cpu_s", "of", "versions")
"""Columns of every case, beside its swept values and its figures."""
NAMED = ("scenario", "loop", "seed")
STUDY = b"polishd.study"
"""Key of the file's metadata: the study's text."""
Row = dict[str, Any]
Rows = list[Row]


class ResultStore:
    """Known results of a study's cases, by the hash of their inputs."""

    def __init__(self, folder: Path | None) -> None:
        """``folder`` None: nothing is stored. ConfigError for an invalid line; an incomplete last one is dropped."""
        self._folder = folder
        self._known: dict[str, Rows] = {}
        if folder is not None:
            _mend(folder / JOURNAL)
            self._known = _known(folder)

    def find(self, case: Case) -> Rows | None:
        """Return the rows of a case with the same inputs; a case that ended in an error is tried again."""
        rows = self._known.get(case.of)
        return None if rows is None or rows[0]["error"] else rows

    def count_others(self, cases: Iterable[Case]) -> int:
        """Count known cases of another study, or of an earlier version of this one."""
        return len(self._known.keys() - {case.of for case in cases})

    def add(self, done: FinishedCase) -> Rows:
        """Add a case, on the disk at once."""
        rows = _rows(done)
        self._known[done.case.of] = rows
        if self._folder is not None:
            path = self._folder / JOURNAL
            try:
                with path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"of": done.case.of, "rows": rows}) + "\n")
            except OSError as error:
                raise unwritable_message(path, error) from error
        return rows

    def merge(self, cases: Iterable[Case], study: str) -> None:
        """Write all results of these cases as one table, whole; then remove the journal."""
        if self._folder is None:
            return
        rows = [row for case in cases for row in self.table(case)]
        if not rows:
            return
        try:
            _write(self._folder / TABLE, rows, study)
            (self._folder / JOURNAL).unlink(missing_ok=True)
        except OSError as error:
            raise unwritable_message(self._folder / TABLE, error) from error

    def table(self, case: Case) -> Rows:
        """Return rows for the table: number and parameters are those of the present study."""
        return [laid(case, row) for row in self._known.get(case.of, ())]


def make_folder(out: Path | None) -> None:
    """Create the folder before any case is computed: an error there must not come at the end. ConfigError."""
    if out is None:
        return
    try:
        out.mkdir(parents=True, exist_ok=True)
        require_writable(out)
    except OSError as error:
        raise ConfigError(f"{out}: cannot create the folder: {error.strerror}. Name a folder with --out") from error


def laid(case: Case, row: Mapping[str, Any]) -> Row:
    """Return a row with the case's number, point and parameters in front."""
    at = {OVER + key: _plain(value) for key, value in case.at.items()}
    named = {name: getattr(case, name) for name in NAMED}
    known = {name: value for name, value in row.items() if name not in {"case", "point", *NAMED}}
    return {"case": case.number, "point": case.point, **at, **named, **known}


def read_table(folder: Path) -> tuple[Rows, str]:
    """Return all rows of a study's folder, complete or not, and the study's text. ConfigError."""
    found = _known(folder)
    if not found:
        raise ConfigError(f"{folder}: no {TABLE} and no {JOURNAL}. Name the --out of a study")
    rows = [row for rows in found.values() for row in rows]
    return sorted(rows, key=lambda row: int(row["case"])), _text(folder / TABLE)


def _known(folder: Path) -> dict[str, Rows]:
    """Return the rows of each case by its hash; the journal's are newer than the table's."""
    return dict(_of_table(folder / TABLE)) | dict(_of_journal(folder / JOURNAL))


def _rows(done: FinishedCase) -> Rows:
    case, answer = done.case, done.answer
    after: Row = {
        "error": answer.error or None,
        "tries": done.tries,
        "wall_s": answer.wall_s,
        "cpu_s": answer.cpu_s,
        "of": case.of,
        "versions": json.dumps(versions()),
    }
    return [laid(case, {**figures, **after}) for figures in answer.rows or ({},)]


def _plain(value: Any) -> Any:
    """Return a swept value for a column: a range of no width is a number."""
    if isinstance(value, list) and len(value) == 2 and value[0] == value[1]:
        return value[0]
    return value


def _write(path: Path, rows: Sequence[Row], study: str) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    table = pa.table(columns).replace_schema_metadata({STUDY: study.encode()})
    with whole_file(path) as file:
        parquet.write_table(table, file, compression="zstd")


def _column(values: list[Any]) -> Any:
    """Return an Arrow array; values of several types are stored as JSON."""
    import pyarrow as pa

    try:
        return pa.array(values)
    except (pa.ArrowInvalid, pa.ArrowTypeError):
        return pa.array([None if value is None else json.dumps(value) for value in values])


def _of_table(path: Path) -> Iterator[tuple[str, Rows]]:
    if not path.exists():
        return
    require_extra(str(path), "studies")
    import pyarrow as pa
    from pyarrow import parquet

    try:
        rows = parquet.read_table(path).to_pylist()
    except (OSError, pa.ArrowInvalid) as error:
        raise ConfigError(
            f"{path}: cannot read: {error}. Move the file away, or name another folder with --out"
        ) from error
    by_case: dict[str, Rows] = {}
    for row in rows:
        by_case.setdefault(row["of"], []).append(row)
    yield from by_case.items()


def _text(path: Path) -> str:
    if not path.exists():
        return ""
    from pyarrow import parquet

    return ((parquet.read_schema(path).metadata or {}).get(STUDY) or b"").decode()


def _mend(path: Path) -> None:
    """Remove an incomplete line after a killed study: the next line starts clean."""
    if path.exists() and not (content := path.read_bytes()).endswith(b"\n"):
        write_atomic(path, content[: content.rfind(b"\n") + 1])


def _of_journal(path: Path) -> Iterator[tuple[str, Rows]]:
    """Read whole lines; an incomplete last line is omitted."""
    if not path.exists():
        return
    lines = path.read_text(encoding="utf-8").split("\n")[:-1]
    for number, line in enumerate(lines, 1):
        try:
            kept = json.loads(line)
            of, rows = str(kept["of"]), [dict(row) for row in kept["rows"]]
            if not rows or any(name not in row for row in rows for name in OWN):
                raise KeyError("rows")
        except (ValueError, TypeError, KeyError) as error:
            raise ConfigError(
                f"{path}:{number}: no case of a study. Remove the line, or name another folder with --out"
            ) from error
        yield of, rows
