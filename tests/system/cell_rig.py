"""Run a small simulated cell: simulator and daemon are processes, as ``polishd demo`` starts them."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, demo_program, simulated_cell, with_values
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.socket import client
from polishd.model.errors import PolishdError
from tests.commissioned import forged
from tests.system.sim_rig import wait_for
from tests.time_limits import SOON_S

Sections = Mapping[str, Mapping[str, Any]]

APERTURE_MM = 30.0
ONE_PASS = {"tolerance_nm": 5.0, "max_cycles": 2}
"""Job that ends after one or two passes."""
REPORT = ', "run_report"'
"""Part of the cell file that requests the run report. Writing one takes seconds: only tests of reports need it."""

PATIENT: Sections = {
    "robot": {"silence_s": 6.0, "watchdog_s": 20.0, "no_progress_s": 5.0},
    "actuator": {"silence_s": 3.0, "watchdog_ms": 5000},
    "spindle": {"silence_s": 6.0, "watchdog_s": 6.0},
    "job": {"stream_ahead_s": 12.0},
}
"""Time limits for a busy machine, where every process pauses for a while: only a process that hangs exceeds them."""


def write_small(
    out: Path, *, report: bool = False, patient: bool = True, touch_off: bool = False, **job: Any
) -> DemoFiles:
    """Write the demo's files with a small part, so that a pass takes seconds.

    ``report``: write run reports; ``patient``: limits for a busy machine; ``touch_off``: check how the part is seated;
    ``job``: keys of [job].
    """
    from polishd.commissioning.rehearsal.simulated_cell import write_demo

    files = write_demo(out, None, 2.0, 4, None)
    part = {"part": {"aperture_mm": APERTURE_MM}, "job": job}
    cell = with_values(files.cell.read_text(), part)
    assert REPORT in cell
    cell = cell if touch_off else without(cell, "touch_off")
    files.cell.write_text(cell if report else cell.replace(REPORT, ""))
    sim = {"plant": {"pv_nm": 100.0}}
    files.sim.write_text(with_values(files.sim.read_text(), sim))
    if patient:
        files.cell.write_text(with_keys(files.cell.read_text(), PATIENT))
    forged(files.profile)
    config = load_config(files.cell)
    config.program_path.write_bytes(demo_program(config))
    return files


def with_part(
    files: DemoFiles, part: Mapping[str, float], make: Callable[[CellConfig], bytes] = demo_program, **surface: float
) -> None:
    """Put another part with that surface into the cell, and write the program that ``make`` returns for it."""
    files.cell.write_text(with_keys(files.cell.read_text(), {"part": part}))
    files.sim.write_text(with_keys(files.sim.read_text(), {"plant": surface}))
    config = load_config(files.cell)
    config.program_path.write_bytes(make(config))


def with_keys(text: str, sections: Sections) -> str:
    """Return the TOML text with these keys. Keys and sections that it lacks are added."""
    lines, wanted, missing = [], {}, dict(sections)
    for line in text.splitlines():
        if line.startswith("["):
            name = line[1:].partition("]")[0]
            wanted = missing.pop(name, {})
            lines += [line, *_assigned(wanted)]
        elif line.partition("=")[0].strip() not in wanted:
            lines.append(line)
    for name, keys in missing.items():
        lines += ["", f"[{name}]", *_assigned(keys)]
    return "\n".join(lines) + "\n"


def _assigned(keys: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {json.dumps(value)}" for key, value in keys.items()]


def with_faults(text: str, *faults: Mapping[str, Any]) -> str:
    """Return the text of SIM.toml with its ``[[fault]]`` tables replaced by these."""
    lines, dropped = [], False
    for line in text.splitlines():
        dropped = line.startswith("[[fault]]") or (dropped and not line.startswith(("[", "#")))
        lines += [] if dropped else [line]
    for fault in faults:
        lines += ["", "[[fault]]", *(f"{key} = {json.dumps(value)}" for key, value in fault.items())]
    return "\n".join(lines) + "\n"


def without(text: str, section: str) -> str:
    """Return the TOML text without one of its sections. AssertionError where it lacks that section."""
    head, found, rest = text.partition(f"[{section}]")
    assert found
    return head + "[" + rest.partition("\n[")[2]


@contextlib.contextmanager
def small_cell(
    out: Path, seed: int = 1, speed: float = 10.0, *, report: bool = False, **job: Any
) -> Iterator[DemoFiles]:
    """Run a simulator with the small part for the duration of the block."""
    files = write_small(out, report=report, **job)
    options = ["--state", str(files.sim_dir), "--seed", str(seed), "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


class Daemon:
    """Process of ``polishd run``; it is killed at the end of a ``with`` block."""

    def __init__(self, files: DemoFiles, *options: str) -> None:
        self.files = files
        self.output = files.daemon_log
        with self.output.open("ab") as log:
            command = [sys.executable, "-m", "polishd.cli.app", "run", str(files.cell), "--json", *options]
            self.process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()

    def status(self) -> dict[str, Any]:
        """Return the daemon's answer to ``status``; empty while it does not answer. AssertionError if it has ended."""
        try:
            return client.request(self.files.state_dir, "status", 5.0)
        except PolishdError:
            assert self.process.poll() is None, self.output.read_text()
            return {}

    def wait_for_state(self, state: str) -> dict[str, Any]:
        """Wait until the daemon is in that state and return its status."""
        return dict(wait_for(lambda: (s := self.status()).get("state") == state and s, f"state {state}"))

    def wait_in_contact(self, blocks: int = 150) -> None:
        """Wait until the robot has passed that block of a new pass."""
        before = len(events(self.files, "blocks"))

        def runs() -> bool:
            assert self.process.poll() is None, self.output.read_text()
            return any(event.get("at_seq", 0) > blocks for event in events(self.files, "blocks")[before:])

        wait_for(runs, "a pass")

    def wait(self) -> int:
        """Wait until the daemon ends without a signal and return its exit code."""
        return self.process.wait(SOON_S)

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send a signal, wait until the daemon ends and return its exit code."""
        self.process.send_signal(number)
        return self.wait()


def events(files: DemoFiles, *names: str) -> list[dict[str, Any]]:
    """Return the simulator's log in time order: all events, or those of these names."""
    lines = (files.sim_dir / "sim.log").read_text().splitlines()
    logged = [json.loads(line) for line in lines if line.endswith("}")]
    return [event for event in logged if not names or event["event"] in names]


def account(files: DemoFiles) -> dict[str, Any]:
    """Return the simulated plant's record of contact time, by program and block."""
    return dict(json.loads((files.sim_dir / "dwell_account.json").read_text()))


def whole_account(files: DemoFiles) -> dict[str, Any]:
    """Wait until that record contains all motion so far and return it: it lags behind the simulator's log."""
    stopped_s = max(event["mono_s"] for event in events(files, "motion_stopped", "lost"))

    def whole() -> dict[str, Any] | None:
        written = account(files)
        return written if written["until_s"] >= stopped_s else None

    return dict(wait_for(whole, "the plant's account"))


def summary(files: DemoFiles) -> dict[str, Any]:
    """Return the summary of the run folder."""
    return dict(json.loads((files.run_dir / "summary.json").read_text()))
