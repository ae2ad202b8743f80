"""Content of a certificate, from a run. Pure: no pictures and no files."""

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
from polishd.model.tolerance import LineResult, line_results, part_holds, worst_line
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

# Passes: plan, execution and result, from the journal.


def passes_of(run: CertificateRun) -> list[CertificatePass]:
    """Return the passes in time order. An interrupted pass has no number; its name has the executed share."""
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
    """Return a time of the journal, to the second, UTC."""
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
    """Return the result of a pass. No parameter is estimated from an interrupted pass."""
    shown = done["facts"].get("shown") or {}
    rate, expected, seen_nm = shown.get("rate") or {}, shown.get("expected_nm"), shown.get("seen_nm")
    events = [
        row for row in run.rows.events if row["name"] == "estimates_updated" and row["cycle"] == done["cycle"] + 1
    ]
    findings = [one["what"] for one in done["facts"].get("findings") or ()]
    return PassEstimate(
        measured_rms_nm=None if after is None else after["stats"]["rms_nm"],
        as_expected=None if expected is None or seen_nm is None else expected[0] <= seen_nm <= expected[1],
        rate=rate.get("value"),
        rate_sigma=rate.get("sigma"),
        notes=[*findings, *(str(note) for row in events[-1:] for note in row["data"].get("notes") or ())],
    )


# Anomalies and the action after each: from the journal's events and passes.

REPORTED = {"removal_check_failed": "stop", "signal_out_of_range": "what", "finding_reported": "what"}
"""Events that are reported, and the field with the description."""
ERRORS = ("daemon_failed", "cell_held")
"""An error that held the cell and then ended the daemon is reported once."""

NO_ACTION = "no action is recorded"


def anomalies_of(run: CertificateRun) -> list[Anomaly]:
    """Return alarms, holds, faults, commands of the operator and interrupted passes, in time order."""
    outcome = wording.text(run.rows.job["outcome"]).replace("_", " ")
    found = [*event_anomalies(run.rows.events, f"the job ended: {outcome}" if outcome else ""), *_of_passes(run)]
    return sorted(found, key=lambda one: one.at)


def event_anomalies(events: Sequence[Row], end: str) -> Iterator[Anomaly]:
    """Yield the anomalies among the journal's events. ``end``: how the job ended, the action if there is no other."""
    last = ""
    for index, event in enumerate(events):
        name, data = event["name"], event["data"]
        if name in REPORTED:
            kind, what = data.get("kind") or name.replace("_", " "), data[REPORTED[name]]
        elif name in ERRORS:
            kind, what = data["kind"], data["error"]
        elif name == "state_changed" and data["state"] == "held" and data["reason"]:
            kind, what = "hold", data["reason"]
        elif name == "command_received" and data["order"] != "resume":
            kind, what = "command", f"{data['order']} was ordered" + (f": {data['reason']}" if data["reason"] else "")
        else:
            continue
        repeated = bool(last) and (what in last or last in what)  # an error, and the hold because of it
        last = what
        if repeated:
            continue
        yield Anomaly(
            at=at(event["at"]), kind=kind, what=str(what), done=_action(events[index + 1 :]) or end or NO_ACTION
        )


def _action(later: Sequence[Row]) -> str:
    """Return what happened next: commands, end and start of the daemon, up to the next map or the end of the pass."""
    steps = []
    for event in later:
        name, data, when = event["name"], event["data"], f"{at(event['at']):%Y-%m-%d %H:%M:%S}"
        if name == "command_received":
            reason = f" ({data['reason']})" if data["reason"] else ""
            steps.append(f"{data['order']} was ordered{reason}, {when}")
        elif name == "state_changed" and data["state"] == "finished":
            steps.append(f"the daemon ended, {when}")
        elif name == "state_changed" and data["state"] == "starting":
            steps.append(f"the daemon was started again, {when}")
        elif name == "map_measured":
            return "; ".join([*steps, f"the part was measured first: RMS {data['rms_nm']:.2f} nm"])
        elif name == "pass_ended":
            return "; ".join([*steps, f"the pass was continued to its end, {when}"])
        elif name in {"pass_started", "queue_job_ended"}:
            break
    return "; ".join(steps)


def _of_passes(run: CertificateRun) -> Iterator[Anomaly]:
    """Yield each interrupted pass with its executed share and the next map."""
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
            done="no map was taken after it: the surface is not known"
            if after is None
            else f"no block of it was repeated; the part was measured again: RMS {after['stats']['rms_nm']:.2f} nm",
        )


# Verdict and its uncertainty, from the judgement of the last map.


def verdict_of(run: CertificateRun) -> CertificateVerdict:
    """Return the verdict by the lines of the last map; "not known" if a pass touched the part after that map."""
    judged, outcome = line_results(run.rows.maps[-1]["stats"]), wording.text(run.folder.summary.get("outcome"))
    since = [done for done in run.rows.passes if done["cycle"] >= run.rows.maps[-1]["cycle"]]
    state: State = "not known" if since or not judged else "in tolerance" if part_holds(judged) else "not in tolerance"
    farthest = worst_line(judged)
    ended = VERDICTS[outcome].text if outcome in VERDICTS else outcome.replace("_", " ")
    if since:
        label = "Not known: the part was polished after its last map"
    elif not judged:
        label = "Not known: the job has no tolerance"
    elif state == "in tolerance":
        label = f"In tolerance: {len(judged)} of {len(judged)} lines hold"
    else:
        label = f"Not in tolerance: {sum(one.holds for one in judged)} of {len(judged)} lines hold"
    unsure = sum(one.unsure for one in judged)
    if unsure and state != "not known":
        label += f"; for {unsure} the limit lies within the uncertainty"
    return CertificateVerdict(
        state=state,
        words=label,
        decided_by="" if farthest is None else str(farthest),
        lines=[Judgement.model_validate(one.facts()) for one in judged],
        unsure_lines=unsure,
        outcome=ended if outcome else "unfinished",
        final=run.rows.job["ended"] is not None,
    )


def uncertainty_of(run: CertificateRun, profile: InstrumentProfile | None) -> Uncertainty:
    """Return the uncertainty of the figures that decide, in sentences."""
    accepted = wording.text(run.folder.summary.get("accept")) or "figure"
    judged = line_results(run.rows.maps[-1]["stats"])
    return Uncertainty.model_validate(
        {"accepted": accepted, "statements": [*_of_lines(judged), *_of_instrument(run, profile)]}
    )


def _of_lines(judged: tuple[LineResult, ...]) -> Iterator[str]:
    """Yield what the table of the lines does not show."""
    for one in judged:
        if one.bound is not None:
            yield f"{one.what}: {one.bound_words}; judged by this bound."
        elif one.unsure:
            sigma = f"{one.value:.3g} ± {one.uncertainty:.2g} {one.unit}"
            yield f"{one.what}: {sigma}. The limit lies within the uncertainty: either verdict is possible."
    plain = [one.what for one in judged if one.bound is None and one.uncertainty is None]
    if plain:
        yield f"LineResult as measured, with unknown uncertainty: {', '.join(plain)}."
    if any(one.bound is None and one.uncertainty is not None for one in judged):
        yield "± includes the repeatability of the instrument only, and is an upper limit."


def _of_instrument(run: CertificateRun, profile: InstrumentProfile | None) -> Iterator[str]:
    repeats = None if profile is None else profile.instrument.repeatability_nm
    if repeats is None:
        yield "The repeatability of the instrument is not in its profile."
    else:
        yield f"The repeatability of the instrument is {repeats:g} nm RMS."
    if run.rows.maps[-1]["stats"].get("system"):
        yield "The system error of the instrument was measured by an absolute test and is subtracted from each map."
    else:
        yield "The system error of the instrument has not been measured: it is included in all figures."


LIBRARIES = ("numpy", "scipy", "matplotlib", "cryptography")
REMOVED = {"piston": "piston", "tilt": "piston and tilt", "power": "piston, tilt and power"}
DERIVED = ("report.html", "pictures")
"""Made from the other files of the run folder."""
ISSUED = "certificate-"
"""Begin of the names of certificates that were made in the run folder; ``certificate.json`` is of a dwell."""


@dataclass(frozen=True, slots=True)
class CertificateRequest:
    """Facts from the command line."""

    operator: str = ""
    customer: str = ""
    drawing: str = ""
    number: str = ""
    shop: str = ""
    wavelength_nm: float = 546.07


@dataclass(frozen=True, slots=True)
class CertificateDraft:
    """Content of a certificate, and the maps of its pictures."""

    content: model.Content
    run: CertificateRun
    before: ReconstructedMap | None
    after: ReconstructedMap | None
    wavelength_nm: float


def certificate_content(
    run: CertificateRun, request: CertificateRequest, now: datetime | None = None
) -> CertificateDraft:
    """Return the content of a run's certificate; ConfigError if the run cannot be certified."""
    reconstructor = MapReconstructor(run, request.wavelength_nm)
    before, after = (_reconstruct(reconstructor, row) for row in (run.rows.maps[0], run.rows.maps[-1]))
    reach, missing = _reach(run, before, after)
    content = model.Content(
        schema_=model.SCHEMA,
        number=request.number or _number(run),
        issued=(now or datetime.now(UTC)).replace(microsecond=0),
        issuer=model.Issuer(shop=request.shop, operator=request.operator, program="polishd", version=__version__),
        part=_part(run, request),
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
        left_out=[_short(run, reason) for reason in (*reconstructor.left_out, *missing, *run.folder.missing)],
    )
    return CertificateDraft(content, run, before, after, request.wavelength_nm)


def _reconstruct(reconstructor: MapReconstructor, row: Row) -> ReconstructedMap | None:
    found = reconstructor.surface(row)
    return None if found is None else as_one_source(found, row["stats"])


def _number(run: CertificateRun) -> str:
    """Return a unique number from the job, the day of its end, and its journal."""
    job = run.rows.job
    day = at(job["ended"] or run.rows.maps[-1]["taken"])
    return f"{job['name']}-{day:%Y%m%d}-{run.rows.sha256[:8]}"


def _part(run: CertificateRun, request: CertificateRequest) -> model.PartFacts:
    terms, job = run.rows.terms, run.rows.job
    return model.PartFacts(
        id=job["part_id"],
        job=job["name"],
        customer=request.customer,
        drawing=request.drawing,
        outline=wording.text(run.folder.summary.get("outline")),
        edge_mm=terms["part.edge_mm"],
        form=_form(terms),
        alignment=terms["part.alignment"],
    )


def _form(terms: Row) -> str:
    """Return the nominal form as text."""
    radius = terms.get("part.curvature_radius_mm")
    if radius is None:
        form = "flat"
    else:
        form = f"{'concave' if radius > 0 else 'convex'}, vertex radius {abs(radius):g} mm"
        conic, even = terms.get("part.conic") or 0.0, terms.get("part.even") or []
        form += f", conic {conic:g}" if conic else ""
        form += f", even terms {', '.join(f'{term:g}' for term in even)}" if even else ""
    nominal = terms.get("part.form")
    return f"{form}; less the map {nominal['file']} (sha256 {nominal['sha256'][:12]}…)" if nominal else form


def _instrument(run: CertificateRun, after: ReconstructedMap | None) -> model.InstrumentFacts:
    profile = profile_of(run)
    record = None if profile is None else profile.instrument.commissioned
    return model.InstrumentFacts(
        profile="" if profile is None else profile.instrument.name,
        measured_by="" if after is None else after.source.instrument,
        commissioned=None if record is None else model.Commissioning(**asdict(record)),
        not_commissioned="the cell has no instrument profile" if profile is None else profile.unproved,
        repeatability_nm=None if profile is None else profile.instrument.repeatability_nm,
        system_map_sha256=run.rows.maps[-1]["stats"].get("system") or "",
    )


def _aperture(run: CertificateRun, after: ReconstructedMap | None) -> model.CertificateAperture:
    terms, last = run.rows.terms, run.rows.maps[-1]
    surface = run.surface(last["cycle"])
    inside = 0 if surface is None else int(np.count_nonzero(surface.metric_mask))
    solved = 0 if surface is None else int(np.count_nonzero(np.isfinite(surface.height_nm)))
    text = (
        f"All figures are those of the samples of the map in the clear aperture: the outline of the part less a rim of "
        f"{terms['part.edge_mm']:g} mm, as found in the first map, the same for all maps. "
        f"{REMOVED[terms['part.alignment']].capitalize()} removed by least squares over it."
    )
    return model.CertificateAperture(
        words=text,
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
    """Return the rows of Table V of the paper: PV, RMS and LSF from the journal, shorter bands from the maps."""
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
    """Return the RMS beyond the reach of the tool, of the same surfaces as all figures; or why it is not known."""
    cutoffs = [done["facts"]["certificate"].get("cutoff_period_mm") for done in run.rows.passes]
    known = [cutoff for cutoff in cutoffs if cutoff]
    if not known:
        why = "no pass was planned" if not cutoffs else "the plans do not have the cut-off period of the spot"
        return None, [f"RMS beyond the reach of the tool: {why}"]
    if before is None or after is None:
        return None, ["RMS beyond the reach of the tool: needs the first and the last map"]
    cutoff = min(known)
    if cutoff <= 2 * after.pitch_mm:
        return None, [f"RMS beyond the reach of the tool: the map cannot show periods below {cutoff:.3g} mm"]
    reach = model.CorrectableRange(
        cutoff_period_mm=cutoff, before_nm=before.beyond_nm(cutoff), after_nm=after.beyond_nm(cutoff)
    )
    return reach, ()


def _surface(found: ReconstructedMap) -> model.CertificateSurface:
    answer = found.reported.answer
    iso, indications, fitted, slope = (answer[key] for key in ("iso10110", "indications", "zernike", "slope"))
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
        else model.CertificateIso10110(
            **iso, indication=indications["iso10110_5"], wavefront_indication=indications["iso10110_14"]
        ),
        slope=None if slope is None else model.CertificateSlope(**_some(model.CertificateSlope, slope)),
        wavelength_nm=answer["wavelength_nm"],
    )


def _terms(fitted: Row) -> list[dict[str, Any]]:
    return [{key: term[key] for key in ("index", "n", "m", "nm")} for term in fitted["terms"]]


def _some(kind: type[model.Facts], facts: Row, **others: Any) -> dict[str, Any]:
    """Return the facts that a model has."""
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
        own = path.is_file() and not name.startswith(ISSUED)
        if own and not path.name.startswith(".") and name.partition("/")[0] not in DERIVED:
            yield model.File(name=name, bytes=path.stat().st_size, sha256=sha256_of(path))


def _journal(run: CertificateRun) -> model.JournalFacts:
    events = [
        model.CertificateEvent(at=at(row["at"]), cycle=row["cycle"], name=row["name"], data=_plain(row["data"]))
        for row in run.rows.events
        if row["name"] != "pass_progressed"
    ]
    return model.JournalFacts(sha256=run.rows.sha256, rows=dict(run.rows.counts), events=events)


def _short(run: CertificateRun, reason: str) -> str:
    """Return the reason without the path of the run folder, which is internal to the shop."""
    return reason.replace(f"{run.path}/", "")


def _plain(value: Any) -> Any:
    """Return a value for JSON and the customer: NaN is null, a path is its last name."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return list(map(_plain, value))
    if isinstance(value, str) and value.startswith("/"):
        return value.rstrip("/").rpartition("/")[2]
    return None if isinstance(value, float) and not math.isfinite(value) else value
