"""What each pass was planned to do, what it did, and what the map after it told: from the journal's rows."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from polishd.console.certificate.model import CertificatePass, PassEstimate, PassExecution, PassPlan
from polishd.console.certificate.sources import CertificateRun, Row
from polishd.show import words


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
                name=f"pass {number}" if whole else f"a pass that was {words.share(entry) or 'never ended'}",
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
