"""A certificate as it stands on paper: every figure of it is taken from what its twin says."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from polishd.maps.map_files import printable
from polishd.model.surface import FloatArray
from polishd.rendering.document import Chapter, DocumentSection, Picture, ReportDocument, Table
from polishd.rendering.plots import BLUE, DIVERGING, GREEN, MUTED, NO_DATA, ORANGE, figure, png, polishd_style, ruled
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

# Pictures of a certificate: before and after on one scale and on their own, both spectra, RMS from map to map.

WIDE_IN = 9.0
DPI = 160
SHARE = 99.5
"""Percentile of the heights at which the colours end."""
LEAST_NM = 1e-3


def before_and_after(before: ReconstructedMap, after: ReconstructedMap) -> Picture:
    """Both on the scale of the one before; then each on its own."""
    caption = (
        "Above: both maps on one colour scale, that of the map before. Below: each on its own scale. Red is high; the "
        "colours end at the 99.5th percentile. Grey: outside the clear aperture, or no data. The RMS over each picture "
        "is that of the tables: the same samples, over the same aperture."
    )
    with polishd_style():
        page = figure(WIDE_IN, 8.2)
        axes = page.subplots(2, 2)
        shared = _limit_nm(before.figure_nm)
        for column, (name, found) in enumerate((("Before", before), ("After", after))):
            rms = found.reported.answer["rms_nm"]
            _map(axes[0][column], found, f"{name}: {rms:.2f} nm RMS", shared)
            _map(axes[1][column], found, f"{name}, on its own scale", _limit_nm(found.figure_nm))
        return Picture("maps", caption, png(page, DPI))


def spectra_picture(before: CertificateSurface, after: CertificateSurface) -> Picture | None:
    """Both PSDs; None where a map does not carry it."""
    if before.psd is None or after.psd is None:
        return None
    caption = "Radially averaged two-dimensional PSD of both maps over the clear aperture."
    with polishd_style():
        page = figure(WIDE_IN * 0.7, 3.9)
        ax = page.add_subplot()
        for surface, name, colour in ((before, "before", MUTED), (after, "after", BLUE)):
            if surface.psd is None:
                continue
            frequency, density = (
                np.asarray(values) for values in (surface.psd.frequency_per_mm, surface.psd.density_nm2_mm2)
            )
            some = density > LEAST_NM**2
            ax.loglog(frequency[some], density[some], color=colour, linewidth=1.1, label=name)
        ax.set(xlabel="spatial frequency, 1/mm", ylabel="PSD, nm² mm²")
        ruled(ax, "both")
        ax.legend()
        return Picture("spectra", caption, png(page, DPI), wide=False)


def convergence(
    measured: Sequence[CertificateMeasurement], passes: Sequence[CertificatePass], limit_nm: float | None
) -> Picture:
    """RMS of each map, what was expected of it, and interrupted passes as broken lines."""
    caption = (
        "RMS of each map. Bars: where the map was expected in 9 of 10 cases, as its pass was planned. Dashed: a pass "
        "that was interrupted, for which nothing was expected."
    )
    with polishd_style():
        page = figure(WIDE_IN * 0.8, 3.4)
        ax = page.add_subplot()
        rms = [one.rms_nm for one in measured]
        _steps(ax, measured, passes)
        ax.plot(rms, "o", color=BLUE, label="measured", zorder=3)
        for index, value in enumerate(rms):
            ax.annotate(f"{value:.2f}", (index, value), (6, 5), textcoords="offset points", fontsize=8)
        if limit_nm is not None:
            ax.axhline(limit_nm, color=GREEN, linewidth=1.2, linestyle=(0, (5, 3)), label=f"limit {limit_nm:g} nm")
        ax.set_yscale("log")
        ax.set_xticks(range(len(measured)), [one.name.replace("after an ", "after an\n") for one in measured])
        near = max(rms) < 3 * min(rms)
        ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]) if near else LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set(ylabel="RMS, nm")
        ax.margins(x=0.08, y=0.15)
        ruled(ax)
        ax.legend(loc="best")
        return Picture("convergence", caption, png(page, DPI))


def _steps(ax: Axes, measured: Sequence[CertificateMeasurement], passes: Sequence[CertificatePass]) -> None:
    """From map to map, and what each whole pass was to leave."""
    by_cycle = {one.cycle: one for one in passes if one.did.how == "done"}
    label: str | None = "expected, 9 of 10"
    for index, (was, now) in enumerate(pairwise(measured)):
        done = by_cycle.get(was.cycle)
        colour, line = (MUTED, "--") if done is None else (BLUE, "-")
        ax.plot([index, index + 1], [was.rms_nm, now.rms_nm], color=colour, linestyle=line, linewidth=1.2)
        if done is None or done.planned.expected_low_nm is None or done.planned.expected_high_nm is None:
            continue
        ends = [done.planned.expected_low_nm, done.planned.expected_high_nm]
        at = [index + 1, index + 1]
        ax.plot(at, ends, color=ORANGE, linewidth=5.0, alpha=0.4, solid_capstyle="butt", label=label)
        label = None


def _limit_nm(height_nm: FloatArray) -> float:
    """Half-width of the colours."""
    inside = np.abs(height_nm[np.isfinite(height_nm)])
    return max(float(np.percentile(inside, SHARE)), LEAST_NM)


def _map(ax: Axes, found: ReconstructedMap, title: str, limit_nm: float) -> None:
    ny, nx = found.figure_nm.shape
    half_x, half_y = nx * found.pitch_mm / 2, ny * found.pitch_mm / 2
    ax.set_facecolor(NO_DATA)
    level = found.figure_nm - np.nanmean(found.figure_nm)
    extent = (-half_x, half_x, -half_y, half_y)
    seen = ax.imshow(level, extent=extent, interpolation="none", cmap=DIVERGING, vmin=-limit_nm, vmax=limit_nm)
    ax.set(title=title, xlabel="x, mm", ylabel="y, mm")
    ax.spines[:].set_visible(False)
    bar = ax.figure.colorbar(seen, ax=ax, shrink=0.85, aspect=24, pad=0.02, extend="both", extendfrac=0.03)
    bar.set_label("nm")
    bar.outline.set_visible(False)


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
    maps = DocumentSection("Before and after", (), (), [before_and_after(drawn.before, drawn.after)])
    masks = DocumentSection("Masks", [Table((), rows)])
    yield Chapter("The surface", [], [maps, masks])
    both = spectra_picture(content.before, content.after)
    spectra = [] if both is None else [DocumentSection("Power spectra", (), (), [both])]
    figures = [*of_form(drawn.after.reported.answer), *of_detail(drawn.after.reported, spectrum=False)]
    yield Chapter("The surface after polishing", [], [*spectra, *figures])


def _making(content: Content) -> Chapter:
    limit = next((line.limit for line in content.verdict.lines if line.what == "RMS"), None)
    picture = convergence(content.measurements, content.passes, limit)
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
