"""``polishd map FILE...``: the figures of each map, as a table, as JSON, and as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from polishd.hookspecs import SurfaceReader
from polishd.maps.figures import HEIGHTS, MapFigures, figured
from polishd.maps.map_files import (
    MapSource,
    distinguish_names,
    draw,
    edges_mm,
    history_rows,
    mask_lines,
    mask_words,
    or_dash,
    printable,
    readers_for,
    require_picture,
    warnings,
)
from polishd.maps.options import FigureOptions
from polishd.model.errors import SurfaceError
from polishd.rendering.terminal import emit, figure_table, json_line, key_table, record_table, say, stdout
from polishd.util.extras import EXTRAS, missing_libraries

SOFT = "; soft: longer than a third of the part"
"""Mark of a band with a soft end."""
MOST_DRAWN = 12
"""Most maps in a picture, one row each."""


def figures_verb(files: Sequence[Path], asked: FigureOptions, *, as_json: bool) -> None:
    """Show the figures of each file. Name an unreadable file on stderr, continue, and exit with code 8."""
    edges = edges_mm(asked.bands)
    require_picture(asked.out)
    if asked.out is not None and len(files) > MOST_DRAWN:
        raise typer.BadParameter(f"--out draws {MOST_DRAWN} maps at most, not {len(files)}")
    source = MapSource.by(asked)
    answers: list[dict[str, Any]] = []
    drawn: list[MapFigures] = []
    for file in files:
        try:
            found = figured(source.read(file), asked.trim, edges)
        except SurfaceError as error:
            say(f"polishd: {error}", err=True)
            continue
        answers.append(found.answer)
        if as_json:
            say(json_line(found.answer))
        if asked.out is not None:
            drawn.append(found)
    if answers and not as_json:
        _show(answers)
    if asked.out is not None and drawn:
        from polishd.maps.pictures import figures_picture

        draw(asked.out, figures_picture(drawn), as_json=as_json)
    if len(answers) < len(files):
        raise typer.Exit(SurfaceError.exit_code)


def _show(answers: Sequence[Mapping[str, Any]]) -> None:
    """Show all figures of one map, or a row for each of several maps, and their notes."""
    names = distinguish_names([answer["path"] for answer in answers])
    if len(answers) == 1:
        stdout.print(key_table(printable(answers[0]["path"]), _rows(answers[0])))
    else:
        columns = ["file", "samples", "pitch mm", "missing", "dated by", "PV nm", "RMS nm", "PV level", "RMS level"]
        columns += next(([band["name"] for band in answer["bands"]] for answer in answers if answer["bands"]), [])
        stdout.print(figure_table("maps", columns, map(_row, names, answers)))
    for line in [*(mask_lines(names, answers) if len(answers) > 1 else ()), *warnings(names, answers)]:
        stdout.print(line, markup=False)


def _row(name: str, answer: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        name,
        f"{answer['rows']} x {answer['cols']}",
        or_dash(answer["pitch_mm"], ".7g"),
        str(answer["missing"]),
        answer["date_from"] or "-",
        *(f"{answer[key]:.3f}" for key in HEIGHTS),
        *(or_dash(band["rms_nm"], ".3f") for band in answer["bands"] or ()),
    )


def _rows(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    missing, trim = f"{answer['missing']} missing", f", {answer['trim']} px trimmed" if answer["trim"] else ""
    missing += f", {answer['masked']} masked" if answer["masks"] else ""
    rows = [
        ("format", f"{answer['format']}, reader {answer['reader_version']}"),
        ("samples", f"{answer['rows']} x {answer['cols']}, {missing}; {answer['samples']} count{trim}"),
        *((f"mask {printable(record['mask'])}", mask_words(record)) for record in answer["masks"]),
        ("pitch", _pitch_words(answer)),
        ("PV, RMS", _pair(answer, "")),
        ("level", f"{_pair(answer, '_tilt_removed')} (piston and tilt removed)"),
        (f"PVr ({answer['pvr_terms']} terms)", or_dash(answer["pvr_nm"], ".6f", " nm")),
        ("slope", or_dash(answer["slope_rms_urad"], ".4g", " urad RMS")),
        *((band["name"], _band_words(band)) for band in answer["bands"] or ()),
    ]
    said = {"part": answer["part_id"], "instrument": answer["instrument"], "taken": date_words(answer)}
    rows += [(name, printable(value)) for name, value in said.items() if value]
    rows += [("orientation", answer["orientation"]), *history_rows(answer["history"])]
    if answer["unsaid"]:
        rows.append(("the file does not say", ", ".join(answer["unsaid"])))
    return [*rows, ("sha256", answer["sha256"])]


def _pitch_words(answer: Mapping[str, Any]) -> str:
    if answer["pitches_mm"] is not None:
        wide, high = answer["pitches_mm"]
        return f"{wide:.7g} x {high:.7g} mm (pixels are not square)"
    return "none" if answer["pitch_mm"] is None else f"{answer['pitch_mm']:.7g} mm"


def date_words(answer: Mapping[str, Any]) -> str:
    """Date of the map, and its source."""
    by = {"file system": "file system: its header has no date", "guessed": "guessed: not used"}
    return f"{answer['dated_at']} ({by.get(answer['date_from'], answer['date_from'])})" if answer["dated_at"] else ""


def _pair(answer: Mapping[str, Any], which: str) -> str:
    return f"{answer[f'pv{which}_nm']:.6f}, {answer[f'rms{which}_nm']:.6f} nm"


def _band_words(band: Mapping[str, Any]) -> str:
    ends = (("below", band["from_mm"]), ("above", band["to_mm"]))
    periods = " and ".join(f"{word} {edge:g} mm" for word, edge in ends if edge is not None)
    return or_dash(band["rms_nm"], ".3f", " nm RMS") + f" (periods {periods}{SOFT if band['soft'] else ''})"


# ``polishd map formats``: formats that can be read and written here.


def formats_verb(cell: Path | None = None, *, as_json: bool) -> None:
    """All readers, in the order in which they are tried."""
    asked = readers_for(cell)
    own = asked.keys() if cell is None else readers_for().keys()
    answers = [{**format_answer(reader), "own": reader.name in own} for reader in asked.values()]
    columns = ("format", "endings", "reads", "writes", "dated by", "installed by")
    emit(
        {"formats": answers}, as_json=as_json, table=lambda: record_table("formats", columns, map(_format_row, answers))
    )


def format_answer(reader: SurfaceReader) -> dict[str, Any]:
    """Abilities of a reader in this installation."""
    extra = reader.name if reader.name in EXTRAS else None  # a format that needs one has its name
    installed = extra is None or not missing_libraries(extra)
    return {
        "name": reader.name,
        "suffixes": list(reader.suffixes),
        "reads": installed,
        "writes": installed and reader.write is not None,
        "dates": reader.dates,
        "extra": extra,
        "installed": installed,
    }


def _format_row(answer: dict[str, Any]) -> tuple[str, ...]:
    extra = answer["extra"]
    by = "polishd" if answer["own"] else "a plugin of the cell"
    return (
        answer["name"],
        " ".join(answer["suffixes"]) or "any",
        "yes" if answer["reads"] else "no",
        "yes" if answer["writes"] else "no",
        "header" if answer["dates"] else "file system",
        f"pip install 'polishd[{extra}]'" + (": is there" if answer["installed"] else "") if extra else by,
    )
