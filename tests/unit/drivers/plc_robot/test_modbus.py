"""Variables over Modbus: pymodbus against the simulated PLC's own registers."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ConfigError, LinkError, ProtocolError
from polishd.config.controller_profile import Variable, load_controller_profile
from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.modbus import Modbus, place, spans
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.file_delivery import Folder
from polishd.sim_backends.plc_robot.device import ModbusServer
from tests.fakes.plc_robot import FakePlc, cycling, serving
from tests.programs import plan_of

PROFILE = load_controller_profile("plc-modbus", Path())


@asynccontextmanager
async def linked(fake: FakePlc, silence_s: float = 5.0) -> AsyncIterator[Modbus]:
    async with serving(fake, ModbusServer) as (port, _):
        link = Modbus(Tcp("127.0.0.1", port), PROFILE.variables, silence_s)
        try:
            yield link
        finally:
            await link.close()


async def test_registers_and_bits_are_what_the_profile_says(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    async with linked(fake) as link:
        await link.open()
        fake.plc.shown |= {"line": 70_000, "state": 3, "clock": -12.625, "feed_hold": True, "in_motion": False}
        values = (await link.read()).values
        seen = {name: values[name] for name in ("line", "state", "clock", "feed_hold", "in_motion", "feed_override")}
        assert seen == {
            "line": 70_000, "state": 3, "clock": -12.625, "feed_hold": True, "in_motion": False, "feed_override": 100,
        }  # fmt: skip
        await link.write({"hold": False, "start": True, "heartbeat": 41})
        assert {name: fake.plc.inputs[name] for name in ("hold", "start", "heartbeat")} == {
            "hold": False, "start": True, "heartbeat": 41,
        }  # fmt: skip


async def test_what_is_not_there_is_refused_and_what_is_silent_is_lost(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    away = PROFILE.variables.alarm
    assert away is not None
    table = PROFILE.variables.model_copy(update={"alarm": away.model_copy(update={"address": "input:60"})})
    async with serving(fake, ModbusServer) as (port, _):
        with pytest.raises(ProtocolError, match="addresses in the profile"):
            await Modbus(Tcp("127.0.0.1", port), table, 5.0).open()
    async with linked(fake, 0.3) as link:
        await link.open()
        fake.silent = True
        with pytest.raises(LinkError):
            await link.read()
    with pytest.raises(LinkError):
        await link.open()


async def test_a_whole_program_over_modbus(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    plan = plan_of([b"G1 X%d F60" % (at + 1) for at in range(30)], approach_blocks=5)
    async with cycling(fake), serving(fake, ModbusServer) as (port, _):
        make = lambda: Modbus(Tcp("127.0.0.1", port), PROFILE.variables, 5.0)  # noqa: E731
        robot = PlcRobot("test PLC", PROFILE, make, Folder(tmp_path))
        try:
            await robot.open()
            await robot.prepare(plan)
            await robot.send(plan.segments)
            await robot.resume()
            assert [one.seq async for one in robot.executed()] == list(range(30))
        finally:
            await robot.close()


def variable(address: str, kind: str) -> Variable:
    return Variable.model_validate({"address": address, "type": kind})


@given(
    st.sampled_from(
        [("int16", -5), ("uint16", 65535), ("int32", -70_000), ("uint32", 4_000_000_000), ("double", 1.5e-7)]
    ),
    st.booleans(),
)
def test_words_come_back_in_either_order(one: tuple[str, int | float], little: bool) -> None:
    kind, value = one
    where = place("x", variable("holding:3", kind), little=little)
    words = where.words(value)
    assert len(words) == where.count
    assert where.value(words) == value
    assert place("x", variable("holding:3", kind), little=not little).words(value) == words[::-1]


@pytest.mark.parametrize(
    ("address", "kind", "why"),
    [
        ("holding", "int16", "write holding:40"),
        ("register:3", "int16", "write holding:40"),
        ("holding:70000", "int16", "write holding:40"),
        ("coil:3", "int16", "does not fit in coils"),
        ("input:3", "string", "does not fit in inputs"),
    ],
)
def test_addresses_that_are_none(address: str, kind: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        place("x", variable(address, kind), little=False)


def test_what_is_too_far_apart_for_one_request_is_refused() -> None:
    places = {name: place(name, variable(f"input:{at}", "uint16"), little=False) for name, at in (("a", 3), ("b", 200))}
    with pytest.raises(ConfigError, match="inputs 3 to 200"):
        spans(places)
