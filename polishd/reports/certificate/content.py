"""From a run to what its certificate says. Nothing is drawn here, and nothing is written."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from polishd import __version__
from polishd.config.instrument_profile import InstrumentProfile
from polishd.model.tolerance import Judged, holds, judged_of, worst
from polishd.reports import wording
from polishd.reports.certificate import model
from polishd.reports.certificate.model import (
    Anomaly,
    CertificatePass,
    CertificateVerdict,
    Judgement,
    PassEstimate,
    PassExecution,
    PassPlan,
    State,
    Uncertainty,
)
from polishd.reports.certificate.sources import (
    CertificateRun,
    MapReconstructor,
    ReconstructedMap,
    Row,
    as_one_source,
    profile_of,
    sha256_of,
)
from polishd.reports.wording import VERDICTS

# What each pass was planned to do, what it did, and what the map after it told: from the journal's rows.


def passes_of(run: CertificateRun) -> list[CertificatePass]:
    """In time order; one that was interrupted has no number, and says how much of it was executed."""
    rows, found, number = run.folder.rows(), [], 0
    measured = {row["cycle"]: row for row in run.rows.maps}
    for done in run.rows.passes:
        cycle = done["cycle"]
        entry = rows[cycle] if cycle < len(rows) else {}
        whole = done["how"] == "done"
        number += whole
        found.append(
            CertificatePass(
                name=f"pass {number}" if whole else f"a pass that was {wording.share(entry) or 'never ended'}",
                number=number if whole else None,
                cycle=cycle,
                tool=str(done["facts"].get("tool") or ""),
                begun=at(done["started"]),
                ended=None if done["ended"] is None else at(done["ended"]),
                planned=_planned(done),
                did=_done(done, entry, run.rows.contact.get(cycle, {})),
                taught=_taught(run, done, measured.get(cycle + 1)),
            )
        )
    return found


def at(unix_s: float) -> datetime:
    """A time of the journal, to the second, UTC."""
    return datetime.fromtimestamp(unix_s, UTC).replace(microsecond=0)


def _planned(done: Row) -> PassPlan:
    facts, forecast = done["facts"], done["facts"].get("forecast") or {}
    return PassPlan(
        dwell_s=facts["dwell_s"],
        **{f"expected_{end}_nm": forecast.get(f"{end}_nm") for end in ("low", "median", "high")},
        program_sha256=done["program_sha256"],
        blocks=done["contact_to"] - done["contact_from"],
    )


def _done(done: Row, entry: Mapping[str, Any], contact: Row) -> PassExecution:
    executed_s, planned_s = entry.get("executed_s") or 0.0, done["facts"]["dwell_s"]
    return PassExecution(
        how=done["how"] or "begun",
        share=executed_s / planned_s if planned_s > 0 else None,
        executed_s=executed_s,
        blocks=contact.get("blocks", 0),
        uncertain_blocks=[(first, last) for first, last in entry.get("uncertain") or ()],
        force_n=contact.get("force_n"),
        rpm=contact.get("rpm"),
    )


def _taught(run: CertificateRun, done: Row, after: Row | None) -> PassEstimate:
    """Of an interrupted pass its map tells the surface only: nothing is learned of half a pass."""
    shown = done["facts"].get("shown") or {}
    rate, expected, seen_nm = shown.get("rate") or {}, shown.get("expected_nm"), shown.get("seen_nm")
    events = [row for row in run.rows.events if row["name"] == "learned" and row["cycle"] == done["cycle"] + 1]
    findings = [one["what"] for one in done["facts"].get("findings") or ()]
    return PassEstimate(
        measured_rms_nm=None if after is None else after["stats"]["rms_nm"],
        as_expected=None if expected is None or seen_nm is None else expected[0] <= seen_nm <= expected[1],
        rate=rate.get("value"),
        rate_sigma=rate.get("sigma"),
        notes=[*findings, *(str(note) for row in events[-1:] for note in row["data"].get("notes") or ())],
    )


# What somebody had to see to, and what was done about it: from the journal's events and passes.

TOLD = {"gate_stopped": "stop", "signal_wrong": "what", "found": "what"}
"""Events that are told as they are, and the field that says what it was."""
AGAIN = ("failed", "held")
"""Errors: one that held the cell and then ended its daemon is told once."""


NOTHING = "nothing is recorded"


def anomalies_of(run: CertificateRun) -> list[Anomaly]:
    """In time order: alarms, holds, faults, orders of a person, interrupted passes; nothing for a job without any."""
    outcome = wording.text(run.rows.job["outcome"]).replace("_", " ")
    found = [*of_events(run.rows.events, f"the job ended: {outcome}" if outcome else ""), *_of_passes(run)]
    return sorted(found, key=lambda one: one.at)


def of_events(events: Sequence[Row], end: str) -> Iterator[Anomaly]:
    """What the journal's events tell of; ``end``: how the job ended, where nothing else came after one of them."""
    told = ""
    for index, event in enumerate(events):
        name, data = event["name"], event["data"]
        if name in TOLD:
            kind, what = data.get("kind") or name.replace("_", " "), data[TOLD[name]]
        elif name in AGAIN:
            kind, what = data["kind"], data["error"]
        elif name == "state" and data["state"] == "held" and data["reason"]:
            kind, what = "hold", data["reason"]
        elif name == "ordered" and data["order"] != "resume":
            kind, what = "order", f"{data['order']} was ordered" + (f": {data['reason']}" if data["reason"] else "")
        else:
            continue
        if told and (what in told or told in what):  # the error, and that the cell was held for it
            told = what
            continue
        told = what
        yield Anomaly(
            at=at(event["at"]), kind=kind, what=str(what), done=_answer(events[index + 1 :]) or end or NOTHING
        )


def _answer(later: Sequence[Row]) -> str:
    """What happened next: a person's order, a start, an end; the first of them and where it led."""
    said = []
    for event in later:
        name, data, when = event["name"], event["data"], f"{at(event['at']):%Y-%m-%d %H:%M:%S}"
        if name == "ordered":
            reason = f" ({data['reason']})" if data["reason"] else ""
            said.append(f"{data['order']} was ordered{reason}, {when}")
        elif name == "state" and data["state"] == "finished":
            said.append(f"the daemon ended, {when}")
        elif name == "state" and data["state"] == "starting":
            said.append(f"it was started again, {when}")
        elif name == "measured":
            return "; ".join([*said, f"measured before anything else: RMS {data['rms_nm']:.2f} nm"])
        elif name == "pass_ended":
            return "; ".join([*said, f"the pass went on to its end, {when}"])
        elif name in {"pass_begun", "job_ended"}:
            break
    return "; ".join(said)


def _of_passes(run: CertificateRun) -> Iterator[Anomaly]:
    """Of each that did not come to its end, how much of it was executed, and the map that followed."""
    rows, maps = run.folder.rows(), {row["cycle"]: row for row in run.rows.maps}
    for done in run.rows.passes:
        if done["how"] == "done":
            continue
        cycle, after = done["cycle"], maps.get(done["cycle"] + 1)
        share = wording.share(rows[cycle]) if cycle < len(rows) else ""
        error = next((row["error"] for row in run.rows.phases if row["cycle"] == cycle and row["phase"] == "run"), "")
        why = "" if not error or error.startswith("CancelledError") else f": {error}"
        yield Anomaly(
            at=at(done["ended"] or done["started"]),
            kind="pass interrupted",
            what=f"the pass after measurement {cycle} was {share or 'begun, and never ended'}{why}",
            done="no map was taken since: the surface is not known"
            if after is None
            else f"none of its blocks was run again; the part was measured anew: RMS {after['stats']['rms_nm']:.2f} nm",
        )


# Whether a part is what its drawing wants, by which line, and how sure that is: from the last map's judgement.


def verdict_of(run: CertificateRun) -> CertificateVerdict:
    """By the lines of the last map. Where a pass touched the part since, nobody knows."""
    judged, outcome = judged_of(run.rows.maps[-1]["stats"]), wording.text(run.folder.summary.get("outcome"))
    since = [done for done in run.rows.passes if done["cycle"] >= run.rows.maps[-1]["cycle"]]
    state: State = "not known" if since or not judged else "in tolerance" if holds(judged) else "not in tolerance"
    farthest = worst(judged)
    ended = VERDICTS[outcome].text if outcome in VERDICTS else outcome.replace("_", " ")
    if since:
        said = "Not known: the part was polished after its last map"
    elif not judged:
        said = "Not known: the job judges no line"
    elif state == "in tolerance":
        said = f"In tolerance: {len(judged)} of {len(judged)} lines hold"
    else:
        said = f"Not in tolerance: {sum(one.holds for one in judged)} of {len(judged)} lines hold"
    unsure = sum(one.unsure for one in judged)
    if unsure and state != "not known":
        said += f"; of {unsure} the limit lies within its uncertainty"
    return CertificateVerdict(
        state=state,
        words=said,
        decided_by="" if farthest is None else str(farthest),
        lines=[Judgement.model_validate(one.facts()) for one in judged],
        unsure_lines=unsure,
        outcome=ended if outcome else "unfinished",
        final=run.rows.job["ended"] is not None,
    )


def uncertainty_of(run: CertificateRun, profile: InstrumentProfile | None) -> Uncertainty:
    """What is known of the error of the figures that decide, in sentences."""
    accepted = wording.text(run.folder.summary.get("accept")) or "figure"
    judged = judged_of(run.rows.maps[-1]["stats"])
    return Uncertainty.model_validate(
        {"accepted": accepted, "statements": [*_of_lines(judged), *_of_instrument(run, profile)]}
    )


def _of_lines(judged: tuple[Judged, ...]) -> Iterator[str]:
    """What the table of the lines does not say by itself."""
    for one in judged:
        if one.bound is not None:
            yield f"{one.what}: {one.bound_words}; judged by that bound."
        elif one.unsure:
            sigma = f"{one.value:.3g} ± {one.uncertainty:.2g} {one.unit}"
            yield f"{one.what}: {sigma}, and the limit lies within that: either verdict is possible."
    plain = [one.what for one in judged if one.bound is None and one.uncertainty is None]
    if plain:
        yield f"Judged as measured, with an uncertainty that is not known: {', '.join(plain)}."
    if any(one.bound is None and one.uncertainty is not None for one in judged):
        yield "± is by the instrument's repeatability alone, at most."


def _of_instrument(run: CertificateRun, profile: InstrumentProfile | None) -> Iterator[str]:
    repeats = None if profile is None else profile.instrument.repeatability_nm
    if repeats is None:
        yield "The instrument's repeatability is not in its profile."
    else:
        yield f"The instrument's repeatability is {repeats:g} nm RMS."
    if run.rows.maps[-1]["stats"].get("system"):
        yield "The instrument's own error was told by turning a part, and is off each map."
    else:
        yield "The instrument's own error has not been told apart from the part's: it is in all figures."


LIBRARIES = ("numpy", "scipy", "matplotlib", "cryptography")
REMOVED = {"piston": "piston", "tilt": "piston and tilt", "power": "piston, tilt and power"}
LEFT_ASIDE = ("report.html", "pictures")
"""Made from the other files, at any time anew."""


@dataclass(frozen=True, slots=True)
class CertificateRequest:
    """What is said on the command line."""

    operator: str = ""
    customer: str = ""
    drawing: str = ""
    number: str = ""
    shop: str = ""
    wavelength_nm: float = 546.07


@dataclass(frozen=True, slots=True)
class CertificateDraft:
    """What a certificate says, and what its pictures are drawn of."""

    content: model.Content
    run: CertificateRun
    before: ReconstructedMap | None
    after: ReconstructedMap | None
    wavelength_nm: float


def certificate_content(
    run: CertificateRun, asked: CertificateRequest, now: datetime | None = None
) -> CertificateDraft:
    """Everything that the certificate of a run says; ConfigError where the run cannot be certified."""
    remaker = MapReconstructor(run, asked.wavelength_nm)
    before, after = (_remade(remaker, row) for row in (run.rows.maps[0], run.rows.maps[-1]))
    reach, why_not = _reach(run, before, after)
    content = model.Content(
        schema_=model.SCHEMA,
        number=asked.number or _number(run),
        issued=(now or datetime.now(UTC)).replace(microsecond=0),
        issuer=model.Issuer(shop=asked.shop, operator=asked.operator, program="polishd", version=__version__),
        part=_part(run, asked),
        verdict=verdict_of(run),
        uncertainty=uncertainty_of(run, profile_of(run)),
        instrument=_instrument(run, after),
        aperture=_aperture(run, after),
        measurements=list(_measurements(run)),
        changes=_changes(run, before, after),
        beyond_reach=reach,
        before=None if before is None else _surface(before),
        after=None if after is None else _surface(after),
        passes=passes_of(run),
        anomalies=anomalies_of(run),
        versions=_versions(run),
        files=list(_files(run)),
        journal=_journal(run),
        left_out=[_short(run, reason) for reason in (*remaker.left_out, *why_not, *run.folder.missing)],
    )
    return CertificateDraft(content, run, before, after, asked.wavelength_nm)


def _remade(remaker: MapReconstructor, row: Row) -> ReconstructedMap | None:
    found = remaker.surface(row)
    return None if found is None else as_one_source(found, row["stats"])


def _number(run: CertificateRun) -> str:
    """Of the job, the day of its end, and its journal: another run cannot have it."""
    job = run.rows.job
    day = at(job["ended"] or run.rows.maps[-1]["taken"])
    return f"{job['name']}-{day:%Y%m%d}-{run.rows.sha256[:8]}"


def _part(run: CertificateRun, asked: CertificateRequest) -> model.PartFacts:
    terms, job = run.rows.terms, run.rows.job
    return model.PartFacts(
        id=job["part_id"],
        job=job["name"],
        customer=asked.customer,
        drawing=asked.drawing,
        outline=wording.text(run.folder.summary.get("outline")),
        edge_mm=terms["part.edge_mm"],
        form=_form(terms),
        alignment=terms["part.alignment"],
    )


def _form(terms: Row) -> str:
    """The form wanted, in words."""
    radius = terms.get("part.curvature_radius_mm")
    if radius is None:
        form = "flat"
    else:
        form = f"{'concave' if radius > 0 else 'convex'}, vertex radius {abs(radius):g} mm"
        conic, even = terms.get("part.conic") or 0.0, terms.get("part.even") or []
        form += f", conic {conic:g}" if conic else ""
        form += f", even terms {', '.join(f'{term:g}' for term in even)}" if even else ""
    nominal = terms.get("part.nominal")
    return f"{form}; less the map {nominal['file']} (sha256 {nominal['sha256'][:12]}…)" if nominal else form


def _instrument(run: CertificateRun, after: ReconstructedMap | None) -> model.InstrumentFacts:
    profile = profile_of(run)
    record = None if profile is None else profile.instrument.commissioned
    return model.InstrumentFacts(
        profile="" if profile is None else profile.instrument.name,
        measured_by="" if after is None else after.source.instrument,
        commissioned=None if record is None else model.Commissioning(**asdict(record)),
        not_commissioned="the cell named no instrument's profile" if profile is None else profile.unproved,
        repeatability_nm=None if profile is None else profile.instrument.repeatability_nm,
        system_map_sha256=run.rows.maps[-1]["stats"].get("system") or "",
    )


def _aperture(run: CertificateRun, after: ReconstructedMap | None) -> model.CertificateAperture:
    terms, last = run.rows.terms, run.rows.maps[-1]
    surface = run.surface(last["cycle"])
    inside = 0 if surface is None else int(np.count_nonzero(surface.metric_mask))
    solved = 0 if surface is None else int(np.count_nonzero(np.isfinite(surface.height_nm)))
    words_ = (
        f"All figures of a measured surface are of the map's own samples in the clear aperture: the part's outline "
        f"less a rim of {terms['part.edge_mm']:g} mm, as the first map showed it, the same for all maps; "
        f"{REMOVED[terms['part.alignment']]} removed by least squares over it."
    )
    return model.CertificateAperture(
        words=words_,
        pitch_mm=None if after is None else after.pitch_mm,
        samples=last["stats"]["samples"],
        grid_pitch_mm=terms["process.grid_mm"],
        solve_samples=solved,
        metric_samples=inside,
    )


def _measurements(run: CertificateRun) -> Iterator[model.CertificateMeasurement]:
    rows = run.folder.rows()
    for index, row in enumerate(run.rows.maps):
        stats = row["stats"]
        lies = stats.get("registration") or {"by": "none", "shift_mm": (0.0, 0.0), "rotation_deg": 0.0}
        yield model.CertificateMeasurement(
            cycle=row["cycle"],
            name=wording.measurement(rows, index),
            taken=at(row["taken"]),
            map_sha256=row["sha256"],
            **{key: stats[key] for key in ("rms_nm", "pv_nm", "lsf_rms_nm", "samples", "spikes")},
            lsf_period_mm=run.rows.terms["job.lsf_period_mm"],
            band_rms_nm=stats.get("band_rms_nm"),
            lines=[model.Judgement.model_validate(line) for line in stats.get("judged") or ()],
            registration=model.CertificateRegistration(
                **{key: lies[key] for key in ("by", "shift_mm", "rotation_deg")}
            ),
            notes=[wording.text(note) for note in stats.get("notes") or ()],
        )


def _changes(
    run: CertificateRun, before: ReconstructedMap | None, after: ReconstructedMap | None
) -> list[model.FigureChange]:
    """Rows of the paper's Table V: of the journal PV, RMS and LSF; the shorter bands as far as the maps show them."""
    first, last = run.rows.maps[0]["stats"], run.rows.maps[-1]["stats"]
    lsf_mm = run.rows.terms["job.lsf_period_mm"]
    named = (("PV", "pv_nm"), ("RMS", "rms_nm"), (f"LSF, periods above {lsf_mm:g} mm", "lsf_rms_nm"))
    pairs = [(name, first[key], last[key]) for name, key in named]
    if before is not None and after is not None:
        bands = (found.reported.answer["bands"] or [] for found in (before, after))
        for was, now in list(zip(*bands, strict=False))[1:]:
            if was["rms_nm"] is not None and now["rms_nm"] is not None:
                to = "" if now["to_mm"] is None else f" to {now['to_mm']:g} mm"
                pairs.append((f"{now['name']}, below {now['from_mm']:g} mm{to}", was["rms_nm"], now["rms_nm"]))
    return [
        model.FigureChange(figure=name, before_nm=was, after_nm=now, change=now / was - 1 if was > 0 else None)
        for name, was, now in pairs
    ]


def _reach(
    run: CertificateRun, before: ReconstructedMap | None, after: ReconstructedMap | None
) -> tuple[model.CorrectableRange | None, Sequence[str]]:
    """What no dwell could remove, of the same surfaces as all figures; or why that is not known."""
    told = [done["facts"]["certificate"].get("cutoff_period_mm") for done in run.rows.passes]
    known = [cutoff for cutoff in told if cutoff]
    if not known:
        why = (
            "no pass was planned" if not told else "the plans do not tell below which periods the spot removes nothing"
        )
        return None, [f"what no dwell could remove: {why}"]
    if before is None or after is None:
        return None, ["what no dwell could remove: needs the first and the last map"]
    cutoff = min(known)
    if cutoff <= 2 * after.pitch_mm:
        return None, [f"what no dwell could remove: periods below {cutoff:.3g} mm are shorter than the map shows"]
    reach = model.CorrectableRange(
        cutoff_period_mm=cutoff, before_nm=before.beyond_nm(cutoff), after_nm=after.beyond_nm(cutoff)
    )
    return reach, ()


def _surface(found: ReconstructedMap) -> model.CertificateSurface:
    answer = found.reported.answer
    iso, said, fitted, slope = (answer[key] for key in ("iso10110", "indications", "zernike", "slope"))
    return model.CertificateSurface(
        cycle=found.cycle,
        map_sha256=found.source.sha256,
        pv_nm=answer["pv_nm"],
        rms_nm=answer["rms_nm"],
        bands=answer["bands"],
        psd=answer["psd"],
        zernike=None if fitted is None else model.Zernike(**_some(model.Zernike, fitted, terms=_terms(fitted))),
        iso10110=None
        if iso is None
        else model.CertificateIso10110(**iso, indication=said["iso10110_5"], wavefront_indication=said["iso10110_14"]),
        slope=None if slope is None else model.CertificateSlope(**_some(model.CertificateSlope, slope)),
        wavelength_nm=answer["wavelength_nm"],
    )


def _terms(fitted: Row) -> list[dict[str, Any]]:
    return [{key: term[key] for key in ("index", "n", "m", "nm")} for term in fitted["terms"]]


def _some(kind: type[model.Facts], facts: Row, **others: Any) -> dict[str, Any]:
    """Of some facts those that a model has."""
    return {key: facts[key] for key in kind.model_fields if key in facts} | others


def _versions(run: CertificateRun) -> dict[str, str]:
    return {
        "polished by polishd": wording.text(run.folder.summary.get("version")) or "not recorded",
        "certified by polishd": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in LIBRARIES},
        "system": platform.system(),
    }


def _files(run: CertificateRun) -> Iterator[model.File]:
    for path in sorted(run.path.rglob("*")):
        name = path.relative_to(run.path).as_posix()
        if path.is_file() and not path.name.startswith(".") and name.partition("/")[0] not in LEFT_ASIDE:
            yield model.File(name=name, bytes=path.stat().st_size, sha256=sha256_of(path))


def _journal(run: CertificateRun) -> model.JournalFacts:
    events = [
        model.CertificateEvent(at=at(row["at"]), cycle=row["cycle"], name=row["name"], data=_plain(row["data"]))
        for row in run.rows.events
        if row["name"] != "progress"
    ]
    return model.JournalFacts(sha256=run.rows.sha256, rows=dict(run.rows.counts), events=events)


def _short(run: CertificateRun, reason: str) -> str:
    """Without the folder in which the run lies: that is nobody's business outside the shop."""
    return reason.replace(f"{run.path}/", "")


def _plain(value: Any) -> Any:
    """As JSON can hold it, and a customer may have it: what is no number is null, and a path its last name."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return list(map(_plain, value))
    if isinstance(value, str) and value.startswith("/"):
        return value.rstrip("/").rpartition("/")[2]
    return None if isinstance(value, float) and not math.isfinite(value) else value
