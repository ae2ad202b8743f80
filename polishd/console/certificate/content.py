"""From a run to what its certificate says. Nothing is drawn here, and nothing is written."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from polishd import __version__
from polishd.console.certificate import model
from polishd.console.certificate.anomalies import anomalies_of
from polishd.console.certificate.passes import at, passes_of
from polishd.console.certificate.sources import CertificateRun, Row, sha256_of
from polishd.console.certificate.surfaces import MapReconstructor, ReconstructedMap, as_one_source, profile_of
from polishd.console.certificate.verdict import uncertainty_of, verdict_of
from polishd.show import words

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
        outline=words.text(run.folder.summary.get("outline")),
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
            name=words.measurement(rows, index),
            taken=at(row["taken"]),
            map_sha256=row["sha256"],
            **{key: stats[key] for key in ("rms_nm", "pv_nm", "lsf_rms_nm", "samples", "spikes")},
            lsf_period_mm=run.rows.terms["job.lsf_period_mm"],
            band_rms_nm=stats.get("band_rms_nm"),
            lines=[model.Judgement.model_validate(line) for line in stats.get("judged") or ()],
            registration=model.CertificateRegistration(
                **{key: lies[key] for key in ("by", "shift_mm", "rotation_deg")}
            ),
            notes=[words.text(note) for note in stats.get("notes") or ()],
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
        "polished by polishd": words.text(run.folder.summary.get("version")) or "not recorded",
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
