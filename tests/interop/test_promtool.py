"""promtool, of Prometheus itself: our metrics keep its conventions of names, units, HELP and TYPE."""

from __future__ import annotations

import subprocess

from prometheus_client.core import CollectorRegistry
from prometheus_client.exposition import generate_latest

from polishd.web.metrics import MetricsSnapshot
from tests.interop.peers import Peer
from tests.unit.web.test_metrics import ALL, TALLY

PEER = Peer("promtool", "the page", "judge of metrics", "Debian", "prometheus")
pytestmark = PEER.needed


def test_it_finds_nothing_wrong_with_our_metrics() -> None:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(
        MetricsSnapshot("cell", {"daemon": "up", "age_s": 0.1, "live": ALL}, TALLY, [{"severity": "alarm"}])
    )
    said = subprocess.run(
        ["promtool", "check", "metrics"], input=generate_latest(registry), capture_output=True, check=False
    )
    assert (said.returncode, said.stdout, said.stderr) == (0, b"", b"")
