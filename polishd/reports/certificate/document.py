"""Document of a certificate. Each figure is taken from the content of its JSON file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from polishd.maps.map_files import printable
from polishd.model.tolerance import LineResult
from polishd.rendering.document import DASH, Chapter, DocumentSection, Picture, ReportDocument, Table, Verdict
from polishd.rendering.map_plots import ConvergenceStep, Spectrum
from polishd.rendering.plots import png, polishd_style
from polishd.reports import pictures, wording
from polishd.reports.certificate.content import CertificateDraft
from polishd.reports.certificate.model import (
    CertificateMeasurement,
    CertificatePass,
    Content,
    HiddenRipple,
    Judgement,
)
from polishd.reports.certificate.sources import ReconstructedMap
from polishd.reports.map_report import editions, heights_picture, of_detail, of_form

# Pictures: those of the run report, from the content of the certificate.


def _maps(drawn: CertificateDraft) -> Figure | None:
    """Draw the first map and the last; None without them."""
    found = [one for one in (drawn.before, drawn.after) if one is not None]
    if len(found) < 2:
        return None
    some = found if len(drawn.content.measurements) > 1 else found[:1]
    names = ("Before", "After") if len(some) > 1 else ("Measured",)
    return pictures.maps_figure([_named(name, one) for name, one in zip(names, some, strict=True)], some[0].pitch_mm)


def _named(name: str, found: ReconstructedMap) -> pictures.NamedMap:
    level_nm = found.figure_nm - np.nanmean(found.figure_nm)
    return pictures.NamedMap(name, level_nm, found.clear, found.reported.answer["rms_nm"])


def _spectra(drawn: CertificateDraft) -> Figure | None:
    """Draw the PSD of both maps with the drawing's limits and the path's ripple; None if no map supports it."""
    content, folder = drawn.content, drawn.run.folder
    both = {"before": content.before, "after": content.after}
    curves = {
        name: Spectrum(found.psd.frequency_per_mm, found.psd.density_nm2_mm2)
        for name, found in both.items()
        if found is not None and found.psd is not None
    }
    if not curves:
        return None
    ripple_mm = [wording.number(one, "period_mm") for row in folder.rows() for one in wording.ripple(row)]
    return pictures.spectra_figure(curves, wording.psd_limits(folder.summary), ripple_mm)


def convergence_steps(
    measured: Sequence[CertificateMeasurement], passes: Sequence[CertificatePass]
) -> list[ConvergenceStep]:
    """Return the RMS of each map and what the pass before it was expected to reach."""
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
    return steps


def _section(title: str, name: str, caption: str, figure: Figure | None, notes: Sequence[str] = ()) -> DocumentSection:
    """Return a section with a picture; without pictures if there is no figure."""
    drawn = [] if figure is None else [Picture(name, caption, png(figure))]
    return DocumentSection(title, notes=notes, pictures=drawn)


GOOD = "in tolerance"


def certificate_document(drawn: CertificateDraft, signed_by: str) -> ReportDocument:
    """Return the document of a certificate.

    Args:
        drawn: its content.
        signed_by: id of the key that signs the JSON file; empty: it is not signed.
    """
    content = drawn.content
    made_by = f"{content.issuer.program} {content.issuer.version}"
    with polishd_style():
        chapters = [
            _front(drawn, signed_by),
            _figures(drawn),
            *_surface(drawn),
            _making(drawn),
            _proofs(content, signed_by),
        ]
    return ReportDocument(
        title=f"Certificate {printable(content.number)}",
        chapters=chapters,
        footer=printable("; ".join(filter(None, (content.issuer.shop, made_by)))),
        header=(
            printable(f"Part {content.part.id}"),
            printable(f"Certificate {content.number}, {content.issued:%Y-%m-%d}"),
        ),
    )


def _front(drawn: CertificateDraft, signed_by: str) -> Chapter:
    """Return the page with part, requirement, result, maps and convergence."""
    content = drawn.content
    part, verdict, issuer, measured = content.part, content.verdict, content.issuer, content.measurements
    interim = "" if verdict.final else " (interim: the job was stopped and can be continued)"
    facts = [
        ("part", part.id),
        ("drawing", part.drawing),
        ("customer", part.customer),
        ("outline", f"{part.outline}, clear aperture less a rim of {part.edge_mm:g} mm"),
        ("nominal form", part.form),
        ("measured", f"{measured[-1].taken:%Y-%m-%d %H:%M} UTC, {measured[-1].name}"),
        ("certificate", content.number),
        ("issued", f"{content.issued:%Y-%m-%d %H:%M} UTC"),
        ("by", issuer.shop),
        ("operator", issuer.operator or "not named"),
        ("job", f"{part.job}, ended as: {verdict.outcome}{interim}"),
        ("signature", f"key {signed_by}" if signed_by else "not signed"),
    ]
    maps, steps = _maps(drawn), convergence_steps(measured, content.passes)
    caption = pictures.MAPS_CAPTION if len(measured) > 1 else pictures.ONE_MAP_CAPTION
    limit_nm = wording.rms_limit(_results(verdict.lines))
    once = [] if len(measured) > 1 else ["The part was measured once: before and after are the same map."]
    parts = [
        *_requirement(content),
        _section("Before and after" if len(measured) > 1 else "The map", "maps", caption, maps, once),
        _section(
            "RMS in the clear aperture",
            "convergence",
            pictures.CONVERGENCE_CAPTION,
            pictures.convergence_figure(steps, limit_nm) if len(measured) > 1 else None,
        ),
    ]
    label = Verdict("good" if verdict.state == GOOD else "bad", f"{verdict.words}{interim}")
    return Chapter(f"Certificate of part {printable(part.id)}", _shown(facts), _filled(parts), label)


def _filled(sections: Sequence[DocumentSection]) -> list[DocumentSection]:
    return [one for one in sections if one.tables or one.notes or one.pictures]


def _results(lines: Sequence[Judgement]) -> list[LineResult]:
    return [LineResult.of(one.model_dump()) for one in lines]


def _requirement(content: Content) -> Iterator[DocumentSection]:
    """Yield the tolerance with the results of the first map and of the last."""
    first = content.measurements[0].lines if len(content.measurements) > 1 else ()
    last = _results(content.verdict.lines)
    accepted = {
        "figure": "The lines are judged by the measured figure.",
        "bound": "The RMS is judged by the 95 % bound of the true RMS, with the part in its mount.",
        "bound_without_power": "The RMS is judged by the 95 % bound of the true RMS, power removed.",
    }[content.uncertainty.accepted]
    decided = f"Decided by: {wording.symbols(content.verdict.decided_by)}. " if content.verdict.decided_by else ""
    for one in wording.requirement(last, "verdict.lines", _results(first), "measurements.0.lines"):
        yield replace(one, notes=[f"{decided}{accepted}", *one.notes])


def _figures(drawn: CertificateDraft) -> Chapter:
    """Return the page with the figures, the ripple that the map does not show, their uncertainty, and the spectra."""
    content = drawn.content
    parts = [
        _changes(content),
        DocumentSection("Uncertainty", notes=content.uncertainty.statements),
        _section("Power spectra", "spectra", pictures.SPECTRA_CAPTION, _spectra(drawn)),
    ]
    return Chapter("Figures", [], _filled(parts))


def _signature(signed_by: str) -> DocumentSection:
    signed = (
        f"The JSON file of the same name has the SHA-256 of this PDF and is signed with the key {signed_by}. "
        "polishd certificate verify finds a change of either file."
        if signed_by
        else "Not signed. The JSON file of the same name has the SHA-256 of this PDF. polishd certificate verify finds "
        "an accidental change of either file, but cannot prove the author."
    )
    return DocumentSection("Signature", notes=[signed])


def _changes(content: Content) -> DocumentSection:
    rows = [
        (one.figure, f"{one.before_nm:.3f}", f"{one.after_nm:.3f}", _percent(one.change)) for one in content.changes
    ]
    notes = [content.aperture.words]
    if content.after is not None and content.after.iso10110 is not None:
        notes.append(f"After, in the notation of ISO 10110-5:2015, nm of surface: {content.after.iso10110.indication}")
    bands = [] if content.after is None else content.after.bands or []
    if any(band.soft and band.rms_nm is not None for band in bands):
        notes.append(
            "Fewer than three of the longest periods of a band fit on this part. The division at this period then "
            "depends on how the map is continued beyond its edge. The squares of all bands add up to the square of "
            "the RMS."
        )
    if content.beyond_reach is not None:
        reach = content.beyond_reach
        change = reach.after_nm / reach.before_nm - 1 if reach.before_nm > 0 else None
        name = f"beyond the reach of the tool, below {reach.cutoff_period_mm:.2f} mm"
        rows.append((name, f"{reach.before_nm:.3f}", f"{reach.after_nm:.3f}", _percent(change)))
        notes.append(
            "Beyond the reach of the tool: RMS of the periods that its spot cannot remove. An increase was left by the "
            "passes."
        )
    tables = [Table(("figure", "before", "after", "change"), rows)]
    if content.hidden_ripple:
        head = ("ripple that the map does not show, RMS in nm", "forecast", "at most (95 %)")
        tables.append(Table(head, [_hidden(one) for one in content.hidden_ripple]))
        notes.append(
            "The lines of the path leave a ripple that the samples of the last map average away. It is forecast from "
            "the passes and not measured. The lines of the tolerance are judged with it."
        )
    return DocumentSection("Before and after, nm", tables, notes)


def _hidden(one: HiddenRipple) -> tuple[str, str, str]:
    ends = (f"below {one.from_mm:g} mm" if one.from_mm else "", f"above {one.to_mm:g} mm" if one.to_mm else "")
    return f"{one.name}, {' and '.join(end for end in ends if end)}", f"{one.rms_nm:.3f}", f"{one.rms_high_nm:.3f}"


def _percent(change: float | None) -> str:
    return DASH if change is None else f"{100 * change:+.1f} %"


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
    after = drawn.after.reported
    sections = [
        DocumentSection("Heights", pictures=[heights_picture(after)]),
        DocumentSection("Masks", [Table((), rows)]),
        *of_form(after.answer),
        *of_detail(after, spectrum=False),
    ]
    yield Chapter("The surface after polishing", [], sections)


def _making(drawn: CertificateDraft) -> Chapter:
    content = drawn.content
    parts = [
        DocumentSection("From map to map", [_measurements(content)], _notes(content)),
        _anomalies(content),
        *map(_pass, content.passes),
        *wording.ripple_section(drawn.run.folder.rows()),
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


def _proofs(content: Content, signed_by: str) -> Chapter:
    journal = content.journal
    rows = ", ".join(f"{count} of {table}" for table, count in journal.rows.items())
    files = [(file.name, file.sha256) for file in content.files]
    parts = [
        _signature(signed_by),
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
