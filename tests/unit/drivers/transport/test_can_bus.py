"""What a bus says of an adapter that cannot be understood."""

from __future__ import annotations

import can
import pytest

from polishd.api import LinkError
from polishd.drivers.transport.can_bus import CanBus


class Garbled(can.BusABC):
    """Bus that raises errors with a traceback in their text, as python-can's socketcand does."""

    def __init__(self, message: str) -> None:
        super().__init__(channel="can0")
        self._message = message

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            bytes.fromhex("0x")
        except ValueError as error:
            raise can.CanOperationError(self._message.format(error)) from error
        raise AssertionError

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Into the void."""


@pytest.mark.parametrize("message", ["Failed to receive: {}  Traceback (most recent call last):\n  File x\n", "Failed"])
async def test_a_frame_that_cannot_be_read_is_reported_in_one_line_with_its_cause(message: str) -> None:
    bus = Garbled(message)
    with pytest.raises(LinkError) as raised:
        await CanBus("can://here", bus).receive(lambda _: None)
    bus.shutdown()
    said = str(raised.value)
    assert said.startswith("can://here: Failed")
    assert said.count("non-hexadecimal") == 1
    assert "\n" not in said
    assert "Traceback" not in said
