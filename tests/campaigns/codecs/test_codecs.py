"""Of malformed, doubled and late replies none is taken for a value, and nothing is left behind, driver by driver.

The driver's whole link runs, with its queue, time limits and reopening: on a virtual clock, and on real wires.
"""

from __future__ import annotations

import gc
from pathlib import Path

import pytest

from tests.campaigns.codecs.nasty import Talk, require_a_talk
from tests.campaigns.codecs.talks import TALKS, campaign


@pytest.mark.parametrize("make", TALKS, ids=lambda one: one.name)
def test_no_reply_is_taken_for_a_value_that_is_none(monkeypatch: pytest.MonkeyPatch, make: type[Talk]) -> None:
    require_a_talk(*campaign(monkeypatch, make, 2_000))


def left_behind() -> tuple[int, int]:
    """(objects alive, open descriptors)."""
    gc.collect()
    return len(gc.get_objects()), len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("make", TALKS, ids=lambda one: one.name)
def test_of_a_million_replies_none_is_taken(monkeypatch: pytest.MonkeyPatch, make: type[Talk]) -> None:
    campaign(monkeypatch, make, 10_000)
    objects, descriptors = left_behind()
    require_a_talk(*campaign(monkeypatch, make, 1_000_000))
    after = left_behind()
    assert after[0] - objects < 1_000
    assert after[1] == descriptors
