"""What every simulated process shares: its start, its identity, its end. None outlives its parent."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import signal
import struct
import sys
import time
import uuid
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.simulator import SimConfig, load_simulator
from polishd.model.surface import FloatArray
from polishd.sim_backends.common.faults import FaultScript, require_possible
from polishd.sim_backends.common.registry import config_model

# The local socket between the plant and the devices: who is there, what they do, and up to when they vouch for it.

ROW = ("seq", "wall0", "wall1", "dt", "x", "y", "z", "a", "c")
"""Columns of motion rows: block, wall seconds from and to, process seconds, pose half-way (program frame, mm, deg)."""

SOCKET = "plant.sock"
_HEAD = struct.Struct(">IB")

Message = dict[str, Any]


def pack_json(message: Message) -> bytes:
    """A JSON frame."""
    payload = json.dumps(message, separators=(",", ":")).encode()
    return _HEAD.pack(len(payload), 0) + payload


def pack_rows(rows: FloatArray) -> bytes:
    """A frame of (n, k) float64 rows."""
    body = np.ascontiguousarray(rows, dtype="<f8").tobytes()
    return _HEAD.pack(len(body) + 4, 1) + struct.pack(">I", rows.shape[1]) + body


async def read_frame(reader: asyncio.StreamReader) -> Message | FloatArray | None:
    """The next frame, or None at the end of the connection."""
    try:
        length, kind = _HEAD.unpack(await reader.readexactly(_HEAD.size))
        payload = await reader.readexactly(length)
    except (asyncio.IncompleteReadError, ConnectionError):
        return None
    if kind == 0:
        message: Message = json.loads(payload)
        return message
    (columns,) = struct.unpack_from(">I", payload)
    return np.frombuffer(payload, dtype="<f8", offset=4).reshape(-1, columns)


def socket_path(folder: int) -> str:
    """The socket's path through an open folder: the folder's own path may be too long for a socket address."""
    return f"/proc/self/fd/{folder}/{SOCKET}"


@dataclass
class PlantLink:
    """A device's end. Sends never wait; ``run`` reads until the plant is gone."""

    device: str
    welcome: Message
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    on_message: Callable[[Message | FloatArray], None] = field(default=lambda _message: None)
    on_force: Callable[[float], None] = field(default=lambda _acting_n: None)
    """Told what acts between tool and part now, in N."""

    def event(self, name: str, at_s: float | None = None, **data: Any) -> None:
        """Tell the witness what happened, and when (time.monotonic)."""
        self.ask(event=name, t=time.monotonic() if at_s is None else at_s, **data)

    def samples(self, values: list[tuple[float, float]], mark_s: float) -> None:
        """(time, value) points of this device's force or speed, and up to when they hold."""
        self.ask(samples=values, mark=mark_s)

    def rows(self, rows: FloatArray, mark_s: float, pose: tuple[float, ...]) -> None:
        """Motion since the last call, and the pose at its end; what is not covered by rows was standstill."""
        if len(rows):
            self.writer.write(pack_rows(rows))
        self.ask(mark=mark_s, pose=pose)

    def pace(self, pace: float, at_s: float) -> None:
        """Planned motion within a second of motion, from then on (time.monotonic)."""
        self.ask(pace=pace, t=at_s)

    def ask(self, **message: Any) -> None:
        """Any other message."""
        if not self.writer.is_closing():
            self.writer.write(pack_json(message))

    async def run(self) -> None:
        """Hand over what the plant says; returns when it is gone."""
        while (message := await read_frame(self.reader)) is not None:
            if isinstance(message, dict) and "acting_n" in message:
                self.on_force(float(message["acting_n"]))
            self.on_message(message)


async def connect(state: Path, device: str, **hello: Any) -> PlantLink:
    """Connect a device to the plant of that state folder and introduce it."""
    folder = os.open(state, os.O_RDONLY | os.O_DIRECTORY)
    try:
        reader, writer = await asyncio.open_unix_connection(socket_path(folder), limit=1 << 26)
    finally:
        os.close(folder)
    writer.write(pack_json({"hello": device, "pid": os.getpid(), "t": time.monotonic(), **hello}))
    welcome = await read_frame(reader)
    if not isinstance(welcome, dict):
        raise ConnectionError(f"the plant in {state} did not answer")
    return PlantLink(device, welcome, reader, writer)


LOOPBACK = "127.0.0.1"
PARENT_S = 0.2
ROOT = Path(__file__).resolve().parents[3]
"""Where the package lies."""


def read_config(path: Path) -> SimConfig:
    """SIM.toml; ConfigError, too, where it scripts a fault that its device or its link cannot have."""
    config = load_simulator(path, config_model)
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
        return changed(self, config=read_config(self.config.path))


@dataclass(slots=True)
class SimRuntime:
    """A running device process."""

    name: str
    start: Start
    boot_count: int
    link: PlantLink
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
    link = await connect(start.state, name, **hello)
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
