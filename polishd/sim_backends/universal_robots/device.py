"""The process of the controller: three servers, its clock, its operator's buttons, and reports to the plant.

RTDE has recipes, samples at the rate of each client, and inputs that one client holds.
"""

from __future__ import annotations

import asyncio
import gc
import hashlib
import math
import re
import signal
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator_devices import SimRobotSection
from polishd.config.simulator_faults import MOTION
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
    REGISTERS,
    RUNNING,
    STOPPED,
    UrArm,
    wrist_deg,
)
from polishd.sim_backends.universal_robots.controller import UrController

# The fields of RTDE in this controller, with their types; those that it does not simulate are 0.

FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
_NAMES = {
    "DOUBLE": "timestamp actual_execution_time speed_scaling target_speed_fraction actual_momentum "
    "actual_main_voltage actual_robot_voltage actual_robot_current standard_analog_input0 standard_analog_input1 "
    "standard_analog_output0 standard_analog_output1 io_current payload tool_output_current tool_temperature",
    "VECTOR6D": "target_q target_qd target_qdd target_current target_moment actual_q actual_qd actual_current "
    "joint_control_output actual_TCP_pose actual_TCP_speed actual_TCP_force target_TCP_pose target_TCP_speed "
    "joint_temperatures actual_joint_voltage ft_raw_wrench payload_inertia tcp_offset",
    "VECTOR3D": "actual_tool_accelerometer elbow_position elbow_velocity payload_cog",
    "VECTOR6INT32": "joint_mode",
    "INT32": "robot_mode safety_mode safety_status tool_output_voltage",
    "UINT32": "runtime_state robot_status_bits safety_status_bits analog_io_types output_bit_registers0_to_31 "
    "output_bit_registers32_to_63 tool_mode",
    "UINT64": "actual_digital_input_bits actual_digital_output_bits",
}
OUTPUTS = {name: kind for kind, names in _NAMES.items() for name in names.split()}
OUTPUTS |= {f"output_int_register_{at}": "INT32" for at in range(REGISTERS)}
OUTPUTS |= {f"output_double_register_{at}": "DOUBLE" for at in range(REGISTERS)}
INPUTS = {
    "speed_slider_mask": "UINT32", "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8", "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8", "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8", "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8", "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE", "standard_analog_output_1": "DOUBLE",
}  # fmt: skip
INPUTS |= {f"input_int_register_{at}": "INT32" for at in range(REGISTERS)}
INPUTS |= {f"input_double_register_{at}": "DOUBLE" for at in range(REGISTERS)}
ON, PROGRAM_RUNS = 1, 2
_NORMAL_BIT, _PROTECTIVE_BIT, _EMERGENCY_BITS = 1, 4, 0x90
_JOINT_RUNNING = 253


def value(machine: UrController, name: str) -> float | Sequence[float]:
    """Return the present value of an output."""
    head, _, number = name.rpartition("_")
    if head == "output_int_register":
        return machine.ints_out[int(number)]
    if head == "output_double_register":
        return machine.doubles_out[int(number)]
    vector = _vectors(machine, name)
    if vector is not None:
        return vector
    known: dict[str, float] = {
        "timestamp": machine.time_s,
        "runtime_state": machine.runtime,
        "robot_mode": machine.robot_mode,
        "safety_mode": machine.safety_mode,
        "safety_status": machine.safety_mode,
        "target_speed_fraction": machine.slider * machine.override.reported(machine.wall_s()),
        "speed_scaling": machine.pace,
        "robot_status_bits": ON * (machine.robot_mode == 7) | PROGRAM_RUNS * (machine.runtime == 2),
        "safety_status_bits": {1: _NORMAL_BIT, 3: _PROTECTIVE_BIT}.get(machine.safety_mode, _EMERGENCY_BITS),
        "actual_main_voltage": 48.0,
        "actual_robot_voltage": 48.0,
    }
    return known.get(name, 0)


def _vectors(machine: UrController, name: str) -> Sequence[float] | None:
    if name in {"actual_TCP_pose", "target_TCP_pose"}:
        return machine.arm.pose_m()
    if name in {"actual_TCP_speed", "target_TCP_speed"}:
        return [*(part / 1000.0 for part in machine.arm.velocity), 0.0, 0.0, 0.0]
    if name == "joint_mode":
        return [_JOINT_RUNNING] * 6
    kind = OUTPUTS[name]
    return [0.0] * int(kind[6]) if kind.startswith("VECTOR") else None


def write(machine: UrController, name: str, number: float, mask: float) -> None:
    """Take a written input; ``mask`` is the last one of the same package."""
    head, _, at = name.rpartition("_")
    if head == "input_int_register":
        machine.ints_in[int(at)] = int(number)
    elif head == "input_double_register":
        machine.doubles_in[int(at)] = number
    elif name == "speed_slider_fraction" and mask and math.isfinite(number):
        machine.slider = min(max(number, 0.0), 1.0)
    machine.written(name)


def packed(machine: UrController, names: Sequence[str]) -> bytes:
    """Return the values of these outputs."""
    flat: list[float] = []
    for name in names:
        found = value(machine, name)
        flat += found if isinstance(found, Sequence) else [found]
    return struct.pack(">" + "".join(FORMATS[OUTPUTS[name]] for name in names), *flat)


HEAD = struct.Struct(">HB")
VERSION, CONTROLLER, TEXT, DATA, SET_OUTPUTS, SET_INPUTS, START, PAUSE = b"VvMUOISP"
SOFTWARE = (5, 11, 0, 0)
MOST_HZ = 1000.0
"""Samples in one wall second, at any speed of the controller's clock."""
BACKLOG = 1 << 17
"""A client that reads more slowly misses samples, as with the real robot."""


def pack(kind: int, payload: bytes = b"") -> bytes:
    """Return a package."""
    return HEAD.pack(HEAD.size + len(payload), kind) + payload


@dataclass(slots=True)
class InputOwnership:
    """The client that writes each input."""

    by: dict[str, RtdeClient] = field(default_factory=dict)


@dataclass(eq=False, slots=True)
class RtdeClient:
    """One connection."""

    machine: UrController
    held: InputOwnership
    send: Callable[[bytes], None]
    backlog: Callable[[], int] = lambda: 0
    outputs: tuple[str, ...] = ()
    rate_hz: float = 0.0
    started: bool = False
    inputs: dict[int, tuple[str, ...]] = field(default_factory=dict)
    _rest: bytes = b""
    _next_s: float = 0.0

    def feed(self, data: bytes) -> None:
        """Act on each whole package."""
        self._rest += data
        while len(self._rest) >= HEAD.size:
            size, kind = HEAD.unpack_from(self._rest)
            if size < HEAD.size or len(self._rest) < size:
                return
            payload, self._rest = self._rest[HEAD.size : size], self._rest[size:]
            self._take(kind, payload)

    def closed(self) -> None:
        """End the connection: its inputs are free and keep their values."""
        self.held.by = {name: client for name, client in self.held.by.items() if client is not self}

    def tick(self, before_s: float) -> None:
        """After a frame that began then, send a sample if one is due."""
        if not self.started or self.machine.time_s < self._next_s:
            return
        period_s = max(1.0 / self.rate_hz, self.machine.speed / MOST_HZ)
        self._next_s = max(self._next_s + period_s, before_s)
        if self.backlog() < BACKLOG:
            self.send(pack(DATA, b"\1" + packed(self.machine, self.outputs)))

    def _take(self, kind: int, payload: bytes) -> None:
        if kind == VERSION:
            self.send(pack(VERSION, bytes([payload == b"\0\2"])))
        elif kind == CONTROLLER:
            self.send(pack(CONTROLLER, struct.pack(">4I", *SOFTWARE)))
        elif kind == SET_OUTPUTS and len(payload) >= 8:
            self._set_outputs(payload)
        elif kind == SET_INPUTS:
            self._set_inputs(payload)
        elif kind == DATA and payload:
            self._write(payload)
        elif kind in {START, PAUSE}:
            self.started = kind == START and bool(self.outputs or self.inputs)
            self._next_s = self.machine.time_s
            self.send(pack(kind, bytes([kind == PAUSE or self.started])))
        else:
            text = b"unknown package"
            self.send(pack(TEXT, bytes([len(text)]) + text + b"\4RTDE" + b"\2"))

    def _set_outputs(self, payload: bytes) -> None:
        names = _names(payload[8:])
        types = [OUTPUTS.get(name, "NOT_FOUND") for name in names]
        good = "NOT_FOUND" not in types
        self.rate_hz = min(max(struct.unpack(">d", payload[:8])[0], 1.0), 1.0 / self.machine.frame_s)
        self.outputs = tuple(names) if good else ()
        self.send(pack(SET_OUTPUTS, bytes([good]) + ",".join(types).encode()))

    def _set_inputs(self, payload: bytes) -> None:
        names = _names(payload)
        types = [self._type(name) for name in names]
        number = 0
        if not {"NOT_FOUND", "IN_USE"} & set(types):
            number = len(self.inputs) + 1
            self.inputs[number] = tuple(names)
            self.held.by.update(dict.fromkeys(names, self))
        self.send(pack(SET_INPUTS, bytes([number]) + ",".join(types).encode()))

    def _type(self, name: str) -> str:
        if name not in INPUTS:
            return "NOT_FOUND"
        return INPUTS[name] if self.held.by.get(name, self) is self else "IN_USE"

    def _write(self, payload: bytes) -> None:
        names = self.inputs.get(payload[0])
        if names is None:
            return
        form = struct.Struct(">" + "".join(FORMATS[INPUTS[name]] for name in names))
        if len(payload) != 1 + form.size:
            return
        mask = 0.0
        for name, number in zip(names, form.unpack(payload[1:]), strict=True):
            mask = number if name.endswith("_mask") else mask
            write(self.machine, name, number, mask)


def _names(payload: bytes) -> list[str]:
    return payload.decode("ascii", "replace").rstrip(",").split(",")


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
    runtime.button(signal.SIGUSR1, machine.emergency_stop, "estop")
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
        faults=(*MOTION, "estop"),
    )
]
