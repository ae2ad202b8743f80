"""What somebody had to see to, and what was done about it: from the journal's events and passes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from polishd.console.certificate.model import Anomaly
from polishd.console.certificate.passes import at
from polishd.console.certificate.sources import CertificateRun, Row
from polishd.show import words

TOLD = {"gate_stopped": "stop", "signal_wrong": "what", "found": "what"}
"""Events that are told as they are, and the field that says what it was."""
AGAIN = ("failed", "held")
"""Errors: one that held the cell and then ended its daemon is told once."""


NOTHING = "nothing is recorded"


def anomalies_of(run: CertificateRun) -> list[Anomaly]:
    """In time order: alarms, holds, faults, orders of a person, interrupted passes; nothing for a job without any."""
    outcome = words.text(run.rows.job["outcome"]).replace("_", " ")
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
        share = words.share(rows[cycle]) if cycle < len(rows) else ""
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
