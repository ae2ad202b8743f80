"""Each row of the table of states leads where it says, with a person there and without."""

from __future__ import annotations

import pytest

from polishd.daemon.state_machine import TRANSITIONS, StateTransition, following


@pytest.mark.parametrize("row", TRANSITIONS)
def test_each_way_leads_where_it_says(row: StateTransition) -> None:
    assert following(row.source, row.trigger) is row.target, "attended is the default"
    assert following(row.source, row.trigger, unattended=True) is (row.unattended or row.target)
