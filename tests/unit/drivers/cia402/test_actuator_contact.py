"""Contact detection by position."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from polishd.drivers.cia402.actuator import WINDOW_S, ContactDetector


def contacts(positions: Iterable[tuple[float, float]]) -> list[bool]:
    contact = ContactDetector(rest_mm=0.1, end_mm=9.9, travel_mm_s=1.0)
    return [contact.feed(at_s, position_mm) for at_s, position_mm in positions]


def way(
    *, speed_mm_s: float, touch_mm: float, until_s: float = 4.0, every_s: float = 0.05
) -> list[tuple[float, float]]:
    at_s = np.arange(0.0, until_s, every_s)
    return [(float(t), min(speed_mm_s * float(t), touch_mm)) for t in at_s]


def test_it_touches_once_it_no_longer_travels() -> None:
    positions = way(speed_mm_s=2.5, touch_mm=5.0)
    answers = contacts(positions)
    first = positions[answers.index(True)][0]
    assert 2.0 < first < 2.0 + 2 * WINDOW_S
    assert all(answers[answers.index(True) :])


def test_at_its_rest_and_at_its_end_it_touches_nothing() -> None:
    assert not any(contacts(way(speed_mm_s=0.0, touch_mm=5.0)))
    assert not any(contacts(way(speed_mm_s=5.0, touch_mm=10.0)))


def test_it_follows_the_part_and_tells_where_the_part_ends() -> None:
    hill = [(t, 5.0 + 0.5 * float(np.sin(1.5 * t))) for t in np.arange(0.0, 6.0, 0.05)]  # 0.75 mm/s at most
    assert all(contacts(hill)[2:])
    edge = [*hill, *((6.0 + t, hill[-1][1] + 20.0 * t) for t in np.arange(0.0, 0.2, 0.05))]
    assert not contacts(edge)[-1]


def test_a_pause_between_readings_is_no_contact_by_itself() -> None:
    assert contacts([(0.0, 0.0), (0.05, 0.125), (1.0, 2.5)]) == [False, False, False]


def test_what_was_before_a_lift_is_forgotten() -> None:
    contact = ContactDetector(rest_mm=0.1, end_mm=9.9, travel_mm_s=1.0)
    assert [contact.feed(t, 5.0) for t in (0.0, 0.1)] == [False, True]
    contact.reset()
    assert not contact.feed(0.2, 5.0)


def test_a_tool_that_lands_slower_than_was_told_of_its_travel_has_not_landed_in_the_air() -> None:
    """``travel_mm_s`` above the speed of landing is a slip of the config: the full force would slam it down."""
    contact = ContactDetector(rest_mm=0.1, end_mm=9.9, travel_mm_s=20.0)
    positions = way(speed_mm_s=5.0, touch_mm=5.0)
    landed = []
    for at_s, position_mm in positions:
        contact.feed(at_s, position_mm)
        landed.append(contact.landed)
    assert 1.0 < positions[landed.index(True)][0] < 1.0 + 2 * WINDOW_S
