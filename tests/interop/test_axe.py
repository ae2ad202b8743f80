"""axe-core: no fault on any view, in any state that the page has, at three sizes, dark and light."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.interop.peers import NODE_MODULES, Peer
from tests.screenshots.frozen_cell import frozen_server
from tests.screenshots.scenes import DASHBOARD, SCENES, asked
from tests.system.browser import Page, browsing, each_browser

PEER = Peer("axe-core", "the page", "judge of accessibility", "npm", "axe-core")
pytestmark = PEER.needed

SIZES = ((1440, 900), (820, 1180), (390, 844))
VIEWS = {
    "polishing": ("dashboard", "maps", "cell", "queue", "history", "host"),
    "held": ("dashboard", "host"),
    "killed": ("dashboard",),
    "approve": ("dashboard", "approve"),
    "measuring": ("dashboard",),
}

DRAWN = "document.querySelector('#view [data-ready]') !== null"
READY = {"dashboard": DASHBOARD, "maps": DRAWN, "cell": DRAWN}


def faults_of(page: Page) -> list[str]:
    """Everything that axe calls a violation."""
    answer = page.run("axe.run(document, { resultTypes: ['violations'] })")
    assert answer["passes"], "axe has looked at nothing"
    return [
        f"{one['id']} ({one['impact']}): {[node['html'][:110] for node in one['nodes']][:4]}"
        for one in answer["violations"]
    ]


@pytest.fixture(scope="module")
def axe() -> str:
    return (NODE_MODULES / "axe-core" / "axe.min.js").read_text()


@each_browser
@pytest.mark.parametrize("scene", VIEWS)
def test_no_view_has_a_fault(tmp_path: Path, axe: str, scene: str, browser: str) -> None:
    found: dict[str, list[str]] = {}
    with frozen_server(tmp_path, SCENES[scene]) as server, browsing(tmp_path / "b", browser=browser) as page:
        page.go(server.url)
        page.until("!document.getElementById('sign-in').hidden")
        page.run(axe)
        found["signing in"] = faults_of(page)
        server.sign_in(page)
        for view in VIEWS[scene]:
            for width, height in SIZES:
                for scheme in ("light", "dark"):
                    page.aim(width, height, scheme)
                    server.show(page, view)
                    page.until(READY.get(view, "document.querySelectorAll('#view *').length > 10"))
                    page.run(axe)
                    found[f"{view} {width}x{height} {scheme}"] = faults_of(page)
        if scene == "held":
            server.show(page, "dashboard")
            page.until(DASHBOARD)
            asked(page)
            page.run(axe)
            found["asked"] = faults_of(page)
        assert page.problems == []
    assert not any(found.values()), {where: faults for where, faults in found.items() if faults}
