"""Starting the simulated cell, which is a program of its own: nothing of polishd imports it."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from polishd.model.errors import DeviceFault

MODULE = "polishd.sim_backends"
END_S = 10.0


def run_simulator(config: Path, options: Sequence[str]) -> int:
    """In the foreground, until it is ended; its exit code."""
    process = subprocess.Popen([sys.executable, "-m", MODULE, str(config), *options])
    try:
        return process.wait()
    except KeyboardInterrupt:
        process.send_signal(signal.SIGINT)
        return process.wait(END_S)


@contextmanager
def simulated_cell(config: Path, options: Sequence[str], log: Path) -> Iterator[None]:
    """In the background, ready for connections inside this block; its stderr goes to ``log``."""
    with log.open("wb") as stderr:
        command = [sys.executable, "-m", MODULE, str(config), *options]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True) as process:
            try:
                if process.stdout is None or not any(line.startswith("READY") for line in process.stdout):
                    raise DeviceFault(f"the simulated cell did not start: {last_words(log)}")
                yield
            finally:
                process.terminate()
                try:
                    process.wait(END_S)
                except subprocess.TimeoutExpired:
                    process.kill()


def measure_artefact(config: Path, target: Path) -> None:
    """Have the simulated instrument write one map of its artefact; DeviceFault where it does not."""
    command = [sys.executable, "-m", MODULE, str(config), "--artefact", str(target)]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise DeviceFault(f"the simulated instrument did not measure its artefact: {done.stderr.strip()}")


def last_words(log: Path, lines: int = 5) -> str:
    """The end of a log, for an error message."""
    return "\n".join(log.read_text(errors="replace").splitlines()[-lines:]) or "it said nothing"
