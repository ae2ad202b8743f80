"""Every way out of contact against lifts that take 0.5, 4 and 10 s; table in docs/reference/results.md."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.campaigns.ways_out import FORGOTTEN, LIFTS_S, PAGE, SAVED, WAYS, Cost, Way, measure, rows_of, save

CASES = [(way, lift_s) for way in WAYS for lift_s in LIFTS_S]
SLACK_S = 0.05
"""Permitted contact at standstill, which does not include the corner of a block."""


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(400)
@pytest.mark.parametrize(("way", "lift_s"), CASES, ids=lambda one: getattr(one, "name", str(one)).replace(" ", "-"))
def test_the_tool_is_off_before_motion_stops(tmp_path: Path, way: Way, lift_s: float) -> None:
    cost = measure(way, lift_s, tmp_path / "cell")
    save(cost, SAVED)
    assert cost.standing_s <= way.stands_s + SLACK_S
    if way.stands_s:
        assert cost.standing_nm < 250.0, "the spindle stops and the force goes at once"
    else:
        require_tool_off_first(cost)
    require_all_recorded(cost, moved=not way.stands_s)


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(400)
def test_a_robot_that_has_forgotten_leaves_no_more_than_a_bound(tmp_path: Path) -> None:
    cost = measure(FORGOTTEN, 4.0, tmp_path / "cell")
    require_all_recorded(cost, moved=True)
    assert cost.uncertain < cost.left / 2


def require_all_recorded(cost: Cost, *, moved: bool) -> None:
    """Require that plant and journal agree for each block. A robot that stopped at once may have run no further one."""
    assert cost.disagreements == []
    assert cost.as_before or not moved, "what ran while contact was left: a journal without it would not have agreed"
    assert 0 < cost.uncertain < cost.left, "marked is what the tool can have reached, not the rest of the program"


def require_tool_off_first(cost: Cost) -> None:
    """Require from the simulators' log and the plant that actuator or robot took the tool off."""
    stops = cost.at("motion stops")
    assert stops is not None
    assert cost.touched_s <= stops + SLACK_S
    confirmed = cost.at("lift confirmed")
    assert confirmed is None or confirmed >= cost.lift_s * 0.9


def test_the_page_tells_what_each_way_costs() -> None:
    """The table that the campaign wrote has each case, and all of its figures pass the tests."""
    allowed = {way.name: way.stands_s + SLACK_S for way in WAYS}
    rows = rows_of(PAGE.read_text())
    assert [(row[0], float(row[1])) for row in rows] == [(way.name, lift_s) for way, lift_s in CASES]
    assert all(float(row[3]) <= allowed[row[0]] for row in rows)
