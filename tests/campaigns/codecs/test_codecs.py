"""Of malformed, doubled and late replies none is taken for a value, and nothing is left behind, driver by driver.

The driver's whole link runs, with its queue, time limits and reopening: on a virtual clock, and on real wires.
"""

from __future__ import annotations

import gc
from collections import Counter
from pathlib import Path

import pytest

from tests.campaigns.codecs import lines, modbus, robots
from tests.campaigns.codecs.nasty import Nasty, Talk, ask_for_ever, require_a_talk
from tests.campaigns.codecs.virtual import virtual

TALKS: list[type[Talk]] = [
    lines.ForceSensor, lines.Monitor, lines.Loader, lines.VoiceCoil, lines.ForceGauge, lines.OwnLines, lines.LinuxCnc,
    modbus.ProfiledRtu, modbus.ProfiledTcp, modbus.Controller,
    robots.RobotLink, robots.Rtde, robots.Dashboard,
]  # fmt: skip


def campaign(monkeypatch: pytest.MonkeyPatch, make: type[Talk], bad: int) -> tuple[Nasty, Counter[str]]:
    """So many malformed or late replies on the virtual clock."""
    with virtual(monkeypatch) as loop:
        nasty = Nasty(make(), 15)
        loop.peer = nasty
        outcomes = loop.run_until_complete(ask_for_ever(nasty.talk, nasty, bad))
    return nasty, outcomes


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
