"""A real cell under the suites: what is asked of its devices at each level, and said before anything moves."""

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
from polishd.testing.device_rig import Rig, TestScope
from polishd.util.address_claims import KeptClaims
from polishd.util.threads import run_loop

# polishd's simulated devices in the places of some of a cell's, beside the real ones.

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
"""The cell's part, with the substitute of each port. The robot holds the tool's tip on the part, so that the actuator
has something to press on."""
ALWAYS = ("robot", "actuator", "spindle")
"""Sections that are in it."""


def require_simulated(config: CellConfig, names: Sequence[str]) -> None:
    """ConfigError where one of these devices is not in the cell, or no simulated device can take its place."""
    own = load_own()
    for name in names:
        if name not in config.devices:
            raise ConfigError(f"--simulate {name}: the cell has {', '.join(config.devices)}")
        if _substitute(own, port_of(name)) is None:
            simulated = join_words(port for port in PORTS if _substitute(own, port))
            raise ConfigError(f"--simulate {name}: only {simulated} are simulated")
    ports = [port_of(name) for name in names]
    if len(set(ports)) < len(ports):
        raise ConfigError(f"--simulate {','.join(names)}: one device of a port is simulated, not several")


@contextmanager
def stand_ins(config: CellConfig, names: Sequence[str], folder: Path) -> Iterator[dict[str, Any]]:
    """Simulated devices, running in this block; gives what to lay over the cell's config, by dotted key."""
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
    """The port's substitute, where it is reached at an address."""
    kind = own.substitute(port)
    return kind if kind is not None and "address" in kind.options.model_fields else None


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


SOON_S = 60.0
SUITES = ("device", "robot", "spindle", "actuator", "cycle")
"""In the order in which they are run: first what moves nothing, last what presses."""


class Level(IntEnum):
    """How far the suites go; each level does what those before it do, too."""

    IDENTIFY = 0
    NO_CONTACT = 1
    CONTACT = 2
    CYCLE = 3

    @classmethod
    def of(cls, word: str) -> Level:
        """As it is written: ``no-contact``."""
        return cls[word.upper().replace("-", "_")]


NEEDED = {
    "polishd_moves": Level.NO_CONTACT,
    "polishd_presses": Level.CONTACT,
    "polishd_cycles": Level.CYCLE,
}
"""The level of a test, by its marks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HilRequest:
    """What a person wants tried."""

    cell: Path
    level: Level = Level.IDENTIFY
    max_force_n: float | None = None
    """Nothing is pressed harder; needed where anything is pressed."""
    simulate: tuple[str, ...] = ()
    """Devices of the cell that are simulated, by name."""
    motion: Path | None = None
    """A program that the robot may run in the air, again and again, block by block."""
    record: Path | None = None
    """File, or folder, that takes what passes on the devices' links."""


@dataclass(frozen=True)
class CellDevice:
    """A device of a cell as a case of the suites: of each test it is built anew, and left safe."""

    config: CellConfig
    hooks: Hooks
    device: str
    scope: TestScope

    @property
    def __name__(self) -> str:
        """In the names of tests."""
        return self.device

    @asynccontextmanager
    async def __call__(self, _folder: Path) -> AsyncIterator[Rig[Device]]:
        """The rig of one test; its link is never cut, and nobody but the device says whether it is at rest."""
        device = build_cell(self.config, self.hooks).devices[self.device]
        try:
            yield Rig(device, scope=self.scope, soon_s=SOON_S)
        finally:
            await device.make_safe()
            await device.close()


@dataclass(frozen=True)
class HilBench:
    """A cell that the suites may use, and nobody else."""

    asked: HilRequest
    config: CellConfig
    hooks: Hooks

    def cases(self, fixture: str) -> list[CellDevice]:
        """Of the suite whose fixture that is: all devices that act, or those of the port."""
        names = [name for name in self.config.devices if fixture in {"any_device", port_of(name)} and _acts(name)]
        scope = self.scope()
        return [CellDevice(self.config, self.hooks, name, scope) for name in names]

    def scope(self) -> TestScope:
        """What is asked of the devices: what the cell's own job asks, never harder, and nothing beyond its limits."""
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
        """A test with these marks goes no further than the level, and needs nothing that a real cell cannot give."""
        if marks & {"polishd_cuts", "polishd_mutes", "polishd_fresh"}:
            return False
        return all(self.asked.level >= level for mark, level in NEEDED.items() if mark in marks)

    def does(self) -> Iterator[tuple[str, str, str]]:
        """(device, real or simulated and what it is, what happens to it) in words, before anything does."""
        for name, section in self.config.devices.items():
            kind = "simulated, in place of" if name in self.asked.simulate else "REAL,"
            address = (section.model_extra or {}).get("address", "")
            yield name, f"{kind} {section.type} {address}".strip(), self._moves(name)
        if self.asked.level >= Level.CYCLE:
            yield "all of them", f"the job of {self.config.path.name}", self._polishes()

    def _polishes(self) -> str:
        return (
            f"last of all ONE CYCLE: the part is measured, POLISHED along {self.config.program_path.name} with "
            f"{self.scope().force_n:g} N and {self.config.process.rpm:g} rpm, and measured"
        )

    def _moves(self, name: str) -> str:
        port, scope, level = port_of(name), self.scope(), self.asked.level
        if not _acts(name):
            return "is not tried: polishd probe asks it who it is"
        safe = {"robot": "is held", "actuator": "takes the force off and lifts", "spindle": "stops"}
        said = f"is opened, asked who it is, made safe ({safe.get(port, 'stops')}) and closed, again and again"
        if level >= Level.NO_CONTACT and port == "spindle":
            said += f"; TURNS with up to {scope.rpm:g} rpm, both ways"
        if level >= Level.NO_CONTACT and port == "robot" and scope.block is None:
            said += "; does not move: no --motion PROGRAM says where it may"
        elif level >= Level.NO_CONTACT and port == "robot":
            said += f"; MOVES along {self.asked.motion}, again and again, and lifts off it by 15 mm"
        if level >= Level.CONTACT and port == "actuator":
            said += f"; LANDS and PRESSES with up to {scope.force_n:g} N on what is below the tool now"
        return said


def asked_in(config: pytest.Config) -> HilRequest:
    """What the options of pytest ask for."""
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
    """The cell as it would be tried, to say what will move: nothing is opened or started. Config- or PluginError."""
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
    """The cell, locked against daemons, its stand-ins running, its addresses claimed; errors before the suites."""
    config = foreseen(asked).config
    with (
        locked(config.state_dir),
        tempfile.TemporaryDirectory(prefix="polishd-hil-") as scratch,
        stand_ins(config, asked.simulate, Path(scratch)) as laid_over,
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
    """Claim the devices' addresses for as long as the suites run: between two tests no other program gets in.

    DeviceClaimed where another program has one. A device that does not answer is for the suites to report.
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
    """What to lay over the cell's config for it: what it learns is forgotten, what it did stays in a run folder."""
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
        raise ConfigError("from --level contact on --max-force NEWTONS is needed: nothing is pressed harder")
    if asked.max_force_n is not None and not 0.0 < asked.max_force_n < 1000.0:
        raise ConfigError(f"--max-force {asked.max_force_n:g}: give newtons, more than 0")


def _acts(device: str) -> bool:
    return PORTS[port_of(device)].acts


def _repeated(motion: Path) -> Any:
    """The blocks of a program, one after another, from its beginning again after its last."""
    try:
        lines = [line.strip() for line in motion.read_bytes().splitlines() if line.strip()]
    except OSError as error:
        raise ConfigError(f"--motion {motion}: {error.strerror}") from error
    if not lines:
        raise ConfigError(f"--motion {motion}: it has no blocks")
    return lambda number: lines[number % len(lines)]


def words(bench: HilBench) -> Sequence[str]:
    """The same, a line each."""
    level = bench.asked.level.name.lower().replace("_", "-")
    rows = [f"{name} ({what.strip()}): {happens}" for name, what, happens in bench.does()]
    return [f"{bench.config.cell.name}, level {level}, one device after another:", *rows]
