"""What every simulated process shares: its start, its identity, its end. None outlives its parent."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import signal
import sys
import time
import uuid
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

from polishd.config.simulator import SimConfig, load_simulator
from polishd.sim_backends import bus
from polishd.sim_backends.faults.links import require_possible
from polishd.sim_backends.faults.script import FaultScript

LOOPBACK = "127.0.0.1"
PARENT_S = 0.2
ROOT = Path(__file__).resolve().parents[2]
"""Where the package lies."""


def read_config(path: Path) -> SimConfig:
    """SIM.toml; ConfigError, too, where it scripts a fault that its device or its link cannot have."""
    config = load_simulator(path)
    require_possible(config)
    return config


@dataclass(frozen=True, slots=True)
class Start:
    """How a process was asked to start."""

    config: SimConfig
    state: Path
    seed: int
    speed: float
    surface: Path | None = None
    rebooted: bool = False
    only: tuple[str, ...] = ()
    """Devices that the supervisor starts; empty: all that the config has."""

    def again(self) -> Start:
        """With what SIM.toml says now."""
        return changed(self, config=read_config(Path(self.config.source.file)))


@dataclass(slots=True)
class SimRuntime:
    """A running device process."""

    name: str
    start: Start
    boot_count: int
    link: bus.PlantLink
    group: asyncio.TaskGroup
    stop: asyncio.Event = field(default_factory=asyncio.Event)
    boot_id: str = field(default_factory=lambda: uuid.uuid4().hex[:12])
    on_again: list[Callable[[], object]] = field(default_factory=list)
    """Who keeps a copy of what SIM.toml says: called when it was read again."""
    script: FaultScript = field(init=False)

    def __post_init__(self) -> None:
        """With the faults of its own."""
        self.script = FaultScript(self.name, self.start.seed, self.link.event, reboot=self.reboot)

    def begin_script(self) -> None:
        """From now on the faults of SIM.toml happen."""
        self.script.set(self.start.config.fault, time.monotonic(), rebooted=self.start.rebooted)
        self.group.create_task(self.script.run())

    def ready(self, endpoint: str) -> None:
        """Tell the supervisor that the device answers there."""
        announce(self.name, endpoint)
        self.link.event("boot", boot_id=self.boot_id, boot_count=self.boot_count)

    def button(self, number: signal.Signals, action: Callable[[], object]) -> None:
        """A fault at the press of a button: the signal that a test, or a person, sends to this process."""

        def pressed() -> None:
            self.link.event("button", signal=number.name)
            action()

        asyncio.get_running_loop().add_signal_handler(number, pressed)

    def again(self) -> None:
        """Read SIM.toml again: faults and the truth may be others from now on; ports, times and places stay."""
        self.start = self.start.again()
        self.script.set(self.start.config.fault, time.monotonic())
        for told in self.on_again:
            told()

    async def serve(self, protocol: Callable[[], asyncio.Protocol], port: int) -> int:
        """Listen on loopback; returns the port. A port of 0 becomes the one of the last start, if it is free."""
        loop = asyncio.get_running_loop()
        kept = self.start.state / f".{self.name}.port"
        wishes = [port] if port else [*map(int, _read(kept).split()), 0]
        for wish in wishes:
            try:
                server = await loop.create_server(protocol, LOOPBACK, wish)
            except OSError:
                if wish == wishes[-1]:
                    raise
                continue
            got = int(server.sockets[0].getsockname()[1])
            if not port:
                kept.write_text(str(got))
            return got
        return 0

    def reboot(self) -> None:
        """Lose power, and come up again in the same process."""
        self.link.event("reboot")
        self.group.create_task(self._reboot())

    async def _reboot(self) -> None:
        await self.link.writer.drain()
        known = [argument for argument in sys.argv[1:] if argument != "--rebooted"]
        arguments = [sys.executable, "-m", "polishd.sim_backends", *known, "--rebooted"]
        terminal = self.start.state / self.name
        if terminal.is_symlink():
            terminal.unlink()  # the terminal ends with this program, and its number is the next one's
        os.execv(sys.executable, arguments)  # noqa: S606  (no shell: the process replaces itself)


Device = Callable[[SimRuntime], Coroutine[Any, Any, None]]


def as_hardware() -> None:
    """Before other programs, where that is allowed: what stands for a machine is not starved by a busy computer.

    Nothing is collected until it is up, see `announce`: on the way there all that is made stays.
    """
    gc.disable()
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)


def announce(name: str, endpoint: str) -> None:
    """One line for the supervisor.

    What the process has by now it has for good, and the garbage collector is to look at it no more: half a million
    objects of an OPC UA server took it 0.3 s, and ten times as long beside ten busy programs. No hardware pauses so.
    """
    gc.freeze()
    gc.enable()
    with contextlib.suppress(BrokenPipeError):
        print(json.dumps({"ready": name, "endpoint": endpoint, "pid": os.getpid()}), flush=True)  # noqa: T201


def replace_file(path: Path, data: bytes) -> None:
    """Write a file whole."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    beside.write_bytes(data)
    beside.replace(path)


async def until_ended(stop: asyncio.Event) -> None:
    """Set ``stop`` at SIGTERM, SIGINT, or when the parent is gone; returns then."""
    loop = asyncio.get_running_loop()
    parent = os.getppid()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    while not stop.is_set() and os.getppid() == parent:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(PARENT_S):
                await stop.wait()
    stop.set()


async def run_device(name: str, start: Start, device: Device, **hello: Any) -> None:
    """Connect to the plant, run the device until the end of the process, the plant or the parent."""
    link = await bus.connect(start.state, name, **hello)
    async with asyncio.TaskGroup() as group:
        runtime = SimRuntime(name, start, _power_up(start.state, name), link, group)
        link.on_force = runtime.script.feel
        runtime.button(signal.SIGHUP, runtime.again)
        group.create_task(_until_plant_ends(runtime))
        group.create_task(device(runtime))
        await until_ended(runtime.stop)
        cancel_all()
    link.writer.close()


def cancel_all() -> None:
    """End every other task of this process."""
    for task in asyncio.all_tasks() - {asyncio.current_task()}:
        task.cancel()


async def _until_plant_ends(runtime: SimRuntime) -> None:
    await runtime.link.run()
    runtime.stop.set()


def _power_up(state: Path, name: str) -> int:
    """Count power-ups, as a device with a memory does."""
    file = state / f".{name}.boots"
    count = int(_read(file) or 0) + 1
    file.write_text(str(count))
    return count


def _read(path: Path) -> str:
    return path.read_text() if path.exists() else ""
