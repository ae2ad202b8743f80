"""Machinery Jobs and Results as a client sees them: nodes and values, and no method that orders motion."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, Node, ua

from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.opcua import server
from polishd.opcua.jobs import ISA95, JOBS, RESULTS, node_id
from tests.unit.opcua.journals import write_journal
from tests.unit.opcua.opcua_client import SECTION, inner, missing, seen, type_of, until, watching
from tests.unit.web.page_server import LIVE, Answers, answering

STATES = ["Ended", "Ended", "Aborted", "Running", "AllowedToStart"]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "POLL_S", 0.02)


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Answers]:
    write_journal(tmp_path)
    with answering(tmp_path) as found:
        yield found


async def listed(machine: Node) -> tuple[Any, str]:
    return await seen(machine, "JobManagement", "JobOrderControl", "JobOrderList")


async def states(machine: Node) -> list[str]:
    """Return the states of the jobs in their order; empty where unknown."""
    value, _ = await listed(machine)
    return [one.State[0].StateText.Text for one in value or ()]


@pytest.mark.full
async def test_every_mandatory_node_of_jobs_and_results_is_there(tmp_path: Path, daemon: Answers) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _are(machine, STATES))
        for name, kind_name in (("JobManagement", "JobManagementType"), ("ResultManagement", "ResultManagementType")):
            node = await inner(machine, name)
            kind = await type_of(node)
            assert (await kind.read_browse_name()).Name == kind_name
            assert not await missing(node, kind)
            assert (await inner(machine, "MachineryBuildingBlocks", name)).nodeid == node.nodeid
        for path in (("JobManagement", "JobOrderControl"), ("JobManagement", "JobOrderResults"),
                     ("ResultManagement", "Results", "Result01")):  # fmt: skip
            node = await inner(machine, *path)
            kind = await type_of(node)
            assert not await missing(node, kind)
            assert await missing(await inner(machine, "Cell"), kind), "something else lacks them"


@pytest.mark.full
async def test_the_jobs_are_reported_with_their_states(tmp_path: Path, daemon: Answers) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _are(machine, STATES))
        jobs, status = await listed(machine)
        assert status == "Good"
        assert [one.JobOrder.JobOrderID for one in jobs] == ["lens", "mirror", "flat", "wedge", "prism"]
        assert jobs[0].JobOrder.MaterialRequirements[0].MaterialLotID == "A-1"
        (top,) = jobs[3].State
        assert (top.BrowsePath.Elements or [], top.StateText.Text, top.StateNumber) == ([], "Running", 3)
        control = ("JobManagement", "JobOrderControl")
        assert await seen(machine, *control, "CurrentState") == ("Running", "Good")
        assert await seen(machine, *control, "MaxDownloadableJobOrders") == (0, "Good")
        number, _ = await seen(machine, *control, "CurrentState", "Id")
        assert (await Node(machine.session, number).read_browse_name()).Name == "Running"
        answers, _ = await seen(machine, "JobManagement", "JobOrderResults", "JobOrderResponseList")
        assert [one.JobResponseID for one in answers] == ["lens.1", "mirror.2", "flat.3", "wedge.4"]
        assert {one.ID: one.Value.Value for one in answers[1].JobResponseData}["PV"] == 17.5
        assert {one.ID: one.EngineeringUnits.DisplayName.Text for one in answers[1].JobResponseData[1:3]} == {
            "RMS": "nm", "PV": "nm"
        }  # fmt: skip


@pytest.mark.full
async def test_a_held_cell_has_its_job_interrupted(
    tmp_path: Path, daemon: Answers, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _are(machine, STATES))
        monkeypatch.setitem(LIVE, "state", "held")
        await until(lambda: _are(machine, ["Interrupted" if one == "Running" else one for one in STATES]))
        assert await seen(machine, "JobManagement", "JobOrderControl", "CurrentState") == ("Interrupted", "Good")


@pytest.mark.full
async def test_a_daemon_that_is_not_understood_leaves_jobs_unknown_and_results_as_they_are(
    tmp_path: Path, daemon: Answers, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _are(machine, STATES))
        monkeypatch.setattr(daemon, "answer", lambda *_: {"ok": True, "state": "dancing"})
        await until(lambda: _unknown(machine))
        assert await seen(machine, "JobManagement", "JobOrderControl", "CurrentState") == (None, "BadNoCommunication")
        assert (await seen(machine, "ResultManagement", "Results", "Result01"))[1] == "Good", "that does not change"
        (tmp_path / JOURNAL_NAME).write_bytes(b"no database at all" * 100)
        await until(lambda: _is_result(machine, None, "BadNoCommunication"))


@pytest.mark.full
async def test_the_latest_results_stand_there_with_verdict_and_figures(tmp_path: Path, daemon: Answers) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _are(machine, STATES))
        places = await (await inner(machine, "ResultManagement", "Results")).get_children()
        found = [(await place.read_value()) for place in places]
        assert [(one.ResultMetaData.ResultId, one.ResultMetaData.ResultEvaluation.name) for one in found] == [
            ("flat.3", "NotDecidable"), ("mirror.2", "NotOK"), ("lens.1", "OK")
        ]  # fmt: skip
        lens = found[2]
        assert (lens.ResultMetaData.PartId, lens.ResultMetaData.JobId) == ("A-1", "lens")
        assert lens.ResultMetaData.ResultEvaluationDetails.Text == "accepted"
        assert lens.ResultMetaData.ProcessingTimes.StartTime.timestamp() == 100.0
        figures = {one.Value.Key.Name: one.Value.Value.Value for one in lens.ResultContent}
        assert figures == {
            "Outcome": "accepted", "Passes": 1, "RMS [nm]": 1.5, "PV [nm]": 7.5, "RMS, counted [nm]": 1.5,
            "RMS, limit [nm]": 2.0,
        }  # fmt: skip
        part = ("ResultManagement", "Results", "Result03", "ResultMetaData", "ResultId")
        assert await seen(machine, *part) == ("lens.1", "Good")


@pytest.mark.full
async def test_a_response_is_asked_for_by_job_and_by_state(tmp_path: Path, daemon: Answers) -> None:
    async with watching(tmp_path) as machine:
        await until(lambda: _are(machine, STATES))
        answers = await inner(machine, "JobManagement", "JobOrderResults")
        space = await _space(machine, ISA95)
        by_id = ua.QualifiedName("RequestJobResponseByJobOrderID", space)
        answer, status = await answers.call_method(by_id, "mirror")
        assert (answer.JobResponseID, answer.Description.Text, status) == ("mirror.2", "rejected: all used", 1)
        assert (await answers.call_method(by_id, "unknown"))[1] == 0b10
        known, _ = await listed(machine)
        by_state = ua.QualifiedName("RequestJobResponseByJobOrderState", space)

        async def in_state(*states: Any) -> tuple[list[str], int]:
            asked = ua.Variant(list(states), ua.VariantType.ExtensionObject, is_array=True)
            found, status = await answers.call_method(by_state, asked)
            return [one.JobOrderID for one in found], status

        (top,) = known[0].State
        text, kind = ua.LocalizedText, type(top)
        assert await in_state(top) == (["lens", "mirror"], 1)
        assert await in_state(kind(StateText=text("Ended"))) == (["lens", "mirror"], 1)
        assert await in_state(kind(StateNumber=5)) == (["lens", "mirror"], 1)
        for none in (kind(StateText=text("Lost")), kind(StateNumber=7)):
            assert await in_state(none) == ([], 0b1000)
        step = ua.RelativePathElement(TargetName=ua.QualifiedName("Ended", space))
        below = kind(BrowsePath=ua.RelativePath([step]), StateText=text("Completed"), StateNumber=1)
        assert await in_state(top, below) == ([], 0b1000), "no state has substates here"
        for invalid in ((), (below,)):
            assert await in_state(*invalid) == ([], 1 << 32)


@pytest.mark.full
async def test_no_client_can_order_motion(tmp_path: Path, daemon: Answers) -> None:
    """Methods of ISA-95 that store, start, pause or stop a job are not there; by the type's they are refused, too."""
    async with watching(tmp_path) as machine:
        control = await inner(machine, "JobManagement", "JobOrderControl")
        assert ua.NodeClass.Method not in [await one.read_node_class() for one in await control.get_children()]
        kind = await type_of(control)
        orders = await kind.get_methods()
        assert {"Store", "StoreAndStart", "Start", "Stop", "Pause", "Resume", "Abort"} <= {
            (await one.read_browse_name()).Name for one in orders
        }
        for order in orders:
            with pytest.raises(ua.UaStatusCodeError):
                await control.call_method(order.nodeid, "lens")
    assert not daemon.asked, "the daemon was asked for nothing but how it is"


@pytest.mark.full
async def test_no_client_can_write_a_job_or_a_result(tmp_path: Path, daemon: Answers) -> None:
    async with server.serving("cell 7", tmp_path, SECTION) as address, Client(address) as client:
        space = await client.get_namespace_index("urn:polishd:cell 7")
        for name in ("JobManagement.JobOrderControl.JobOrderList", "JobManagement.JobOrderControl.CurrentState"):
            with pytest.raises(ua.UaStatusCodeError):
                await client.get_node(node_id(name, space)).write_value(None)
        assert {JOBS, RESULTS} <= set(await client.get_namespace_array())


async def _are(machine: Node, wanted: list[str]) -> bool:
    return await states(machine) == wanted


async def _unknown(machine: Node) -> bool:
    return await listed(machine) == (None, "BadNoCommunication")


async def _is_result(machine: Node, value: Any, status: str) -> bool:
    return await seen(machine, "ResultManagement", "Results", "Result01") == (value, status)


async def _space(machine: Node, uri: str) -> int:
    array = await Node(machine.session, node_id(ua.ObjectIds.Server_NamespaceArray, 0)).read_value()
    return int(array.index(uri))
