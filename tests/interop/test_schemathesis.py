"""Schemathesis: the page's HTTP API is as its OpenAPI document says it is, whatever is asked of it."""

from __future__ import annotations

import subprocess
from pathlib import Path

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.web.http.users import Role, UserFile, users_path
from tests.interop.peers import BUILT, Peer
from tests.system.cell_rig import with_keys
from tests.system.test_web import FREE, web_of
from tests.unit.web.page_server import answering

PEER = Peer("Schemathesis", "HTTP", "client", "PyPI", "schemathesis")
pytestmark = PEER.needed

PROGRAM = BUILT / "venv" / "bin" / "schemathesis"
NOT_ASKED = ("/api/events", "/api/session")
"""Excluded paths: a stream that never ends, and the login, which locks out clients that guess tokens."""
OPTIONS = (
    "--phases=examples,coverage,fuzzing", "--max-examples=60", "--mode=all", "--generation-deterministic", "--no-color",
    "--rate-limit=45/s",
)  # fmt: skip


def test_nothing_that_it_asks_is_a_fault_and_all_answers_are_as_documented(tmp_path: Path) -> None:
    files = write_demo(tmp_path / "demo", None, 2.0, 4, None)
    files.cell.write_text(with_keys(files.cell.read_text(), FREE))
    config = load_config(files.cell)
    token = UserFile(users_path(config)).add("anna", Role.ENGINEER)
    left_out = [f"--exclude-path={path}" for path in NOT_ASKED]
    with answering(config.state_dir) as daemon, web_of(files) as url:
        command = [PROGRAM, "run", f"{url}api/openapi.json", f"--header=Authorization: Bearer {token}"]
        done = subprocess.run(
            [*command, *OPTIONS, *left_out], capture_output=True, text=True, check=False, cwd=tmp_path
        )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert daemon.asked
