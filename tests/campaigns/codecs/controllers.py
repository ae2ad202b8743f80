"""What libraries answer: the variables of a controller over OPC UA and ADS.

Bytes and their order are the libraries' affair. What is distinguished here is types, numbers that are none, what is
missing, errors of single variables, and timestamps.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import asyncua
import pyads
import pytest
from asyncua import ua

from polishd.api import PolishdError
from polishd.config.controller_profile import Variable, load_controller_profile
from polishd.drivers.plc_robot.ads import Ads
from polishd.drivers.plc_robot.opcua import OpcUa
from polishd.drivers.plc_robot.program_tracker import report_of
from polishd.drivers.plc_robot.variables import Variables, watched

BAD_SHARE = 0.6
NOW = datetime(2026, 1, 1)  # noqa: DTZ001 -- as asyncua gives them
RANGES = {"int16": 1 << 15, "uint16": 1 << 16, "int32": 1 << 31, "uint32": 1 << 32}


class Controller:
    """Gives all variables of a profile, each with another value, and now and then one that is no value."""

    def __init__(self, name: str, seed: int) -> None:
        self.profile = load_controller_profile(name, Path())
        self.points = watched(self.profile.variables)
        self.rng = random.Random(seed)
        self.counts = Counter[str]()
        self.truth: dict[str, Any] = {}
        self.broken = False
        """The last reading has something that is no value."""

    def reading(self) -> dict[str, Any]:
        """By address."""
        self.broken = self.rng.random() < BAD_SHARE
        number = self.counts.total()
        self.counts["broken" if self.broken else "good"] += 1
        self.truth = {name: self._value(point, number + at) for at, (name, point) in enumerate(self.points.items())}
        given = {self.points[name].address: value for name, value in self.truth.items()}
        if self.broken:
            point = self.rng.choice(list(self.points.values()))
            given[point.address] = self._nonsense(point)
        return given

    def _value(self, point: Variable, number: int) -> Any:
        match point.type:
            case "string":
                return f"text {number}"
            case "bool":
                return number % 2 == 0
            case "float" | "double":
                return number / 8
        return number % 7 if point is self.profile.variables.state else number % (RANGES[point.type] - 1)

    def _nonsense(self, point: Variable) -> Any:
        rng = self.rng
        match point.type:
            case "string":
                return rng.choice([None, 7, 1.5, b"text", [], True])
            case "bool":
                return rng.choice([None, "True", 1.0, b"\1", []])
            case "float" | "double":
                return rng.choice([None, math.nan, math.inf, -math.inf, "1.0", b"1", [1.0], 10**400])
        most = RANGES[point.type]
        return rng.choice([None, "7", 1.5, math.nan, math.inf, most, -most - 1, 1 << 70, 10**400, [3], b"3"])


class OpcUaServer(Controller):
    """In place of asyncua's client: what it makes of a server's answers."""

    def __init__(self, seed: int) -> None:
        super().__init__("plc-opcua", seed)
        self.uaclient = self
        self.nodes: dict[str, Any] = {}

    def client(self, *_: object, **__: object) -> OpcUaServer:
        return self

    async def connect(self) -> None: ...
    async def disconnect(self) -> None: ...
    def disconnect_socket(self) -> None: ...

    async def get_namespace_array(self) -> list[str]:
        return ["", "urn:polishd:handover"]

    async def read_attributes(self, nodes: list[Any], _attribute: object) -> list[Any]:
        given = list(self.reading().values())
        answers = [_answer(value) for value in given]
        if self.broken and self.rng.random() < 0.2:
            answers[0].StatusCode = ua.StatusCode(ua.StatusCodes.BadSensorFailure)
        return answers


def _answer(value: Any) -> Any:
    given = SimpleNamespace(Value=value)
    return SimpleNamespace(
        Value=given, StatusCode=None, SourceTimestamp=NOW, ServerTimestamp=NOW + timedelta(seconds=1)
    )


class AdsServer(Controller):
    """In place of a connection of pyads."""

    def __init__(self, seed: int) -> None:
        super().__init__("plc-ads", seed)

    def connection(self, *_: object) -> AdsServer:
        return self

    def open(self) -> None: ...
    def close(self) -> None: ...
    def set_timeout(self, _ms: int) -> None: ...

    def read_list_by_name(self, addresses: list[str]) -> dict[str, Any]:
        return self.reading()


def opcua(monkeypatch: pytest.MonkeyPatch, seed: int) -> tuple[Controller, Variables]:
    """A controller, and the driver's link to it."""
    server = OpcUaServer(seed)
    monkeypatch.setattr(asyncua, "Client", server.client)
    return server, OpcUa("opc.tcp://nowhere", server.profile.variables, 60.0)


def ads(monkeypatch: pytest.MonkeyPatch, seed: int) -> tuple[Controller, Variables]:
    """The same over ADS."""
    server = AdsServer(seed)
    monkeypatch.setattr(pyads, "Connection", server.connection)
    return server, Ads("nowhere", "1.1.1.1.1.1", 851, server.profile.variables, 60.0)


Make = Callable[[pytest.MonkeyPatch, int], tuple[Controller, Variables]]
MAKERS: dict[str, Make] = {"PLC robot, OPC UA": opcua, "PLC robot, ADS": ads}


async def read_until(variables: Variables, controller: Controller, bad: int) -> Counter[str]:
    """Read until so many readings were broken; count which are taken. AssertionError if a good one is refused."""
    outcomes = Counter[str]()
    opened = False
    while controller.counts["broken"] < bad:
        try:
            if not opened:
                await variables.open()
                opened = True
            reading = await variables.read()
            report = report_of(controller.profile.variables, reading)
        except PolishdError:
            outcomes["refused"] += 1
            assert controller.broken, "a good reading was refused"
        else:
            outcomes["value"] += 1
            sound = not controller.broken and reading.values == controller.truth
            outcomes["taken"] += not (sound and math.isfinite(report.time_s) and math.isfinite(report.override))
    await variables.close()
    return outcomes
