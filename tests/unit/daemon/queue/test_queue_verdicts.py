"""Result of each end of a job, for its part and for the queue."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import get_args

import pytest

from polishd.daemon.queue.queue import RULES, How, JobResult, QueueEffect, judge, rule_of
from polishd.model.errors import (
    DeviceFault,
    HandlingError,
    LinkError,
    MapError,
    PlanRefused,
    PolishdError,
    RemovalCheckStop,
    SafetyStop,
    ToolStop,
    WrongPart,
)
from polishd.model.states import Outcome

ACCEPTED = JobResult("accepted", "the part is in tolerance", "")


def test_each_row_has_a_result_and_an_effect_that_exist() -> None:
    for rule in RULES:
        assert rule.how is None or rule.how in get_args(How)
        assert rule.queue in get_args(QueueEffect)
        assert (rule.queue == "waits") is (rule.how is None), "a job that is not over waits"


@pytest.mark.parametrize(
    ("end", "how", "effect"),
    [
        (Outcome.AS_PROGRAMMED, "accepted", "goes on"),
        (Outcome.STALLED, "set aside", "goes on"),
        (ToolStop("x"), "set aside", "stops"),
        (HandlingError("x"), None, "waits"),
        (LinkError("x"), None, "waits"),
    ],
)
def test_a_rare_end_has_its_row(end: Outcome | PolishdError, how: str | None, effect: str) -> None:
    rule = rule_of(end)
    assert (rule.how, rule.queue) == (how, effect)


@pytest.mark.parametrize(
    ("end", "torn", "how", "stops"),
    [
        (Outcome.IN_TOLERANCE, False, "accepted", ""),
        (Outcome.CYCLES_USED, False, "rejected", ""),
        (Outcome.DIVERGED, False, "rejected", ""),
        (MapError("x"), False, "set aside", ""),
        (WrongPart("x"), False, "set aside", ""),
        (PlanRefused("x"), False, "set aside", ""),
        (RemovalCheckStop("x"), False, "set aside", "instrument or alignment is wrong"),
        (SafetyStop("x"), True, "set aside", ""),
        (LinkError("x"), True, "set aside", ""),
        (SafetyStop("x"), False, "set aside", "an operator has to decide"),
    ],
)
def test_each_ending_has_its_verdict(end: Outcome | PolishdError, torn: bool, how: str, stops: str) -> None:
    found = judge(end, torn=torn, previous="")
    assert found is not None
    assert (found.how, bool(found.fault)) == (how, how != "accepted")
    assert stops in found.stops
    assert bool(found.stops) == bool(stops)
    if isinstance(end, PolishdError):
        assert found.reason == f"{type(end).__name__}: x"


@pytest.mark.parametrize("end", [LinkError("x"), DeviceFault("x")])
def test_a_job_is_not_over_where_a_device_is_at_fault_between_passes(end: PolishdError) -> None:
    assert judge(end, torn=False, previous="") is None


def test_the_same_fault_twice_in_a_row_stops_the_queue() -> None:
    for end, previous in itertools.product(
        (MapError("x"), Outcome.CYCLES_USED), ("MapError", "cycles_used", "", "WrongPart")
    ):
        found = judge(end, torn=False, previous=previous)
        assert found is not None
        assert bool(found.stops) == (previous == found.fault), (end, previous)
    assert judge(Outcome.IN_TOLERANCE, torn=False, previous="") == ACCEPTED


def test_every_error_and_outcome_has_a_row() -> None:
    def kinds(kind: type[PolishdError]) -> Iterator[type[PolishdError]]:
        yield kind
        for inner in kind.__subclasses__():
            yield from kinds(inner)

    for end in [*(kind("x") for kind in kinds(PolishdError) if kind.__module__ == PolishdError.__module__)]:
        assert rule_of(end) in RULES
    for outcome in set(Outcome) - {Outcome.STOPPED}:
        assert rule_of(outcome) in RULES
