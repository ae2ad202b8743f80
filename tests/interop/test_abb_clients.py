"""abb-robot-client and rwswrap, clients of others, at the simulated ABB controllers of both versions.

Differences between them and ABB's documents are in docs/protocols/abb_rws.md.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.interop.peers import Peer
from tests.system.sim_rig import Cell, cell
from tests.time_limits import SOON_S

PEER = Peer("abb-robot-client", "Robot Web Services 1.0", "client", "PyPI", "abb-robot-client")
pytestmark = PEER.needed

SIM = """
[plant]
aperture_mm = 40.0
speed = 4.0
[robot]
kind = "abb_rws"
port = 0
"""
TAIL = "[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"
MODULE = f"""MODULE interop
  PERS num count:=0;
  PERS jointtarget joints:=[[1,2,3,4,5,6],[9E9,9E9,9E9,9E9,9E9,9E9]];
  PROC main()
    WHILE count<3 DO
      MoveL [[10,0,60],{TAIL},v50\\T:=0.4,fine,tool0;
      MoveL [[0,0,60],{TAIL},v50,fine,tool0;
      Incr count;
    ENDWHILE
  ENDPROC
ENDMODULE
"""
UNENDING = MODULE.replace("count<3", "count<1000")
"""Runs until it is stopped: no state of it is over between two looks of a busy machine."""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("abb"), SIM) as found:
        yield found


def until(condition: Callable[[], Any]) -> None:
    end = time.monotonic() + SOON_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.fixture
def client(running: Cell) -> Iterator[Any]:
    from abb_robot_client.rws import RWS

    found = RWS(running.endpoints["robot"].replace("tcp:", "http:"))
    yield found
    found.close()


def load(client: Any, module: str = MODULE) -> None:
    """Load a module, with the requests that this client has no call for: mastership and loadmod."""
    client.upload_file("$HOME/interop.mod", module.encode())
    client._do_post("rw/mastership/rapid?action=request")
    client._do_post("rw/rapid/tasks/T_ROB1?action=loadmod", {"modulepath": "$HOME/interop.mod", "replace": "true"})
    client._do_post("rw/mastership/rapid?action=release")
    client.resetpp()


def test_it_reads_panel_tasks_position_and_log(client: Any) -> None:
    assert client.get_controller_state() == "motoron"
    assert client.get_operation_mode() == "AUTO"
    assert client.get_speedratio() == 100.0
    assert client.get_execution_state().ctrlexecstate == "stopped"
    tasks = client.get_tasks()
    assert (tasks["T_ROB1"].motiontask, tasks["T_POLISHD"].motiontask) == (True, False)
    assert client.get_robtarget().trans == pytest.approx([0.0, 0.0, 60.0])
    assert isinstance(client.read_event_log(), list)


def test_it_loads_a_module_starts_it_and_reads_its_variables(client: Any) -> None:
    load(client)
    assert "interop.mod" in client.list_files("$HOME")
    assert client.read_file("$HOME/interop.mod").decode() == MODULE
    assert client.get_rapid_variable_num("count") == 0.0
    client.start(cycle="once")
    until(lambda: client.get_rapid_variable_num("count") == 3.0)
    until(lambda: client.get_execution_state().ctrlexecstate == "stopped")
    client.set_rapid_variable_num("count", 2)
    assert client.get_rapid_variable_num("count") == 2.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # its numpy.fromstring
        assert client.get_rapid_variable_jointtarget("joints").robax[1] == pytest.approx(0.0349066)


def test_it_stops_the_program_and_slows_it_down(client: Any) -> None:
    load(client, UNENDING)
    client.set_speedratio(50)
    assert client.get_speedratio() == 50.0
    client.start(cycle="once")
    until(lambda: client.get_robtarget().trans[0] > 1.0)
    client.stop()
    until(lambda: client.get_execution_state().ctrlexecstate == "stopped")
    stands = client.get_robtarget().trans
    assert client.get_robtarget().trans == pytest.approx(stands)
    client.set_speedratio(100)
    count = client.get_rapid_variable_num("count")
    client.start(cycle="once")
    until(lambda: client.get_rapid_variable_num("count") > count)
    client.stop()
    until(lambda: client.get_execution_state().ctrlexecstate == "stopped")


def test_it_gets_events_of_a_variable_and_of_the_execution(client: Any) -> None:
    from abb_robot_client import rws

    load(client, UNENDING)
    kinds, priority = rws.SubscriptionResourceType, rws.SubscriptionResourcePriority
    wanted = [
        rws.SubscriptionResourceRequest(kinds.PersVar, priority.High, "count"),
        rws.SubscriptionResourceRequest(kinds.ExecutionState, priority.Medium),
    ]
    values: list[str] = []
    states: list[str] = []

    def on_event(event: Any) -> None:
        if isinstance(event, rws.VariableValue):
            values.append(event.value)
        elif isinstance(event, rws.RAPIDExecutionState):
            states.append(event.ctrlexecstate)

    # The client reads one resource of a message, and a message has all that changed: a subscription for each.
    subscriptions = [client.subscribe([one], on_event) for one in wanted]
    until(lambda: (values[-1:], states[-1:]) == (["0"], ["stopped"]))  # it opens its WebSockets in threads
    client.start(cycle="once")
    until(lambda: states[-1] == "running" and values[-1] != "0")
    client.stop()
    until(lambda: states[-1] == "stopped")
    for subscription in subscriptions:
        subscription.close()


def test_a_module_that_is_wrong_is_refused_with_a_code(client: Any) -> None:
    from abb_robot_client.rws import ABBException

    client.upload_file("$HOME/wrong.mod", b"MODULE wrong\nPROC x()\nNoSuch;\nENDPROC\nENDMODULE\n")
    client._do_post("rw/mastership/rapid?action=request")
    with pytest.raises(ABBException, match="line 3"):
        client._do_post("rw/rapid/tasks/T_ROB1?action=loadmod", {"modulepath": "$HOME/wrong.mod"})
    client._do_post("rw/mastership/rapid?action=release")
