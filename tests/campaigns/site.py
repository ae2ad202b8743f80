"""Run a simulated cell for a campaign: start, kill and restart its daemon, and compare journal and plant."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, with_values
from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.socket import client
from polishd.model.errors import PolishdError
from tests.system.agreement import disagreements
from tests.system.cell_rig import APERTURE_MM, account
from tests.system.sim_rig import ROOT, end_pid
from tests.time_limits import SOON_S

LOOK_S = 0.03
MOVING = {"motion_started": True, "motion_stopped": False, "boot": False, "lost": False}
EXTENDED = {"engage": True, "retracted": False, "boot": False, "lost": False}


class Log:
    """Reader of the simulator's log that continues where it stopped."""

    def __init__(self, path: Path) -> None:
        self._path, self._at = path, 0
        self.events: list[dict[str, Any]] = []

    def look(self) -> list[dict[str, Any]]:
        """Read the new lines and return all events so far."""
        with self._path.open("rb") as file:
            file.seek(self._at)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._at += len(whole)
        self.events += map(json.loads, whole.splitlines())
        return self.events

    def last(self, device: str, states: dict[str, bool]) -> bool:
        """Return the device's state after the last of its events that is in ``states``."""
        known = (states[e["event"]] for e in reversed(self.look()) if e["device"] == device and e["event"] in states)
        return next(known, False)


class Site:
    """One cell with the processes of its daemon and its restarted devices."""

    def __init__(self, files: DemoFiles) -> None:
        self.files = files
        self.log = Log(files.sim_dir / "sim.log")
        self.process: subprocess.Popen[bytes] | None = None
        self.booted: list[subprocess.Popen[bytes]] = []

    # the daemon

    def start(self, command: Sequence[str] = ("-m", "polishd"), tracer: Sequence[str] = ()) -> None:
        """Start ``polishd run``, or another command with the cell file as its argument."""
        run = ["run"] if command[-1] == "polishd" else []
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with self.files.daemon_log.open("ab") as log:
            self.process = subprocess.Popen(
                [*tracer, sys.executable, *command, *run, str(self.files.cell)],
                stdout=log, stderr=log, stdin=subprocess.DEVNULL, cwd=ROOT, env=environment, start_new_session=True,
            )  # fmt: skip

    @property
    def ended(self) -> bool:
        """Whether no daemon runs."""
        return self.process is None or self.process.poll() is not None

    @property
    def pid(self) -> int:
        """Process id of the daemon, also below a tracer; 0 while it has not taken its lock."""
        try:
            return int((self.files.state_dir / "lock").read_text() or 0)
        except FileNotFoundError:
            return 0

    def kill(self) -> None:
        """Kill the daemon, its worker and its tracer."""
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait(SOON_S)
            self.process = None

    def state(self) -> dict[str, Any]:
        """Return the answer to ``status``; empty where no daemon answers."""
        try:
            return client.request(self.files.state_dir, "status", 5.0)
        except PolishdError:
            return {}

    def order(self, verb: str) -> None:
        """Send a request, as the command line does. The daemon may end before it answers."""
        with contextlib.suppress(PolishdError):
            client.request(self.files.state_dir, verb, 60.0)

    def workers(self) -> list[int]:
        """Return the process ids of the compute workers."""
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                parent = int((path.parent / "stat").read_text().rpartition(")")[2].split()[1])
                if parent == self.pid and b"runtime.compute" in path.read_bytes():
                    found.append(int(path.parent.name))
            except (OSError, IndexError):
                continue  # it ended meanwhile
        return found

    # the simulator

    def device(self, name: str) -> int:
        """Return the process id of a simulated device."""
        return int(json.loads((self.files.sim_dir / "pids.json").read_text())[name])

    def reboot(self, name: str) -> None:
        """Kill a simulated device, as a power failure does, and return when it runs again."""
        end_pid(self.device(name))
        simulator = (sys.executable, "-m", "polishd.sim_backends", str(self.files.sim))
        command = [*simulator, "--state", str(self.files.sim_dir), "--device", name, "--rebooted"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, cwd=ROOT)
        self.booted.append(process)
        assert process.stdout is not None
        assert b"ready" in process.stdout.readline(), f"the {name} does not boot"
        pids = json.loads((self.files.sim_dir / "pids.json").read_text())
        (self.files.sim_dir / "pids.json").write_text(json.dumps({**pids, name: process.pid}))

    def rest(self) -> None:
        """Wait until the robot stands still and the actuator is retracted."""
        end_s = time.monotonic() + SOON_S
        while self.log.last("robot", MOVING) or self.log.last("actuator", EXTENDED):
            assert time.monotonic() < end_s, f"the cell does not come to rest: {self.log.events[-10:]}"
            time.sleep(LOOK_S)

    def close(self) -> None:
        """End all processes."""
        self.kill()
        for process in self.booted:
            process.terminate()
            process.wait(SOON_S)
            if process.stdout is not None:
                process.stdout.close()

    # journal and plant

    @property
    def _path(self) -> Path:
        return self.files.state_dir / JOURNAL_NAME

    def journal(self) -> sqlite3.Connection:
        """Open the journal for reading."""
        return sqlite3.connect(f"file:{self._path}?mode=ro", uri=True)

    def job_under_way(self) -> bool:
        """Return whether a job is unfinished: then the next start of the daemon is held."""
        if not self._path.exists():
            return False
        with contextlib.suppress(sqlite3.OperationalError), contextlib.closing(self.journal()) as journal:
            return bool(journal.execute("SELECT 1 FROM job WHERE outcome IS NULL").fetchall())
        return False  # killed before it had tables

    def contradictions(self) -> list[str]:
        """Return the contradictions between the journal and the plant's record of contact for settled passes."""
        settled = self._passes()
        books = self._account()["programs"]
        unknown = [book["sha256"][:8] for book in books if book["sha256"] not in settled and any(book["contact_s"])]
        known = [book for book in books if settled.get(book["sha256"])]
        said = [f"{name}: polished, and no pass" for name in unknown]
        return said + disagreements(self._path, known) if settled else said

    def _passes(self) -> dict[str, bool]:
        """Return for each program hash of the journal whether its pass is settled."""
        if not self._path.exists():
            return {}
        with contextlib.closing(self.journal()) as journal:
            if not journal.execute("SELECT 1 FROM sqlite_master WHERE name = 'pass'").fetchall():
                return {}  # killed before it had tables
            return dict(journal.execute("SELECT program_sha256, ended IS NOT NULL FROM pass").fetchall())

    def stands(self) -> list[tuple[float, float]]:
        """Return when the tool stood still on the part under force: start on ``time.monotonic`` and duration, in s."""
        found = self._account()["stands"]
        inside = (stand for stand in found if math.hypot(stand["x_mm"], stand["y_mm"]) < APERTURE_MM / 2)
        return [(stand["from_s"], stand["seconds"]) for stand in inside]

    def _account(self) -> dict[str, Any]:
        """Return the plant's record of contact; empty until the plant has written the first one."""
        if not (self.files.sim_dir / "dwell_account.json").exists():
            return {"programs": [], "stands": []}
        return account(self.files)

    def change(self, **job: Any) -> None:
        """Set values of [job] in the cell file."""
        self.files.cell.write_text(with_values(self.files.cell.read_text(), {"job": job}))
