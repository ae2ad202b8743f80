"""Anomalies from the journal's events: each once, with the action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from polishd.model import events
from polishd.model.events import Event
from polishd.model.states import NOT_ASKED
from polishd.reports.certificate.content import event_anomalies

END = "the job ended: cycles used"
HELD = "pass 0 was interrupted: 3 of 40 blocks are recorded as executed"


def rows(*published: Event) -> list[Mapping[str, Any]]:
    """Return the events as rows of the journal, ten seconds apart."""
    return [
        {"at": 1_760_000_000.0 + 10 * k, "cycle": event.cycle, "name": event.name, "data": dict(event.data)}
        for k, event in enumerate(published)
    ]


def state(name: str, reason: str = "") -> Event:
    return events.StateChanged(state=name, reason=reason, standing=NOT_ASKED)


def anomalies(*published: Event) -> list[tuple[str, str, str]]:
    return [(one.kind, one.what, one.done) for one in event_anomalies(rows(*published), END)]


def test_a_quiet_job_has_none() -> None:
    assert anomalies(state("starting"), state("polishing"), state("finished", "in_tolerance")) == []


def test_an_error_that_held_and_then_ended_the_daemon_is_one() -> None:
    lost = {"error": "robot: the link is silent", "kind": "LinkError"}
    found = anomalies(
        events.CellHeld(**lost), state("held", "LinkError: robot: the link is silent"), events.DaemonFailed(**lost)
    )
    assert found == [("LinkError", "robot: the link is silent", END)]


def test_a_hold_that_a_person_ordered() -> None:
    found = anomalies(
        events.CommandReceived(order="hold", reason="lunch"), state("held", "held by command: lunch"),
        events.CommandReceived(order="resume", reason=""), state("polishing"),
    )  # fmt: skip
    order, hold = found
    assert order[:2] == ("command", "hold was ordered: lunch")
    assert hold[:2] == ("hold", "held by command: lunch")
    assert hold[2] == "resume was ordered, 2025-10-09 08:53:40"


def test_a_restart_after_an_interruption() -> None:
    (found,) = anomalies(state("held", HELD), state("finished", "stopped"), state("starting"))
    assert found[2] == "the daemon ended, 2025-10-09 08:53:30; the daemon was started again, 2025-10-09 08:53:40"


@pytest.mark.parametrize(
    ("event", "kind", "what"),
    [
        (events.FindingReported(kind="wear", what="the pad wore", stops="cell"), "wear", "the pad wore"),
        (
            events.SignalOutOfRange(signal="flow", what="flow is low", action="notify"),
            "signal out of range",
            "flow is low",
        ),
        (events.RemovalCheckFailed(stop="turned by 90", cycle_dir="c"), "removal check failed", "turned by 90"),
        (events.CommandReceived(order="estop", reason=""), "command", "estop was ordered"),
    ],
)
def test_each_kind_has_its_description(event: Event, kind: str, what: str) -> None:
    (found,) = anomalies(event, events.PassEnded(cycle=0, executed_s=3.0))
    assert found == (kind, what, "the pass was continued to its end, 2025-10-09 08:53:30")


def test_an_anomaly_without_an_action() -> None:
    (found,) = event_anomalies(rows(events.FindingReported(kind="wear", what="the pad wore", stops="cell")), "")
    assert found.done == "no action is recorded"
