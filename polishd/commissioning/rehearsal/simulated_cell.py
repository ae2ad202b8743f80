"""Start of the simulated cell, a separate program that nothing of polishd imports."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

from polishd.commissioning.init.connected import aperture_mm
from polishd.config.cell import CellConfig, load_config
from polishd.drivers.cia402.device_types import SIMULATED_EDS
from polishd.model.errors import ConfigError, DeviceFault, MapError
from polishd.pipeline.run_folder import read_map
from polishd.plugin_loader import load_own
from polishd.programs.make import own_program
from polishd.util.serialization import toml

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
    """Have the simulated instrument write one map of its artefact.

    Raises:
        ConfigError: the simulator refuses SIM.toml.
        DeviceFault: the instrument does not measure.
    """
    command = [sys.executable, "-m", MODULE, str(config), "--artefact", str(target)]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    if done.returncode == ConfigError.exit_code:
        raise ConfigError(done.stderr.strip())
    if done.returncode:
        raise DeviceFault(f"the simulated instrument did not measure its artefact: {done.stderr.strip()}")


def last_words(log: Path, lines: int = 5) -> str:
    """The end of a log, for an error message."""
    return "\n".join(log.read_text(errors="replace").splitlines()[-lines:]) or "it said nothing"


# The files of a demo: a cell, what is true of its simulated machine, and a raster program.

SURFACE_PERIOD_MM = 7.0
"""Twice the spot's diameter: no dwell reaches shorter periods."""


class DemoFiles:
    """Where everything of a demo is."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.cell = out / "cell.toml"
        """The cell's config, as a user would write it."""
        self.sim = out / "sim.toml"
        """The simulator's config."""
        self.profile = out / "instrument.toml"
        """The profile of the simulated instrument."""
        self.artefact = out / "artefact.dat"
        """A map of the artefact that proves the profile."""
        self.sim_dir = out / "sim"
        """The simulator's state: device nodes, maps, its own log."""
        self.state_dir = out / "state"
        """The daemon's state folder."""
        self.run_dir = out / "run"
        """The run folder."""
        self.daemon_log = out / "daemon.log"
        """What the daemon printed."""


def write_demo(out: Path, surface: Path | None, tolerance_nm: float, cycles: int, correction: str | None) -> DemoFiles:
    """Write config, simulator config and program into ``out``; MapError where ``surface`` cannot be used."""
    part: dict[str, Any] = {}
    period = 0.0
    if surface is not None:
        part["aperture_mm"] = aperture_of(surface)
        period = SURFACE_PERIOD_MM
    files = DemoFiles(out)
    out.mkdir(parents=True, exist_ok=True)
    values: dict[str, Mapping[str, Any]] = {
        "cell": {"run_dir": "run"},
        "robot": {"address": f"tcp://127.0.0.1:{free_port()}"},
        "instrument": {"profile": files.profile.name},
        "part": part,
        "process": {"correction": correction} if correction else {},
        "job": {"tolerance_nm": tolerance_nm, "max_cycles": cycles, "tolerance_period_mm": period},
    }
    files.cell.write_text(with_values(_shipped("cell.toml"), values))
    files.sim.write_text(_shipped("sim.toml"))
    files.profile.write_text(_shipped("instrument.toml"))
    (out / "drive.eds").write_bytes(SIMULATED_EDS.read_bytes())
    config = load_config(files.cell)
    config.program_path.write_bytes(demo_program(config))
    return files


def demo_program(config: CellConfig) -> bytes:
    """A boustrophedon raster over the clear aperture and a little more, as RNC text."""
    return own_program(config, f"polishd demo raster over {config.outline()}")


def aperture_of(surface: Path) -> float:
    """Diameter, mm, of the round part that a measured map shows, centred in its frame."""
    measured = read_map(surface, load_own().surface_readers().values())
    if measured.pitch_mm is None:
        raise MapError(f"{surface}: has no lateral scale; the demo needs one")
    return aperture_mm(measured, measured.pitch_mm)


def with_values(text: str, sections: Mapping[str, Mapping[str, Any]]) -> str:
    """The TOML text of our own template with some values changed, comments kept; KeyError where a key is not there."""
    changes = {(section, key): value for section, keys in sections.items() for key, value in keys.items()}
    section, lines = "", []
    for line in text.splitlines():
        if header := re.match(r"\s*\[([^\]]+)\]", line):
            section = header[1]
        key = re.match(r"(?:# )?(\w+)( *)= ", line)
        if key and (section, key[1]) in changes:
            comment = re.search(r"\s+#[^\"]*$", line.removeprefix("# "))
            lines.append(f"{key[1]}{key[2]}= {toml(changes.pop((section, key[1])))}{comment[0] if comment else ''}")
        else:
            lines.append(line)
    if changes:
        raise KeyError(f"not in the template: {sorted(changes)}")
    return "\n".join(lines) + "\n"


def free_port() -> int:
    """A free port on loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _shipped(name: str) -> str:
    """Return a file of the demo without its line for editors, whose path starts from `examples/`."""
    text = (resources.files("polishd.commissioning.rehearsal") / "demo_data" / name).read_text(encoding="utf-8")
    return re.sub(r"^#:schema .*\n", "", text)
