"""``polishd program``: contents of a program, new times for it, and the proof that nothing else changed."""

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
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.dialect import (
    DEFAULT,
    DIALECTS,
    HEAD_BYTES,
    AnyDialect,
    DwellWord,
    GcodeDialect,
    detect,
    dialect,
    require_language,
)
from polishd.plugins.rnc_robot.dialect import dialect as dialect_named
from polishd.plugins.rnc_robot.formats import require_one_reading
from polishd.plugins.rnc_robot.gcode.rewrite import StreamCounts, scan_program
from polishd.plugins.rnc_robot.languages import LanguageProfile
from polishd.plugins.rnc_robot.verify import Verification, verify
from polishd.process.toolpath.apertures import TOWARDS, Aperture
from polishd.programs.rewrite import DwellTable, opened, read_program_file, require_new_target, rewrite_file
from polishd.rendering.map_plots import path_map
from polishd.rendering.plots import BLUE, INK, ORANGE, figure, png, polishd_style
from polishd.rendering.terminal import emit, key_table, record_table, stderr, stdout

SHOWN = 20
"""Longest list of changed lines and warnings for people."""


def _is_pipe(file: Path) -> bool:
    with suppress(OSError):
        return file.is_fifo()
    return False


def chosen(file: Path, dialect: str | None) -> tuple[AnyDialect, str]:
    """The dialect of a program, and the reason of the choice.

    Raises:
        ProgramError: the file is in another language than the dialect; or, without one, several fit, or none is read.
        ConfigError: there is no such dialect.
    """
    if _is_pipe(file):  # read only once
        if dialect is None:
            raise ProgramError(f"{file}: a pipe is read once, so its dialect is not detected. To do: give --dialect.")
        return dialect_named(dialect), "--dialect"
    with opened(file) as source:
        head = source.read(HEAD_BYTES)
    if dialect is None:
        found = detect(head, file.name)
        if found.dialect == DEFAULT:
            require_one_reading(head, file.name)
        return dialect_named(found.dialect), found.why
    profile = dialect_named(dialect)
    require_language(profile, head, file.name)
    return profile, "--dialect"


@contextmanager
def _naming_the_assumption(profile: AnyDialect, why: str) -> Iterator[None]:
    """Add to the refusal of a line that the dialect was only assumed: then a wrong dialect is the likely cause."""
    try:
        yield
    except ProgramError as error:
        if not why.endswith("assumed") or ", line " not in str(error):
            raise
        raise ProgramError(
            f"{error} The file was read as {profile.name} ({why}); for another controller give --dialect."
        ) from error


def inspect_verb(file: Path, dialect: str | None, picture: Path | None, *, as_json: bool) -> None:
    """Show points, times, feeds, bounds and assumptions of a program."""
    profile, why = chosen(file, dialect)
    if picture is not None:
        require_new_target(picture, file)
    with _naming_the_assumption(profile, why):
        answer = {**_inspected(file, profile), "dialect_by": why}
    if picture is not None:
        from polishd.rendering.plots import save_picture

        with stderr.status(f"drawing {file.name}"):
            save_picture(picture, program_picture(read_program_file(profile, file)), "--picture")
    emit(answer, as_json=as_json, table=lambda: _inspect_table(file.name, answer))
    if not as_json:
        _say_notes("warning", answer["warnings"])
        if picture is not None:
            stdout.print(f"written to {picture}", markup=False)


def _inspected(file: Path, profile: AnyDialect) -> dict[str, Any]:
    """Figures as JSON values. NC text of any size is read in bounded memory."""
    found: StreamCounts | Program
    if isinstance(profile, GcodeDialect):
        with _bar("reading", file) as progress, opened(file) as source:
            found = scan_program(profile, source, file.name, progress)
        points, total_s, (slow, fast) = found.points, found.time_s, found.feed_mm_min
        bounds = (found.low_mm, found.high_mm)
    else:
        found = read_program_file(profile, file)
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
    "time": "the time of each move",
}


def rewrite_verb(
    file: Path,
    dwell: Path,
    out: Path,
    dialect: str | None,
    encoding: Encoding | None,
    *,
    comment: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Write the program with other times; write nothing where anything is wrong."""
    (profile, why), table = chosen(file, dialect), DwellTable(dwell)
    with _naming_the_assumption(profile, why), _bar("rewriting", file) as progress:
        written = rewrite_file(file, table, out, profile, encoding, comment=comment, force=force, progress=progress)
    answer = {**asdict(written), "out": [str(path) for path in written.out], "dialect": profile.name, "dialect_by": why}
    rows = [
        ("dialect", f"{profile.name} ({why})"),
        ("points", f"{written.points}, time in {ENCODINGS[written.encoding]}"),
        ("asked for", f"{written.asked_total_s:.9g} s"),
        ("written", f"{written.dwell_total_s:.9g} s{_kept(written.points - written.rows)}"),
        *(("to", path) for path in written.out),
    ]
    emit(answer, as_json=as_json, table=lambda: key_table(f"{file.name}, rewritten", rows))
    if not as_json:
        _say_notes("warning", written.warnings)


def _kept(moves: int) -> str:
    return f", with {moves} moves that had no dwell and keep their time" if moves else ""


@contextmanager
def _bar(what: str, file: Path) -> Iterator[Callable[[int], None]]:
    """Progress bar on stderr while a file is read; it takes bytes."""
    size = os.path.getsize(file) if os.path.isfile(file) else None  # noqa: PTH113, PTH202 - Path's raise
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal) as bar:
        task = bar.add_task(f"{what} {file.name}", total=size)
        yield lambda count: bar.advance(task, count)


def verify_verb(old: Path, new: Path, dialect: str | None, *, with_rs274: bool, as_json: bool) -> None:
    """Prove that the motion is identical, and list what changed. ProgramError where it is not proved."""
    profile, why = chosen(old, dialect)
    chosen(new, dialect or profile.name)
    with _naming_the_assumption(profile, why), stderr.status(f"comparing {old.name} and {new.name}"):
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
        ("points", f"{found.points}, {_changed_words(found)}"),
        ("before", f"{found.time_before_s:.6g} s, a point {before[0]:.6g} to {before[1]:.6g} s"),
        ("after", f"{found.time_after_s:.6g} s, a point {after[0]:.6g} to {after[1]:.6g} s"),
        *(("proved by", words) for words in found.proved_by),
    ]
    return key_table(title, rows)


def _changed_words(found: Verification) -> str:
    if found.changed_points is None or found.largest_change_s is None:
        return "times not compared"
    return f"the time of {found.changed_points} changed, by {found.largest_change_s:.6g} s at most"


def _say_notes(what: str, notes: list[str] | tuple[str, ...]) -> None:
    for note in notes[:SHOWN]:
        stdout.print(f"{what}: {note}", markup=False, highlight=False, soft_wrap=True)
    if len(notes) > SHOWN:
        stdout.print(f"{what}: {len(notes) - SHOWN} more; --json has them", markup=False)


# ``polishd program dialects``: time rules of each shipped profile.

_COLUMNS = ("dialect", "for", "dwell", "new dwells", "quantum, s", "time in F", "lines at most")


def dialects_verb(*, as_json: bool) -> None:
    """All shipped dialects, as a table or as JSON."""
    answers = [dialect_answer(dialect(name)) for name in DIALECTS]
    emit({"dialects": answers}, as_json=as_json, table=lambda: record_table("dialects", _COLUMNS, map(_row, answers)))


def dialect_answer(profile: AnyDialect) -> dict[str, Any]:
    """Time rules of a profile as JSON values; null: none, or no limit."""
    return {
        "name": profile.name,
        "kind": profile.kind,
        **dict.fromkeys(("title", "dwell", "written", "quantum_s", "finest_s", "resolution_s", "feed", "inverse")),
        "most_lines": None,
        **(_of_nc(profile) if isinstance(profile, GcodeDialect) else _of_language(profile)),
    }


def _of_language(profile: LanguageProfile) -> dict[str, Any]:
    return {
        "title": profile.summary,
        "dwell": [*profile.statements.dwell, *profile.statements.dwell_in_position],
        "quantum_s": profile.dwell.quantum_s,
        "finest_s": profile.dwell.quantum_s,
        "most_lines": profile.line_limit or None,
    }


def _of_nc(profile: GcodeDialect) -> dict[str, Any]:
    dwell = profile.dwell
    words = {letter: _unit(word) for letter, word in dwell.words.items()}
    return {
        "title": profile.title,
        "dwell": [f"{letter} {unit}" for letter, unit in words.items() if unit],
        "written": dwell.written,
        "quantum_s": 10.0**-dwell.decimals,
        "finest_s": 10.0**-dwell.most_decimals,
        "resolution_s": dwell.resolution_s or None,
        "feed": profile.feed.unit,
        "inverse": None if profile.feed.g93 == "refuse" else profile.feed.g93,
    }


def _unit(word: DwellWord) -> str:
    """Unit of a dwell word as text; empty where both forms are refused."""
    if word.whole == word.decimal:
        return "" if word.whole == "refuse" else word.whole
    ways = ((word.whole, "without a point"), (word.decimal, "with a point"))
    return ", ".join(f"{unit} {way}" for unit, way in ways if unit != "refuse")


def _row(answer: dict[str, Any]) -> tuple[str, ...]:
    inverse = answer["inverse"]
    feed = f"{answer['feed']}" + (f"; G93 {inverse}" if inverse else "") if answer["feed"] else "no"
    return (
        answer["name"],
        answer["title"],
        "\n".join(answer["dwell"]),
        answer["written"] or "as the program has them",
        _quantum(answer),
        feed,
        str(answer["most_lines"] or "any"),
    )


def _quantum(answer: dict[str, Any]) -> str:
    """Resolution of new numbers, of the program's own, and of the controller."""
    found = f"{answer['quantum_s']:g}"
    if answer["finest_s"] < answer["quantum_s"]:
        found += f", to {answer['finest_s']:g}"
    return found + (f" (runs {answer['resolution_s']:g})" if answer["resolution_s"] else "")


# Pictures of programs: dwell times on the part, and a generated path.

MOST_DOTS = 20_000
"""Most points that are drawn one by one; of more, every k-th."""


def program_picture(program: Program) -> bytes:
    """PNG: the points seen from above, coloured by their time, and the time along the program."""
    step = max(1, -(-program.n // MOST_DOTS))
    place, time_s = program.end_mm[::step], program.time_s[::step]
    with polishd_style():
        page = figure(7.6, 3.6)
        above, along = page.subplots(1, 2)
        path_map(above, place, time_s, program.name, "s")
        along.plot(np.arange(1, program.n + 1, step), time_s, color=BLUE, linewidth=0.8)
        along.set(title="time along the program", xlabel="point", ylabel="s", ylim=(0, None))
        return png(page)


def path_picture(points_mm: FloatArray, normal: FloatArray, aperture: Aperture, title: str) -> bytes:
    """PNG: the path (n, 3) seen from above with the aperture's outline, and the tilt of its normals (n, 3)."""
    step = max(1, -(-len(points_mm) // MOST_DOTS))
    tilt_deg = np.degrees(np.arctan2(np.hypot(normal[:, 0], normal[:, 1]), normal[:, 2]))
    outline = aperture.outline_mm()
    with polishd_style():
        page = figure(8.2, 3.9)
        path, tilt = page.subplots(1, 2, sharex=True, sharey=True)
        thin = float(np.clip(2000 / len(points_mm), 0.15, 1.2))
        path.plot(*points_mm.T[:2], color=BLUE, linewidth=thin)
        path.plot(*points_mm[0, :2], "o", color=ORANGE, markersize=4, label="first point")
        path.plot(*points_mm[-1, :2], "s", color=ORANGE, markersize=4, label="last point")
        path.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2)
        path.set(title=title.replace("$", r"\$"), ylabel="y, mm")
        path_map(tilt, points_mm[::step], tilt_deg[::step], "tilt of the normal", "deg")
        for axes in (path, tilt):
            axes.plot(*np.vstack([outline, outline[:1]]).T, color=INK, linewidth=0.9)
            axes.plot(*(aperture.hole_mm * np.vstack([TOWARDS, TOWARDS[:1]])).T, color=INK, linewidth=0.9)
            axes.set(xlabel="x, mm", aspect="equal")
        return png(page)
