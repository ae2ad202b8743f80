"""Variables of controllers that load files: what a library hands over is no value because it came."""

from __future__ import annotations

from collections.abc import Callable

import asyncua
import pyads
import pytest

from polishd.drivers.handover.ads import Ads
from polishd.drivers.handover.opcua import OpcUa
from polishd.drivers.handover.variables import Variables
from tests.campaigns.codecs.controllers import AdsServer, Controller, OpcUaServer, read_for_ever

Make = Callable[[pytest.MonkeyPatch], tuple[Controller, Variables]]


def opcua(monkeypatch: pytest.MonkeyPatch) -> tuple[Controller, Variables]:
    server = OpcUaServer()
    monkeypatch.setattr(asyncua, "Client", server.client)
    return server, OpcUa("opc.tcp://nowhere", server.profile.variables, 60.0)


def ads(monkeypatch: pytest.MonkeyPatch) -> tuple[Controller, Variables]:
    server = AdsServer()
    monkeypatch.setattr(pyads, "Connection", server.connection)
    return server, Ads("nowhere", "1.1.1.1.1.1", 851, server.profile.variables, 60.0)


@pytest.mark.parametrize("make", [opcua, ads])
async def test_no_reading_is_taken_that_is_none(monkeypatch: pytest.MonkeyPatch, make: Make) -> None:
    server, variables = make(monkeypatch)
    outcomes = await read_for_ever(variables, server, 1_000)
    assert outcomes["value"] > 100


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("make", [opcua, ads])
async def test_of_a_million_readings_none_is_taken(monkeypatch: pytest.MonkeyPatch, make: Make) -> None:
    server, variables = make(monkeypatch)
    outcomes = await read_for_ever(variables, server, 1_000_000)
    assert outcomes["value"] > 100_000
