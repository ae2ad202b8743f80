"""A night in a simulated cell: the spindle dies, the mail server is down, and somebody hears of it all the same."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from polishd.console.demo_files import DemoFiles
from tests.fakes.receivers import mail_server, web_server
from tests.system.cell_rig import Daemon, small_cell

pytestmark = pytest.mark.system
SECRET = "hunter2-and-more"


def tell(files: DemoFiles, mail_port: int, url: str) -> None:
    """The cell's people."""
    (files.out / "secret").write_text(SECRET)
    (files.out / "secret").chmod(0o600)
    text = files.cell.read_text()
    assert '"plan_guard"' in text
    files.cell.write_text(
        text.replace('"plan_guard"', '"plan_guard", "notifications"')
        + f"""
[notify.mail]
type = "email"
host = "127.0.0.1"
port = {mail_port}
security = "none"
user = "cell"
password = "file:secret"
sender = "cell@example.org"
to = ["ada@example.org"]

[notify.chat]
type = "webhook"
url = "{url}"
"""
    )


@pytest.mark.full
def test_a_spindle_that_dies_at_night_is_heard_of(tmp_path: Path) -> None:
    with mail_server() as server:
        port = server.port
    with web_server() as hook, small_cell(tmp_path / "cell", seed=4) as files:
        tell(files, port, hook.url)
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            os.kill(json.loads((files.sim_dir / "pids.json").read_text())["spindle"], signal.SIGKILL)
            assert daemon.wait() == 5
        told = hook.wait()
        ending = json.loads((files.state_dir / "ending.json").read_text())
        assert (told["event"], told["severity"]) == ("failed", "alarm")
        assert told["what"] == f"failed: {ending['reason']}"
        assert told["todo"] == ending["next"].replace("CELL.toml", str(files.cell))
        assert "tool off the part: yes" in told["now"]
        other = hook.wait()
        assert (other["event"], other["severity"]) == ("notification_failed", "warning")
        with (
            mail_server(port) as server,
            Daemon(files) as daemon,
        ):  # somebody starts it again: the spindle is still dead
            mail = server.wait()
            assert " ".join(mail["Subject"].split()) == told["title"]
            assert daemon.wait() == 5
    for path in (tmp_path / "cell").rglob("*"):
        if path.is_file() and path.name != "secret":
            assert SECRET.encode() not in path.read_bytes(), path
