"""RTDE, the controller's side: recipes, samples at the rate that each client asks for, inputs that one client holds."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from polishd.sim_backends.universal_robots import fields
from polishd.sim_backends.universal_robots.fields import FORMATS, INPUTS, OUTPUTS
from polishd.sim_backends.universal_robots.machine import UrController

HEAD = struct.Struct(">HB")
VERSION, CONTROLLER, TEXT, DATA, SET_OUTPUTS, SET_INPUTS, START, PAUSE = b"VvMUOISP"
SOFTWARE = (5, 11, 0, 0)
MOST_HZ = 1000.0
"""Samples a second of the wall's clock, however fast its own runs."""
BACKLOG = 1 << 17
"""A client that reads no faster than that misses samples, as with the real one."""


def pack(kind: int, payload: bytes = b"") -> bytes:
    """A package."""
    return HEAD.pack(HEAD.size + len(payload), kind) + payload


@dataclass(slots=True)
class InputOwnership:
    """Which client writes which inputs."""

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
        """The connection ended: its inputs are free, and keep their values."""
        self.held.by = {name: client for name, client in self.held.by.items() if client is not self}

    def tick(self, before_s: float) -> None:
        """After a frame that began then: send a sample if one is due."""
        if not self.started or self.machine.time_s < self._next_s:
            return
        period_s = max(1.0 / self.rate_hz, self.machine.speed / MOST_HZ)
        self._next_s = max(self._next_s + period_s, before_s)
        if self.backlog() < BACKLOG:
            self.send(pack(DATA, b"\1" + fields.packed(self.machine, self.outputs)))

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
            said = b"unknown package"
            self.send(pack(TEXT, bytes([len(said)]) + said + b"\4RTDE" + b"\2"))

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
            fields.write(self.machine, name, number, mask)


def _names(payload: bytes) -> list[str]:
    return payload.decode("ascii", "replace").rstrip(",").split(",")
