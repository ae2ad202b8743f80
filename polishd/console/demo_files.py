"""The files of a demo: a cell, a simulated cell that hides another truth, and a raster program."""

from __future__ import annotations

import re
import socket
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig, load_config
from polishd.hooks.loader import load_own
from polishd.model.errors import MapError
from polishd.recipe.files import read_map
from polishd.workbench.programs.own_raster import own_program
from polishd.workbench.setup.sample import aperture_mm

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
    """Write config, simulator config and program into ``out``; BadMap where ``surface`` cannot be used."""
    part: dict[str, Any] = {}
    period = 0.0
    if surface is not None:
        part["aperture_mm"] = aperture_of(surface)
        period = SURFACE_PERIOD_MM
    files = DemoFiles(out)
    out.mkdir(parents=True, exist_ok=True)
    port = free_port()
    values: dict[str, Mapping[str, Any]] = {
        "cell": {"run_dir": "run"},
        "robot": {"address": f"tcp://127.0.0.1:{port}"},
        "instrument": {"profile": files.profile.name},
        "part": part,
        "process": {"correction": correction} if correction else {},
        "job": {"tolerance_nm": tolerance_nm, "max_cycles": cycles, "tolerance_period_mm": period},
    }
    files.cell.write_text(with_values(_shipped("cell.toml"), values))
    files.sim.write_text(with_values(_shipped("sim.toml"), {"plant": part, "robot": {"port": port}}))
    files.profile.write_text(_shipped("instrument.toml"))
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
    wanted = {(section, key): value for section, keys in sections.items() for key, value in keys.items()}
    section, lines = "", []
    for line in text.splitlines():
        if header := re.match(r"\s*\[([^\]]+)\]", line):
            section = header[1]
        key = re.match(r"(?:# )?(\w+)( *)= ", line)
        if key and (section, key[1]) in wanted:
            comment = re.search(r"\s+#[^\"]*$", line.removeprefix("# "))
            lines.append(f"{key[1]}{key[2]}= {_toml(wanted.pop((section, key[1])))}{comment[0] if comment else ''}")
        else:
            lines.append(line)
    if wanted:
        raise KeyError(f"not in the template: {sorted(wanted)}")
    return "\n".join(lines) + "\n"


def free_port() -> int:
    """A port on loopback that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)


def _shipped(name: str) -> str:
    return (resources.files("polishd.console") / "demo_data" / name).read_text(encoding="utf-8")
