"""The shipped profile of polishd's force sensor: the document's vectors, nonsense, and a device that misbehaves."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceFault, DeviceIdentity, DeviceRefused, ProtocolError, SensorTimes
from polishd.config.device_profile_checks import profile_of
from polishd.drivers.profile_device import build, codec
from polishd.drivers.profile_device.drives import ProfiledForceSensor
from polishd.drivers.transport import lines
from polishd.drivers.transport.address import Tcp
from tests.fakes.sensors_and_monitors import FakeAmplifier
from tests.fakes.wires import TcpWire
from tests.vectors import vectors

PROFILE = profile_of("force_sensor_line", Path())
FORCE = {name: line.encode() for name, line in vectors("force_sensor").items()}


def sensor(address: Tcp, times: SensorTimes | None = None) -> ProfiledForceSensor:
    return build.force_sensor(PROFILE, address, times)


def body(line: bytes) -> str:
    """Return the body of an answer."""
    found = lines.decode(line)
    assert found is not None
    return found[1]


def reading(answer: str) -> Any:
    return sensor(Tcp("127.0.0.1", 1))._reading(codec.fields_of(PROFILE, PROFILE.asks["reading"], answer))


@pytest.mark.parametrize(
    ("name", "number", "request_body"),
    [("force_request", 7, PROFILE.asks["reading"].send), ("tare", 11, PROFILE.commands.tare[0])],
)
def test_requests_are_those_of_the_document(name: str, number: int, request_body: str) -> None:
    assert lines.encode(number, request_body) == FORCE[name] + b"\r\n"


@pytest.mark.parametrize(
    ("name", "is_taring", "count", "force_n", "fault", "faults"),
    [
        ("force", False, 1024, 12.004, 0, ""),
        ("pulling", False, 1025, -0.031, 0, ""),
        ("taring", True, 1026, 0.0, 0, ""),
        ("over_range", False, 1027, 60.0, 1, "over its range"),
    ],
)
def test_forces_are_read_as_the_document_says(
    name: str, is_taring: bool, count: int, force_n: float, fault: int, faults: str
) -> None:
    found = reading(body(FORCE[name]))
    assert (found.is_taring, found.count, found.force_n) == (is_taring, count, force_n)
    assert (found.fault, found.faults) == (fault, faults)


def test_who_answers() -> None:
    values = codec.fields_of(PROFILE, PROFILE.asks["identity"], body(FORCE["identity"]))
    assert codec.identity(PROFILE, values) == DeviceIdentity("polishd", "simulated F1", "SIM-F1", "1.0", "3")


@pytest.mark.parametrize("answer", ["F,0,1,12.0,0", "F,0,1,+12,0", "F,3,1,+1.0,0", "F,0,1,+nan,0", "F,0,1,+1e3,0", ""])
def test_what_is_no_force_is_a_protocol_error(answer: str) -> None:
    with pytest.raises(ProtocolError):
        reading(answer)


@given(st.text(max_size=30))
def test_nonsense_is_a_protocol_error_or_a_reading(text: str) -> None:
    try:
        reading(text)
    except ProtocolError:
        return
    assert text[:2] == "F,"


@pytest.fixture
async def wire() -> TcpWire:
    return await TcpWire(FakeAmplifier()).start()


async def test_a_converter_that_stands_gives_no_new_readings(wire: TcpWire) -> None:
    fake: FakeAmplifier = wire.peer  # type: ignore[assignment]
    device = sensor(Tcp("127.0.0.1", wire.port))
    await device.open()
    try:
        async with aclosing(device.samples()) as samples:  # type: ignore[type-var]
            await anext(samples)
            fake.stands = True
            await anext(samples)  # the last one that it made
            asked = len(fake.requests)
            late = asyncio.ensure_future(anext(samples))
            while len(fake.requests) < asked + 5:  # noqa: ASYNC110 -- the fake has no event for it
                await asyncio.sleep(0.01)
            assert not late.done()
            fake.stands = False
            await late
    finally:
        await device.close()
        await wire.close()


async def test_what_is_read_while_it_tares_is_no_force_and_the_tare_ends_by_its_state(wire: TcpWire) -> None:
    fake: FakeAmplifier = wire.peer  # type: ignore[assignment]
    device = sensor(Tcp("127.0.0.1", wire.port))
    await device.open()
    try:
        fake.shaken = True
        assert (await device.status()).state == "taring"
        async with aclosing(device.samples()) as samples:  # type: ignore[type-var]
            asked = len(fake.requests)
            late = asyncio.ensure_future(anext(samples))
            while len(fake.requests) < asked + 5:  # noqa: ASYNC110 -- the fake has no event for it
                await asyncio.sleep(0.01)
            assert not late.done()
            fake.shaken = False
            await late
        await device.tare()
        fake.weight_n += 2.0  # a force that acts after the tare does not keep it from ending
        async with aclosing(device.samples()) as samples:  # type: ignore[type-var]
            assert (await anext(samples)).force_n == pytest.approx(2.0)
    finally:
        await device.close()
        await wire.close()


async def test_a_tare_that_does_not_end_or_is_refused_is_an_error(wire: TcpWire) -> None:
    fake: FakeAmplifier = wire.peer  # type: ignore[assignment]
    device = sensor(Tcp("127.0.0.1", wire.port), SensorTimes(tare_s=0.05))
    await device.open()
    try:
        order = device._wire.order

        async def shaken(name: str, asked: float = 0.0) -> None:
            await order(name, asked)
            fake.shaken = fake.shaken or name == "tare"

        device._wire.order = shaken  # type: ignore[method-assign]
        with pytest.raises(DeviceFault, match=r"not tared after 0\.05 s"):
            await device.tare()
        fake.shaken, fake.fault = False, 2
        assert (await device.status()).detail == "no cell connected"
        with pytest.raises(DeviceRefused, match="a fault is set"):
            await device.tare()
    finally:
        await device.close()
        await wire.close()
