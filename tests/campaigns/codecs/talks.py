"""What the campaign of malformed and late replies talks to, and one talk of it."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.campaigns.codecs import lines, modbus, robots, rws
from tests.campaigns.codecs.nasty import Nasty, Talk, ask_for_ever
from tests.campaigns.codecs.virtual import virtual

TALKS: list[type[Talk]] = [
    lines.ForceSensor, lines.Monitor, lines.Loader, lines.VoiceCoil, lines.ForceGauge, lines.OwnLines, lines.LinuxCnc,
    modbus.ProfiledRtu, modbus.ProfiledTcp, modbus.Controller, robots.RobotLink, robots.Rtde, robots.Dashboard,
    rws.RobotWebServices, robots.FanucRmi, robots.KukaProxy,
]  # fmt: skip


def campaign(monkeypatch: pytest.MonkeyPatch, make: type[Talk], bad: int, seed: int = 15) -> tuple[Nasty, Counter[str]]:
    """So many malformed or late replies on the virtual clock."""
    with virtual(monkeypatch) as loop:
        nasty = Nasty(make(), seed)
        loop.peer = nasty
        nasty.talk.wired(monkeypatch, nasty)
        outcomes = loop.run_until_complete(ask_for_ever(nasty.talk, nasty, bad))
    return nasty, outcomes
