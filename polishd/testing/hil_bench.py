"""Bench for the suites on a real cell: tests of each level, and their description before any motion."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from pathlib import Path
from typing import Any

import pytest

from polishd.config.cell import PORTS, CellConfig, load_config
from polishd.config.toml_loader import join_words
from polishd.daemon.assembly import build_cell, require_time_limits
from polishd.daemon.cell.cell import OPEN_S
from polishd.daemon.cell.recorder import place, recording_to
from polishd.daemon.runtime.exit_record import locked
from polishd.hookspecs import DeviceType
from polishd.interfaces import Device
from polishd.model.devices import port_of
from polishd.model.errors import ConfigError, DeviceClaimed, DeviceFault, PolishdError
from polishd.plugin_loader import Hooks, load_own, plugins_of
from polishd.testing.device_rig import Rig, TestScope, close_safe
from polishd.util.address_claims import KeptClaims
from polishd.util.threads import run_loop

# Simulated devices that replace some of a cell's devices, beside the real ones.

MODULE = "polishd.sim_backends"
END_S = 10.0
SIM = """
cell = {cell}
[plant]
speed = 20.0
program_offset_mm = [0.0, 0.0, 0.0]
program_rotation_deg = 0.0
[robot]
kind = "link"
port = 0
watchdog_s = 60.0
x_mm = [-150.0, 150.0]
y_mm = [-150.0, 150.0]
z_mm = [-2.0, 120.0]
home = [0.0, 0.0, 0.0, 15.0, 0.0]
[actuator]
kind = "modbus_rtu"
[spindle]
kind = "slcan"
"""
"""The robot holds the tool's tip on the part, so that the actuator can press on it."""
ALWAYS = ("robot", "actuator", "spindle")
"""Sections that SIM has."""


def require_simulated(config: CellConfig, names: Sequence[str]) -> None:
    """Raise ConfigError if one of these devices is not in the cell, or cannot be simulated."""
    own = load_own()
    for name in names:
        if name not in config.devices:
            raise ConfigError(f"--simulate {name}: the cell has {', '.join(config.devices)}. Name some of them")
        if _substitute(own, port_of(name)) is None:
            simulated = join_words(port for port in PORTS if _substitute(own, port))
            raise ConfigError(f"--simulate {name}: only {simulated} can be simulated")
    ports = [port_of(name) for name in names]
    if len(set(ports)) < len(ports):
        raise ConfigError(f"--simulate {','.join(names)}: simulate only one device of a port")


@contextmanager
def simulated_devices(config: CellConfig, names: Sequence[str], folder: Path) -> Iterator[dict[str, Any]]:
    """Run simulated devices during the block; yield the overrides of the cell's config, by dotted key."""
    if not names:
        yield {}
        return
    own, sim, ports = load_own(), folder / "sim.toml", [port_of(name) for name in names]
    lines = "".join(f'[{port}]\nkind = "tcp"\n' for port in ports if port not in ALWAYS)
    sim.write_text(SIM.format(cell=json.dumps(str(config.path))) + lines)
    only = [word for port in ports for word in ("--only", port)]
    with _running([str(sim), "--state", str(folder / "sim"), *only]) as endpoints:
        laid_over, plugins = dict[str, Any](), list(config.plugins.load)
        for name, port in zip(names, ports, strict=True):
            if kind := _substitute(own, port):
                laid_over[name] = {"type": kind.name, **(kind.substitute or {}), "address": endpoints[port]}
                plugins.append(own.plugin_of("polishd_device_types", kind.name))
        yield {**laid_over, "plugins.load": list(dict.fromkeys(plugins))}


def _substitute(own: Hooks, port: str) -> DeviceType | None:
    """Return the port's simulated device type, if it has an address."""
    kind = own.substitute(port)
    return kind if kind is not None and "address" in kind.options.model_fields else None


@contextmanager
def _running(arguments: Sequence[str]) -> Iterator[Mapping[str, str]]:
    """Run the simulator; yield its devices' addresses. DeviceFault if it does not start (reason on stderr)."""
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


SOON_S = 60.0
SUITES = ("device", "robot", "spindle", "actuator", "cycle")
"""Suites in the order of their runs: first without motion, last with pressing."""


class Level(IntEnum):
    """Level of the tests; each level includes the lower ones."""

    IDENTIFY = 0
    NO_CONTACT = 1
    CONTACT = 2
    CYCLE = 3

    @classmethod
    def of(cls, word: str) -> Level:
        """Parse a level: ``no-contact``."""
        return cls[word.upper().replace("-", "_")]


NEEDED = {
    "polishd_moves": Level.NO_CONTACT,
    "polishd_presses": Level.CONTACT,
    "polishd_cycles": Level.CYCLE,
}
"""Level that a test needs, by its mark."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HilRequest:
    """Options of a hardware-in-the-loop run."""

    cell: Path
    level: Level = Level.IDENTIFY
    max_force_n: float | None = None
    """Force limit; required from level contact on."""
    simulate: tuple[str, ...] = ()
    """Names of the cell's devices to simulate."""
    motion: Path | None = None
    """Program that the robot may repeat in the air, block by block."""
    record: Path | None = None
    """File or folder for the recording of the devices' links."""


@dataclass(frozen=True)
class CellDevice:
    """A cell's device as a case of the suites: built for each test, and left safe."""

    config: CellConfig
    hooks: Hooks
    device: str
    scope: TestScope

    @property
    def __name__(self) -> str:
        """Name of the case in test names."""
        return self.device

    @asynccontextmanager
    async def __call__(self, _folder: Path) -> AsyncIterator[Rig[Device]]:
        """Yield the rig of one test; its link is never cut, and only the device reports whether it is at rest."""
        device = build_cell(self.config, self.hooks).devices[self.device]
        try:
            yield Rig(device, scope=self.scope, soon_s=SOON_S)
        finally:
            await close_safe(device)


@dataclass(frozen=True)
class HilBench:
    """A cell that is locked for the suites."""

    asked: HilRequest
    config: CellConfig
    hooks: Hooks

    def cases(self, fixture: str) -> list[CellDevice]:
        """Return the cases of a suite's fixture: all devices that act, or those of the port."""
        names = [name for name in self.config.devices if fixture in {"any_device", port_of(name)} and _acts(name)]
        scope = self.scope()
        return [CellDevice(self.config, self.hooks, name, scope) for name in names]

    def scope(self) -> TestScope:
        """Return the scope of the tests: values of the cell's job, within ``max_force_n`` and the cell's limits."""
        process, asked = self.config.process, self.asked
        return TestScope(
            force_n=min(process.force_n, asked.max_force_n or process.force_n),
            most_n=None,
            band=max(self.config.limits.force_band, TestScope().band),
            period_s=None,
            rpm=process.rpm,
            most_rpm=None,
            block=None if asked.motion is None else _repeated(asked.motion),
        )

    def allows(self, marks: set[str]) -> bool:
        """Whether a test with these marks is within the level and possible on a real cell."""
        if marks & {"polishd_cuts", "polishd_mutes", "polishd_fresh"}:
            return False
        return all(self.asked.level >= level for mark, level in NEEDED.items() if mark in marks)

    def does(self) -> Iterator[tuple[str, str, str]]:
        """Yield (device, real or simulated type, action) for the description before any motion."""
        for name, section in self.config.devices.items():
            kind = "simulated, in place of" if name in self.asked.simulate else "REAL,"
            address = (section.model_extra or {}).get("address", "")
            yield name, f"{kind} {section.type} {address}".strip(), self._moves(name)
        if self.asked.level >= Level.CYCLE:
            yield "all of them", f"the job of {self.config.path.name}", self._polishes()

    def _polishes(self) -> str:
        # a cycle is the first pass of a job
        return (
            f"last of all ONE CYCLE: the part is measured, POLISHED along {self.config.program_path.name} with "
            f"{self.scope().force_n:g} N and {self.config.process.rpm:g} rpm, and measured"
        )

    def _moves(self, name: str) -> str:
        port, scope, level = port_of(name), self.scope(), self.asked.level
        if not _acts(name):
            return "is not tested: polishd probe identifies it"
        safe = {"robot": "is held", "actuator": "takes the force off and lifts", "spindle": "stops"}
        text = f"is opened, identified, made safe ({safe.get(port, 'stops')}) and closed, repeatedly"
        if level >= Level.NO_CONTACT and port == "spindle":
            text += f"; TURNS with up to {scope.rpm:g} rpm, both ways"
        if level >= Level.NO_CONTACT and port == "robot" and scope.block is None:
            text += "; does not move: no --motion PROGRAM is given"
        elif level >= Level.NO_CONTACT and port == "robot":
            text += f"; MOVES along {self.asked.motion}, repeatedly, and lifts off it by 15 mm"
        if level >= Level.CONTACT and port == "actuator":
            text += f"; LANDS and PRESSES with up to {scope.force_n:g} N on the surface below the tool"
        return text


def asked_in(config: pytest.Config) -> HilRequest:
    """Return the request from pytest's options."""
    simulate = str(config.getoption("--hil-simulate"))
    return HilRequest(
        cell=config.getoption("--cell"),
        level=Level.of(config.getoption("--hil-level")),
        max_force_n=config.getoption("--hil-max-force"),
        simulate=tuple(filter(None, simulate.split(","))),
        motion=config.getoption("--hil-motion"),
        record=config.getoption("--hil-record"),
    )


def foreseen(asked: HilRequest) -> HilBench:
    """Return the bench to describe the motion, without opening or starting anything. ConfigError or PluginError."""
    _require(asked)
    config = load_config(asked.cell)
    require_simulated(config, asked.simulate)
    if asked.record is not None:
        place(asked.record, config)
    hooks = plugins_of(config)
    hooks.report.require()
    return HilBench(asked, config, hooks)


@contextmanager
def bench(asked: HilRequest) -> Iterator[HilBench]:
    """Lock the cell against daemons, run its simulated devices, claim its addresses; errors come before the suites."""
    config = foreseen(asked).config
    with (
        locked(config.state_dir),
        tempfile.TemporaryDirectory(prefix="polishd-hil-") as scratch,
        simulated_devices(config, asked.simulate, Path(scratch)) as laid_over,
    ):
        config = load_config(asked.cell, {**laid_over, **_one_cycle(asked, config, Path(scratch))})
        hooks = plugins_of(config)
        hooks.report.require()
        cell = build_cell(config, hooks)
        if asked.level >= Level.CYCLE:
            require_time_limits(config, cell)
        claims = KeptClaims(config.cell.name, "polishd hil")
        try:
            run_loop(_claim(config, hooks, claims))
            with recording_to(place(asked.record, config), config) if asked.record else nullcontext():
                yield HilBench(asked, config, hooks)
        finally:
            claims.release()


async def _claim(config: CellConfig, hooks: Hooks, claims: KeptClaims) -> None:
    """Claim the devices' addresses during the suites, so that no other program connects between two tests.

    DeviceClaimed if another program has one. The suites report a device that does not answer.
    """
    devices = build_cell(config, hooks).devices
    with claims.keeping():
        for name in filter(_acts, devices):
            device = devices[name]
            try:
                async with asyncio.timeout(OPEN_S):
                    await device.open()
            except DeviceClaimed:
                raise
            except (PolishdError, TimeoutError):
                continue
            finally:
                await device.close()


def _one_cycle(asked: HilRequest, config: CellConfig, scratch: Path) -> dict[str, Any]:
    """Return the config overrides of one cycle: its estimates are dropped, its run folder is kept."""
    if asked.level < Level.CYCLE:
        return {}
    return {
        "cell.state_dir": str(scratch / "state"),
        "cell.run_dir": str(config.state_dir / "runs" / f"hil-{datetime.now(UTC):%Y%m%dT%H%M%S}"),
        "job.max_cycles": 1,
        "process.force_n": min(config.process.force_n, asked.max_force_n or config.process.force_n),
    }


def _require(asked: HilRequest) -> None:
    if asked.level >= Level.CONTACT and asked.max_force_n is None:
        raise ConfigError("--level contact and cycle need --max-force NEWTONS. Add it with the largest allowed force")
    if asked.max_force_n is not None and not 0.0 < asked.max_force_n < 1000.0:
        raise ConfigError(f"--max-force {asked.max_force_n:g} N: must be greater than 0. Set it in N")


def _acts(device: str) -> bool:
    return PORTS[port_of(device)].acts


def _repeated(motion: Path) -> Any:
    """Return a function of the block number that repeats the blocks of a program."""
    try:
        lines = [line.strip() for line in motion.read_bytes().splitlines() if line.strip()]
    except OSError as error:
        raise ConfigError(f"--motion {motion}: cannot be read: {error.strerror}. Name the program's file") from error
    if not lines:
        raise ConfigError(f"--motion {motion}: the program has no blocks. Name a program that moves in the air")
    return lambda number: lines[number % len(lines)]


def words(bench: HilBench) -> Sequence[str]:
    """Return the description, one line per device."""
    level = bench.asked.level.name.lower().replace("_", "-")
    rows = [f"{name} ({what.strip()}): {happens}" for name, what, happens in bench.does()]
    return [f"{bench.config.cell.name}, level {level}, one device after another:", *rows]
