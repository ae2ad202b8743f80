"""Start, identity and end of every simulated process. Each one ends with its parent."""

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

# The local socket between the plant and the devices: which devices are there, their motion, and the time up to which
# each vouches for it.

ROW = ("seq", "wall0", "wall1", "dt", "x", "y", "z", "a", "c")
"""Columns of motion rows: block, wall seconds from and to, process seconds, pose half-way (program frame, mm, deg)."""

SOCKET = "plant.sock"
_HEAD = struct.Struct(">IB")

Message = dict[str, Any]


def pack_json(message: Message) -> bytes:
    """Return a JSON frame."""
    payload = json.dumps(message, separators=(",", ":")).encode()
    return _HEAD.pack(len(payload), 0) + payload


def pack_rows(rows: FloatArray) -> bytes:
    """Return a frame of (n, k) float64 rows."""
    body = np.ascontiguousarray(rows, dtype="<f8").tobytes()
    return _HEAD.pack(len(body) + 4, 1) + struct.pack(">I", rows.shape[1]) + body


async def read_frame(reader: asyncio.StreamReader) -> Message | FloatArray | None:
    """Return the next frame, or None at the end of the connection."""
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
    """Return the socket's path through an open folder: the path of the folder may be too long for a socket address."""
    return f"/proc/self/fd/{folder}/{SOCKET}"


@dataclass
class PlantLink:
    """The device end of the socket. Sends never wait; ``run`` reads until the plant is gone."""

    device: str
    welcome: Message
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    on_message: Callable[[Message | FloatArray], None] = field(default=lambda _message: None)
    on_force: Callable[[float], None] = field(default=lambda _acting_n: None)
    """Called with the force between tool and part, in N."""

    def event(self, name: str, at_s: float | None = None, **data: Any) -> None:
        """Report an event and its time (time.monotonic) to the event log."""
        self.send_message(event=name, t=time.monotonic() if at_s is None else at_s, **data)

    def samples(self, values: list[tuple[float, float]], mark_s: float) -> None:
        """Send (time, value) points of this device's force or speed, and the time up to which they hold."""
        self.send_message(samples=values, mark=mark_s)

    def rows(self, rows: FloatArray, mark_s: float, pose: tuple[float, ...]) -> None:
        """Send motion since the last call and the pose at its end; time without rows was standstill."""
        if len(rows):
            self.writer.write(pack_rows(rows))
        self.send_message(mark=mark_s, pose=pose)

    def pace(self, pace: float, at_s: float) -> None:
        """Send the planned motion within a second of motion, from then on (time.monotonic)."""
        self.send_message(pace=pace, t=at_s)

    def send_message(self, **message: Any) -> None:
        """Send any other message."""
        if not self.writer.is_closing():
            self.writer.write(pack_json(message))

    async def run(self) -> None:
        """Pass on the plant's messages; return when it is gone."""
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
"""Folder of the package."""


def read_config(path: Path) -> SimConfig:
    """Read SIM.toml. ConfigError, too, where it scripts a fault that its device or link cannot have."""
    config = load_simulator(path, config_model)
    require_possible(config)
    return config


@dataclass(frozen=True, slots=True)
class Start:
    """Start arguments of a process."""

    config: SimConfig
    state: Path
    seed: int
    speed: float
    surface: Path | None = None
    rebooted: bool = False
    only: tuple[str, ...] = ()
    """Devices that the supervisor starts; empty: all of the config."""

    def again(self) -> Start:
        """Return the start with the present content of SIM.toml."""
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
    """Callbacks that run when SIM.toml was read again."""
    script: FaultScript = field(init=False)

    def __post_init__(self) -> None:
        """Create it with the faults of its device."""
        self.script = FaultScript(self.name, self.start.seed, self.link.event, reboot=self.reboot)

    def begin_script(self) -> None:
        """Begin the faults of SIM.toml."""
        self.script.set(self.start.config.fault, time.monotonic(), rebooted=self.start.rebooted)
        self.group.create_task(self.script.run())

    def ready(self, endpoint: str) -> None:
        """Report to the supervisor that the device answers there."""
        announce(self.name, endpoint)
        self.link.event("boot", boot_id=self.boot_id, boot_count=self.boot_count)

    def button(self, number: signal.Signals, action: Callable[[], object], fault: str = "") -> None:
        """Trigger a fault by the signal that a test or a person sends to this process, or by ``[[fault]]``."""
        if fault:
            self.script.panel[fault] = action

        def pressed() -> None:
            self.link.event("button", signal=number.name)
            action()

        asyncio.get_running_loop().add_signal_handler(number, pressed)

    def again(self) -> None:
        """Read SIM.toml again: faults and the truth may change; ports, times and paths stay."""
        self.start = self.start.again()
        self.script.set(self.start.config.fault, time.monotonic())
        for callback in self.on_again:
            callback()

    async def serve(self, protocol: Callable[[], asyncio.Protocol], port: int) -> int:
        """Listen on loopback; return the port. Port 0 becomes the port of the last start, if it is free."""
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
        """Lose power and come up again in the same process."""
        self.link.event("reboot")
        self.group.create_task(self._reboot())

    async def _reboot(self) -> None:
        await self.link.writer.drain()
        known = [argument for argument in sys.argv[1:] if argument != "--rebooted"]
        arguments = [sys.executable, "-m", "polishd.sim_backends", *known, "--rebooted"]
        terminal = self.start.state / self.name
        if terminal.is_symlink():
            terminal.unlink()  # the terminal ends with this program, and the kernel gives its number to the next one
        os.execv(sys.executable, arguments)  # noqa: S606  (no shell: the process replaces itself)


Device = Callable[[SimRuntime], Coroutine[Any, Any, None]]


def as_hardware() -> None:
    """Raise the priority where that is allowed: a busy computer must not starve a simulated machine.

    Garbage is not collected before the device is up, see `announce`: all objects made on the way there stay.
    """
    gc.disable()
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, -10)


def announce(name: str, endpoint: str) -> None:
    """Write one line for the supervisor.

    The objects that exist by now stay, and the garbage collector skips them from now on: half a million objects of an
    OPC UA server took it 0.3 s, and ten times as long beside ten busy programs. No hardware pauses for so long.
    """
    gc.freeze()
    gc.enable()
    with contextlib.suppress(BrokenPipeError):
        print(json.dumps({"ready": name, "endpoint": endpoint, "pid": os.getpid()}), flush=True)  # noqa: T201


def replace_file(path: Path, data: bytes) -> None:
    """Replace a file whole."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    beside.write_bytes(data)
    beside.replace(path)


async def until_ended(stop: asyncio.Event) -> None:
    """Set ``stop`` at SIGTERM, at SIGINT, or when the parent is gone; return then."""
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
    """Connect to the plant and run the device until the process, the plant or the parent ends."""
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
