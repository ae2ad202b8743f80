"""polishd's simulated devices in the places of some of a cell's, beside the real ones."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.config.outline import as_keys
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError, DeviceFault

MODULE = "polishd.sim_backends"
END_S = 10.0
SIM = """
[plant]
speed = 20.0
part_id = {part_id}
{outline}
origin_mm = {origin_mm}
rotation_rpy_deg = {rotation_rpy_deg}
[robot]
port = 0
watchdog_s = 60.0
home = [0.0, 0.0, 0.0, 15.0, 0.0]
"""
"""The robot stands with the tool's tip on the part, so that there is something to press on."""
PATIENT: Mapping[str, Mapping[str, Any]] = {
    "robot": {"type": "robot_link", "watchdog_s": 60.0},
    "actuator": {"type": "voice_coil_modbus", "silence_s": 1.0, "watchdog_ms": 2000},
    "spindle": {"type": "spindle_can", "silence_s": 1.5},
    "loader": {"type": "loader_line"},
}
"""By port: the section of a simulated one, less its address. The computer that simulates may be busy."""
PLUGINS = {"robot": "rnc_robot", "actuator": "voice_coil", "spindle": "spindle", "loader": "loader"}


def require_simulated(config: CellConfig, names: Sequence[str]) -> None:
    """ConfigError where one of these devices is not in the cell, or has no stand-in."""
    for name in names:
        if name not in config.devices:
            raise ConfigError(f"--simulate {name}: the cell has {', '.join(config.devices)}")
        if port_of(name) not in PATIENT:
            raise ConfigError(f"--simulate {name}: only {', '.join(PATIENT)} are simulated")
    ports = [port_of(name) for name in names]
    if len(set(ports)) < len(ports):
        raise ConfigError(f"--simulate {','.join(names)}: one device of a port is simulated, not several")


@contextmanager
def stand_ins(config: CellConfig, names: Sequence[str], folder: Path) -> Iterator[dict[str, Any]]:
    """Simulated devices, running in this block; gives what to lay over the cell's config, by dotted key."""
    if not names:
        yield {}
        return
    part = config.part
    sim = folder / "sim.toml"
    written = {"part_id": part.id}
    outline = "\n".join(f"{key} = {json.dumps(value)}" for key, value in as_keys(config.outline()).items())
    placed = {"origin_mm": list(part.origin_mm), "rotation_rpy_deg": list(part.rotation_rpy_deg)}
    text = SIM.format(outline=outline, **{key: json.dumps(value) for key, value in {**written, **placed}.items()})
    ports = [port_of(name) for name in names]
    sim.write_text(text + ("[loader]\n" if "loader" in ports else ""))
    only = [word for port in ports for word in ("--only", port)]
    with _running([str(sim), "--state", str(folder / "sim"), *only]) as endpoints:
        devices = {name: {**PATIENT[port_of(name)], "address": endpoints[port_of(name)]} for name in names}
        plugins = dict.fromkeys([*config.plugins.load, *(PLUGINS[port] for port in ports)])
        yield {**devices, "plugins.load": list(plugins)}


@contextmanager
def _running(arguments: Sequence[str]) -> Iterator[Mapping[str, str]]:
    """Where its devices answer; DeviceFault where it does not come up (it says why on stderr)."""
    command = [sys.executable, "-m", MODULE, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            line = next((line for line in process.stdout or () if line.startswith("READY ")), None)
            if line is None:
                raise DeviceFault("the simulated devices did not start")
            yield json.loads(line.removeprefix("READY "))
        finally:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
