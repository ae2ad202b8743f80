"""A device plugin that is not what its port asks is found by check, probe and run, before anything is opened."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import demo_program, with_values
from polishd.config.cell import load_config
from tests.commissioned import commissioned
from tests.time_limits import SOON_S
from tests.unit.cli_result import Polishd

VERBS = ("check", "probe", "run")
TOOL = """
from pathlib import Path
from pydantic import BaseModel

class Options(BaseModel, extra="forbid"):
    address: str = "here"

class SoftTool:
    def __init__(self, options, context):
        self.opened = context.base_dir / "opened"

    async def open(self): self.opened.touch()
    async def close(self): ...
    async def make_safe(self): ...
    async def identify(self): return DeviceIdentity("Acme", "soft tool", "1", "1.0")
    async def status(self): return DeviceStatus(ready=True, safe=True, state="idle")
    async def set_force(self, force_n): ...
    async def samples(self):
        yield None
{retract}

def build(options, context):
{build}
    return SoftTool(options, context)

@hookimpl
def polishd_device_types():
    return [DeviceType(name="soft_tool", port="actuator", options=Options, build=build)]
"""
LIFTS = "    async def retract(self): ..."
OWN = ["rnc_robot", "devices", "voice_coil", "interferometer", "removal_models", "dwell_solvers", "plan_checks"]


@pytest.fixture
def cell(tmp_path: Path, example: str) -> Path:
    """A small part's cell, commissioned, with its program; its devices are said by the test."""
    path = tmp_path / "cell.toml"
    change = {"part": {"aperture_mm": 20.0}, "process": {"grid_mm": 2.0}, "instrument": {"profile": "instrument.toml"}}
    path.write_text(with_values(example, change))
    commissioned(tmp_path)
    config = load_config(path)
    config.program_path.write_bytes(demo_program(config))
    return path


def with_tool(cell: Path, plugin: str) -> int:
    """The cell with the plugin's actuator; the line of its type."""
    text = with_values(cell.read_text(), {"plugins": {"load": [*OWN, plugin]}})
    text = re.sub(r"\[actuator\][^\[]*", '[actuator]\ntype = "soft_tool"\naddress = "bus 7"\n\n', text)
    cell.write_text(text)
    return text.splitlines().index('type = "soft_tool"') + 1


@pytest.mark.full
@pytest.mark.parametrize("verb", VERBS)
def test_an_actuator_that_cannot_lift(polishd: Polishd, cell: Path, install: Callable[..., str], verb: str) -> None:
    line = with_tool(cell, install("acme", TOOL.format(retract="", build="    pass")))
    said = polishd(verb, cell)
    assert said.code == 3, said
    assert f"polishd: {cell}:{line}: actuator.type: plugin 'acme', device type 'soft_tool': " in said.err
    assert "SoftTool is not a ForceActuator: it has no " in said.err
    assert "'retract'" in said.err
    assert "nothing was opened" in said.err
    assert not (cell.parent / "opened").exists()


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("build", "key", "says"),
    [
        ("    raise ConfigError(f'{options.address!r} is no bus')", "address", "'bus 7' is no bus"),
        ("    raise ConfigError('no licence')", "", "no licence"),
        (
            "    raise ValueError('of mine')",
            "type",
            "plugin 'acme', device type 'soft_tool': cannot be built: ValueError",
        ),
        ("    return None", "type", "NoneType is not a ForceActuator: it has no 'open'"),
    ],
)
def test_a_device_that_cannot_be_built(
    polishd: Polishd, cell: Path, install: Callable[..., str], build: str, key: str, says: str
) -> None:
    line = with_tool(cell, install("acme", TOOL.format(retract=LIFTS, build=build)))
    place = {"address": line + 1, "": line - 1, "type": line}[key]
    said = polishd("check", cell)
    assert said.code == 3
    assert said.err.startswith(f"polishd: {cell}:{place}: {'.'.join(filter(None, ['actuator', key]))}: ")
    assert says in said.err


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("section", "address"),
    [
        ("robot", "tcp://localhost"),
        ("robot", "serial:/dev/ttyS0"),
        ("actuator", "socketcand://localhost:1/can0"),
        ("actuator", "serial:tty?baud=fast"),
        ("spindle", "slcan:bus?bitrate=7"),
        ("spindle", "tcp://localhost:1"),
    ],
)
def test_a_bad_address_has_its_place(polishd: Polishd, cell: Path, section: str, address: str) -> None:
    cell.write_text(with_values(cell.read_text(), {section: {"address": address}}))
    (line,) = (n for n, text in enumerate(cell.read_text().splitlines(), 1) if address in text)
    said = polishd("check", cell)
    assert said.code == 3
    assert said.err.startswith(f"polishd: {cell}:{line}: {section}.address: ")
    assert repr(address) in said.err


@pytest.mark.full
def test_a_driver_whose_thread_hangs_does_not_keep_the_process(cell: Path, install: Callable[..., str]) -> None:
    """As ``asyncio.to_thread`` on a share that is away: Python itself would wait for it for ever."""
    hangs = TOOL.replace(
        "self.opened.touch()", "asyncio.get_running_loop().run_in_executor(None, threading.Event().wait)"
    )
    source = "import asyncio, threading\n" + hangs.format(
        retract=f"{LIFTS}\n    times = ActuatorTimes(watchdog_s=1.0)", build=""
    )
    with_tool(cell, install("acme", source))
    path = os.pathsep.join([str(cell.parent / "site"), os.environ.get("PYTHONPATH", "")])
    said = subprocess.run(
        [sys.executable, "-m", "polishd", "probe", cell, "--only", "actuator"],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, timeout=SOON_S, check=False,
    )  # fmt: skip
    assert said.returncode == 0, said
    assert "a thread hangs, and is left" in said.stderr
