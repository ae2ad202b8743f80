"""The drivers of the campaign of malformed and late replies, and a run with one of them."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.campaigns.codecs import hses, lines, modbus, robots, rws
from tests.campaigns.codecs.faulty_peer import FaultyPeer, Talk, ask_until
from tests.campaigns.codecs.virtual_clock import virtual

TALKS: list[type[Talk]] = [
    lines.ForceSensor, lines.Monitor, lines.Loader, lines.VoiceCoil, lines.ForceGauge, lines.OwnLines, lines.LinuxCnc,
    modbus.ProfiledRtu, modbus.ProfiledTcp, modbus.Controller, hses.Controller, robots.RobotLink, robots.Rtde,
    robots.Dashboard, rws.RobotWebServices, robots.FanucRmi, robots.KukaProxy,
]  # fmt: skip


def campaign(
    monkeypatch: pytest.MonkeyPatch, make: type[Talk], bad: int, seed: int = 15
) -> tuple[FaultyPeer, Counter[str]]:
    """Send so many malformed or late replies on the virtual clock."""
    with virtual(monkeypatch) as loop:
        peer = FaultyPeer(make(), seed)
        loop.peer = peer
        peer.talk.wired(monkeypatch, peer)
        outcomes = loop.run_until_complete(ask_until(peer.talk, peer, bad))
    return peer, outcomes
