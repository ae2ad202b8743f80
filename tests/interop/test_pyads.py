"""Our ADS driver at the server that pyads has for its own tests."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.ads import Ads
from polishd.drivers.plc_robot.variables import watched, written
from tests.interop.peers import Peer

PEER = Peer("pyads' test server", "ADS", "server", "PyPI", "pyads")
pytestmark = PEER.needed

HOST = f"127.{130 + os.getpid() % 80}.{os.getpid() // 80 % 250}.1"
TABLE = load_controller_profile("plc-ads", Path()).variables
TYPES = {"bool": (33, "<?"), "uint16": (18, "<H"), "uint32": (19, "<I"), "double": (5, "<d"), "string": (30, "256s")}
SILENCE_S = 10.0


@pytest.fixture
def handler() -> Iterator[Any]:
    """Return the handler of a server with all variables of the profile, each 0 or empty."""
    from pyads.testserver import AdsTestServer, AdvancedHandler, PLCVariable

    made = AdvancedHandler()
    for point in {**watched(TABLE), **written(TABLE)}.values():
        number, form = TYPES[point.type]
        empty = bytes(struct.calcsize(form))
        made.add_variable(PLCVariable(point.address, empty, number, "STRING(255)" if number == 30 else point.type))
    server = AdsTestServer(made, ip_address=HOST, logging=False)
    with server:
        yield made
    server.join()
    for client in server.clients:
        client.join()


def fill(handler: Any, name: str, data: bytes) -> None:
    handler.get_variable_by_name(f"GVL_polishd.{name}").value = data


def filled(handler: Any, name: str) -> bytes:
    return bytes(handler.get_variable_by_name(f"GVL_polishd.{name}").value)


async def test_our_driver_reads_and_orders(handler: Any) -> None:
    ads = Ads(HOST, f"{HOST}.1.1", 851, TABLE, SILENCE_S)
    await ads.open()
    try:
        fill(handler, "line", struct.pack("<I", 70_000))
        fill(handler, "state", struct.pack("<H", 3))
        fill(handler, "clock", struct.pack("<d", -12.625))
        fill(handler, "in_motion", b"\1")
        fill(handler, "alarm_text", "Düse".encode().ljust(256, b"\0"))
        values = (await ads.read()).values
        assert {name: values[name] for name in ("line", "state", "clock", "in_motion", "feed_hold", "alarm_text")} == {
            "line": 70_000, "state": 3, "clock": -12.625, "in_motion": True, "feed_hold": False, "alarm_text": "Düse",
        }  # fmt: skip
        await ads.write({"hold": False, "start": True, "program": "a.nc", "heartbeat": 7})
        assert filled(handler, "start") == b"\1"
        assert filled(handler, "heartbeat") == struct.pack("<I", 7)
        assert filled(handler, "program").rstrip(b"\0") == b"a.nc"
        assert (await ads.identify()).firmware == "1.2.3"
    finally:
        await ads.close()
