"""node-opcua: its server before our driver, and its client at our simulated PLC and at a cell's server."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.api import LinkError, ProtocolError
from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.opcua import OpcUa
from polishd.drivers.plc_robot.variables import watched, written
from tests.interop.devices import DONE, IDLE, QUICK, READY
from tests.interop.peers import Peer, Program, program
from tests.system.sim_rig import Cell, cell, wait_for
from tests.unit.opcua.journals import write_journal
from tests.unit.web.page_server import answering

PEER = Peer("node-opcua", "OPC UA", "server and client", "npm", "node-opcua")
pytestmark = PEER.needed

MACHINE = '\n[opcua]\nport = 0\nmanufacturer = "Maker"\nserial_number = "7"\nproduct_instance_uri = "urn:maker:7"\n'
TABLE = load_controller_profile("plc-opcua", Path()).variables
TYPES = {
    "bool": ("Boolean", False), "uint16": ("UInt16", 0), "uint32": ("UInt32", 0), "double": ("Double", 0.0),
    "string": ("String", ""),
}  # fmt: skip
SILENCE_S = 20.0
CONTROL = ("JobManagement", "JobOrderControl")
NOT_OK = 2
"""Value of ResultEvaluationEnum."""
SIM = """
[plant]
aperture_mm = 40.0
speed = 20.0
[robot]
kind = "opcua"
port = 0
watchdog_s = 60.0
"""


@pytest.fixture
def server() -> Iterator[Program]:
    """With all variables of the profile, each 0 or empty; only what polishd writes can be written."""
    with program("opcua.js", "server") as peer:
        points = {**watched(TABLE), **written(TABLE)}
        peer.ask(variables=[[name, *TYPES[one.type], name in written(TABLE)] for name, one in points.items()])
        yield peer


def link(peer: Program, table: Any = TABLE) -> OpcUa:
    return OpcUa(f"opc.tcp://127.0.0.1:{peer.greeting}", table, SILENCE_S)


async def test_its_server_answers_our_driver(server: Program) -> None:
    ours = link(server)
    await ours.open()
    try:
        values_set = {
            "line": 70_000,
            "state": 3,
            "clock": -12.625,
            "in_motion": True,
            "alarm_text": "Düse",
            "session": "a",
        }
        server.ask(set=values_set)
        values = (await ours.read()).values
        assert {name: values[name] for name in values_set} == values_set
        await ours.write({"hold": False, "start": True, "program": "a.nc", "heartbeat": 7})
        assert server.ask(get=["hold", "start", "program", "heartbeat"]) == [False, True, "a.nc", 7]
        identity = await ours.identify()
        assert (identity.vendor, identity.model, identity.firmware) == ("others", "PLC", "1.2")
        assert identity.boot_id
    finally:
        await ours.close()


async def test_our_driver_says_what_its_server_has_not(server: Program) -> None:
    away = TABLE.model_copy(
        update={"line": TABLE.line.model_copy(update={"address": "nsu=urn:polishd:handover;s=lines"})}
    )
    with pytest.raises(ProtocolError, match="variable line cannot be read: BadNodeIdUnknown"):
        await link(server, away).open()
    typed = TABLE.start.model_copy(update={"type": "uint16", "on": 1, "off": 0})
    ours = link(server, TABLE.model_copy(update={"start": typed}))
    await ours.open()
    with pytest.raises(ProtocolError, match="variable start cannot be written: BadTypeMismatch"):
        await ours.write({"start": 1})
    await ours.close()


async def test_a_server_that_dies_is_a_lost_link() -> None:
    with program("opcua.js", "server") as peer:
        points = {**watched(TABLE), **written(TABLE)}
        peer.ask(variables=[[name, *TYPES[one.type], name in written(TABLE)] for name, one in points.items()])
        ours = link(peer)
        await ours.open()
    with pytest.raises(LinkError):
        await ours.read()
    await ours.close()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("opcua"), SIM) as found:
        yield found


@pytest.fixture
def client(running: Cell) -> Iterator[Program]:
    with program("opcua.js", "client", running.endpoints["robot"]) as peer:
        yield peer


def test_its_client_finds_a_cell_as_a_machine(tmp_path: Path) -> None:
    cell_file = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    cell_file.write_text(cell_file.read_text() + MACHINE)
    config = load_config(cell_file)
    write_journal(config.state_dir)
    command = [sys.executable, "-m", "polishd.cli.app", "opcua", str(cell_file)]
    with contextlib.ExitStack() as stack:
        stack.enter_context(answering(config.state_dir))
        server = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(server.terminate)
        assert server.stdout is not None
        url = server.stdout.readline().strip()
        with program("opcua.js", "client", url) as peer:

            def seen(*path: str) -> list[str]:
                return list(peer.ask(walk=["Machines", config.cell.name, *path]))

            state = ("MachineryItemState", "CurrentState")
            wait_for(lambda: seen(*state) == ["Good", "Executing"], "the state of the daemon")
            assert seen("MachineryOperationMode", "CurrentState") == ["Good", "Processing"]
            assert seen("Identification", "ProductInstanceUri") == ["Good", "urn:maker:7"]
            assert seen("MachineryBuildingBlocks", *state) == ["Good", "Executing"]
            assert seen("Cell", "Force_N")[0] == "BadNoData"
            assert seen("Identification", "Colour") == ["absent", "Colour"]
            wait_for(lambda: seen(*CONTROL, "CurrentState") == ["Good", "Running"], "the job under way")
            _it_reads_jobs_and_results(lambda *path: peer.ask(walk=["Machines", config.cell.name, *path], whole=True))


def _it_reads_jobs_and_results(read: Callable[..., Any]) -> None:
    status, jobs = read(*CONTROL, "JobOrderList")
    assert status == "Good"
    assert [(one["jobOrder"]["jobOrderID"], one["state"][0]["stateText"]["text"]) for one in jobs] == [
        ("lens", "Ended"), ("mirror", "Ended"), ("flat", "Aborted"), ("wedge", "Running"), ("prism", "AllowedToStart")
    ]  # fmt: skip
    _, answers = read("JobManagement", "JobOrderResults", "JobOrderResponseList")
    assert [one["jobResponseID"] for one in answers] == ["lens.1", "mirror.2", "flat.3", "wedge.4"]
    status, result = read("ResultManagement", "Results", "Result02")
    values_set = result["resultMetaData"]
    assert (status, values_set["resultId"], values_set["partId"], values_set["resultEvaluation"]) == (
        "Good",
        "mirror.2",
        "A-2",
        NOT_OK,
    )
    assert read("ResultManagement", "Results", "Result02", "ResultMetaData", "ResultId") == ["Good", "mirror.2"]


def test_its_client_finds_all_that_our_plc_has(client: Program) -> None:
    assert client.ask(browse=True) == sorted([*watched(TABLE), *written(TABLE)])
    types = {name: TYPES[one.type][0] for name, one in {**watched(TABLE), **written(TABLE)}.items()}
    assert {name: type_ for name, (type_, _) in zip(types, client.ask(read=list(types)), strict=True)} == types
    assert client.ask(read=["lines"]) == [["BadNodeIdUnknown", None]]


def test_its_client_loads_and_runs_a_program_on_our_plc(running: Cell, client: Program) -> None:
    (running.state / "programs" / "others.nc").write_text("\n".join(QUICK) + "\n")

    def order(**values: Any) -> None:
        kinds = {name: TYPES[written(TABLE)[name].type][0] for name in values}
        assert set(client.ask(write=[[name, kinds[name], value] for name, value in values.items()])) == {"Good"}

    def reaches(state: int) -> None:
        wait_for(lambda: client.ask(read=["state"]) == [["UInt16", state]], f"state {state}")

    order(reset=True)
    reaches(IDLE)
    order(program="others.nc", load=True)
    reaches(READY)
    order(hold=False, start=True, heartbeat=7)
    reaches(DONE)
    assert client.ask(read=["loaded"]) == [["String", "others.nc"]]
    assert client.ask(write=[["state", "UInt16", 1]]) == ["BadUserAccessDenied"]
    assert client.ask(write=[["start", "String", "on"]]) == ["BadTypeMismatch"]
