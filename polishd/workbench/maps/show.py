"""``polishd map FILE...``: what each map is, as a table or as JSON, and as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from polishd.model.errors import SurfaceError
from polishd.show.tables import figure_table, key_table, stdout
from polishd.workbench.maps.figures import Figured, figured, json_line
from polishd.workbench.maps.files import edges_mm, map_from, profile_of, readers_for, require_picture, shown, told_apart
from polishd.workbench.maps.options import FigureOptions

MOST_DRAWN = 12
"""Maps in a picture: one row each."""


def figures_verb(files: Sequence[Path], options: FigureOptions, *, as_json: bool) -> None:
    """Figures of each file. One that cannot be read is named on stderr, and the others go on; the exit code is 8."""
    edges = edges_mm(options.bands)
    require_picture(options.out)
    if options.out is not None and len(files) > MOST_DRAWN:
        raise typer.BadParameter(f"--out draws {MOST_DRAWN} maps at most, not {len(files)}")
    instrument, readers = profile_of(options.profile), readers_for(options.cell)
    answers: list[dict[str, Any]] = []
    drawn: list[Figured] = []
    for file in files:
        try:
            found = figured(map_from(file, readers, instrument), options.trim, edges)
        except SurfaceError as error:
            typer.echo(f"polishd: {error}", err=True)
            continue
        answers.append(found.answer)
        if as_json:
            typer.echo(json_line(found.answer))
        if options.out is not None:
            drawn.append(found)
    if answers and not as_json:
        show(answers)
    if options.out is not None and drawn:
        _draw(options.out, drawn, as_json=as_json)
    if len(answers) < len(files):
        raise typer.Exit(SurfaceError.exit_code)


def _draw(out: Path, drawn: Sequence[Figured], *, as_json: bool) -> None:
    from polishd.show.style import save_picture
    from polishd.workbench.maps.pictures import figures_picture

    save_picture(out, figures_picture(drawn))
    if not as_json:
        stdout.print(f"drawn in {shown(out)}", markup=False)


def show(answers: Sequence[Mapping[str, Any]]) -> None:
    """For people: everything of one map, or a row each of several; then what is to be known of them."""
    names = told_apart([answer["path"] for answer in answers])
    if len(answers) == 1:
        stdout.print(key_table(shown(answers[0]["path"]), _rows(answers[0])))
    else:
        columns = ("file", "samples", "pitch mm", "missing", "PV nm", "RMS nm", "PV level", "RMS level")
        stdout.print(figure_table("maps", (*columns, *_band_columns(answers)), map(_row, names, answers)))
    for name, answer in zip(names, answers, strict=True):
        for warning in answer["warnings"]:
            stdout.print(f"warning: {name}: {shown(warning)}", markup=False)


def _band_columns(answers: Sequence[Mapping[str, Any]]) -> list[str]:
    return next(([band["name"] for band in answer["bands"]] for answer in answers if answer["bands"]), [])


def _row(name: str, answer: Mapping[str, Any]) -> tuple[str, ...]:
    figures = ("pv_nm", "rms_nm", "pv_tilt_removed_nm", "rms_tilt_removed_nm")
    return (
        name,
        f"{answer['rows']} x {answer['cols']}",
        _or_dash(answer["pitch_mm"], ".7g"),
        str(answer["missing"]),
        *(f"{answer[key]:.3f}" for key in figures),
        *(_or_dash(band["rms_nm"], ".3f") for band in answer["bands"] or ()),
    )


def _rows(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    missing, trim = f"{answer['missing']} missing", f", {answer['trim']} px trimmed" if answer["trim"] else ""
    pitch = answer["pitch_mm"]
    rows = [
        ("format", f"{answer['format']}, reader {answer['reader_version']}"),
        (
            "samples",
            f"{answer['rows']} x {answer['cols']}, {missing}; {answer['samples']} count{trim}",
        ),
        ("pitch", "none" if pitch is None else f"{pitch:.7g} mm"),
        ("PV, RMS", _pair(answer, "")),
        ("level", f"{_pair(answer, '_tilt_removed')} (piston and tilt removed)"),
        (f"PVr ({answer['pvr_terms']} terms)", _or_dash(answer["pvr_nm"], ".6f", " nm")),
        ("slope", _or_dash(answer["slope_rms_urad"], ".4g", " urad RMS")),
        *((band["name"], _band_words(band)) for band in answer["bands"] or ()),
    ]
    said = {"part": answer["part_id"], "instrument": answer["instrument"], "taken": answer["taken_at"]}
    rows += [(name, shown(value)) for name, value in said.items() if value]
    rows.append(("orientation", answer["orientation"]))
    if answer["unsaid"]:
        rows.append(("the file does not say", ", ".join(answer["unsaid"])))
    return [*rows, ("sha256", answer["sha256"])]


def _pair(answer: Mapping[str, Any], which: str) -> str:
    return f"{answer[f'pv{which}_nm']:.6f}, {answer[f'rms{which}_nm']:.6f} nm"


def _band_words(band: Mapping[str, Any]) -> str:
    ends = (("below", band["from_mm"]), ("above", band["to_mm"]))
    periods = " and ".join(f"{word} {edge:g} mm" for word, edge in ends if edge is not None)
    return _or_dash(band["rms_nm"], ".3f", " nm RMS") + f" (periods {periods})"


def _or_dash(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"
