"""``polishd program``: what an RNC program says, its times rewritten, and the proof that nothing else changed."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from polishd.model.errors import ProgramError
from polishd.model.program import Encoding, Program
from polishd.plugins.rnc_robot.detect import HEAD_BYTES, detect, require_language
from polishd.plugins.rnc_robot.dialect import DEFAULT, AnyDialect, GcodeDialect
from polishd.plugins.rnc_robot.dialect import dialect as dialect_named
from polishd.plugins.rnc_robot.formats import read
from polishd.plugins.rnc_robot.nc.stream import StreamCounts, look_through
from polishd.plugins.rnc_robot.verify import Verification, verify
from polishd.show.tables import emit, key_table, stderr, stdout
from polishd.workbench.programs.dwell_csv import DwellTable
from polishd.workbench.programs.files import content, not_over, opened, rewrite_file

SHOWN = 20
"""Most changed lines and warnings that a person is shown."""


def _is_pipe(file: Path) -> bool:
    with suppress(OSError):
        return file.is_fifo()
    return False


def chosen(file: Path, dialect: str | None) -> tuple[AnyDialect, str]:
    """The dialect of a program, and by what it was chosen.

    Raises:
        ProgramError: the file is in another language than the dialect; or, without one, several fit, or none is read.
        ConfigError: there is no such dialect.
    """
    if _is_pipe(file):  # it is read once
        return dialect_named(dialect or DEFAULT), "--dialect" if dialect else "assumed: not a regular file"
    with opened(file) as source:
        head = source.read(HEAD_BYTES)
    if dialect is None:
        found = detect(head, file.name)
        return dialect_named(found.dialect), found.why
    profile = dialect_named(dialect)
    require_language(profile, head, file.name)
    return profile, "--dialect"


def inspect_verb(file: Path, dialect: str | None, picture: Path | None, *, as_json: bool) -> None:
    """What a program says: points, times, feeds, bounds, and what was assumed."""
    profile, why = chosen(file, dialect)
    if picture is not None:
        not_over(picture, file)
    answer = {**_inspected(file, profile), "dialect_by": why}
    if picture is not None:
        from polishd.show.style import save_picture
        from polishd.workbench.programs.pictures import program_picture

        with stderr.status(f"drawing {file.name}"):
            save_picture(picture, program_picture(read(profile, content(file), file.name)))
    emit(answer, as_json=as_json, table=lambda: _inspect_table(file.name, answer))
    if not as_json:
        _say_notes("warning", answer["warnings"])
        if picture is not None:
            stdout.print(f"written to {picture}", markup=False)


def _inspected(file: Path, profile: AnyDialect) -> dict[str, Any]:
    """The figures as JSON holds them. NC text of any size is looked through in bounded memory."""
    found: StreamCounts | Program
    if isinstance(profile, GcodeDialect):
        with _bar("reading", file) as progress, opened(file) as source:
            found = look_through(profile, source, file.name, progress)
        points, total_s, (slow, fast) = found.points, found.time_s, found.feed_mm_min
        bounds = (found.low_mm, found.high_mm)
    else:
        found = read(profile, content(file), file.name)
        points, total_s, feeds = found.n, math.fsum(found.time_s), found.feed_mm_min[np.isfinite(found.feed_mm_min)]
        slow, fast = (float(feeds.min()), float(feeds.max())) if feeds.size else (np.inf, -np.inf)
        bounds = (found.end_mm.min(axis=0), found.end_mm.max(axis=0))
    return {
        "dialect": found.dialect,
        "lines": found.lines,
        "points": points,
        "dwell_total_s": total_s,
        "feed_range_mm_min": [slow, fast] if slow <= fast else None,
        "bounds_mm": {axis: [float(low), float(high)] for axis, low, high in zip("xyz", *bounds, strict=True)},
        "warnings": list(found.warnings),
        "encoding": found.encoding,
        "unit": found.unit,
        "sha256": found.sha256,
    }


def _inspect_table(name: str, answer: dict[str, Any]) -> Any:
    points, total_s, feeds = answer["points"], answer["dwell_total_s"], answer["feed_range_mm_min"]
    rows = [
        ("dialect", f"{answer['dialect']} ({answer['dialect_by']})"),
        ("lines", answer["lines"]),
        ("points", f"{points}, time in {ENCODINGS[answer['encoding']]} ({answer['unit']})"),
        ("dwell", f"{total_s:.6g} s, {total_s / points:.4g} s a point on average"),
        ("feed", "not known" if feeds is None else f"{feeds[0]:.6g} to {feeds[1]:.6g} mm/min"),
        *((axis, f"{a:.4f} to {b:.4f} mm") for axis, (a, b) in answer["bounds_mm"].items()),
        ("sha256", answer["sha256"]),
    ]
    return key_table(name, rows)


ENCODINGS: dict[Encoding, str] = {
    "dwell": "dwell blocks",
    "feed": "the feed of each move",
    "inverse": "inverse-time feed (G93)",
}


def rewrite_verb(
    file: Path, dwell: Path, out: Path, dialect: str | None, encoding: Encoding | None, *, comment: bool, as_json: bool
) -> None:
    """Write the program with other times; nothing is written where anything is wrong."""
    (profile, why), table = chosen(file, dialect), DwellTable(dwell)
    with _bar("rewriting", file) as progress:
        written = rewrite_file(file, table, out, profile, encoding, comment=comment, progress=progress)
    answer = {**asdict(written), "out": [str(path) for path in written.out], "dialect": profile.name, "dialect_by": why}
    rows = [
        ("dialect", f"{profile.name} ({why})"),
        ("points", f"{written.points}, time in {ENCODINGS[written.encoding]}"),
        ("asked for", f"{written.asked_total_s:.9g} s"),
        ("written", f"{written.dwell_total_s:.9g} s{_kept(written.points - written.rows)}"),
        *(("to", path) for path in written.out),
    ]
    emit(answer, as_json=as_json, table=lambda: key_table(f"{file.name}, rewritten", rows))


def _kept(moves: int) -> str:
    return f", with {moves} moves that had no dwell and keep their time" if moves else ""


@contextmanager
def _bar(what: str, file: Path) -> Iterator[Callable[[int], None]]:
    """A bar on stderr for as long as a file is read; hears of bytes."""
    size = os.path.getsize(file) if os.path.isfile(file) else None  # noqa: PTH113, PTH202 - Path's raise
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal) as bar:
        task = bar.add_task(f"{what} {file.name}", total=size)
        yield lambda count: bar.advance(task, count)


def verify_verb(old: Path, new: Path, dialect: str | None, *, with_rs274: bool, as_json: bool) -> None:
    """Prove that the motion is identical, and list what changed. ProgramError where it is not proved."""
    profile, why = chosen(old, dialect)
    chosen(new, dialect or profile.name)
    with stderr.status(f"comparing {old.name} and {new.name}"):
        found = verify(old, new, profile, with_rs274=with_rs274)
    by = {"dialect": profile.name, "dialect_by": why}
    title = f"{old.name}, {new.name}: {profile.name} ({why})"
    emit(asdict(found) | by, as_json=as_json, table=lambda: _verify_table(found, title))
    if not as_json:
        _say_notes("also changed", [str(change) for change in found.other_changes])
    if found.difference is not None:
        raise ProgramError(f"{new}: not proved to move as {old.name} does: {found.difference}.")


def _verify_table(found: Verification, title: str) -> Any:
    before, after = found.range_before_s, found.range_after_s
    rows = [
        ("motion", "identical" if found.identical_motion else "NOT proved identical"),
        (
            "points",
            f"{found.points}, the time of {found.changed_points} changed, by {found.largest_change_s:.6g} s at most",
        ),
        ("before", f"{found.time_before_s:.6g} s, a point {before[0]:.6g} to {before[1]:.6g} s"),
        ("after", f"{found.time_after_s:.6g} s, a point {after[0]:.6g} to {after[1]:.6g} s"),
        *(("proved by", words) for words in found.proved_by),
    ]
    return key_table(title, rows)


def _say_notes(what: str, notes: list[str] | tuple[str, ...]) -> None:
    for note in notes[:SHOWN]:
        stdout.print(f"{what}: {note}", markup=False, highlight=False, soft_wrap=True)
    if len(notes) > SHOWN:
        stdout.print(f"{what}: {len(notes) - SHOWN} more; --json has them", markup=False)
