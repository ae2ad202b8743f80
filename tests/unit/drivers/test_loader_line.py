"""The loader's lines against the document's vectors, and against nonsense."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceFault, DeviceIdentity, LoaderTimes, ProtocolError
from polishd.drivers import loader_line
from polishd.drivers.loader_line import LoaderLine, LoaderReading, LoaderState
from polishd.drivers.transport import lines
from polishd.drivers.transport.address import Tcp
from tests.fakes.loader import FakeLoader
from tests.fakes.wires import TcpWire
from tests.vectors import vectors

LINES = {name: line.encode() for name, line in vectors("loader").items()}


@pytest.mark.parametrize(
    ("name", "number", "body"),
    [("load", 7, loader_line.load("lens 7")), ("unload", 8, "UL"), ("stop", 9, "STOP"), ("status_request", 10, "ST?")],
)
def test_requests_are_those_of_the_document(name: str, number: int, body: str) -> None:
    assert lines.encode(number, body) == LINES[name] + b"\r\n"


@pytest.mark.parametrize(
    ("name", "reading"),
    [
        ("status", LoaderReading(LoaderState.IDLE, 0, "lens 7")),
        ("empty", LoaderReading(LoaderState.MOVING, 0, None)),
        ("dropped", LoaderReading(LoaderState.FAULT, 2, None)),
    ],
)
def test_answers_are_read_as_the_document_says(name: str, reading: LoaderReading) -> None:
    answer = lines.decode(LINES[name])
    assert answer is not None
    assert loader_line.status(answer[1]) == reading


def test_faults_have_words() -> None:
    assert LoaderReading(LoaderState.FAULT, 3, None).faults == "jammed, it has dropped a part"


def test_identity() -> None:
    assert lines.identity("ID,Acme,L,7,1.0,3") == DeviceIdentity("Acme", "L", "7", "1.0", boot_id="3")
    with pytest.raises(ProtocolError):
        lines.identity("ID,Acme")


@pytest.mark.full
@given(st.text(max_size=40))
def test_any_name_of_a_part_comes_through(part: str) -> None:
    sent = loader_line.load(part).removeprefix("LD,")
    assert loader_line.status(f"ST,0,0,{sent}").seat == (part or None)


@given(st.text(max_size=20))
def test_nonsense_is_a_protocol_error_or_a_reading(body: str) -> None:
    try:
        loader_line.status(f"ST,{body}")
    except ProtocolError:
        return
    assert body[:1] in "0123"


@pytest.fixture
async def wire() -> TcpWire:
    return await TcpWire(FakeLoader()).start()


async def test_a_fault_over_a_change_is_reported_with_its_words(wire: TcpWire) -> None:
    device = LoaderLine(Tcp("127.0.0.1", wire.port))
    await device.open()
    try:
        wire.peer.faults_amid = 2  # type: ignore[attr-defined]
        for _ in range(2):  # the second time it stands already
            with pytest.raises(DeviceFault, match=r"it has dropped a part.*over LD,P-1"):
                await device.load("P-1")
        assert not (await device.status()).ready
    finally:
        await device.close()
        await wire.close()


async def test_a_change_that_takes_too_long_is_a_fault(wire: TcpWire) -> None:
    device = LoaderLine(Tcp("127.0.0.1", wire.port), LoaderTimes(change_s=0.0))
    await device.open()
    try:
        with pytest.raises(DeviceFault, match="not done after 0 s over LD,P-1"):
            await device.load("P-1")
        await device.make_safe()
        assert (await device.status()).safe
    finally:
        await device.close()
        await wire.close()
