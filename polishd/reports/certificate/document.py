"""Document of a certificate. Each figure is taken from the content of its JSON file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from polishd.maps.map_files import printable
from polishd.rendering.document import DASH, Chapter, DocumentSection, Picture, ReportDocument, Table, Verdict
from polishd.rendering.map_plots import ConvergenceStep, Spectrum, convergence, height_map, spectrum
from polishd.rendering.plots import BLUE, MUTED, figure, png, polishd_style
from polishd.rendering.scales import PERCENTILE, height_limit
from polishd.reports.certificate.content import CertificateDraft
from polishd.reports.certificate.model import (
    CertificateMeasurement,
    CertificatePass,
    CertificateSurface,
    Content,
    Judgement,
)
from polishd.reports.certificate.sources import ReconstructedMap
from polishd.reports.map_report import editions, of_detail, of_form

# Pictures: both maps on one scale and on their own, both spectra, and the RMS of each map.

WIDTH_IN = 9.0
DPI = 160
"""For a report that may be printed."""


def maps_picture(before: ReconstructedMap, after: ReconstructedMap) -> Picture:
    """Draw both maps on the scale of the first, then each on its own scale."""
    caption = (
        "Above: both maps on the color scale of the map before. Below: each map on its own scale. Red is high. The "
        f"colors end at the {PERCENTILE:g}th percentile. Gray: outside the clear aperture, or no data. The RMS above a "
        "picture is that of the tables, of the same samples and aperture."
    )
    with polishd_style():
        page = figure(WIDTH_IN, 8.2)
        axes = page.subplots(2, 2)
        for column, (name, found) in enumerate((("Before", before), ("After", after))):
            level, pitch_mm = found.figure_nm - np.nanmean(found.figure_nm), found.pitch_mm
            title = f"{name}: {found.reported.answer['rms_nm']:.2f} nm RMS"
            height_map(axes[0][column], level, pitch_mm, title, limit_nm=height_limit(before.figure_nm))
            height_map(axes[1][column], level, pitch_mm, f"{name}, on its own scale")
        return Picture("maps", caption, png(page, DPI))


def both_spectra_picture(before: CertificateSurface, after: CertificateSurface) -> Picture | None:
    """Draw the PSD of both maps; None if a map does not support it."""
    if before.psd is None or after.psd is None:
        return None
    caption = "Radially averaged two-dimensional PSD of both maps over the clear aperture."
    curves = {
        name: Spectrum(psd.frequency_per_mm, psd.density_nm2_mm2)
        for name, psd in (("before", before.psd), ("after", after.psd))
    }
    with polishd_style():
        page = figure(WIDTH_IN * 0.7, 3.9)
        spectrum(page.add_subplot(), curves, "", colors=(MUTED, BLUE))
        return Picture("spectra", caption, png(page, DPI), wide=False)


def maps_convergence(
    measured: Sequence[CertificateMeasurement], passes: Sequence[CertificatePass], limit_nm: float | None
) -> Picture:
    """Draw the RMS of each map and what was expected."""
    caption = (
        "RMS of each map. Bars: the range that the plan expected in 9 of 10 cases. Dashed: an interrupted pass, for "
        "which nothing is expected."
    )
    done = {one.cycle: one.planned for one in passes if one.did.how == "done"}
    steps = []
    for index, one in enumerate(measured):
        planned = done.get(measured[index - 1].cycle) if index else None
        low, high = (None, None) if planned is None else (planned.expected_low_nm, planned.expected_high_nm)
        steps.append(
            ConvergenceStep(
                one.name,
                one.rms_nm,
                expected_nm=None if low is None or high is None else (low, high),
                interrupted=index > 0 and planned is None,
            )
        )
    with polishd_style():
        page = figure(WIDTH_IN * 0.8, 3.4)
        convergence(page.add_subplot(), steps, limit_nm)
        return Picture("convergence", caption, png(page, DPI))


GOOD = "in tolerance"


def certificate_document(drawn: CertificateDraft, signed_by: str) -> ReportDocument:
    """Return the document of a certificate.

    Args:
        drawn: its content.
        signed_by: id of the key that signs the JSON file; empty: it is not signed.
    """
    content = drawn.content
    made_by = f"{content.issuer.program} {content.issuer.version}"
    chapters = [_front(content, signed_by), *_surface(drawn), _making(content), _proofs(content)]
    return ReportDocument(
        title=f"Certificate {printable(content.number)}",
        chapters=chapters,
        footer=printable("; ".join(filter(None, (content.issuer.shop, made_by)))),
        header=(
            printable(f"Part {content.part.id}"),
            printable(f"Certificate {content.number}, {content.issued:%Y-%m-%d}"),
        ),
    )


def _front(content: Content, signed_by: str) -> Chapter:
    part, verdict, issuer = content.part, content.verdict, content.issuer
    interim = "" if verdict.final else " (interim: the job was stopped and can be continued)"
    facts = [
        ("certificate", content.number),
        ("issued", f"{content.issued:%Y-%m-%d %H:%M} UTC"),
        ("by", issuer.shop),
        ("operator", issuer.operator or "not named"),
        ("customer", part.customer),
        ("drawing", part.drawing),
        ("part", part.id),
        ("outline", f"{part.outline}, clear aperture less a rim of {part.edge_mm:g} mm"),
        ("nominal form", part.form),
        ("job", f"{part.job}, ended as: {verdict.outcome}{interim}"),
        ("last measurement", f"{content.measurements[-1].taken:%Y-%m-%d %H:%M} UTC, {content.measurements[-1].name}"),
    ]
    signed = (
        f"The JSON file of the same name has the SHA-256 of this PDF and is signed with the key {signed_by}. "
        "polishd certificate verify finds a change of either file."
        if signed_by
        else "Not signed. The JSON file of the same name has the SHA-256 of this PDF. polishd certificate verify finds "
        "an accidental change of either file, but cannot prove the author."
    )
    once = ["The part was measured once: before and after are the same map."] if len(content.measurements) == 1 else []
    parts = [
        _specification(content),
        DocumentSection("Signature", notes=[signed]),
        DocumentSection("Uncertainty", notes=[*content.uncertainty.statements, *once]),
        _changes(content),
        *_reach(content),
    ]
    label = Verdict("good" if verdict.state == GOOD else "bad", f"{verdict.words}{interim}")
    return Chapter(f"Certificate of part {printable(part.id)}", _shown(facts), parts, label)


def _specification(content: Content) -> DocumentSection:
    first = {line.what: line for line in content.measurements[0].lines}
    rows = [(line.what, _limit(line), _value(first.get(line.what)), _value(line), *_uncertainty(line)) for line in
            content.verdict.lines]  # fmt: skip
    accepted = {
        "figure": "The lines are judged by the measured figure.",
        "bound": "The RMS is judged by the 95 % bound of the true RMS, with the part in its mount.",
        "bound_without_power": "The RMS is judged by the 95 % bound of the true RMS, power removed.",
    }[content.uncertainty.accepted]
    decided = f"Decided by: {content.verdict.decided_by.replace('+-', '±')}." if content.verdict.decided_by else ""
    head = ("line of the drawing", "limit", "before", "after", "±, or bound", "holds")
    return DocumentSection("Specification and verdict", [Table(head, rows)], [*filter(None, (decided,)), accepted])


def _limit(line: Judgement) -> str:
    return f"{line.limit:g} {line.unit}"


def _value(line: Judgement | None) -> str:
    return DASH if line is None else f"{line.value:.4g}"


def _uncertainty(line: Judgement) -> tuple[str, str]:
    text = f"± {line.uncertainty:.2g}" if line.uncertainty is not None else "not known"
    return (text if line.bound is None else f"at most {line.bound:.3g}"), "yes" if line.holds else "no"


def _changes(content: Content) -> DocumentSection:
    rows = [
        (one.figure, f"{one.before_nm:.3f}", f"{one.after_nm:.3f}", _percent(one.change)) for one in content.changes
    ]
    notes = [content.aperture.words]
    bands = [] if content.after is None else content.after.bands or []
    if any(band.soft and band.rms_nm is not None for band in bands):
        notes.append(
            "Fewer than three of the longest periods of a band fit on this part. The division at this period then "
            "depends on how the map is continued beyond its edge. The squares of all bands add up to the square of "
            "the RMS."
        )
    return DocumentSection("Before and after, nm", [Table(("figure", "before", "after", "change"), rows)], notes)


def _percent(change: float | None) -> str:
    return DASH if change is None else f"{100 * change:+.1f} %"


def _reach(content: Content) -> Iterator[DocumentSection]:
    reach = content.beyond_reach
    if reach is None:
        return
    table = Table(
        ("RMS of these periods, nm", "before", "after"),
        [(f"below {reach.cutoff_period_mm:.2f} mm", f"{reach.before_nm:.3f}", f"{reach.after_nm:.3f}")],
    )
    note = (
        "The spot of the tool cannot remove shorter periods. An increase was left by the passes. The samples and the "
        "aperture are those of all figures above. The figures of the solver, on its coarser grid, are not repeated."
    )
    yield DocumentSection("Beyond the reach of the tool", [table], [note])


def _surface(drawn: CertificateDraft) -> Iterator[Chapter]:
    content = drawn.content
    if drawn.before is None or drawn.after is None or content.before is None or content.after is None:
        return
    aperture = content.aperture
    rows = [
        ("samples of the map in the clear aperture", f"{aperture.samples}, {aperture.pitch_mm or 0.0:.6g} mm apart"),
        ("process grid: in the solve", f"{aperture.solve_samples}, {aperture.grid_pitch_mm:g} mm apart"),
        ("process grid: in the clear aperture", f"{aperture.metric_samples}"),
    ]
    maps = DocumentSection("Before and after", pictures=[maps_picture(drawn.before, drawn.after)])
    masks = DocumentSection("Masks", [Table((), rows)])
    yield Chapter("The surface", [], [maps, masks])
    both = both_spectra_picture(content.before, content.after)
    spectra = [] if both is None else [DocumentSection("Power spectra", (), (), [both])]
    figures = [*of_form(drawn.after.reported.answer), *of_detail(drawn.after.reported, spectrum=False)]
    yield Chapter("The surface after polishing", [], [*spectra, *figures])


def _making(content: Content) -> Chapter:
    limit = next((line.limit for line in content.verdict.lines if line.what == "RMS"), None)
    picture = maps_convergence(content.measurements, content.passes, limit)
    parts = [
        DocumentSection("From map to map", [_measurements(content)], _notes(content), [picture]),
        _anomalies(content),
        *map(_pass, content.passes),
    ]
    interrupted = sum(one.number is None for one in content.passes)
    passes = f"{len(content.passes) - interrupted}" + (f", and {interrupted} interrupted" if interrupted else "")
    return Chapter("Process", [("passes", passes)], parts)


def _measurements(content: Content) -> Table:
    rows = [
        (one.name, f"{one.taken:%m-%d %H:%M}", f"{one.pv_nm:.2f}", f"{one.rms_nm:.3f}", f"{one.lsf_rms_nm:.3f}")
        for one in content.measurements
    ]
    return Table(("map", "time, UTC", "PV, nm", "RMS, nm", "LSF, nm"), rows)


def _notes(content: Content) -> list[str]:
    return [printable(f"Map {one.name}: {note}") for one in content.measurements for note in one.notes]


def _pass(one: CertificatePass) -> DocumentSection:
    planned, did = one.planned, one.did
    force = "not known" if did.force_n is None else f"{did.force_n:.2f} N"
    speed = "" if did.rpm is None else f", {did.rpm:.0f} rpm"
    uncertain = ", ".join(f"{first} to {last}" for first, last in did.uncertain_blocks)
    rows = [
        ("tool", one.tool),
        (
            "begin",
            f"{one.begun:%Y-%m-%d %H:%M:%S} UTC" + ("" if one.ended is None else f", ended {one.ended:%H:%M:%S}"),
        ),
        ("planned", f"{planned.dwell_s:,.1f} s over {planned.blocks:,} blocks{_expected(one)}"),
        ("executed", f"{did.executed_s:,.1f} s{_share(did.share)}, {did.blocks:,} blocks; mean {force}{speed}"),
        ("not known", f"contact in blocks {uncertain}" if uncertain else ""),
        ("result", _result(one)),
        ("program", f"SHA-256 {planned.program_sha256}"),
    ]
    title = one.name[:1].upper() + one.name[1:]
    return DocumentSection(
        title, [Table((), _shown([row for row in rows if row[1]]))], [printable(note) for note in one.taught.notes]
    )


def _expected(one: CertificatePass) -> str:
    low, high = one.planned.expected_low_nm, one.planned.expected_high_nm
    if low is None or high is None:
        return ""
    void = "" if one.number is not None else ", if the pass had been whole"
    return f"; RMS of {low:.2f} to {high:.2f} nm expected after it (9 of 10){void}"


def _share(share: float | None) -> str:
    return "" if share is None else f" in contact ({share:.0%} of the plan's)"


def _result(one: CertificatePass) -> str:
    taught = one.taught
    if taught.measured_rms_nm is None:
        return "no map was taken after the pass"
    result = f"the next map has {taught.measured_rms_nm:.3f} nm RMS"
    if one.number is None:
        return f"{result}; no parameter is estimated from an interrupted pass"
    if taught.as_expected is not None:
        result += ", as expected" if taught.as_expected else ", not as expected"
    if taught.rate is not None:
        sigma = "" if taught.rate_sigma is None else f" ± {taught.rate_sigma:.3f}"
        result += f"; removal rate {taught.rate:.3f}{sigma} of the nominal rate"
    return result


def _anomalies(content: Content) -> DocumentSection:
    title = "Anomalies"
    if not content.anomalies:
        return DocumentSection(
            title, notes=["None: the journal of this job has no alarm, hold, fault or interrupted pass."]
        )
    rows = [
        row
        for one in content.anomalies
        for row in ((f"{one.at:%Y-%m-%d %H:%M:%S} UTC", f"{one.kind}: {one.what}"), ("action", one.done))
    ]
    return DocumentSection(title, [Table((), _shown(rows))])


def _proofs(content: Content) -> Chapter:
    journal = content.journal
    rows = ", ".join(f"{count} of {table}" for table, count in journal.rows.items())
    files = [(file.name, file.sha256) for file in content.files]
    parts = [
        _instrument(content),
        DocumentSection(
            "Versions",
            [Table((), list(content.versions.items()))],
            ["Of the program that made this certificate, and of the program that polished if the run folder has it."],
        ),
        DocumentSection("Journal", [Table((), [("SHA-256 of the rows", journal.sha256), ("rows", rows)])]),
        editions(),
        DocumentSection("Files of the run", [Table(("file", "SHA-256"), _shown(files))]),
    ]
    if content.left_out:
        parts.insert(0, DocumentSection("Left out of this certificate", notes=list(map(printable, content.left_out))))
    return Chapter("Instrument, versions, checksums", [], parts)


def _instrument(content: Content) -> DocumentSection:
    found, rows = content.instrument, []
    if found.commissioned is not None:
        record = found.commissioned
        rows = [
            ("commissioned", f"{record.at:%Y-%m-%d %H:%M} UTC with the artefact {record.artefact!r}"),
            ("correlation", f"{record.correlation:.4f}; the next best orientation has {record.next_best:.4f}"),
            ("map", f"SHA-256 {record.map_sha256}"),
            ("profile", f"SHA-256 {record.profile_sha256}"),
        ]
    repeats = "not known" if found.repeatability_nm is None else f"{found.repeatability_nm:g} nm RMS"
    facts = [
        ("profile", found.profile),
        ("measured by", found.measured_by),
        *rows,
        ("not commissioned", found.not_commissioned),
        ("repeatability", repeats),
        (
            "system map",
            f"SHA-256 {found.system_map_sha256}" if found.system_map_sha256 else "none",
        ),
    ]
    return DocumentSection("Instrument", [Table((), _shown([fact for fact in facts if fact[1]]))])


def _shown(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    return [(printable(name), printable(value)) for name, value in rows]
