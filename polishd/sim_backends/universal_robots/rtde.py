"""RTDE, the controller's side: recipes, samples at the rate of each client, and inputs that one client holds."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from polishd.sim_backends.universal_robots.arm import REGISTERS
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
