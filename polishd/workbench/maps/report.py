"""``polishd map report FILE... --out report.html|pdf``: the page that goes to the customer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import typer

from polishd.files import write_atomic
from polishd.model.errors import ConfigError, SurfaceError
from polishd.show.tables import json_line, stdout
from polishd.show.terminal import say
from polishd.workbench.maps.figures import figured
from polishd.workbench.maps.files import MapSource, edges_mm, printable
from polishd.workbench.maps.options import ReportOptions
from polishd.workbench.maps.report_figures import MapReportData, MapReportOptions, reported

ENDINGS = (".html", ".pdf")


def report_verb(files: Sequence[Path], asked: ReportOptions, *, as_json: bool) -> None:
    """Report of the maps. One that cannot be read is named on stderr, the others are reported; the exit code is 8."""
    edges = edges_mm(asked.bands)
    if asked.out.suffix.lower() not in ENDINGS:
        raise ConfigError(f"{asked.out}: a report is an HTML or a PDF file; name it *.html or *.pdf")
    source = MapSource.by(asked)
    wanted = _wanted(asked, source)
    found: list[MapReportData] = []
    for file in files:
        try:
            found.append(reported(figured(source.read(file), asked.trim, edges), wanted))
        except SurfaceError as error:
            say(f"polishd: {error}", err=True)
            continue
        if as_json:
            say(json_line(found[-1].answer))
    if found:
        _write(asked.out, found, as_json=as_json)
    if len(found) < len(files):
        raise typer.Exit(SurfaceError.exit_code)


def _wanted(asked: ReportOptions, source: MapSource) -> MapReportOptions:
    wanted = MapReportOptions(
        wavelength_nm=asked.wavelength,
        ordering=asked.zernike.value,
        terms=asked.terms,
        repeatability_nm=None if source.instrument is None else source.instrument.repeatability_nm,
        by=asked.by,
    )
    if asked.tolerance is not None:
        from polishd.config.tolerance import load_tolerance

        return replace(wanted, lines=load_tolerance(asked.tolerance), judged_by=str(asked.tolerance))
    return wanted if asked.cell is None else _as_the_cell(wanted, asked.cell)


def _as_the_cell(wanted: MapReportOptions, cell: Path) -> MapReportOptions:
    """Judged by the lines of a cell's file, as its job is."""
    from polishd.config.cell import load_config
    from polishd.recipe.making import instrument_of

    config = load_config(cell)
    instrument = instrument_of(config)
    repeatability_nm = instrument.repeatability_nm if instrument is not None else None
    return replace(
        wanted,
        lines=config.lines,
        judged_by=str(cell),
        alignment=config.part.alignment,
        repeatability_nm=wanted.repeatability_nm if wanted.repeatability_nm is not None else repeatability_nm,
    )


def _write(out: Path, found: list[MapReportData], *, as_json: bool) -> None:
    from polishd.workbench.maps.report_sheet import sheet

    page = sheet(found)
    if out.suffix.lower() == ".pdf":
        from polishd.show.sheet_pdf import pdf

        content = pdf(page)
    else:
        from polishd.show.sheet_html import html

        content = html(page).encode()
    try:
        write_atomic(out, content)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}; name a file with --out") from error
    if not as_json:
        stdout.print(f"report of {len(found)} map{'s' * (len(found) > 1)} in {printable(out)}", markup=False)
