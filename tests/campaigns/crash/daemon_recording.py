"""Two jobs of the real daemon on a simulated cell, recorded: cut off in contact, held, resumed, stopped, ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, with_values
from polishd.daemon.runtime.exit_record import LOCK_NAME
from polishd.daemon.socket import client
from tests.campaigns.crash.disk import Disk
from tests.campaigns.crash.recording import MARKS, ROOT, Op, marked, ops, traced
from tests.system.cell_rig import Daemon, small_cell
from tests.time_limits import SOON_S

SPEED = 40.0
BLOCKS = 300
"""Executed in contact before something happens."""


class Recorded(Daemon):
    """``polishd run`` under strace, on a journal that leaves marks."""

    def __init__(self, files: DemoFiles, account: Path) -> None:
        self.files, self.output, self.account = files, files.daemon_log, account
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = traced(account, marked(files.out / MARKS, "daemon", files.cell, "--json"))
        with self.output.open("ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log, cwd=ROOT, env=environment)

    def signal(self, number: int) -> int:
        """To the daemon, not to strace; the exit code."""
        os.kill(int((self.files.state_dir / LOCK_NAME).read_text()), number)
        return self.process.wait(SOON_S)

    def __exit__(self, *error: object) -> None:
        if self.process.poll() is None:
            self.signal(signal.SIGKILL)


def recorded_daemon(folder: Path) -> list[Op]:
    """Start a daemon four times, for two jobs, and return what all of them did."""
    accounts: list[Path] = []
    with small_cell(folder, seed=7, speed=SPEED, tolerance_nm=0.01, max_cycles=1) as files:

        @contextmanager
        def started() -> Iterator[Recorded]:
            accounts.append(files.out / f"account-{len(accounts)}")
            with Recorded(files, accounts[-1]) as daemon:
                yield daemon

        def order(daemon: Daemon, verb: str) -> None:
            client.request(files.state_dir, verb, SOON_S)

        with started() as daemon:
            daemon.wait_in_contact(BLOCKS)
            daemon.signal(signal.SIGKILL)
        with started() as daemon:
            daemon.wait_for_state("held")
            order(daemon, "resume")
            daemon.wait_in_contact(BLOCKS)
            order(daemon, "hold")
            order(daemon, "resume")
            daemon.process.wait(SOON_S)
        files.cell.write_text(with_values(files.cell.read_text(), {"job": {"id": "another"}}))
        with started() as daemon:
            daemon.wait_in_contact(BLOCKS)
            daemon.signal(signal.SIGTERM)
        with started() as daemon:
            daemon.wait_for_state("held")
            order(daemon, "resume")
            daemon.process.wait(SOON_S)
    recording = ops(folder, folder / MARKS, *accounts)
    disk = Disk()
    for op in recording:
        disk.apply(op)
    disk.require_complete(folder)
    return recording
