"""``polishd map report FILE... --out report.html|pdf``: the report of maps for the customer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from polishd.maps.figures import figured
from polishd.maps.inspect import date_words
from polishd.maps.map_files import MapSource, edges_mm, printable
from polishd.maps.options import ReportOptions
from polishd.model.errors import ConfigError, SurfaceError
from polishd.model.surface import FloatArray
from polishd.model.tolerance import LineResult
from polishd.rendering.document import (
    DASH,
    Cell,
    Chapter,
    DocumentSection,
    Picture,
    ReportDocument,
    ReportValue,
    Table,
    Verdict,
    html,
    pdf,
)
from polishd.rendering.map_grid import LOWEST_IN, SLENDER
from polishd.rendering.map_plots import Spectrum, color_bar, height_map, histogram, profiles, value_map
from polishd.rendering.plots import BLUE, INK, ORANGE, PAGE_IN, add_panel, page_figure, png, polishd_style
from polishd.rendering.scales import PERCENTILE, height_limit
from polishd.rendering.terminal import json_line, say, stdout
from polishd.reports import wording
from polishd.reports.map_figures import MapReportData, MapReportOptions, reported
from polishd.reports.pictures import RIGHT_IN, SPECTRA_CAPTION, spectra_figure
from polishd.util.files import write_atomic

ENDINGS = (".html", ".pdf")


def report_verb(files: Sequence[Path], options: ReportOptions, *, as_json: bool) -> None:
    """Report the maps. A map that cannot be read is named on stderr; the others are reported and the exit code is 8."""
    edges = edges_mm(options.bands)
    if options.out.suffix.lower() not in ENDINGS:
        raise ConfigError(f"{options.out}: a report is an HTML or a PDF file. Use a name that ends in .html or .pdf.")
    source = MapSource.by(options)
    report_options = _report_options(options, source)
    found: list[MapReportData] = []
    for file in files:
        try:
            found.append(reported(figured(source.read(file), options.trim, edges), report_options))
        except SurfaceError as error:
            say(f"polishd: {error}", err=True)
            continue
        if as_json:
            say(json_line(found[-1].answer))
    if found:
        _write(options.out, found, as_json=as_json)
    if len(found) < len(files):
        raise typer.Exit(SurfaceError.exit_code)


def _report_options(options: ReportOptions, source: MapSource) -> MapReportOptions:
    report = MapReportOptions(
        wavelength_nm=options.wavelength,
        ordering=options.zernike.value,
        terms=options.terms,
        repeatability_nm=None if source.instrument is None else source.instrument.repeatability_nm,
        by=options.by,
    )
    if options.tolerance is not None:
        from polishd.config.tolerance import load_tolerance

        return replace(report, lines=load_tolerance(options.tolerance), judged_by=str(options.tolerance))
    return report if options.cell is None else _with_cell(report, options.cell)


def _with_cell(report: MapReportOptions, cell: Path) -> MapReportOptions:
    """Use the tolerance of a cell's file, as its job does."""
    from polishd.config.cell import load_config
    from polishd.pipeline.build_recipe import instrument_of

    config = load_config(cell)
    instrument = instrument_of(config)
    repeatability_nm = instrument.repeatability_nm if instrument is not None else None
    return replace(
        report,
        lines=config.lines,
        judged_by=str(cell),
        alignment=config.part.alignment,
        repeatability_nm=report.repeatability_nm if report.repeatability_nm is not None else repeatability_nm,
    )


def _write(out: Path, found: list[MapReportData], *, as_json: bool) -> None:
    document = map_report_document(found)
    content = pdf(document) if out.suffix.lower() == ".pdf" else html(document).encode()
    try:
        write_atomic(out, content)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written: {error.strerror}. Name another file with --out.") from error
    if not as_json:
        stdout.print(f"report of {len(found)} map{'s' * (len(found) > 1)} in {printable(out)}", markup=False)


# Pictures of the map report: heights with peak, valley and profiles, slope, and spectrum.

MARK_COLORS = {"peak": ORANGE, "valley": BLUE}
MARKS = {"peak": "^", "valley": "v"}
LEFT_IN, BOTTOM_IN, SIDE_IN = 0.58, 0.46, 2.35
"""Room for the labels of y and of x, and side of the square that a map is drawn in."""
CHART_IN = 4.25
"""Left edge of the charts beside a map."""


def heights_picture(data: MapReportData) -> Picture:
    """Draw the level map with its peak and valley, and the profiles through them along x and y."""
    caption = (
        "Piston and tilt removed; red is high. Marked: peak (triangle up) and valley (triangle down). The dashed lines "
        "are the profiles in the charts. Gray: no data, or outside the mask."
    )
    answer, unit = data.answer, data.answer["place_unit"]
    level = data.figured.level_nm
    with polishd_style():
        page, ax, bar, charts = _heights_panels(level.shape)
        image = height_map(ax, level, data.figured.surface.pitch_mm, "", limit_nm=height_limit(level, 100.0), bar=False)
        color_bar([image], "height, nm", bar)
        for name, color in MARK_COLORS.items():
            mark = answer[name]
            ax.axhline(mark["y"], color=color, linewidth=0.7, linestyle="--")
            ax.axvline(mark["x"], color=color, linewidth=0.7, linestyle="--")
            ax.plot(mark["x"], mark["y"], MARKS[name], color=color, markeredgecolor=INK, markersize=7)
        for chart, along in zip(charts, "xy", strict=True):
            lines = {
                f"through the {line['through']}": (line["place"], np.array(line["nm"], dtype=np.float64))
                for line in answer["profiles"]
                if line["along"] == along
            }
            profiles(chart, lines, xlabel=f"{along}, {unit}", colors=(ORANGE, BLUE))
            chart.legend().remove()
            for name, color in MARK_COLORS.items():
                chart.plot(answer[name][along], answer[name]["nm"], MARKS[name], color=color)
        return Picture("heights", caption, png(page))


def _heights_panels(shape: tuple[int, ...]) -> tuple[Figure, Axes, Axes, list[Axes]]:
    """Return a page with the panels of a map, its color bar, and two charts: below the map of a slender part."""
    aspect = shape[0] / shape[1]
    if aspect >= SLENDER:
        page = page_figure(3.0)
        chart_in = PAGE_IN - CHART_IN - RIGHT_IN, SIDE_IN - 1.28
        charts = [add_panel(page, CHART_IN, BOTTOM_IN + lift_in, *chart_in) for lift_in in (1.28, 0.0)]
        return page, *_map_and_bar(page), charts
    wide_in = PAGE_IN - LEFT_IN - RIGHT_IN
    high_in = max(wide_in * aspect, LOWEST_IN)
    page = page_figure(high_in + 2.8)
    charts = [add_panel(page, left_in, BOTTOM_IN, 2.6, 1.1) for left_in in (LEFT_IN, CHART_IN - RIGHT_IN)]
    bar = add_panel(page, LEFT_IN, 2.1, wide_in, 0.1)
    return page, add_panel(page, LEFT_IN, 2.7, wide_in, high_in), bar, charts


def _map_and_bar(page: Figure) -> tuple[Axes, Axes]:
    """Add the panels of a map and of its color bar at the left of a page."""
    bar = add_panel(page, LEFT_IN + SIDE_IN + 0.12, BOTTOM_IN, 0.1, SIDE_IN)
    return add_panel(page, LEFT_IN, BOTTOM_IN, SIDE_IN, SIDE_IN), bar


def slope_picture(data: MapReportData, slope_urad: FloatArray) -> Picture:
    """Draw the magnitude of the slope, and its histogram."""
    caption = (
        f"Magnitude of the slope over the distance of two samples. The colors end at the {PERCENTILE:g}th percentile."
    )
    with polishd_style():
        page = page_figure(3.0)
        ax, bar = _map_and_bar(page)
        greatest = float(np.nanpercentile(slope_urad, PERCENTILE)) or 1.0
        pitch_mm = data.figured.surface.pitch_mm
        image = value_map(ax, slope_urad, pitch_mm, "", scale=(0.0, greatest), bar=False)
        color_bar([image], "slope, µrad", bar)
        spread = add_panel(page, CHART_IN, BOTTOM_IN, PAGE_IN - CHART_IN - RIGHT_IN, SIDE_IN)
        values = np.clip(slope_urad[np.isfinite(slope_urad)], 0.0, greatest)
        histogram(spread, values, "", xlabel="slope, µrad", limits=(0.0, greatest))
        return Picture("slope", caption, png(page))


def spectrum_picture(data: MapReportData) -> Picture:
    """Draw the radial PSD up to the Nyquist frequency, with the drawing's PSD lines."""
    psd = data.answer["psd"]
    curves = {"measured": Spectrum(psd["frequency_per_mm"], psd["density_nm2_mm2"])}
    limits = [asdict(line) for line in data.lines if line.figure == "psd"]
    with polishd_style():
        return Picture("spectrum", SPECTRA_CAPTION, png(spectra_figure(curves, limits)))


# The document of the map report. Each figure is taken from the answer of ``--json``.

FORM = "ISO 10110-5:2015, evaluated by ISO 14999-4:2015"
EDITIONS = (
    ("surface form, 3/A(B/C), RMSt, RMSi, RMSa", "ISO 10110-5:2015", "2026"),
    ("wavefront, 13/A(B/C) and RMS", "ISO 10110-14:2018", ""),
    ("evaluation of both", "ISO 14999-4:2015", "2026"),
    ("PSD line A / f^B", "ISO 10110-8:2010", "2019"),
)
"""Figure, edition that is followed, and newer edition whose text was not available."""
HEIGHT_NAMES = {"pv": "PV", "rms": "RMS", "pvr": "PVr"}
ISO_NAMES = {
    "a": "A, sagitta error",
    "b": "B, irregularity",
    "c": "C, rotationally symmetric irregularity",
    "rms_t": "RMSt, whole deviation",
    "rms_i": "RMSi, irregularity",
    "rms_a": "RMSa, without the symmetric part",
}
BANDS = {"from_mm": "g", "to_mm": "g", "rms_nm": ".3f"}
"""Fields of a band, and their formats."""
REMOVED = {"piston": "piston", "tilt": "piston and tilt", "power": "piston, tilt and power"}
NORMS = {"edge": "amplitude 1 at the circle's edge", "rms": "RMS 1 over the circle"}


def map_report_document(found: Sequence[MapReportData]) -> ReportDocument:
    """Return the report, with a chapter for each map."""
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
    sections = [*_tolerance(answer), _surface(found), *form, *detail, _origin(answer), editions()]
    return Chapter(printable(answer["part_id"]) or name, facts, sections, _verdict(answer))


def of_form(answer: Mapping[str, Any]) -> list[DocumentSection]:
    """Return the primary aberrations and the ISO 10110 figures, as far as the samples support them."""
    return [*_aberrations(answer), *_indications(answer)]


def of_detail(found: MapReportData, *, spectrum: bool = True) -> list[DocumentSection]:
    """Return slope, spatial periods and Zernike terms in the same way. ``spectrum``: with the picture of the PSD."""
    return [*_slope(found), *_periods(found, spectrum=spectrum), *_zernike(found.answer)]


def _verdict(answer: Mapping[str, Any]) -> Verdict | None:
    lines = answer["tolerance"]
    if not lines:
        return None
    held = sum(line["holds"] for line in lines)
    within = answer["within"]
    words = f"{'In' if within else 'Not in'} tolerance: {held} of {len(lines)} lines hold"
    return Verdict("good" if within else "bad", words)


def _surface(found: MapReportData) -> DocumentSection:
    answer = found.answer
    level = [(HEIGHT_NAMES[key], *_length(answer, f"level.{key}")) for key in HEIGHT_NAMES]
    marks = [
        (
            name,
            ReportValue.of(answer, f"{name}.nm", ".3f"),
            *(ReportValue.of(answer, f"{name}.{axis}", ".4g") for axis in "xy"),
        )
        for name in ("peak", "valley")
    ]
    heights = (
        "Heights are those of the surface, not of a wavefront. Piston and tilt are removed by least squares over the "
        "samples that count. A wave is a wavelength of surface height: two fringes in reflection."
    )
    pvr = f"PVr: PV of a fit of {answer['pvr_terms']} Zernike terms (fringe) and three times the RMS of its residual."
    unit = answer["place_unit"]
    places = ("position", "height, nm", f"x, {unit}", f"y, {unit}")
    tables = [Table(("height", "nm", _waves(answer)), level), Table(places, marks)]
    return DocumentSection("Surface", tables, [heights, pvr], [heights_picture(found)])


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
    indications = answer["indications"]
    if indications is None:
        return
    rows = [
        (
            name,
            ReportValue.of(answer, f"iso10110.{key}_nm", ".3f"),
            ReportValue.of(answer, f"iso10110_waves.{key}", ".4f"),
        )
        for key, name in ISO_NAMES.items()
    ]
    texts = [("surface form, nm", indications["iso10110_5"]), ("reflected wavefront, nm", indications["iso10110_14"])]
    note = (
        f"By {FORM}. The indications are the tightest that this surface meets, rounded up to three digits. The "
        "wavefront, by ISO 10110-14:2018, is that of one reflection at normal incidence: twice the surface."
    )
    tables = [Table((FORM, "nm", _waves(answer)), rows), Table(("indication", "text"), texts)]
    yield DocumentSection("ISO 10110-5 and ISO 10110-14", tables, [note])


def _tolerance(answer: Mapping[str, Any]) -> Iterator[DocumentSection]:
    if not answer["tolerance"]:
        return
    note = (
        f"By {printable(answer['judged_by'])}, over the samples that count, {REMOVED[answer['alignment']]} removed. "
        "± is the repeatability of the instrument, if it is known."
    )
    for one in wording.requirement([LineResult.of(line) for line in answer["tolerance"]], "tolerance"):
        yield replace(one, notes=[note, *one.notes])


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
    yield DocumentSection("Slope", [table, length], (), [slope_picture(found, found.slope_urad)])


def _periods(found: MapReportData, *, spectrum: bool) -> Iterator[DocumentSection]:
    answer = found.answer
    if answer["psd"] is None:
        return
    rows = [
        (band["name"], *(ReportValue.of(answer, f"bands.{at}.{key}", form) for key, form in BANDS.items()))
        for at, band in enumerate(answer["bands"])
    ]
    note = "The surface divided by ideal band-pass filters. A dash: no limit, or a band that the samples cannot show."
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
        ("circle's center, row", ReportValue.of(answer, "zernike.centre_px.0", ".6g")),
        ("circle's center, column", ReportValue.of(answer, "zernike.centre_px.1", ".6g")),
        ("condition", ReportValue.of(answer, "zernike.condition", ".3g")),
        ("RMS of the residual, nm", ReportValue.of(answer, "zernike.residual_rms_nm", ".3f")),
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
        ("not in the file", ", ".join(answer["unsaid"])),
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
        tables.append(Table(("factor applied by the reader", ""), factors))
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
    """Return the editions of the standards: the one that is followed, and the newer one that was not available."""
    rows = [(what, edition, newer or DASH) for what, edition, newer in EDITIONS]
    note = (
        "If the text of a newer edition was not available, the older edition is followed. The definitions were checked "
        "against published summaries of the standards."
    )
    return DocumentSection("Editions", [Table(("figure", "follows", "newer, not available"), rows)], [note])


def _length(answer: Mapping[str, Any], key: str) -> tuple[ReportValue | str, ReportValue | str]:
    return ReportValue.of(answer, f"{key}.nm", ".3f"), ReportValue.of(answer, f"{key}.waves", ".4f")


def _waves(answer: Mapping[str, Any]) -> str:
    return f"waves of {answer['wavelength_nm']:g} nm"
