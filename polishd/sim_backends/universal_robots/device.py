"""The process of the controller: three servers, its clock, its operator's buttons, and reports to the plant."""

from __future__ import annotations

import asyncio
import gc
import hashlib
import re
import signal
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator import MOTION, SimRobotSection
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.universal_robots.arm import (
    BLOCK_REGISTER,
    NORMAL,
    PAUSED,
    PAUSING,
    POWER_OFF,
    PROTECTIVE_STOP,
    RUNNING,
    STOPPED,
    UrArm,
    wrist_deg,
)
from polishd.sim_backends.universal_robots.controller import UrController
from polishd.sim_backends.universal_robots.rtde import InputOwnership, RtdeClient

# The dashboard server: a line in, a line out. It serves any number of clients at once, as a real one does.

GREETING = b"Connected: Universal Robots Dashboard Server\n"
_SAFETY = {NORMAL: "NORMAL", PROTECTIVE_STOP: "PROTECTIVE_STOP"}
DASHBOARD_LINE_BYTES = 1000


@dataclass(slots=True)
class Dashboard:
    """One connection. Requests that stop or pause are answered when that is done."""

    machine: UrController
    send: Callable[[bytes], None]
    later: Callable[[Callable[[], bool], Callable[[], None]], None]
    """Call the second function once the first returns true."""
    _rest: bytes = b""

    def feed(self, data: bytes) -> None:
        """Answer each whole line."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-DASHBOARD_LINE_BYTES:]
        for line in lines:
            self._answer(line.decode("utf-8", "replace").strip())

    def _reply(self, text: str) -> None:
        self.send(text.encode() + b"\n")

    def _answer(self, request: str) -> None:
        machine = self.machine
        if request == "stop":
            machine.stop()
            self.later(lambda: machine.runtime == STOPPED, lambda: self._reply("Stopped"))
        elif request == "pause":
            paused = machine.pause()
            if paused:
                self.later(lambda: machine.runtime != PAUSING, lambda: self._reply("Pausing program"))
            else:
                self._reply("Failed to execute: pause")
        else:
            self._reply(self._order(request) or self._state(request) or f"could not understand: '{request}'")

    def _order(self, request: str) -> str:
        machine = self.machine
        if request == "play":
            return "Starting program" if machine.play() else "Failed to execute: play"
        if request == "power off":
            machine.power_off()
            return "Powering off"
        if request in {"power on", "brake release"}:
            machine.robot_mode = RUNNING if machine.safety_mode == NORMAL else POWER_OFF
            return "Powering on" if request == "power on" else "Brake releasing"
        if request == "unlock protective stop":
            machine.unlock()
            return "Protective stop releasing"
        verb, _, rest = request.partition(" ")
        replies = {"popup": "showing popup", "close": "closing popup", "addToLog": "Added log message"}
        return f"File not found: {rest}" if verb == "load" else replies.get(verb, "")

    def _state(self, request: str) -> str:
        machine = self.machine
        modes = {RUNNING: "RUNNING", POWER_OFF: "POWER_OFF"}
        program = "STOPPED" if machine.program is None else "PAUSED" if machine.runtime == PAUSED else "PLAYING"
        known = {
            "running": f"Program running: {str(machine.runtime != STOPPED).lower()}",
            "robotmode": f"Robotmode: {modes.get(machine.robot_mode, 'IDLE')}",
            "safetymode": f"Safetymode: {_SAFETY.get(machine.safety_mode, 'ROBOT_EMERGENCY_STOP')}",
            "safetystatus": f"Safetystatus: {_SAFETY.get(machine.safety_mode, 'ROBOT_EMERGENCY_STOP')}",
            "programState": f"{program} polishd",
            "get loaded program": "No program loaded",
            "isProgramSaved": "true",
            "is in remote control": str(machine.remote).lower(),
            "PolyscopeVersion": "URSoftware 5.11.0.0 (simulated)",
            "version": "URSoftware 5.11.0.0 (simulated)",
            "get robot model": "UR5",
            "get serial number": "SIM-UR1",
            "quit": "Disconnected",
        }
        return known.get(request, "")


# The primary client interface: scripts as text, one error message for each script, and a state message at intervals.

_DEPTH = re.compile(rb"^[ \t]*(?:def|thread|while|if|sec)\b.*:[ \t]*(?:#.*)?\r?$")
_END = re.compile(rb"^[ \t]*end[ \t]*(?:#.*)?\r?$")
PRIMARY_BYTES = 64 << 20
STATE = 16


def message(kind: int, payload: bytes) -> bytes:
    """Return a message."""
    return struct.pack(">iB", 5 + len(payload), kind) + payload


def complaint(line: int, text: str) -> bytes:
    """Return a runtime exception: line in the script, and text."""
    head = struct.pack(">QbBii", time.monotonic_ns() // 1000, -2, 10, line, 0)
    return message(20, head + text.encode())


@dataclass(slots=True)
class ScriptIntake:
    """Collect lines until a ``def`` has its end; single lines are dropped, they are separate programs."""

    run: Callable[[str], None]
    _rest: bytes = b""
    _depth: int = 0
    _lines: list[bytes] = field(default_factory=list)

    def feed(self, data: bytes) -> None:
        """Return each whole script."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            self._take(line)

    def _take(self, line: bytes) -> None:
        opens, closes = _DEPTH.match(line) is not None, _END.match(line) is not None
        if not self._lines and not opens:
            return
        self._lines.append(line)
        self._depth += opens - closes
        if self._depth == 0:
            lines, self._lines = self._lines, []
            self.run(b"\n".join(lines).decode("utf-8", "replace"))


TICK_S = 0.004
STATE_S = 0.1
READ_S = 0.005
"""Duration of a turn, while a script is read."""
_BLOCKS = re.compile(rf"(?:polishd_at\(|write_output_integer_register\({BLOCK_REGISTER}, )(\d+)\)")


class UniversalRobotServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime) -> None:
        start, config = runtime.start, runtime.start.config.robot
        hidden = hidden_truth.draw(start.config.hidden_truth, start.seed)
        arm = UrArm.at(tuple(runtime.link.welcome.get("pose") or config.home))
        self.machine = UrController(
            config, arm, 1.0 / config.cycle_hz, hidden.overhead_s, start.speed, time.monotonic()
        )
        self.machine.complain = self.complain
        runtime.script.suffer = self.machine.override.suffer
        self._runtime = runtime
        self._held = InputOwnership()
        self._rtde: list[RtdeClient] = []
        self._primary: list[FaultyLink] = []
        self._waiting: list[tuple[Callable[[], bool], Callable[[], None]]] = []
        self._blocks = 0
        """Of the last loaded script."""
        self._loading: Iterator[None] = iter(())
        self._moved = False
        self._seen = (self.machine.runtime, self.machine.safety_mode)

    async def run(self) -> None:
        """Tick until cancelled."""
        next_state = 0.0
        while True:
            self.advance()
            self._go_on_loading()
            if time.monotonic() >= next_state:
                next_state = time.monotonic() + STATE_S
                for outlet in self._primary:
                    outlet.send(message(STATE, b"\0" * 16))
            await asyncio.sleep(TICK_S)

    def advance(self) -> None:
        """Run frames up to the present, with a sample after each, and send the plant's rows."""
        machine = self.machine
        for _ in machine.due(time.monotonic()):
            before_s = machine.time_s
            machine.frame()
            for client in self._rtde:
                client.tick(before_s)
        self._report()
        due, self._waiting = self._waiting, []
        for condition, then in due:
            if condition():
                then()
            else:
                self._waiting.append((condition, then))

    def rtde(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of an RTDE client."""
        client = RtdeClient(self.machine, self._held, outlet.send, outlet.backlog)
        self._rtde.append(client)

        def closed() -> None:
            client.closed()
            self._rtde.remove(client)

        outlet.on_closed = closed
        return self._now(client.feed)

    def dashboard(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a dashboard client."""
        served = Dashboard(self.machine, outlet.send, lambda when, then: self._waiting.append((when, then)))
        return self._now(served.feed)

    def primary(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client that sends scripts."""
        self._primary.append(outlet)
        outlet.on_closed = lambda: self._primary.remove(outlet)
        return self._now(ScriptIntake(self.load).feed)

    def load(self, text: str) -> None:
        """Take a script: stop the running one at once, and read the new one in parts."""
        self._loading = self._load(text)
        self._go_on_loading()

    def _go_on_loading(self) -> None:
        """Read a part. Its half a million objects stay for good: no garbage collection shall search them."""
        until_s = time.monotonic() + READ_S
        for _ in self._loading:
            gc.freeze()
            if time.monotonic() >= until_s:
                return

    def _load(self, text: str) -> Iterator[None]:
        turned_s, longest_s = time.monotonic(), 0.0
        for _ in self.machine.loading(text):
            yield
            longest_s, turned_s = max(longest_s, time.monotonic() - turned_s), time.monotonic()
        runs = self.machine.program is not None
        self._blocks = max(map(int, _BLOCKS.findall(text)), default=0) + 1
        sha256 = hashlib.sha256(text.encode()).hexdigest()
        self._runtime.link.event(
            "program_loaded", sha256=sha256, blocks=self._blocks, runs=runs, longest_turn_s=round(longest_s, 4)
        )

    def complain(self, line: int, text: str) -> None:
        """Report to the sender of the script."""
        self._runtime.link.event("complaint", line=line, text=text)
        for outlet in self._primary:
            outlet.send(complaint(line, text))

    def _now(self, feed: Feed) -> Feed:
        """Apply received data from now on, not to frames that this process missed."""

        def act(data: bytes) -> None:
            self.advance()
            feed(data)

        return act

    def _report(self) -> None:
        """Send the motion since the last call to the plant, and vouch for it."""
        machine, link, now = self.machine, self._runtime.link, time.monotonic()
        rows = np.array(machine.rows).reshape(-1, 9)
        machine.rows.clear()
        for at_s, share in machine.shares:
            link.pace(share, at_s)
            machine.share = share
        machine.shares.clear()
        rows[rows[:, 0] >= self._blocks, 0] = -1.0  # of a script that is not from polishd
        moved = bool(len(rows)) or machine.active
        if moved and not self._moved:
            link.event("motion_started", float(rows[0, 1]) if len(rows) else now)
        mark = machine.wall_s()
        link.rows(rows, mark, (*machine.arm.place.xyz_mm, *wrist_deg(machine.arm.place.turn)))
        if self._moved and not moved:
            link.event("motion_stopped", mark)
        seen = (machine.runtime, machine.safety_mode)
        if seen != self._seen:
            link.event("controller", mark, runtime=machine.runtime, safety_mode=machine.safety_mode)
        self._moved, self._seen = moved, seen


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    server, config = UniversalRobotServer(runtime), runtime.start.config.robot
    receivers = {"rtde": server.rtde, "dashboard": server.dashboard, "primary": server.primary}
    wires = [SimWire(runtime, receive, link) for link, receive in receivers.items()]
    address = await wires[0].open_tcp(config.port)
    await wires[1].open_tcp(config.dashboard_port or config.port + 1, GREETING)
    await wires[2].open_tcp(config.primary_port or config.port + 2)
    machine = server.machine
    runtime.button(signal.SIGUSR1, machine.emergency_stop)
    runtime.button(signal.SIGUSR2, machine.pause)
    wires[0].ready(f"tcp://{address}")
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="universal_robots",
        device="robot",
        section=SimRobotSection,
        links={"universal_robots": {"rtde": "rtde", "dashboard": "dashboard", "primary": "primary"}},
        main=main,
        faults=MOTION,
    )
]
