"""The dashboard's lines and the primary interface's messages, as they are and as they should not be."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceRefused, LinkError, ProtocolError
from polishd.drivers.transport.address import Tcp
from polishd.drivers.universal_robots import driver
from polishd.drivers.universal_robots.driver import ControllerMessage, MessageReader
from polishd.sim_backends.universal_robots import device as simulated
from tests.fakes.wires import Peer, TcpWire

STATE = simulated.message(16, b"\0" * 40)


class Says(Peer):
    """Greets, and answers every line alike."""

    def __init__(self, greeting: bytes, answer: bytes) -> None:
        super().__init__()
        self.greeting, self.answer = greeting, answer

    def on_connect(self) -> None:
        self.send(self.greeting)

    def on_bytes(self, data: bytes) -> None:
        self.send(self.answer)


async def asked(greeting: bytes, answer: bytes, within_s: float = 5.0) -> str:
    wire = await TcpWire(Says(greeting, answer)).start()
    try:
        return await driver.ask(Tcp("127.0.0.1", wire.port), "running", within_s)
    finally:
        await wire.close()


async def test_a_question_has_its_answer() -> None:
    assert await asked(driver.GREETING + b"\n", b"Program running: true\n") == "Program running: true"


async def test_another_server_is_no_dashboard() -> None:
    with pytest.raises(ProtocolError, match="not a dashboard"):
        await asked(b"220 ftp ready\n", b"true\n")


async def test_a_dashboard_that_says_nothing_is_a_dead_link() -> None:
    with pytest.raises(LinkError):
        await asked(driver.GREETING + b"\n", b"half an answer", within_s=0.3)
    with pytest.raises(LinkError):
        await asked(b"", b"", within_s=0.3)


@pytest.mark.parametrize(
    ("answer", "value"),
    [
        ("Program running: true", "Program running: true"),
        ("could not understand: 'is in remote control'", ""),
        ("'get robot model' is not supported on this robot", ""),
        ("Could not understand", ""),
    ],
)
def test_what_an_old_controller_does_not_know_is_empty(answer: str, value: str) -> None:
    assert driver.read(answer, "any", "there") == value


@pytest.mark.parametrize("answer", ["Failed to execute: stop", "Error while loading program: x.urp"])
def test_an_order_that_fails_is_refused(answer: str) -> None:
    with pytest.raises(DeviceRefused, match=answer):
        driver.read(answer, "any", "there")


def test_true_is_true() -> None:
    assert driver.yes("Program running: true")
    assert driver.yes("True")
    assert not driver.yes("Program running: false")
    for neither in ("", "Program running: tru", "maybe"):
        with pytest.raises(ProtocolError, match="neither true nor false"):
            driver.yes(neither)


def test_complaints_are_found_among_states_however_they_are_dribbled() -> None:
    stream = STATE + simulated.complaint(17, "syntax error") + STATE + simulated.complaint(3, "another")
    reader = MessageReader()
    found = [one for at in range(len(stream)) for one in reader.feed(stream[at : at + 1])]
    assert found == [ControllerMessage(17, "syntax error"), ControllerMessage(3, "another")]


@pytest.mark.parametrize(
    "message",
    [
        STATE,
        simulated.message(20, b""),
        simulated.message(20, struct.pack(">QbB", 0, 0, 10)),
        simulated.message(20, struct.pack(">QbB", 0, 0, 7) + b"\0" * 20),
    ],
)
def test_other_messages_are_none(message: bytes) -> None:
    assert list(MessageReader().feed(message)) == []


@given(st.binary(max_size=120))
def test_no_bytes_break_the_reader(data: bytes) -> None:
    try:
        assert all(one.line >= 0 for one in MessageReader().feed(data))
    except ProtocolError:
        assert not 5 <= struct.unpack_from(">i", data)[0] <= 1 << 20 or len(data) > 5


@pytest.mark.parametrize("size", [-1, 0, 4, (1 << 20) + 1])
def test_a_length_that_cannot_be_ends_the_link(size: int) -> None:
    with pytest.raises(ProtocolError, match="message of"):
        list(MessageReader().feed(struct.pack(">iB", size, 16)))
