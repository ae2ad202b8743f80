"""``polishd demo``: a simulated cell, its daemon, and a table at the end.

It writes a config and a program, starts the simulator and ``polishd run``, and shows the events.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from polishd.cli.run import progress
from polishd.commissioning.rehearsal.simulated_cell import (
    DemoFiles,
    last_words,
    measure_artefact,
    simulated_cell,
    write_demo,
)
from polishd.daemon.socket import client
from polishd.daemon.socket.client import SOCKET_NAME
from polishd.maps.commission import CommissioningResult, prove_profile
from polishd.model.errors import LinkError, PolishdError
from polishd.rendering.terminal import outcome_tables, say, stderr, stdout
from polishd.util.files import require_new, require_writable

START_S = 150.0
STOP_S = 30.0


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """The options of ``polishd demo``."""

    seed: int
    speed: float
    cycles: int
    tolerance_nm: float
    surface: Path | None
    correction: str | None
    out: Path | None


def run_demo(options: DemoOptions, *, as_json: bool) -> int:
    """Run the demo to its end; 0 only if the tolerance was met."""
    out = options.out or Path("polishd-demo") / datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
    require_new(out)
    require_writable(out)
    files = write_demo(out.absolute(), options.surface, options.tolerance_nm, options.cycles, options.correction)
    stderr.print("polishd demo", f"in {out}  (seed {options.seed}, {options.speed:g} x real time)")
    simulator = ["--state", str(files.sim_dir), "--seed", str(options.seed), "--speed", f"{options.speed:g}"]
    simulator += ["--surface", str(options.surface.absolute())] if options.surface else []
    signal.signal(signal.SIGTERM, _raise_exit)  # so that SIGTERM also ends the started processes
    proved = commission_demo(files)
    stderr.print(f"the instrument's profile is commissioned: correlation {proved.proof.correlation:.4f}")
    with simulated_cell(files.sim, simulator, files.out / "sim.log"):
        code = _daemon(files)
    summary_path = files.run_dir / "summary.json"
    if not summary_path.exists():
        raise PolishdError(f"the daemon ended with code {code}: {last_words(files.daemon_log)}")
    summary = json.loads(summary_path.read_text())
    if as_json:
        say(json.dumps(summary))
    else:
        stdout.print(outcome_tables(summary))
        for note in summary["notes"]:
            stdout.print(note, markup=False)
        stdout.print(f"report: {files.run_dir / 'report.html'}", markup=False, soft_wrap=True)
    return code


def commission_demo(files: DemoFiles) -> CommissioningResult:
    """Measure the artefact with the simulated instrument, and commission its profile; raise the command's errors."""
    measure_artefact(files.sim, files.artefact)
    return prove_profile(files.profile, files.artefact)


def _daemon(files: DemoFiles) -> int:
    """Run ``polishd run`` as a process, show its events, and return its exit code."""
    command = [sys.executable, "-m", "polishd", "run", str(files.cell), "--json", "--no-hold"]
    with files.daemon_log.open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        try:
            watcher = threading.Thread(target=_watch, args=(process, files), daemon=True)
            watcher.start()
            code = process.wait()
            watcher.join(STOP_S)
            return code
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
                process.wait(STOP_S)


def _watch(process: subprocess.Popen[bytes], files: DemoFiles) -> None:
    """Show the daemon's events until it ends."""
    waited = threading.Event()
    while process.poll() is None and not (files.state_dir / SOCKET_NAME).exists():
        waited.wait(0.05)  # another process makes this file, so there is no event to wait for
    with contextlib.suppress(LinkError), progress([("", files.cell)]) as (show,):
        for event in client.subscribe(files.state_dir):
            show(event["name"], event["cycle"], event["data"])


def _raise_exit(number: int, _frame: object) -> None:
    raise SystemExit(128 + number)
