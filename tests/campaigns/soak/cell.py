"""Run a simulated cell with a queue of parts, and act on it as an operator or a failure does."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from polishd.commissioning.rehearsal.simulated_cell import (
    DemoFiles,
    free_port,
    measure_artefact,
    simulated_cell,
    with_values,
)
from polishd.model.errors import PolishdError
from tests.campaigns.site import Site
from tests.campaigns.soak.usage import Meter, children
from tests.system.cell_rig import with_faults, with_keys, write_small
from tests.system.sim_rig import ROOT, wait_for
from tests.time_limits import SOON_S

QUICK = {
    "robot": {"silence_s": 3.0, "watchdog_s": 10.0},
    "actuator": {"silence_s": 2.5, "watchdog_ms": 3500, "retract_s": 1.0},
    "spindle": {"silence_s": 3.0, "watchdog_s": 3.0},
    "metrology": {"timeout_s": 15.0},
    "job": {"stream_ahead_s": 8.0},
}
"""Real time: longer than a busy machine keeps a process waiting, short enough for a fault to cost seconds only."""
REPEATABILITY_NM = 0.3
"""Stated in the instrument's profile; it is the noise of the simulated maps."""
DEPTH = {"effects": {"eq_44": [1.0, 1.0]}}
"""Depth as the plan has it. Drawn between none and eq. 44, a first part is removed up to 20 % deeper than planned."""


class Row(NamedTuple):
    """Row of the queue for a job."""

    verdict: str | None
    reason: str
    fault: str
    run_dir: str | None
    took_s: float | None
    """Time from begin to end of the job."""


class SoakCell(Site):
    """Cell and daemon, with the actions of an operator and of the service manager."""

    def __init__(self, files: DemoFiles) -> None:
        super().__init__(files)
        self.meter = Meter()
        self._sim = files.sim.read_text()
        self._hups = 0
        """Number of times that the simulator's file was written."""

    # daemon and service manager

    def start_queue(self) -> None:
        """Start the daemon, as systemd does."""
        self.start(("-m", "polishd", "run", "--queue"))

    def kill_daemon(self) -> None:
        """Kill the daemon but not its worker, as the kernel does when memory is short."""
        self.look()
        if self.process is not None:
            os.kill(self.pid, signal.SIGKILL)
            self.process.wait(SOON_S)

    def kill_worker(self) -> None:
        """Kill the worker alone."""
        for pid in self.workers():
            os.kill(pid, signal.SIGKILL)

    def workers(self) -> list[int]:
        """Return the process ids of the compute worker where the daemon runs."""
        return [] if self.ended or self.process is None else children(self.process.pid)

    def look(self) -> None:
        """Update the CPU time and the waiting time of all processes."""
        pids = json.loads((self.files.sim_dir / "pids.json").read_text()).values()
        daemon = [] if self.process is None else [self.process.pid]
        self.meter.look({"daemon": daemon, "worker": self.workers(), "simulators": pids})

    # operator

    def polishd(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run a command of polishd."""
        command = [sys.executable, "-m", "polishd", *words]
        with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
            process = subprocess.Popen(command, stdout=out, stderr=err, stdin=subprocess.DEVNULL, cwd=ROOT)
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            self.meter.add("commands", used.ru_utime + used.ru_stime)
            said = [file.seek(0) or file.read() for file in (out, err)]
        return subprocess.CompletedProcess(command, process.returncode, *said)

    def asked(self, *words: str) -> dict[str, Any]:
        """Run a command with ``--json`` and return its answer. PolishdError where it is refused."""
        done = self.polishd(*words, "--json")
        if done.returncode and not done.stdout.startswith("{"):
            raise PolishdError(done.stderr.strip())
        return dict(json.loads(done.stdout or "{}"))

    def row(self, job: str) -> Row | None:
        """Return the queue's last row of that job."""
        with contextlib.closing(self.journal()) as journal:
            found = journal.execute(
                "SELECT verdict, queue.reason, fault, run_dir, queue.ended - queue.begun "
                "FROM queue LEFT JOIN job ON job.id = queue.job "
                "WHERE queue.name = ? ORDER BY queue.id DESC LIMIT 1",
                (job,),
            ).fetchone()
        return None if found is None else Row(*found)

    def written_mb(self) -> float:
        """Return the size of journal, array store and log in MB; pages of the journal's WAL count."""
        with contextlib.closing(self.journal()) as journal:
            ((pages,),) = journal.execute("PRAGMA page_count").fetchall()
            ((size,),) = journal.execute("PRAGMA page_size").fetchall()
        state = self.files.state_dir
        others = sum(path.stat().st_size for path in [*(state / "store").glob("*.npz"), *state.glob("*.log*")])
        return float(pages * size + others) / 1e6

    def reset_loader(self) -> None:
        """Check what the loader holds, clear it, and press its button."""
        self.press("loader")
        self.quiet()

    # failures

    def quiet(self) -> None:
        """Remove all faults."""
        self.set({})

    def set(self, sections: Mapping[str, Mapping[str, Any]], wires: Sequence[Mapping[str, Any]] = ()) -> None:
        """Write the simulator's file with these faults and values, and wait until all devices use it."""
        self.files.sim.write_text(with_faults(with_keys(self._sim, sections), *wires))
        self._hups += 1
        pids = json.loads((self.files.sim_dir / "pids.json").read_text())
        del pids["supervisor"]
        for pid in pids.values():
            os.kill(pid, signal.SIGHUP)
        wait_for(lambda: self._reloaded() >= set(pids), f"the simulators to read {sections}")

    def _reloaded(self) -> set[str]:
        """Return the devices that have read the file as often as it was written."""
        read = [e["device"] for e in self.log.look() if e["event"] == "button" and e["signal"] == "SIGHUP"]
        return {device for device in set(read) if read.count(device) >= self._hups}

    def press(self, device: str) -> None:
        """Press the first button of a simulated device."""
        os.kill(self.device(device), signal.SIGUSR1)

    def pause(self, who: str, seconds: float) -> None:
        """Pause a process for a while."""
        pid = self.pid if who == "daemon" else self.device(who)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(seconds)  # that is what is done here
        os.kill(pid, signal.SIGCONT)

    def cut(self, device: str) -> None:
        """Unplug the wire of a device and plug it in again."""
        os.kill(self.device(device), signal.SIGURG)

    def reboot(self, name: str) -> None:
        """Switch a device off and on, as an operator does."""
        self.look()
        super().reboot(name)
        self.quiet()


def write_cell(folder: Path) -> DemoFiles:
    """Write a small cell's files with a loader. Its instrument is not commissioned yet."""
    files = write_small(folder, patient=False)
    port = free_port()
    cell = files.cell.read_text()
    cell += f'\n[loader]\ntype = "loader_line"\naddress = "tcp://127.0.0.1:{port}"\n'
    files.cell.write_text(with_keys(with_values(cell, {"dwell": {"cross_check": ""}}), QUICK))
    sim = with_faults(files.sim.read_text()) + "\n[loader.faults]\n"
    files.sim.write_text(with_keys(sim, DEPTH))
    profile = files.profile.read_text().partition("\n[commissioned]")[
        0
    ]  # tests may forge it; here the instrument is commissioned
    files.profile.write_text(with_keys(profile, {"repeatability": {"rms_nm": REPEATABILITY_NM}}))
    return files


@contextmanager
def running_cell(folder: Path, seed: int, speed: float) -> Iterator[SoakCell]:
    """Run the cell's simulator without a daemon for the duration of the block."""
    files = write_cell(folder)
    options = ["--state", str(files.sim_dir), "--seed", str(seed), "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        cell = SoakCell(files)
        try:
            yield cell
        finally:
            cell.close()


def prove_instrument(cell: SoakCell, *, mirrored: bool) -> list[str]:
    """Commission the instrument before the first part, optionally one that differs from its profile.

    Return the failures: a mirrored artefact must be refused, and without a commissioned profile nothing runs.
    """
    wrong, artefact, profile = [], cell.files.artefact, cell.files.profile
    words = ("map", "commission", str(profile), str(artefact), "--out", str(cell.files.out / "proof.png"))
    if mirrored:
        before = profile.read_bytes()
        cell.set({"interferometer.faults": {"mirror": True}})
        measure_artefact(cell.files.sim, artefact)
        refused = cell.polishd(*words)
        if refused.returncode != 8 or profile.read_bytes() != before:
            wrong.append(f"a mirrored artefact: exit code {refused.returncode}: {refused.stderr}")
        started = cell.polishd("run", str(cell.files.cell), "--queue", "--until-empty")
        if started.returncode != 3:
            wrong.append(f"a profile that nothing proves: exit code {started.returncode}: {started.stderr}")
        cell.quiet()
    measure_artefact(cell.files.sim, artefact)
    proved = cell.polishd(*words)
    if proved.returncode:
        wrong.append(f"the artefact: exit code {proved.returncode}: {proved.stderr}")
    return wrong


def rows(journal: Path, sql: str) -> list[tuple[Any, ...]]:
    """Return the rows of a query to a journal file."""
    with contextlib.closing(sqlite3.connect(f"file:{journal}?mode=ro", uri=True)) as file:
        return file.execute(sql).fetchall()
