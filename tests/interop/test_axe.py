"""axe-core: no serious fault on any page, in any state that it has, dark and light."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.cell import load_config
from polishd.web.http.users import Role, UserFile, users_path
from tests.interop.peers import NODE_MODULES, Peer
from tests.system.browser import Page, browsing
from tests.system.cell_rig import Daemon, small_cell, with_keys
from tests.system.test_web import FREE, FRESH, STATE, signed_in, web_of

PEER = Peer("axe-core", "the page", "judge of accessibility", "npm", "axe-core")
pytestmark = PEER.needed

GRAVE = ("serious", "critical")


def faults_of(page: Page) -> list[str]:
    """Those that axe calls serious or critical, in either scheme of colours."""
    found = []
    for scheme in ("light", "dark"):
        page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        answer = page.run("axe.run(document, { resultTypes: ['violations'] })")
        assert answer["passes"], "axe has looked at nothing"
        for one in answer["violations"]:
            if one["impact"] in GRAVE:
                nodes = [f"{node['html'][:90]} ({node['failureSummary'][:160]})" for node in one["nodes"]]
                found.append(f"{scheme}: {one['id']}: {nodes[:6]}")
    return found


@pytest.fixture(scope="module")
def axe() -> str:
    return (NODE_MODULES / "axe-core" / "axe.min.js").read_text()


def test_no_state_of_the_page_has_a_serious_fault(tmp_path: Path, axe: str) -> None:
    found: dict[str, list[str]] = {}
    with small_cell(tmp_path / "cell", speed=5.0, tolerance_nm=0.1, max_cycles=4) as files:
        files.cell.write_text(with_keys(files.cell.read_text(), FREE))
        token = UserFile(users_path(load_config(files.cell))).add("anna", Role.OPERATE)
        with web_of(files) as url, browsing(tmp_path / "browser") as page:
            page.go(url)
            page.until("!document.getElementById('sign-in').hidden")
            page.run(axe)
            found["signing in"] = faults_of(page)
            signed_in(page, url, token)
            page.until("document.getElementById('lost').textContent.includes('NO DAEMON')")
            page.run(axe)
            found["no daemon"] = faults_of(page)
            with Daemon(files):
                page.until(FRESH)
                page.until("document.querySelectorAll('#passes tr').length > 0")
                found["polishing"] = faults_of(page)
                page.press("hold")
                page.until(STATE.format("held"))
                found["held"] = faults_of(page)
            page.until("!document.getElementById('lost').hidden")
            found["killed"] = faults_of(page)
    assert not any(found.values()), found
