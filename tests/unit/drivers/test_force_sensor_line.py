"""Force sensor and monitor: their lines against the documents' vectors, against nonsense, and amid mischief."""

from __future__ import annotations

import asyncio
from contextlib import aclosing

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceFault, DeviceIdentity, DeviceRefused, ProtocolError, SensorTimes
from polishd.drivers import force_sensor_line as force_codec
from polishd.drivers import monitor_line as monitor_codec
from polishd.drivers.force_sensor_line import ForceSensorLine, ForceSensorLineReading, ForceSensorState
from polishd.drivers.transport import lines
from polishd.drivers.transport.address import Tcp
from tests.fakes.looking import FakeAmplifier
from tests.fakes.wires import TcpWire
from tests.vectors import vectors

FORCE = {name: line.encode() for name, line in vectors("force_sensor").items()}
MONITOR = {name: line.encode() for name, line in vectors("monitor").items()}


def body(line: bytes) -> str:
    """Of an answer."""
    found = lines.decode(line)
    assert found is not None
    return found[1]


@pytest.mark.parametrize(
    ("line", "number", "request_body"),
    [
        (FORCE["force_request"], 7, "F?"),
        (FORCE["tare"], 11, "TARE"),
        (MONITOR["list_request"], 7, "LS?,0"),
        (MONITOR["value_request"], 9, "V?,slurry_flow"),
    ],
)
def test_requests_are_those_of_the_documents(line: bytes, number: int, request_body: str) -> None:
    assert lines.encode(number, request_body) == line + b"\r\n"


@pytest.mark.parametrize(
    ("name", "reading"),
    [
        ("force", ForceSensorLineReading(ForceSensorState.MEASURING, 1024, 12.004, 0)),
        ("pulling", ForceSensorLineReading(ForceSensorState.MEASURING, 1025, -0.031, 0)),
        ("taring", ForceSensorLineReading(ForceSensorState.TARING, 1026, 0.0, 0)),
        ("over_range", ForceSensorLineReading(ForceSensorState.FAULT, 1027, 60.0, 1)),
    ],
)
def test_forces_are_read_as_the_document_says(name: str, reading: ForceSensorLineReading) -> None:
    assert force_codec.force(body(FORCE[name])) == reading


def test_who_answers() -> None:
    assert lines.identity(body(FORCE["identity"])) == DeviceIdentity("polishd", "simulated F1", "SIM-F1", "1.0", "3")


def test_faults_have_words() -> None:
    assert ForceSensorLineReading(ForceSensorState.FAULT, 0, 0.0, 3).faults == "over its range, no cell connected"


@pytest.mark.parametrize(("name", "value"), [("number", 1.25), ("unknown", None)])
def test_values_are_read_as_the_document_says(name: str, value: float | None) -> None:
    assert monitor_codec.parse_value("slurry_flow", body(MONITOR[name])) == value


def test_states_and_names_are_read_as_the_document_says() -> None:
    assert monitor_codec.parse_value("guard_closed", body(MONITOR["state"])) is True
    assert monitor_codec.parse_value("guard_closed", "V,guard_closed,OFF") is False
    assert monitor_codec.listed(0, body(MONITOR["list"])) == "slurry_flow"
    assert monitor_codec.listed(7, body(MONITOR["list_end"])) == ""


@pytest.mark.parametrize("answer", ["F,0,1,12.0,0", "F,0,1,+12,0", "F,3,1,+1.0,0", "F,0,1,+nan,0", "F,0,1,+1e3,0", ""])
def test_what_is_no_force_is_a_protocol_error(answer: str) -> None:
    with pytest.raises(ProtocolError, match=r"no answer to F\?"):
        force_codec.force(answer)


@pytest.mark.parametrize("answer", ["V,other,1.0", "V,flow,", "V,flow,nan", "V,flow,1e3", "V,flow,on", "V,flow", "OK"])
def test_what_is_no_value_is_a_protocol_error(answer: str) -> None:
    with pytest.raises(ProtocolError, match=r"no answer to V\?,flow"):
        monitor_codec.parse_value("flow", answer)


@pytest.mark.parametrize("answer", ["LS,1,flow", "LS,0,", "LS,0,a b", "LS,0flow", "LS", "LS,0,-x"])
def test_what_is_no_name_is_a_protocol_error(answer: str) -> None:
    with pytest.raises(ProtocolError, match=r"no answer to LS\?,0"):
        monitor_codec.listed(0, answer)


@given(st.text(max_size=30))
def test_nonsense_is_a_protocol_error_or_a_reading(text: str) -> None:
    for read in (force_codec.force, lambda said: monitor_codec.parse_value("flow", said)):
        try:
            read(text)
        except ProtocolError:
            continue
        assert text[:2] in {"F,", "V,"}


# amid mischief


@pytest.fixture
async def wire() -> TcpWire:
    return await TcpWire(FakeAmplifier()).start()


async def test_a_converter_that_stands_gives_no_new_readings(wire: TcpWire) -> None:
    fake: FakeAmplifier = wire.peer  # type: ignore[assignment]
    device = ForceSensorLine(Tcp("127.0.0.1", wire.port))
    await device.open()
    try:
        async with aclosing(device.samples()) as samples:  # type: ignore[type-var]
            await anext(samples)
            fake.stands = True
            await anext(samples)  # the last one that it made
            asked = len(fake.requests)
            late = asyncio.ensure_future(anext(samples))
            while len(fake.requests) < asked + 5:  # noqa: ASYNC110 -- the machine tells nobody
                await asyncio.sleep(0.01)
            assert not late.done()
            fake.stands = False
            await late
    finally:
        await device.close()
        await wire.close()


async def test_a_tare_that_does_not_settle_or_cannot_be_is_told(wire: TcpWire) -> None:
    fake: FakeAmplifier = wire.peer  # type: ignore[assignment]
    device = ForceSensorLine(Tcp("127.0.0.1", wire.port), SensorTimes(tare_s=0.05))
    await device.open()
    try:
        ask = device.ask

        async def shaken(request: str) -> str:
            answer = await ask(request)
            fake.shaken = fake.shaken or request == "TARE"
            return answer

        device.ask = shaken  # type: ignore[method-assign]
        with pytest.raises(DeviceFault, match=r"not tared after 0\.05 s; does something shake it"):
            await device.tare()
        fake.shaken, fake.fault = False, 2
        assert (await device.status()).detail == "no cell connected"
        with pytest.raises(DeviceRefused, match="a fault is set"):
            await device.tare()
    finally:
        await device.close()
        await wire.close()
