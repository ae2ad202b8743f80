"""A simulated cell at night: the spindle fails, the mail server is down, and the notifications still arrive."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from tests.fakes.receivers import mail_server, web_server
from tests.system.cell_rig import Daemon, small_cell
from tests.unit.plugins.interferometer.test_watched_folder import dat

pytestmark = pytest.mark.system
SECRET = "hunter2-and-more"


def add_notifiers(files: DemoFiles, mail_port: int, url: str) -> None:
    """Add notifiers to the cell file."""
    (files.out / "secret").write_text(SECRET)
    (files.out / "secret").chmod(0o600)
    text = files.cell.read_text()
    assert '"plan_checks"' in text
    files.cell.write_text(
        text.replace('"plan_checks"', '"plan_checks", "notifications"')
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
def test_a_spindle_that_fails_at_night_is_reported(tmp_path: Path) -> None:
    with mail_server() as server:
        port = server.port
    with web_server() as hook, small_cell(tmp_path / "cell", seed=4) as files:
        add_notifiers(files, port, hook.url)
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            os.kill(json.loads((files.sim_dir / "pids.json").read_text())["spindle"], signal.SIGKILL)
            assert daemon.wait() == 5
        message = hook.wait()
        ending = json.loads((files.state_dir / "ending.json").read_text())
        assert (message["event"], message["severity"]) == ("daemon_failed", "alarm")
        assert message["what"] == f"failed: {ending['reason']}"
        assert message["todo"] == ending["next"].replace("CELL.toml", str(files.cell))
        assert "tool off the part: yes" in message["now"]
        other = hook.wait()
        assert (other["event"], other["severity"]) == ("notification_failed", "warning")
        with (
            mail_server(port) as server,
            Daemon(files) as daemon,
        ):  # the operator starts it again: the spindle is still dead
            mail = server.wait()
            assert " ".join(mail["Subject"].split()) == message["title"]
            assert daemon.wait() == 5
    for path in (tmp_path / "cell").rglob("*"):
        if path.is_file() and path.name != "secret":
            assert SECRET.encode() not in path.read_bytes(), path


@pytest.mark.full
def test_a_refused_map_is_reported_at_once_and_stands_in_the_status(tmp_path: Path) -> None:
    """The instrument is silent, and the map of the previous part is dropped into its folder."""
    with web_server() as hook, small_cell(tmp_path / "cell", seed=4) as files:
        os.kill(json.loads((files.sim_dir / "pids.json").read_text())["interferometer"], signal.SIGKILL)
        add_notifiers(files, 9, hook.url)
        with Daemon(files) as daemon:
            daemon.wait_for_state("polishing")
            (files.sim_dir / "maps" / "before.dat").write_bytes(dat(1, part="THE-PART-BEFORE"))
            message = hook.wait()
            assert (message["event"], message["severity"]) == ("map_refused", "warning")
            assert "map before.dat refused: WrongPart: it shows part 'THE-PART-BEFORE'" in message["what"]
            assert "Measure part" in message["todo"]
            command = [sys.executable, "-m", "polishd.cli.app", "status", str(files.cell)]
            said = subprocess.run(
                command, capture_output=True, text=True, check=True, env=os.environ | {"COLUMNS": "200"}
            )
            assert "map refused" in said.stdout
            assert "before.dat: WrongPart" in said.stdout
            assert daemon.end() == 1
