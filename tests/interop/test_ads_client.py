"""ads-client (JavaScript) at our simulated PLC: symbols by name, sums of reads and writes, a program run."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest

from tests.interop.devices import DONE, IDLE, QUICK, READY
from tests.interop.peers import Peer, Program, program
from tests.system.sim_rig import Cell, cell, wait_for

PEER = Peer("ads-client", "ADS", "client", "npm", "ads-client")
pytestmark = PEER.needed

SIM = """
[plant]
aperture_mm = 40.0
speed = 20.0
[robot]
kind = "ads"
port = {port}
watchdog_s = 60.0
"""
RUN = 5
ON, OFF = "01", "00"


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("ads"), SIM.format(port=20_000 + os.getpid() % 20_000)) as found:
        yield found


@pytest.fixture
def peer(running: Cell) -> Iterator[Program]:
    where = urlsplit(running.endpoints["robot"])
    netid, _, port = where.path.strip("/").partition(":")
    with program("ads_client.js", where.hostname, netid, port) as found:
        yield found


def value(peer: Program, name: str) -> int:
    """A whole number, or a bool."""
    (said,) = peer.ask(read=[f"GVL_polishd.{name}"])
    return int.from_bytes(bytes.fromhex(said), "little")


def test_it_knows_our_plc_and_its_symbols(peer: Program) -> None:
    who = peer.ask(who=True)
    assert who["info"]["deviceName"] == "polishd sim PLC"
    assert who["state"] == "Run"
    found = peer.ask(symbol="GVL_polishd.clock")
    assert (found["size"], found["type"]) == (8, "LREAL")
    found = peer.ask(symbol="GVL_polishd.program")
    assert (found["size"], found["type"]) == (256, "STRING(255)")
    assert "not found" in peer.ask(missing="GVL_polishd.nothing").lower()


def test_it_loads_and_runs_a_program_on_our_plc(running: Cell, peer: Program) -> None:
    (running.state / "programs" / "others.nc").write_text("\n".join(QUICK) + "\n")
    name = b"others.nc".ljust(256, b"\0").hex()

    def order(**levels: str) -> None:
        assert all(peer.ask(write=[[f"GVL_polishd.{key}", level] for key, level in levels.items()]))

    def reaches(state: int) -> None:
        wait_for(lambda: value(peer, "state") == state, f"state {state}")

    order(reset=ON)
    reaches(IDLE)
    order(program=name, load=ON)
    reaches(READY)
    order(hold=OFF, start=ON, heartbeat="07000000")
    reaches(DONE)
    order(start=OFF, load=OFF, reset=OFF)
    loaded, clock, line = peer.ask(read=[f"GVL_polishd.{key}" for key in ("loaded", "clock", "line")])
    assert bytes.fromhex(loaded).rstrip(b"\0") == b"others.nc"
    assert struct.unpack("<d", bytes.fromhex(clock))[0] > 0.0
    assert 1 <= int.from_bytes(bytes.fromhex(line), "little") <= len(QUICK)
