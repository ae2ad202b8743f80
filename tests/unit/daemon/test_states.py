"""The table of states, and its copy in docs/cycle.md."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest

from polishd.daemon.states import DOES, ORDERS, TRANSITIONS, State, Trigger, following, obeyed
from polishd.daemon.verbs import VERBS

DOCS = Path(__file__).resolve().parents[3] / "docs" / "cycle.md"


def cause(trigger: Trigger) -> str:
    """Orders are verbs, and look like it."""
    return f"`{trigger}`" if trigger in ORDERS else trigger.value


def test_the_docs_have_every_state_and_every_way() -> None:
    states = ["| state | what happens in it |", "|---|---|", *(f"| `{state}` | {DOES[state]} |" for state in State)]
    ways = ["| in | when | next | with `--no-hold` | |", "|---|---|---|---|---|"]
    for row in TRANSITIONS:
        alone = f"`{row.unattended}`" if row.unattended else ""
        ways.append(f"| `{row.source}` | {cause(row.trigger)} | `{row.target}` | {alone} | {row.note} |")
    for table in (states, ways):
        assert "\n".join(table) in DOCS.read_text(), "\n".join(table)


def test_no_way_stands_in_it_twice_and_none_leads_out_of_the_end() -> None:
    ways = [(row.source, row.trigger) for row in TRANSITIONS]
    assert len(set(ways)) == len(ways)
    assert all(row.source is not State.FINISHED for row in TRANSITIONS)


def test_every_state_is_come_to_and_can_be_ended() -> None:
    assert {row.target for row in TRANSITIONS} | {State.STARTING} == set(State)
    for state in set(State) - {State.FINISHED}:
        assert following(state, Trigger.STOP) is State.FINISHED
        assert following(state, Trigger.ERROR) is State.FINISHED


def test_what_is_not_in_the_table_raises() -> None:
    known = {(row.source, row.trigger) for row in TRANSITIONS}
    for state, trigger in set(product(State, Trigger)) - known:
        with pytest.raises(RuntimeError, match="a fault of polishd"):
            following(state, trigger)


def test_without_a_person_nothing_is_held_but_by_order() -> None:
    held = {row.trigger for row in TRANSITIONS if following(row.source, row.trigger, unattended=True) is State.HELD}
    assert held == {Trigger.HOLD, Trigger.ESTOP}


def test_an_order_is_obeyed_where_it_leads() -> None:
    assert set(ORDERS) == {verb.name for verb in VERBS.values() if verb.changes == "an order"}
    assert {order: obeyed(order) for order in ORDERS} == {
        Trigger.HOLD: {State.HELD, State.FINISHED},
        Trigger.RESUME: {State.IDLE, State.POLISHING, State.FINISHED},
        Trigger.STOP: {State.FINISHED},
        Trigger.ESTOP: {State.HELD, State.FINISHED},
    }
