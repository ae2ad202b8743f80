"""Each row of the table of states leads where it says, with a person there and without."""

from __future__ import annotations

import pytest

from polishd.model.states import TRANSITIONS, StateTransition, next_state


@pytest.mark.parametrize("row", TRANSITIONS)
def test_each_way_leads_where_it_says(row: StateTransition) -> None:
    assert next_state(row.source, row.trigger) is row.target, "the default is an attended cell"
    assert next_state(row.source, row.trigger, unattended=True) is (row.unattended or row.target)
