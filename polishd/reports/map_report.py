"""``polishd map report FILE... --out report.html|pdf``: the page that goes to the customer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import typer
from matplotlib.axes import Axes

from polishd.maps.figures import figured
from polishd.maps.inspect import date_words
from polishd.maps.map_files import MapSource, edges_mm, printable
from polishd.maps.options import ReportOptions
from polishd.maps.pictures import LEAST_NM
from polishd.model.errors import ConfigError, SurfaceError
from polishd.model.surface import FloatArray
from polishd.model.tolerance import ToleranceLine
from polishd.rendering.document import Cell, Chapter, DocumentSection, Picture, ReportDocument, ReportValue, Table
from polishd.rendering.plots import BLUE, DIVERGING, INK, NO_DATA, ORANGE, SEQUENTIAL, figure, png, polishd_style, ruled
from polishd.rendering.terminal import json_line, say, stdout
from polishd.reports.map_figures import MapReportData, MapReportOptions, reported
from polishd.util.files import write_atomic

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
    from polishd.pipeline.build_recipe import instrument_of

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

    page = sheet(found)
    if out.suffix.lower() == ".pdf":
        from polishd.rendering.pdf import pdf

        content = pdf(page)
    else:
        from polishd.rendering.document import html

        content = html(page).encode()
    try:
        write_atomic(out, content)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}; name a file with --out") from error
    if not as_json:
        stdout.print(f"report of {len(found)} map{'s' * (len(found) > 1)} in {printable(out)}", markup=False)


# Pictures of a map's report: heights with marked peak and valley, lines through them, slope, spectrum and its line.

WIDE_IN = 9.0
DPI = 160
"""A report is printed, too."""
COLOURS = {"peak": ORANGE, "valley": BLUE}
MARKS = {"peak": "^", "valley": "v"}


def height_picture(found: MapReportData) -> Picture:
    """The level map with its peak and valley, and the lines through them, along x and y."""
    caption = (
        "Piston and tilt removed; red is high. Marked: peak (triangle up) and valley (triangle down); the dashed lines "
        "are the profiles beside it. Grey: no data, or outside the mask."
    )
    with polishd_style():
        page = figure(WIDE_IN, 4.2)
        axes = page.subplot_mosaic([["map", "x"], ["map", "y"]], width_ratios=[1.15, 1.0])
        level = found.figured.level_nm
        limit = float(np.nanmax(np.abs(level)))
        limit = limit if limit > LEAST_NM else 1.0
        _map(axes["map"], found, level, "nm", cmap=DIVERGING, vmin=-limit, vmax=limit)
        for name, colour in COLOURS.items():
            mark = found.answer[name]
            axes["map"].axhline(mark["y"], color=colour, linewidth=0.7, linestyle="--")
            axes["map"].axvline(mark["x"], color=colour, linewidth=0.7, linestyle="--")
            axes["map"].plot(mark["x"], mark["y"], MARKS[name], color=colour, markeredgecolor=INK, markersize=7)
        for line in found.answer["profiles"]:
            ax, name = axes[line["along"]], line["through"]
            nm = np.array([np.nan if value is None else value for value in line["nm"]])
            ax.plot(line["place"], nm, color=COLOURS[name], linewidth=0.9, label=f"through the {name}")
            ax.plot(found.answer[name][line["along"]], found.answer[name]["nm"], MARKS[name], color=COLOURS[name])
        for along in "xy":
            axes[along].set(xlabel=f"{along}, {found.unit}", ylabel="nm")
            ruled(axes[along])
        axes["x"].legend(loc="best")
        return Picture("heights", caption, png(page, DPI))


def slopes(found: MapReportData, slope_urad: FloatArray) -> Picture:
    """The magnitude of the slope."""
    caption = "Magnitude of the slope over two samples' distance; the last colour is the 99.8th percentile and above."
    with polishd_style():
        page = figure(WIDE_IN * 0.6, 3.8)
        most = float(np.nanpercentile(slope_urad, 99.8)) or 1.0
        _map(page.add_subplot(), found, slope_urad, "µrad", cmap=SEQUENTIAL, vmin=0.0, vmax=most)
        return Picture("slope", caption, png(page, DPI), wide=False)


def spectrum_picture(found: MapReportData) -> Picture:
    """The radially averaged PSD up to Nyquist, with the lines that the drawing has for it."""
    psd = found.answer["psd"]
    lines = [line for line in found.lines if line.figure == "psd"]
    caption = "Radially averaged two-dimensional PSD, up to the frequency of two samples a period."
    caption += " The straight lines are the drawing's: the PSD must be below." if lines else ""
    frequency, density = (np.asarray(psd[key]) for key in ("frequency_per_mm", "density_nm2_mm2"))
    some = density > LEAST_NM**2
    with polishd_style():
        page = figure(WIDE_IN * 0.6, 3.8)
        ax = page.add_subplot()
        ax.loglog(frequency[some], density[some], color=BLUE, linewidth=1.0, label="measured")
        for line, at in _ends(lines):
            label = f"{line.limit:g} / f^{line.exponent:g}" if line.exponent else f"{line.limit:g}"
            ax.loglog(at, line.limit / at**line.exponent, color=ORANGE, linewidth=1.8, label=label)
        ax.set(xlabel="spatial frequency f, 1/mm", ylabel="PSD, nm² mm²")
        ruled(ax, "both")
        if lines:
            ax.legend()
        return Picture("spectrum", caption, png(page, DPI), wide=False)


def _ends(lines: list[ToleranceLine]) -> Iterator[tuple[ToleranceLine, FloatArray]]:
    """Each line of a PSD with the frequencies between which it holds."""
    for line in lines:
        yield line, np.array([1 / (line.below_mm or np.inf), 1 / line.above_mm])


def _map(ax: Axes, found: MapReportData, values: FloatArray, unit: str, **colours: Any) -> None:
    half_x, half_y = found.grid.nx * found.grid.pitch_mm / 2, found.grid.ny * found.grid.pitch_mm / 2
    ax.set_facecolor(NO_DATA)
    seen = ax.imshow(values, extent=(-half_x, half_x, -half_y, half_y), interpolation="none", **colours)
    ax.set(xlabel=f"x, {found.unit}", ylabel=f"y, {found.unit}")
    ax.figure.colorbar(seen, ax=ax, label=unit, shrink=0.9)


# The report of a map as it stands on paper: every figure of it is taken from the answer that ``--json`` gives.

FORM = "ISO 10110-5:2015, evaluated by ISO 14999-4:2015"
EDITIONS = (
    ("surface form, 3/A(B/C), RMSt, RMSi, RMSa", "ISO 10110-5:2015", "2026"),
    ("wavefront, 13/A(B/C) and RMS", "ISO 10110-14:2018", ""),
    ("evaluation of both", "ISO 14999-4:2015", "2026"),
    ("PSD line A / f^B", "ISO 10110-8:2010", "2019"),
)
"""What is followed, and the edition that is newer and whose text was not at hand."""
WORDS = {"pv": "PV", "rms": "RMS", "pvr": "PVr"}
ISO_WORDS = {
    "a": "A, sagitta error",
    "b": "B, irregularity",
    "c": "C, rotationally symmetric irregularity",
    "rms_t": "RMSt, whole deviation",
    "rms_i": "RMSi, irregularity",
    "rms_a": "RMSa, without the symmetric part",
}
BANDS = {"from_mm": "g", "to_mm": "g", "rms_nm": ".3f"}
"""Figures of a band, and their formats."""
REMOVED = {"piston": "piston", "tilt": "piston and tilt", "power": "piston, tilt and power"}
NORMS = {"edge": "amplitude 1 at the circle's edge", "rms": "RMS 1 over the circle"}


def sheet(found: list[MapReportData]) -> ReportDocument:
    """A chapter for each map."""
    first = found[0].answer
    title = "Surface report" + (f": {printable(first['part_id'])}" if len(found) == 1 and first["part_id"] else "")
    return ReportDocument(title, [_chapter(one) for one in found], _footer(first["computed"]))


def _footer(computed: Mapping[str, Any]) -> str:
    by = f" for {computed['by']}" if computed["by"] else ""
    at = datetime.fromisoformat(computed["at"])
    return f"computed by {computed['program']} {computed['version']}{by}, {at:%Y-%m-%d %H:%M:%S} UTC"


def _chapter(found: MapReportData) -> Chapter:
    answer = found.answer
    name = printable(answer["path"].rpartition("/")[2])
    facts = [
        ("part", printable(answer["part_id"])),
        ("file", name),
        ("instrument", printable(answer["instrument"])),
        ("measured", date_words(answer)),
        ("computed by", _footer(answer["computed"]).removeprefix("computed by ")),
    ]
    form, detail = of_form(answer), of_detail(found)
    parts = [_surface(found), *form, *_tolerance(answer), *detail, _origin(answer), editions()]
    verdict = _verdict(answer)
    return Chapter(printable(answer["part_id"]) or name, facts, parts, verdict, answer["within"] is not False)


def of_form(answer: Mapping[str, Any]) -> list[DocumentSection]:
    """Primary aberrations and ISO 10110 of a surface, as far as its samples carry them."""
    return [*_aberrations(answer), *_indications(answer)]


def of_detail(found: MapReportData, *, spectrum: bool = True) -> list[DocumentSection]:
    """Slope, spatial periods and Zernike terms, likewise; ``spectrum``: with a picture of its PSD."""
    return [*_slope(found), *_periods(found, spectrum=spectrum), *_zernike(found.answer)]


def _verdict(answer: Mapping[str, Any]) -> str:
    lines = answer["tolerance"]
    if not lines:
        return ""
    held = sum(line["holds"] for line in lines)
    return f"{'in' if answer['within'] else 'not in'} tolerance: {held} of {len(lines)} lines hold"


def _surface(found: MapReportData) -> DocumentSection:
    answer = found.answer
    level = [(WORDS[key], *_length(answer, f"level.{key}")) for key in WORDS]
    marks = [
        (
            name,
            ReportValue.of(answer, f"{name}.nm", ".3f"),
            *(ReportValue.of(answer, f"{name}.{axis}", ".4g") for axis in "xy"),
        )
        for name in ("peak", "valley")
    ]
    heights = (
        "Heights are of the surface, not of a wavefront; piston and tilt are removed by least squares over the samples "
        "that count. A wave is a wavelength of surface height: two fringes in reflection."
    )
    pvr = f"PVr: PV of a fit of {answer['pvr_terms']} Zernike terms (fringe) and three times the RMS of what it leaves."
    places = ("place", "height, nm", f"x, {found.unit}", f"y, {found.unit}")
    tables = [Table(("height", "nm", _waves(answer)), level), Table(places, marks)]
    return DocumentSection("Surface", tables, [heights, pvr], [height_picture(found)])


def _aberrations(answer: Mapping[str, Any]) -> Iterator[DocumentSection]:
    if answer["aberrations"] is None:
        return
    rows = [
        (
            name,
            *_length(answer, f"aberrations.{name}"),
            ReportValue.of(answer, f"aberrations.{name}.deg", ".1f") if "deg" in aberration else "",
        )
        for name, aberration in answer["aberrations"].items()
    ]
    note = (
        "Amplitudes of the fringe Zernike terms 4; 5 and 6; 7 and 8; 9, each 1 at the edge of the circle, from the fit "
        "below. Directions: of the high meridian or side, from x (right) towards y (up)."
    )
    yield DocumentSection(
        "Primary aberrations", [Table(("aberration", "nm", _waves(answer), "direction, °"), rows)], [note]
    )


def _indications(answer: Mapping[str, Any]) -> Iterator[DocumentSection]:
    said = answer["indications"]
    if said is None:
        return
    rows = [
        (
            words,
            ReportValue.of(answer, f"iso10110.{key}_nm", ".3f"),
            ReportValue.of(answer, f"iso10110_waves.{key}", ".4f"),
        )
        for key, words in ISO_WORDS.items()
    ]
    texts = [("surface form, nm", said["iso10110_5"]), ("reflected wavefront, nm", said["iso10110_14"])]
    note = (
        f"By {FORM}. The indications are the tightest, rounded up to three digits, that this surface keeps; the "
        "wavefront's, by ISO 10110-14:2018, is that of one reflection at normal incidence, twice the surface."
    )
    tables = [Table((FORM, "nm", _waves(answer)), rows), Table(("indication", "text"), texts)]
    yield DocumentSection("ISO 10110-5 and ISO 10110-14", tables, [note])


def _tolerance(answer: Mapping[str, Any]) -> Iterator[DocumentSection]:
    if not answer["tolerance"]:
        return
    rows = [
        (
            line["what"],
            ReportValue.of(answer, f"tolerance.{at}.value", ".4g"),
            ReportValue.of(answer, f"tolerance.{at}.limit", "g"),
            ReportValue.of(answer, f"tolerance.{at}.uncertainty", ".2g"),
            line["unit"],
            "yes" if line["holds"] else "no",
        )
        for at, line in enumerate(answer["tolerance"])
    ]
    note = (
        f"By {printable(answer['judged_by'])}, over the samples that count, {REMOVED[answer['alignment']]} removed. "
        "± is the instrument's repeatability, where it is known. A PSD line is the A of A / f^B as ISO 10110-8:2010 "
        "writes it, of the radially averaged two-dimensional PSD, not of profiles."
    )
    yield DocumentSection("Tolerance", [Table(("line", "measured", "limit", "±", "unit", "holds"), rows)], [note])


def _slope(found: MapReportData) -> Iterator[DocumentSection]:
    if found.slope_urad is None:
        return
    answer = found.answer
    rows = [
        ("along x", *(ReportValue.of(answer, f"slope.{key}_x_urad", ".4g") for key in ("rms", "pv"))),
        ("along y", *(ReportValue.of(answer, f"slope.{key}_y_urad", ".4g") for key in ("rms", "pv"))),
        ("magnitude", *(ReportValue.of(answer, f"slope.{key}_urad", ".4g") for key in ("rms", "max"))),
    ]
    length = Table(("", "mm"), [("integration length", ReportValue.of(answer, "slope.integration_mm", ".4g"))])
    table = Table(("slope", "RMS, µrad", "PV, µrad"), rows)
    yield DocumentSection("Slope", [table, length], (), [slopes(found, found.slope_urad)])


def _periods(found: MapReportData, *, spectrum: bool) -> Iterator[DocumentSection]:
    answer = found.answer
    if answer["psd"] is None:
        return
    rows = [
        (band["name"], *(ReportValue.of(answer, f"bands.{at}.{key}", form) for key, form in BANDS.items()))
        for at, band in enumerate(answer["bands"])
    ]
    note = "The surface split by ideal band-passes; a dash is no limit, or a band that the samples do not show."
    table = Table(("band", "below, mm", "above, mm", "RMS, nm"), rows)
    yield DocumentSection("Spatial periods", [table], [note], [spectrum_picture(found)] if spectrum else [])


def _zernike(answer: Mapping[str, Any]) -> Iterator[DocumentSection]:
    fitted = answer["zernike"]
    if fitted is None:
        return
    rows = [
        (
            ReportValue.of(answer, f"zernike.terms.{at}.index", "d"),
            ReportValue.of(answer, f"zernike.terms.{at}.n", "d"),
            ReportValue.of(answer, f"zernike.terms.{at}.m", "d"),
            *_length(answer, f"zernike.terms.{at}"),
        )
        for at in range(len(fitted["terms"]))
    ]
    circle = [
        ("circle's radius, mm", ReportValue.of(answer, "zernike.radius_mm", ".6g")),
        ("circle's radius, px", ReportValue.of(answer, "zernike.radius_px", ".6g")),
        ("circle's centre, row", ReportValue.of(answer, "zernike.centre_px.0", ".6g")),
        ("circle's centre, column", ReportValue.of(answer, "zernike.centre_px.1", ".6g")),
        ("condition", ReportValue.of(answer, "zernike.condition", ".3g")),
        ("RMS that the fit leaves, nm", ReportValue.of(answer, "zernike.residual_rms_nm", ".3f")),
    ]
    note = (
        f"Ordering: {fitted['ordering']}; norm: {NORMS[fitted['norm']]}. m above 0 is a cosine, below 0 a sine, "
        "of the angle from x (right) towards y (up). By least squares over the samples that count, all terms together."
    )
    yield DocumentSection(
        "Zernike terms", [Table(("term", "n", "m", "nm", _waves(answer)), rows), Table(("fit", ""), circle)], [note]
    )


def _origin(answer: Mapping[str, Any]) -> DocumentSection:
    rows: list[tuple[str, Cell]] = [
        ("file", printable(answer["path"])),
        ("SHA-256", answer["sha256"]),
        ("format", f"{answer['format']}, reader {answer['reader_version']}"),
        ("rows", ReportValue.of(answer, "rows", "d")),
        ("columns", ReportValue.of(answer, "cols", "d")),
        ("pitch, mm", ReportValue.of(answer, "pitch_mm", ".7g")),
        ("samples without data", ReportValue.of(answer, "missing", "d")),
        ("samples that count", ReportValue.of(answer, "samples", "d")),
        ("trimmed, px", ReportValue.of(answer, "trim", "d")),
        ("orientation", answer["orientation"]),
        ("the file does not say", ", ".join(answer["unsaid"])),
    ]
    tables = [Table(("measurement", ""), [row for row in rows if row[1]])]
    if answer["masks"]:
        masks = [
            (printable(mask["mask"]), *(ReportValue.of(answer, f"masks.{at}.{key}", "d") for key in ("samples", "of")))
            for at, mask in enumerate(answer["masks"])
        ]
        tables.append(Table(("mask", "samples with data in it", "of"), masks))
    if answer["factors"]:
        factors = [(printable(name), _factor(answer, name, value)) for name, value in answer["factors"].items()]
        tables.append(Table(("applied once by the reader", ""), factors))
    notes = [f"warning: {printable(warning)}" for warning in answer["warnings"]]
    return DocumentSection(
        "Measurement", tables, [*notes, *(f"left out: {printable(reason)}" for reason in answer["left_out"])]
    )


def _factor(answer: Mapping[str, Any], name: str, value: object) -> Cell:
    return (
        ReportValue.of(answer, f"factors.{name}", ".7g")
        if isinstance(value, float) and "." not in name
        else printable(value)
    )


def editions() -> DocumentSection:
    """Which edition of each standard is followed, and the newer one that was not at hand."""
    rows = [(what, edition, newer or "–") for what, edition, newer in EDITIONS]
    note = (
        "Where a newer edition is out and its text was not at hand, the older is followed. Definitions were checked "
        "against published summaries of the standards."
    )
    return DocumentSection("Editions", [Table(("figure", "follows", "newer, not at hand"), rows)], [note])


def _length(answer: Mapping[str, Any], key: str) -> tuple[ReportValue | str, ReportValue | str]:
    return ReportValue.of(answer, f"{key}.nm", ".3f"), ReportValue.of(answer, f"{key}.waves", ".4f")


def _waves(answer: Mapping[str, Any]) -> str:
    return f"waves of {answer['wavelength_nm']:g} nm"
