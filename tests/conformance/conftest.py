"""What of the suites ``make test`` leaves out; and time limits that hold for all of our devices."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from tests.conformance.rigs.actuators import PATIENT

PROMPT_S = 2.5
"""Longest time to detect a dead link: less than a second, with a margin for a busy computer."""
BOUND_S = 8 * PATIENT.silence_s
"""Longest call to a dead device: four answers, each of which may arrive late by as much again."""

FULL = {"test_samples_feed_the_watchdog", "test_samples_keep_it_running"}
SLOW_RIG, ITS_OWN = "[universal_robots]", {"test_all_is_executed_in_order_and_once", "test_hold_returns_when_it_stands"}
"""A controller that takes seconds to boot and to load: of the robots' tests these alone."""
ONE_OF_EACH = {
    "test_make_safe_on_a_cut_link_fails_in_bounded_time": (),
    "test_a_silent_link_is_known_at_once": (),
    "test_make_safe_on_a_silent_link_fails_in_bounded_time": (),
    "test_opening_a_silent_link_fails_in_bounded_time": (),
    "test_without_samples_it_retracts": (),
    "test_impossible_forces_are_refused": ("force_n",),
}
"""Tests of the suites that wait, by name: tests/selection.py."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Before tests/conftest.py looks at the marks."""
    for item in items:
        name = getattr(item, "originalname", item.name)
        if not str(getattr(getattr(item, "function", None), "__module__", "")).startswith("polishd.testing"):
            continue
        slow = item.name.endswith(SLOW_RIG) and item.path.name == "test_robot.py" and name not in ITS_OWN
        if name in FULL or slow:
            item.add_marker(pytest.mark.full)
        elif name in ONE_OF_EACH:
            item.add_marker(pytest.mark.one_of_each(*ONE_OF_EACH[name]))


async def seen(condition: Callable[[], bool]) -> None:
    """Look at the machine itself until it is so: pytest's timeout is the limit."""
    while not condition():  # noqa: ASYNC110 -- the machine sends no event
        await asyncio.sleep(0.01)
