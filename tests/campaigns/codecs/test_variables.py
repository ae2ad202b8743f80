"""Variables of controllers that load files: what a library hands over is no value because it came."""

from __future__ import annotations

import pytest

from polishd.drivers.plc_robot.variables import VariableSnapshot
from tests.campaigns.codecs.controllers import MAKERS, Make, read_until

SEED = 15


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
async def test_no_reading_is_taken_that_is_none(monkeypatch: pytest.MonkeyPatch, make: Make) -> None:
    server, variables = make(monkeypatch, SEED)
    outcomes = await read_until(variables, server, 1_000)
    assert outcomes["taken"] == 0
    assert outcomes["value"] > 100


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
async def test_what_is_taken_is_counted(monkeypatch: pytest.MonkeyPatch, make: Make) -> None:
    server, variables = make(monkeypatch, SEED)

    async def without_checks() -> VariableSnapshot:
        server.reading()
        return VariableSnapshot(1.0, server.truth)

    monkeypatch.setattr(variables, "read", without_checks)
    outcomes = await read_until(variables, server, 20)
    assert 0 < outcomes["taken"] < outcomes["value"]


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
async def test_of_a_million_readings_none_is_taken(monkeypatch: pytest.MonkeyPatch, make: Make) -> None:
    server, variables = make(monkeypatch, SEED)
    outcomes = await read_until(variables, server, 1_000_000)
    assert outcomes["taken"] == 0
    assert outcomes["value"] > 100_000
