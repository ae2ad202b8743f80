"""rwswrap, a client of others, at the simulated ABB controller with Robot Web Services 2.0."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import pytest

from tests.interop.peers import Peer
from tests.interop.test_abb_clients import MODULE, SIM, UNENDING, until
from tests.system.sim_rig import Cell, cell

PEER = Peer("rwswrap", "Robot Web Services 2.0", "client", "PyPI", "rwswrap")
pytestmark = [PEER.needed, pytest.mark.filterwarnings("ignore:Unverified HTTPS request")]


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("omnicore"), SIM + 'rws = "2.0"\n') as found:
        yield found


@pytest.fixture
def client(running: Cell) -> Iterator[Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from rwswrap.RWS import RWS

    found = RWS(running.endpoints["robot"].replace("tcp:", "https:"), module="interop")
    yield found
    found.session.close()


def put(client: Any, module: str = MODULE) -> None:
    """Upload a module, which this client has no call for."""
    headers = {"Content-Type": "application/octet-stream;v=2.0"}
    url = f"{client.base_url}/fileservice/$HOME/interop.modx"
    assert client.session.put(url, module.encode(), headers=headers, verify=False).status_code == 201


def test_it_loads_a_module_starts_it_and_reads_its_variables(client: Any) -> None:
    put(client)
    assert client.load_module("interop", overwrite=False).status_code == 204
    assert client.get_modules() == ["interop"]
    assert client.get_rapid_variable("count", module="interop") == "0"
    assert client.start_RAPID().status_code == 204
    until(lambda: client.get_rapid_variable("count", module="interop") == "3")
    until(lambda: not client.is_running())
    assert client.set_rapid_variable("count", "2", module="interop").status_code == 204
    assert client.get_rapid_variable("count", module="interop") == "2"


def test_it_replaces_the_module_and_stops_the_program(client: Any) -> None:
    put(client, UNENDING)
    assert client.load_module("interop").status_code == 204
    assert client.start_RAPID().status_code == 204
    until(client.is_running)
    assert client.stop_RAPID().status_code == 204
    until(lambda: not client.is_running())
    assert client.toggle_motors(0).status_code == 204
    assert client.start_RAPID().status_code == 403, "with its motors off"
    assert client.toggle_motors(1).status_code == 204
