"""The report of a map as it stands on paper: every figure of it is taken from the answer that ``--json`` gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from polishd.show.sheet import Cell, Chapter, DocumentSection, ReportDocument, ReportValue, Table
from polishd.workbench.maps import report_pictures as pictures
from polishd.workbench.maps.files import printable
from polishd.workbench.maps.report_figures import MapReportData
from polishd.workbench.maps.show import date_words

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
    return DocumentSection("Surface", tables, [heights, pvr], [pictures.height_picture(found)])


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
    yield DocumentSection("Slope", [table, length], (), [pictures.slopes(found, found.slope_urad)])


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
    yield DocumentSection("Spatial periods", [table], [note], [pictures.spectrum_picture(found)] if spectrum else [])


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
