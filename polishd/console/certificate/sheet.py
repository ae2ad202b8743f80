"""A certificate as it stands on paper: every figure of it is taken from what its twin says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from polishd.console.certificate import pictures
from polishd.console.certificate.content import CertificateDraft
from polishd.console.certificate.model import CertificatePass, Content, Judgement
from polishd.show.sheet import Chapter, DocumentSection, ReportDocument, Table
from polishd.workbench.maps.files import printable
from polishd.workbench.maps.report_sheet import editions, of_detail, of_form

GOOD = "in tolerance"


def sheet(drawn: CertificateDraft, signed_by: str) -> ReportDocument:
    """The certificate's pages.

    Args:
        drawn: what it says.
        signed_by: id of the key that its twin is signed with; empty: it is not signed.
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
    interim = "" if verdict.final else " (interim: the job was stopped, and can go on)"
    facts = [
        ("certificate", content.number),
        ("issued", f"{content.issued:%Y-%m-%d %H:%M} UTC"),
        ("by", issuer.shop),
        ("operator", issuer.operator or "nobody was named"),
        ("customer", part.customer),
        ("drawing", part.drawing),
        ("part", part.id),
        ("outline", f"{part.outline}, clear aperture less a rim of {part.edge_mm:g} mm"),
        ("form wanted", part.form),
        ("job", f"{part.job}, ended as: {verdict.outcome}{interim}"),
        ("measured last", f"{content.measurements[-1].taken:%Y-%m-%d %H:%M} UTC, {content.measurements[-1].name}"),
    ]
    signed = (
        f"The twin of this PDF, the JSON file of the same name, holds this PDF's SHA-256 and is signed with the key "
        f"{signed_by}. polishd report verify says whether either was changed."
        if signed_by
        else "Not signed. The twin of this PDF, the JSON file of the same name, holds this PDF's SHA-256: polishd "
        "report verify says whether either was changed by accident, and proves no author."
    )
    once = ["The part was measured once: before and after are one map."] if len(content.measurements) == 1 else []
    parts = [
        _specification(content),
        DocumentSection("Signature", notes=[signed]),
        DocumentSection("How sure", notes=[*content.uncertainty.statements, *once]),
        _changes(content),
        *_reach(content),
    ]
    words = f"{verdict.words}{interim}"
    return Chapter(f"Certificate of part {printable(part.id)}", _shown(facts), parts, words, verdict.state == GOOD)


def _specification(content: Content) -> DocumentSection:
    first = {line.what: line for line in content.measurements[0].lines}
    rows = [(line.what, _limit(line), _value(first.get(line.what)), _value(line), *_sure(line)) for line in
            content.verdict.lines]  # fmt: skip
    accepted = {
        "figure": "Lines are judged by the figure as measured.",
        "bound": "RMS is judged by the 95 % bound of what is true, as the part's mount holds it.",
        "bound_without_power": "RMS is judged by the 95 % bound of what is true, power removed.",
    }[content.uncertainty.accepted]
    decided = f"Decided by: {content.verdict.decided_by.replace('+-', '±')}." if content.verdict.decided_by else ""
    head = ("line of the drawing", "limit", "before", "after", "±, or bound", "holds")
    return DocumentSection("Specification and verdict", [Table(head, rows)], [*filter(None, (decided,)), accepted])


def _limit(line: Judgement) -> str:
    return f"{line.limit:g} {line.unit}"


def _value(line: Judgement | None) -> str:
    return "–" if line is None else f"{line.value:.4g}"


def _sure(line: Judgement) -> tuple[str, str]:
    sure = f"± {line.uncertainty:.2g}" if line.uncertainty is not None else "not known"
    return (sure if line.bound is None else f"at most {line.bound:.3g}"), "yes" if line.holds else "no"


def _changes(content: Content) -> DocumentSection:
    rows = [
        (one.figure, f"{one.before_nm:.3f}", f"{one.after_nm:.3f}", _percent(one.change)) for one in content.changes
    ]
    notes = [content.aperture.words]
    bands = [] if content.after is None else content.after.bands or []
    if any(band.soft and band.rms_nm is not None for band in bands):
        notes.append(
            "Fewer than three of a band's longest periods fit on this part: what lies to either side of such an edge "
            "depends on how the rim is continued. The squares of all bands add up to that of the RMS."
        )
    return DocumentSection("Before and after, nm", [Table(("figure", "before", "after", "change"), rows)], notes)


def _percent(change: float | None) -> str:
    return "–" if change is None else f"{100 * change:+.1f} %"


def _reach(content: Content) -> Iterator[DocumentSection]:
    reach = content.beyond_reach
    if reach is None:
        return
    table = Table(
        ("RMS of these periods, nm", "before", "after"),
        [(f"below {reach.cutoff_period_mm:.2f} mm", f"{reach.before_nm:.3f}", f"{reach.after_nm:.3f}")],
    )
    note = (
        "The tool's spot removes nothing of shorter periods, so no dwell takes this away; what is more of it after "
        "than before, the passes left. Of the same samples over the same aperture as all figures above; the solver's "
        "own figures, on its coarser grid, are not repeated here."
    )
    yield DocumentSection("What no dwell could remove", [table], [note])


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
    maps = DocumentSection("Before and after", (), (), [pictures.before_and_after(drawn.before, drawn.after)])
    masks = DocumentSection("Masks", [Table((), rows)])
    yield Chapter("The surface", [], [maps, masks])
    both = pictures.spectra_picture(content.before, content.after)
    spectra = [] if both is None else [DocumentSection("Power spectra", (), (), [both])]
    figures = [*of_form(drawn.after.reported.answer), *of_detail(drawn.after.reported, spectrum=False)]
    yield Chapter("The surface after polishing", [], [*spectra, *figures])


def _making(content: Content) -> Chapter:
    limit = next((line.limit for line in content.verdict.lines if line.what == "RMS"), None)
    picture = pictures.convergence(content.measurements, content.passes, limit)
    parts = [
        DocumentSection("From map to map", [_measurements(content)], _notes(content), [picture]),
        _anomalies(content),
        *map(_pass, content.passes),
    ]
    torn = sum(one.number is None for one in content.passes)
    whole = len(content.passes) - torn
    return Chapter("How it was made", [("passes", f"{whole}" + (f", and {torn} interrupted" if torn else ""))], parts)


def _measurements(content: Content) -> Table:
    rows = [
        (one.name, f"{one.taken:%m-%d %H:%M}", f"{one.pv_nm:.2f}", f"{one.rms_nm:.3f}", f"{one.lsf_rms_nm:.3f}")
        for one in content.measurements
    ]
    return Table(("map", "taken, UTC", "PV, nm", "RMS, nm", "LSF, nm"), rows)


def _notes(content: Content) -> list[str]:
    return [printable(f"Map {one.name}: {note}") for one in content.measurements for note in one.notes]


def _pass(one: CertificatePass) -> DocumentSection:
    planned, did, taught = one.planned, one.did, one.taught
    force = "not known" if did.force_n is None else f"{did.force_n:.2f} N"
    speed = "" if did.rpm is None else f", {did.rpm:.0f} rpm"
    torn = ", ".join(f"{first} to {last}" for first, last in did.uncertain_blocks)
    rows = [
        ("tool", one.tool),
        (
            "begun",
            f"{one.begun:%Y-%m-%d %H:%M:%S} UTC" + ("" if one.ended is None else f", ended {one.ended:%H:%M:%S}"),
        ),
        ("planned", f"{planned.dwell_s:,.1f} s over {planned.blocks:,} blocks{_expected(one)}"),
        ("did", f"{did.executed_s:,.1f} s{_share(did.share)}, {did.blocks:,} blocks; mean {force}{speed}"),
        ("not known", f"whether the tool touched in blocks {torn}" if torn else ""),
        ("taught", _taught(one)),
        ("program", f"SHA-256 {planned.program_sha256}"),
    ]
    title = one.name[:1].upper() + one.name[1:]
    return DocumentSection(
        title, [Table((), _shown([row for row in rows if row[1]]))], [printable(note) for note in taught.notes]
    )


def _expected(one: CertificatePass) -> str:
    low, high = one.planned.expected_low_nm, one.planned.expected_high_nm
    if low is None or high is None:
        return ""
    void = "" if one.number is not None else ", had it been a whole pass"
    return f"; RMS of {low:.2f} to {high:.2f} nm expected after it (9 of 10){void}"


def _share(share: float | None) -> str:
    return "" if share is None else f" in contact ({share:.0%} of the plan's)"


def _taught(one: CertificatePass) -> str:
    taught = one.taught
    if taught.measured_rms_nm is None:
        return "no map was taken after it"
    said = f"the map after it has {taught.measured_rms_nm:.3f} nm RMS"
    if one.number is None:
        return f"{said}; nothing else is learned of part of a pass"
    if taught.as_expected is not None:
        said += ", as expected" if taught.as_expected else ", not as expected"
    if taught.rate is not None:
        sigma = "" if taught.rate_sigma is None else f" ± {taught.rate_sigma:.3f}"
        said += f"; removal rate {taught.rate:.3f}{sigma} of the model's own"
    return said


def _anomalies(content: Content) -> DocumentSection:
    title = "What went wrong, and what was done"
    if not content.anomalies:
        return DocumentSection(
            title, notes=["Nothing: no alarm, hold, fault or interrupted pass is in the journal of this job."]
        )
    rows = [
        row
        for one in content.anomalies
        for row in ((f"{one.at:%Y-%m-%d %H:%M:%S} UTC", f"{one.kind}: {one.what}"), ("what was done", one.done))
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
            ["Of what made this certificate; what polished, where the run folder tells it."],
        ),
        DocumentSection("Journal", [Table((), [("SHA-256 of its rows", journal.sha256), ("rows", rows)])]),
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
            ("its map", f"SHA-256 {record.map_sha256}"),
            ("its values", f"SHA-256 {record.profile_sha256}"),
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
            f"SHA-256 {found.system_map_sha256}" if found.system_map_sha256 else "none: nothing is taken off",
        ),
    ]
    return DocumentSection("Instrument", [Table((), _shown([fact for fact in facts if fact[1]]))])


def _shown(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    return [(printable(name), printable(value)) for name, value in rows]
