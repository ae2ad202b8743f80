"""The table of states: each row leads where it says."""

from __future__ import annotations

from itertools import product

import pytest

from polishd.daemon.socket.client import VERBS
from polishd.daemon.state_machine import ORDERS, TRANSITIONS, StateEvent, StateTransition, following, obeyed
from polishd.model.states import DaemonState


def test_others_know_the_states_by_these_names() -> None:
    names = {"starting", "idle", "changing", "polishing", "held", "finished"}
    assert {state.value for state in DaemonState} == names


def test_no_way_stands_in_it_twice_and_none_leads_out_of_the_end() -> None:
    ways = [(row.source, row.trigger) for row in TRANSITIONS]
    assert len(set(ways)) == len(ways)
    assert all(row.source is not DaemonState.FINISHED for row in TRANSITIONS)


def test_every_state_is_come_to_and_can_be_ended() -> None:
    assert {row.target for row in TRANSITIONS} | {DaemonState.STARTING} == set(DaemonState)
    for state in set(DaemonState) - {DaemonState.FINISHED}:
        assert following(state, StateEvent.STOP) is DaemonState.FINISHED
        assert following(state, StateEvent.ERROR) is DaemonState.FINISHED


def test_what_is_not_in_the_table_raises() -> None:
    known = {(row.source, row.trigger) for row in TRANSITIONS}
    for state, trigger in set(product(DaemonState, StateEvent)) - known:
        with pytest.raises(RuntimeError, match="a fault of polishd"):
            following(state, trigger)


def test_without_a_person_nothing_is_held_but_by_order() -> None:
    held = {
        row.trigger for row in TRANSITIONS if following(row.source, row.trigger, unattended=True) is DaemonState.HELD
    }
    assert held == {StateEvent.HOLD, StateEvent.ESTOP}


def test_an_order_is_obeyed_where_it_leads() -> None:
    assert set(ORDERS) == {verb.name for verb in VERBS.values() if verb.changes == "an order"}
    assert {order: obeyed(order) for order in ORDERS} == {
        StateEvent.HOLD: {DaemonState.HELD, DaemonState.FINISHED},
        StateEvent.RESUME: {DaemonState.IDLE, DaemonState.POLISHING, DaemonState.FINISHED},
        StateEvent.STOP: {DaemonState.FINISHED},
        StateEvent.ESTOP: {DaemonState.HELD, DaemonState.FINISHED},
    }


@pytest.mark.parametrize("row", TRANSITIONS)
def test_each_way_leads_where_it_says(row: StateTransition) -> None:
    assert following(row.source, row.trigger) is row.target, "attended is the default"
    assert following(row.source, row.trigger, unattended=True) is (row.unattended or row.target)
