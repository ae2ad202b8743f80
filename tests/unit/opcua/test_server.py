"""``polishd opcua`` as a client sees it: mandatory nodes of the models, statuses of what is old, and no writing."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, Node, ua
from asyncua.ua.uaerrors import BadNotWritable, BadUserAccessDenied

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.model.states import DaemonState
from polishd.opcua import server
from polishd.opcua.jobs import node_id
from polishd.opcua.server import FILES, STATES
from tests.time_limits import SOON_S
from tests.unit.cli_result import Polishd
from tests.unit.opcua.opcua_client import SECTION, inner, missing, seen, type_of, until, watching
from tests.unit.web.page_server import LIVE, Answers, answering

KEYS = '\n[opcua]\nport = 0\nmanufacturer = "Maker"\nserial_number = "7"\nproduct_instance_uri = "urn:maker:7"\n'
KINDS = {"MachineIdentificationType", "MachineryItemState_StateMachineType", "MachineryOperationModeStateMachineType"}
READINGS = {
    "force": {"force_n": 19.5, "setpoint_n": 20.0, "age_s": 0.1},
    "speed": {"rpm": 600.0, "age_s": 9.0},
    "sensed": None,
    "robot": None,
}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "POLL_S", 0.02)
    for key, value in {"readings": READINGS, "cycle": 2, "pressing": True, "job": "lens"}.items():
        monkeypatch.setitem(LIVE, key, value)


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Answers]:
    with answering(tmp_path) as found:
        yield found


@pytest.mark.full
async def test_every_mandatory_node_of_the_models_is_there_and_can_be_read(tmp_path: Path, daemon: Answers) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _is(machine, ("Cell", "State"), "polishing"))
        for name in ("Identification", "MachineryItemState", "MachineryOperationMode"):
            node = await inner(machine, name)
            kind = await type_of(node)
            assert (await kind.read_browse_name()).Name in KINDS
            assert not await missing(node, kind)
            assert await missing(await inner(machine, "Cell"), kind), "something else lacks them"
            assert (await inner(machine, "MachineryBuildingBlocks", name)).nodeid == node.nodeid
        facts = (("Manufacturer", "Maker"), ("SerialNumber", "7"), ("ProductInstanceUri", "urn:maker:7"))
        for name, value in (*facts, ("Location", "Hall 2"), ("Model", "P"), ("ComponentName", "cell 7")):
            assert await seen(machine, "Identification", name) == (value, "Good")
        assert await seen(machine, "MachineryItemState", "CurrentState") == ("Executing", "Good")
        assert await seen(machine, "MachineryOperationMode", "CurrentState") == ("Processing", "Good")
        number, _ = await seen(machine, "MachineryItemState", "CurrentState", "Id")
        assert (await Node(machine.session, number).read_browse_name()).Name == "Executing"


@pytest.mark.full
async def test_a_value_has_its_status_and_the_time_at_which_it_was_reported(tmp_path: Path, daemon: Answers) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _is(machine, ("Cell", "State"), "polishing"))
        assert await seen(machine, "Cell", "Force_N") == (19.5, "Good")
        assert await seen(machine, "Cell", "SpindleSpeed_rpm") == (600.0, "UncertainLastUsableValue")
        assert await seen(machine, "Cell", "SensedForce_N") == (None, "BadNoData")
        old = await (await inner(machine, "Cell", "SpindleSpeed_rpm")).read_data_value(raise_on_bad_status=False)
        assert old.SourceTimestamp is not None
        assert old.ServerTimestamp is not None
        assert (old.ServerTimestamp - old.SourceTimestamp).total_seconds() == pytest.approx(9.0, abs=0.5)


@pytest.mark.full
async def test_without_a_daemon_the_machine_is_not_available_and_nothing_else_is_known(tmp_path: Path) -> None:
    with answering(tmp_path):
        serving = watching(tmp_path)
        machine = await serving.__aenter__()
        await until(lambda: _is(machine, ("Cell", "State"), "polishing"))
    try:
        await until(lambda: _is(machine, ("MachineryItemState", "CurrentState"), "NotAvailable"))
        assert await seen(machine, "MachineryOperationMode", "CurrentState") == ("None", "Good")
        await until(lambda: _bad(machine, ("Cell", "Force_N")))
        assert await seen(machine, "Cell", "State") == (None, "BadNoCommunication")
    finally:
        await serving.__aexit__(None, None, None)


@pytest.mark.full
async def test_a_daemon_that_hangs_is_reported_as_unknown_while_clients_are_answered(
    tmp_path: Path, daemon: Answers, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "REPLY_TIMEOUT_S", 0.1)
    over, real = threading.Event(), daemon.answer

    def hang(verb: str, args: dict[str, Any]) -> dict[str, Any]:
        over.wait(SOON_S)
        return real(verb, args)

    async with watching(tmp_path) as machine:
        await until(lambda: _is(machine, ("Cell", "State"), "polishing"))
        monkeypatch.setattr(daemon, "answer", hang)
        try:
            await until(lambda: _bad(machine, ("MachineryItemState", "CurrentState")))
            assert await seen(machine, "Cell", "Force_N") == (None, "BadNoCommunication")
            assert await seen(machine, "Identification", "SerialNumber") == ("7", "Good"), "that does not change"
        finally:
            over.set()


@pytest.mark.full
@pytest.mark.parametrize("answer", [{"ok": False, "error": "no"}, {"ok": True, "state": "dancing"}])
async def test_an_answer_that_is_none_of_ours_is_reported_as_unknown(
    tmp_path: Path, daemon: Answers, monkeypatch: pytest.MonkeyPatch, answer: dict[str, Any]
) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _is(machine, ("Cell", "State"), "polishing"))
        monkeypatch.setattr(daemon, "answer", lambda *_: answer)
        await until(lambda: _bad(machine, ("MachineryItemState", "CurrentState")))


@pytest.mark.full
async def test_no_client_can_write_add_or_remove(tmp_path: Path, daemon: Answers) -> None:
    async with server.serving("cell 7", tmp_path, SECTION) as address:
        client = Client(address)
        client.set_user("admin")
        with pytest.raises(ua.UaError):
            await client.connect()
        async with Client(address) as client:
            space = await client.get_namespace_index("urn:polishd:cell 7")
            force = client.get_node(node_id("Cell.Force_N", space))
            with pytest.raises((BadUserAccessDenied, BadNotWritable)):
                await force.write_value(1.0)
            with pytest.raises(BadUserAccessDenied):
                await client.nodes.objects.add_object(space, "mine")
            with pytest.raises(BadUserAccessDenied):
                await force.delete()


def test_each_state_of_a_daemon_has_its_name_there() -> None:
    assert set(STATES) == set(DaemonState)


def test_each_nodeset_has_its_licence_at_its_head() -> None:
    folder = resources.files("polishd.opcua") / "nodesets"
    licence = (folder / "LICENSE").read_text()
    assert "OPC Foundation MIT License 1.00" in licence
    for file in FILES:
        head = (folder / file).read_text(encoding="utf-8")[:2000]
        assert "OPC Foundation MIT License 1.00" in head
        assert "Permission is hereby granted, free of charge" in head


def test_a_cell_that_does_not_say_who_it_is_is_refused(polishd: Polishd, tmp_path: Path) -> None:
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    said = polishd("opcua", cell)
    assert (said.code, "opcua: is missing" in said.err, "docs/how-to/plant-systems.md" in said.err) == (3, True, True)


@pytest.mark.full
def test_the_process_says_where_it_listens_and_ends_by_sigterm(tmp_path: Path) -> None:
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    cell.write_text(cell.read_text() + KEYS)
    assert load_config(cell).opcua is not None
    command = [sys.executable, "-m", "polishd.cli.app", "opcua", str(cell)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith("opc.tcp://127.0.0.1:")
        process.send_signal(signal.SIGTERM)
        assert process.wait(SOON_S) == 0
        assert process.stderr.read() == ""


@pytest.mark.full
def test_a_port_that_is_taken_is_said(tmp_path: Path) -> None:
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        cell.write_text(cell.read_text() + KEYS.replace("port = 0", f"port = {taken.getsockname()[1]}"))
        # In a separate process: the server gives way to others for as long as its process lives.
        command = [sys.executable, "-m", "polishd.cli.app", "opcua", str(cell)]
        said = subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, check=False)
    assert (said.returncode, "opcua.port: " in said.stderr, "set another port" in said.stderr) == (3, True, True)


async def _is(machine: Node, names: tuple[str, ...], value: Any) -> bool:
    return await seen(machine, *names) == (value, "Good")


async def _bad(machine: Node, names: tuple[str, ...]) -> bool:
    return await seen(machine, *names) == (None, "BadNoCommunication")
