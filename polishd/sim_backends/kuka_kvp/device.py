"""The process of the controller: the proxy on its TCP port, its clock, its operator's buttons, reports to the plant.

The proxy answers as C3 Bridge 1.7 does: big-endian headers, texts of messages 4 to 10 in UTF-16 LE, a footer of code
and flag. Modules are read from ``programs`` of the state folder when they are selected.
"""

from __future__ import annotations

import asyncio
import gc
import hashlib
import re
import signal
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import polishd.config
from polishd.config.simulator_devices import SimRobotSection
from polishd.config.simulator_faults import MOTION, PANEL
from polishd.model.errors import ProgramError
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.kuka_kvp.controller import KukaController, kuka_path
from polishd.sim_backends.kuka_kvp.krl import compiled, read_krl, shown
from polishd.sim_backends.universal_robots.arm import wrist_deg

# The proxy: a request, its answer.

_HEAD = struct.Struct(">HHB")
_TEXT = struct.Struct(">H")
READ_ASCII, WRITE_ASCII, READ, WRITE, READ_MANY, WRITE_MANY, CONTROL = 0, 1, 4, 5, 6, 7, 10
GENERAL, SUCCESS, NOT_IMPLEMENTED, PROTOCOL = 0, 1, 7, 9
RESET, START, STOP, CANCEL, SELECT, RUN = range(1, 7)
ROBOT = 1
"""Interpreter of a CONTROL request; 0 is the submit interpreter."""
PROXY = {"@PROXY_PORT": "7000", "@PROXY_TYPE": "c3bridge", "@PROXY_VERSION": "1.7.0", "PING": "PONG"}


def kvp_answer(number: int, kind: int, payload: bytes, code: int) -> bytes:
    """Return an answer."""
    body = payload + struct.pack(">HB", code, code == SUCCESS)
    return _HEAD.pack(number, 1 + len(body), kind) + body


class _Fields:
    """Fields of a request, in turn. struct.error or IndexError where it is too short."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def number(self, form: str) -> int:
        size = struct.calcsize(form)
        (value,) = struct.unpack_from(form, self._data, self._at)
        self._at += size
        return int(value)

    def text(self, *, wide: bool) -> str:
        size = self.number(">H") * (2 if wide else 1)
        if self._at + size > len(self._data):
            raise IndexError(size)
        raw = self._data[self._at : self._at + size]
        self._at += size
        return raw.decode("utf-16-le" if wide else "latin-1", "replace")


def _text(value: str, *, wide: bool) -> bytes:
    return _TEXT.pack(len(value)) + value.encode("utf-16-le" if wide else "latin-1", "replace")


@dataclass(slots=True)
class KvpClient:
    """One connection of the proxy."""

    machine: KukaController
    send: Callable[[bytes], None]
    select: Callable[[str, Callable[[int], None]], None]
    """Select a module and call back with the code."""
    has_c3: bool = True
    """False: it knows messages 0 and 1 only, as KUKAVARPROXY does."""
    _rest: bytes = b""

    def feed(self, data: bytes) -> None:
        """Answer each whole request."""
        self._rest += data
        while len(self._rest) >= _HEAD.size:
            number, length, kind = _HEAD.unpack_from(self._rest)
            if len(self._rest) < 4 + length:
                return
            payload, self._rest = self._rest[_HEAD.size : 4 + length], self._rest[4 + length :]
            try:
                self._request(number, kind, _Fields(payload))
            except (struct.error, IndexError):
                self.send(kvp_answer(number, kind, b"", PROTOCOL))

    def _request(self, number: int, kind: int, fields: _Fields) -> None:
        wide = kind not in (READ_ASCII, WRITE_ASCII)
        if wide and not self.has_c3:
            self.send(kvp_answer(number, kind, b"", GENERAL))
        elif kind in (READ_ASCII, READ, WRITE_ASCII, WRITE):
            name = fields.text(wide=wide)
            writes = kind in (WRITE_ASCII, WRITE)
            code, value = self._write(name, fields.text(wide=wide)) if writes else self._read(name)
            self.send(kvp_answer(number, kind, _text(value, wide=wide), code))
        elif kind in (READ_MANY, WRITE_MANY):
            found = []
            for _ in range(fields.number("B")):
                name = fields.text(wide=True)
                found.append(self._write(name, fields.text(wide=True)) if kind == WRITE_MANY else self._read(name))
            payload = bytes([len(found)]) + b"".join(bytes([code]) + _text(value, wide=True) for code, value in found)
            self.send(kvp_answer(number, kind, payload, SUCCESS if all(code for code, _ in found) else GENERAL))
        elif kind == CONTROL:
            self._control(number, fields)
        else:
            self.send(kvp_answer(number, kind, b"", NOT_IMPLEMENTED))

    def _read(self, name: str) -> tuple[int, str]:
        if name in PROXY and (self.has_c3 or name == "PING"):
            return SUCCESS, PROXY[name]
        try:
            return SUCCESS, shown(compiled(name)(self.machine.read))
        except (ProgramError, KeyError, TypeError):
            return GENERAL, ""

    def _write(self, name: str, text: str) -> tuple[int, str]:
        try:
            value = compiled(text)(self.machine.read)
            self.machine.write(name.upper(), value)
        except (ProgramError, KeyError, TypeError):
            return GENERAL, ""
        return SUCCESS, text

    def _control(self, number: int, fields: _Fields) -> None:
        machine, command, interpreter = self.machine, fields.number("B"), fields.number(">H")

        def answer(code: int) -> None:
            self.send(kvp_answer(number, CONTROL, bytes([command]), code))

        if command == SELECT:
            name, _parameters = fields.text(wide=True), fields.text(wide=True)
            if machine.state not in ("#P_FREE", "#P_RESET", "#P_END") and not fields.number("B"):
                answer(GENERAL)
            else:
                self.select(name, answer)
            return
        acts = {RESET: machine.reset, START: machine.start, STOP: machine.stop, CANCEL: machine.cancel}
        if command not in acts or interpreter != ROBOT:
            answer(NOT_IMPLEMENTED)
        else:
            answer(SUCCESS if acts[command]() else GENERAL)


# The process.

FRAME_S = 0.012
"""Interpolation cycle of a KR C4."""
TICK_S = 0.004
READ_S = 0.005
"""Duration of a turn, while a module is read."""
PROGRAMS = "programs"
MODULES = Path(polishd.config.__file__).with_name("robot_programs") / "kuka"
"""The modules that a shop installs: they are tested as they are."""
_BLOCKS = re.compile(r"POLISHD_BLOCK=(\d+)")


class KukaServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime, folder: Path) -> None:
        start, config = runtime.start, runtime.start.config.robot
        hidden = hidden_truth.draw(start.config.hidden_truth, start.seed)
        path = kuka_path(tuple(runtime.link.welcome.get("pose") or config.home), hidden.overhead_s)
        self.machine = KukaController(config, path, FRAME_S, hidden.accel_mm_s2, start.speed, time.monotonic())
        self.machine.complain = self.complain
        self.machine.boot(*(read_krl((MODULES / name).read_text()) for name in INSTALLED))
        runtime.script.suffer = self.machine.override.suffer
        self._runtime = runtime
        self._folder = folder
        self._blocks = 0
        """Of the selected module."""
        self._loading: Iterator[None] = iter(())
        self._moved = False
        self._seen = (self.machine.state, self.machine.mode, self.machine.stop_message)

    async def run(self) -> None:
        """Tick until cancelled."""
        while True:
            self.advance()
            self._go_on_loading()
            await asyncio.sleep(TICK_S)

    def advance(self) -> None:
        """Run frames up to the present, and send the plant's rows."""
        for _ in self.machine.due(time.monotonic()):
            self.machine.frame()
        self._report()

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client."""
        client = KvpClient(self.machine, outlet.send, self.select)

        def feed(data: bytes) -> None:
            self.advance()  # a request acts from now on, not on frames that this process missed
            client.feed(data)

        return feed

    def select(self, name: str, answer: Callable[[int], None]) -> None:
        """Select the module of that name: read it in parts, then answer."""
        self._loading = self._select(re.split(r"[/\\]", name)[-1].partition("(")[0], answer)
        self._go_on_loading()

    def _go_on_loading(self) -> None:
        until_s = time.monotonic() + READ_S
        for _ in self._loading:
            if time.monotonic() >= until_s:
                return

    def _select(self, name: str, answer: Callable[[int], None]) -> Iterator[None]:
        turned_s, longest_s = time.monotonic(), 0.0
        try:
            text, data = read_module(self._folder, name)
            for _ in self.machine.selecting(name, text, data):
                yield
                longest_s, turned_s = max(longest_s, time.monotonic() - turned_s), time.monotonic()
        except (OSError, ProgramError) as error:
            line, why = (int(error.args[1]), str(error.args[0])) if isinstance(error, ProgramError) else (0, str(error))
            self.complain(line, why)
            answer(GENERAL)
            return
        gc.freeze()  # its objects stay for good: no garbage collection shall search them
        self._blocks = max(map(int, _BLOCKS.findall(text)), default=0)
        sha256, longest_turn_s = hashlib.sha256(text.encode()).hexdigest(), round(longest_s, 4)
        self._runtime.link.event(
            "program_loaded", sha256=sha256, blocks=self._blocks, runs=False, longest_turn_s=longest_turn_s
        )
        answer(SUCCESS)

    def complain(self, line: int, text: str) -> None:
        """Write an error of a program to the event log: a real controller shows it at the pendant."""
        self._runtime.link.event("complaint", line=line, text=text)

    def _report(self) -> None:
        """Send the motion since the last call to the plant, and vouch for it."""
        machine, link, now = self.machine, self._runtime.link, time.monotonic()
        rows = np.array(machine.rows).reshape(-1, 9)
        machine.rows.clear()
        for at_s, share in machine.shares:
            link.pace(share, at_s)
            machine.share = share
        machine.shares.clear()
        rows[rows[:, 0] >= self._blocks, 0] = -1.0  # of a program that is not from polishd
        moved = bool(len(rows)) or machine.active
        if moved and not self._moved:
            link.event("motion_started", float(rows[0, 1]) if len(rows) else now)
        mark = machine.wall_s()
        link.rows(rows, mark, (*machine.path.pose.xyz_mm, *wrist_deg(machine.path.pose.turn)))
        if self._moved and not moved:
            link.event("motion_stopped", mark)
        seen = (machine.state, machine.mode, machine.stop_message)
        if seen != self._seen:
            link.event("controller", mark, state=machine.state, mode=machine.mode, stop_message=machine.stop_message)
        self._moved, self._seen = moved, seen


def read_module(folder: Path, name: str) -> tuple[str, str]:
    """Return the text of a module and of its data list; that is empty where there is none. OSError."""
    source, listed = (folder / f"{name.lower()}.{ending}" for ending in ("src", "dat"))
    return source.read_text("latin-1"), listed.read_text("latin-1") if listed.exists() else ""


INSTALLED = ("polishd_watch.dat", "polishd_watch.sub", "sps.sub")


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    folder = runtime.start.state / PROGRAMS
    folder.mkdir(exist_ok=True)
    server = KukaServer(runtime, folder)
    wire = SimWire(runtime, server.connected)
    address = await wire.open_tcp(runtime.start.config.robot.port)
    runtime.button(signal.SIGUSR1, server.machine.emergency_stop, "estop")
    runtime.button(signal.SIGUSR2, server.machine.turn_to_manual, "manual")
    wire.ready(f"tcp://{address}")
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="kuka_kvp",
        device="robot",
        section=SimRobotSection,
        links={"kuka_kvp": {"": "kvp"}},
        main=main,
        faults=(*MOTION, *PANEL),
    )
]
