"""Each peer of tests/interop has its place on the page that `make interop` writes."""

from __future__ import annotations

import re
from pathlib import Path

from tests.interop.page import LINKS

PEER = re.compile(r'Peer\("[^"]+", "([^"]+)"')


def test_the_page_knows_the_link_of_each_peer() -> None:
    found = {
        link
        for path in (Path(__file__).parents[1] / "interop").glob("test_*.py")
        for link in PEER.findall(path.read_text())
    }
    assert len(found) > 10
    assert found <= set(LINKS)
