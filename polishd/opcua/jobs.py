"""Jobs of OPC 40001-3 and results of OPC 40001-101: the cell's queue and history, read only.

People add and start jobs at the cell, with polishd's own orders; the server has no methods for it.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import Node, Server, ua
from asyncua.common.instantiate_util import instantiate

from polishd.daemon.journal.history import read_only
from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.model.states import Outcome
from polishd.model.tolerance import line_results

# Values of variables: a value with its status, or a status alone.

Status = ua.StatusCodes


def good(value: Any) -> ua.DataValue:
    """A good value with the present time."""
    return data_value(value if isinstance(value, ua.Variant) else ua.Variant(value), Status.Good, datetime.now(UTC))


def nothing(status: int) -> ua.DataValue:
    """No value, with the reason as status."""
    return data_value(ua.Variant(None), status, datetime.now(UTC))


# asyncua's type hints name its own numbers and times; it accepts Python's.


def data_value(value: ua.Variant, status: Any, source_time: Any) -> ua.DataValue:
    """The value with that status and its source time."""
    now: Any = datetime.now(UTC)
    return ua.DataValue(value, ua.StatusCode(status), source_time, now)


def node_id(identifier: Any, namespace: Any) -> ua.NodeId:
    """Make the NodeId."""
    return ua.NodeId(identifier, namespace)


# Jobs of a cell for the plant, read from its journal beside a running daemon.

MOST_ENDED = 20
"""Number of ended jobs that are shown; ``polishd history`` has the older ones."""
TO_ITS_END = {"accepted", "rejected", *(Outcome)} - {Outcome.STOPPED}
"""Ends of a job whose part was judged; any other end interrupted the job."""


@dataclass(frozen=True, slots=True)
class OpcUaResultValue:
    """One of a part's figures from its last map."""

    name: str
    value: float | int | str
    unit: str = ""


@dataclass(frozen=True, slots=True)
class OpcUaJob:
    """A waiting, running or ended job. Times are Unix times."""

    name: str
    part_id: str
    began_s: float | None
    ended_s: float | None
    end: str
    """End of the job: the queue's verdict, or the job's outcome; empty: not ended."""
    why: str
    number: int | None
    """Its row in the journal's jobs; None: not begun."""
    figures: tuple[OpcUaResultValue, ...]
    holds: bool | None
    """Whether the part meets its drawing in its last map; None: not judged."""

    @property
    def id(self) -> str:
        """Unique key: the name of a job may repeat where there is no queue."""
        return f"{self.name}.{self.number}"

    @property
    def state(self) -> str:
        """State of OPC 10031-4; ``Running`` also for an interrupted job, which only the daemon knows."""
        if self.end:
            return "Ended" if self.end in TO_ITS_END else "Aborted"
        return "AllowedToStart" if self.began_s is None else "Running"


def read_work(state_dir: Path) -> tuple[OpcUaJob, ...]:
    """Ended jobs, the latest last, the job under way, and the waiting jobs in their order.

    ConfigError where the journal cannot be read; an empty result where there is no journal yet.
    """
    if not (state_dir / JOURNAL_NAME).exists():
        return ()
    with read_only(state_dir) as journal:
        return tuple(_orders(journal))


def _orders(journal: sqlite3.Connection) -> Iterator[OpcUaJob]:
    queued = {}
    waiting = []
    sql = ("SELECT job, name, part_id, verdict, reason, ended FROM queue WHERE ended IS NULL OR id IN "
           "(SELECT id FROM queue WHERE ended IS NOT NULL ORDER BY ended DESC, id DESC LIMIT ?) "
           "ORDER BY ended IS NULL, ended, place")  # fmt: skip
    for job, name, part_id, verdict, reason, ended_s in journal.execute(sql, (MOST_ENDED,)):
        if job is None:  # waits, or was removed before it began
            waiting.append(OpcUaJob(name, part_id, None, ended_s, verdict or "", reason, None, (), None))
        else:
            queued[job] = (verdict, reason, ended_s)
    sql = "SELECT id, name, part_id, started, ended, outcome, detail FROM job ORDER BY id DESC LIMIT ?"
    jobs = journal.execute(sql, (MOST_ENDED + 1,)).fetchall()
    for number, name, part_id, began_s, job_ended_s, outcome, detail in reversed(jobs):
        verdict, reason, ended_s = queued.get(number, (None, "", None))
        # It was given up where another job began after it.
        given_up = "given up" if number != jobs[0][0] else ""
        end = verdict or outcome or given_up
        figures, holds = _measured(journal, number)
        when = ended_s or job_ended_s
        yield OpcUaJob(name, part_id, began_s, when, end, reason or detail or "", number, figures, holds)
    yield from waiting


def _measured(journal: sqlite3.Connection, job: int) -> tuple[tuple[OpcUaResultValue, ...], bool | None]:
    """Figures of a job's last map, and whether all lines of its drawing hold."""
    sql = "SELECT stats FROM map WHERE job = ? ORDER BY id DESC LIMIT 1"
    found = journal.execute(sql, (job,)).fetchone()
    passes = journal.execute("SELECT count(*) FROM pass WHERE job = ? AND how = 'done'", (job,)).fetchone()[0]
    if found is None:
        return (OpcUaResultValue("Passes", passes),), None
    stats: dict[str, Any] = json.loads(found[0])
    named = (("RMS", "rms_nm"), ("PV", "pv_nm"))
    figures = [OpcUaResultValue("Passes", passes)]
    figures += [OpcUaResultValue(name, float(stats[key]), "nm") for name, key in named if stats.get(key) is not None]
    lines = line_results(stats)
    for line in lines:
        figures += [OpcUaResultValue(f"{line.what}, counted", line.counted, line.unit)]
        figures += [OpcUaResultValue(f"{line.what}, limit", line.limit, line.unit)]
    return tuple(figures), all(line.holds for line in lines) if lines else None


ISA95 = "http://opcfoundation.org/UA/ISA95-JOBCONTROL_V2/"
JOBS = "http://opcfoundation.org/UA/Machinery/Jobs/"
RESULTS = "http://opcfoundation.org/UA/Machinery/Result/"
JOB_MANAGEMENT, RESULT_MANAGEMENT, RESULT_TYPE, RESPONSE = 1003, 1004, 2001, 3013
"""Nodes of the types."""
MOST_RESULTS = 10
"""Number of result nodes; ``Result01`` is the latest."""
NO_ERROR, UNKNOWN_JOB, UNKNOWN_STATE, INVALID = 1 << 0, 1 << 1, 1 << 3, 1 << 32
"""Bits of a ReturnStatus (OPC 10031-4, B.2)."""
STATES = ("NotAllowedToStart", "AllowedToStart", "Running", "Interrupted", "Ended", "Aborted")
"""State number of a job order; the first is 1 (OPC 10031-4, 6.2.1.2)."""
UNITS = "http://www.opcfoundation.org/UA/units/un/cefact"
NANOMETRE = 4404277
"""Code of the unit, C45."""
COMPLETED = 1
"""ResultState of OPC 40001-101."""
EMPTY = ("EquipmentID", "MaterialClassID", "MaterialDefinitionID", "PersonnelID", "PhysicalAssetID", "WorkMaster")
"""Lists for names in external orders: this machine accepts none."""
TYPES: Any = ua
"""Classes of the models, which asyncua makes while the server starts."""


class OpcUaJobs:
    """Jobs and results of one cell."""

    def __init__(self, server: Server, control: Node, responses: Node, results: Node) -> None:
        self._server, self._control, self._responses, self._results = server, control, responses, results
        self._isa95 = 0
        self._published: tuple[OpcUaJob, ...] | None = None
        self._is_running: bool | None = None
        self._result_nodes: list[tuple[Node, Node, Node]] = []

    @classmethod
    async def added(cls, server: Server, management: Node, results: Node) -> OpcUaJobs:
        """Add the nodes to these two, of the types JobManagementType and ResultManagementType."""
        isa95, jobs = [await server.get_namespace_index(uri) for uri in (ISA95, JOBS)]
        control = await management.get_child(ua.QualifiedName("JobOrderControl", jobs))
        answers = await management.get_child(ua.QualifiedName("JobOrderResults", jobs))
        for name in EMPTY:
            child = await control.get_child(ua.QualifiedName(name, isa95))
            kind = ua.VariantType.ExtensionObject if name == "WorkMaster" else ua.VariantType.String
            await child.write_value(good(ua.Variant([], kind, is_array=True)))
        most = await control.get_child(ua.QualifiedName("MaxDownloadableJobOrders", isa95))
        await most.write_value(good(ua.Variant(0, ua.VariantType.UInt16)))
        own = management.nodeid.NamespaceIndex
        listed = await answers.add_variable(
            node_id("JobManagement.JobOrderResults.JobOrderResponseList", own),
            ua.QualifiedName("JobOrderResponseList", isa95),
            _several([]),
            datatype=node_id(RESPONSE, isa95),
        )
        space = await server.get_namespace_index(RESULTS)
        folder = await results.add_object(
            node_id("ResultManagement.Results", own), ua.QualifiedName("Results", space), ua.ObjectIds.FolderType
        )
        found = cls(server, control, listed, folder)
        found._isa95 = isa95
        by_id = await answers.get_child(ua.QualifiedName("RequestJobResponseByJobOrderID", isa95))
        by_state = await answers.get_child(ua.QualifiedName("RequestJobResponseByJobOrderState", isa95))
        server.link_method(by_id, found._by_id)
        server.link_method(by_state, found._by_state)
        return found

    async def update(self, orders: Sequence[OpcUaJob] | None, is_running: bool | None) -> None:
        """Show the jobs of the journal; None: it cannot be read.

        ``is_running``: the job under way continues; None: its state is unknown.
        """
        now = None if orders is None else tuple(orders)
        if (now, is_running) == (self._published, self._is_running) and now is not None:
            return
        self._published, self._is_running = now, is_running
        current = await self._control.get_child("0:CurrentState")
        number = await current.get_child("0:Id")
        orders_list = await self._control.get_child(ua.QualifiedName("JobOrderList", self._isa95))
        if now is None or is_running is None:
            await self._write(nothing(Status.BadNoCommunication), current, number, orders_list, self._responses)
        else:
            await self._write(good(_several([self._and_state(order) for order in now])), orders_list)
            answers = [self._response(order) for order in now if order.number is not None]
            await self._write(good(_several(answers)), self._responses)
            await self._state_is(next((one for one in now if one.state == "Running"), None), current, number)
        await self._results_are(None if now is None else [one for one in now if one.end and one.number is not None])

    async def _state_is(self, order: OpcUaJob | None, current: Node, number: Node) -> None:
        """Set the state machine to the job under way; without one it has no state."""
        if order is None:
            await self._write(nothing(Status.BadNoData), current, number)
            return
        states = {"Running": 5037, "Interrupted": 5038}
        await self._write(good(ua.LocalizedText(self._state_name(order), "en")), current)
        await self._write(good(node_id(states[self._state_name(order)], self._isa95)), number)

    async def _results_are(self, ended: Sequence[OpcUaJob] | None) -> None:
        """Show the latest results first, in as many variables as there ever were results."""
        latest = [] if ended is None else list(reversed(ended))[:MOST_RESULTS]
        while len(self._result_nodes) < len(latest):
            self._result_nodes.append(await self._add_result_nodes(len(self._result_nodes) + 1))
        for number, nodes in enumerate(self._result_nodes):
            if number < len(latest):
                found = _result(latest[number])
                values = (found, found.ResultMetaData, found.ResultMetaData.ResultId)
                for node, value in zip(nodes, values, strict=True):
                    await self._write(good(value), node)
            else:
                why = Status.BadNoCommunication if ended is None else Status.BadNoData
                await self._write(nothing(why), *nodes)

    async def _add_result_nodes(self, number: int) -> tuple[Node, Node, Node]:
        """Add a result node with the mandatory parts of the model."""
        space = await self._server.get_namespace_index(RESULTS)
        own = self._results.nodeid.NamespaceIndex
        name = f"Result{number:02}"
        (result, *_) = await instantiate(
            self._results, self._server.get_node(node_id(RESULT_TYPE, space)),
            nodeid=node_id(f"ResultManagement.Results.{name}", own), bname=ua.QualifiedName(name, own),
            dname=ua.LocalizedText(name), instantiate_optional=False,
        )  # fmt: skip
        meta = await result.get_child(ua.QualifiedName("ResultMetaData", space))
        return result, meta, await meta.get_child(ua.QualifiedName("ResultId", space))

    async def _write(self, value: ua.DataValue, *nodes: Node) -> None:
        for node in nodes:
            await self._server.write_attribute_value(node.nodeid, value)

    def _state_name(self, order: OpcUaJob) -> str:
        """State of the job; a job under way counts as interrupted while no daemon works on it."""
        return "Interrupted" if order.state == "Running" and not self._is_running else order.state

    def _states(self, order: OpcUaJob) -> list[Any]:
        """The top state only, with a null path: there are no substates."""
        name = self._state_name(order)
        text, number = ua.LocalizedText(name, "en"), STATES.index(name) + 1
        return [TYPES.ISA95StateDataType(BrowsePath=ua.RelativePath(), StateText=text, StateNumber=number)]

    def _and_state(self, order: OpcUaJob) -> Any:
        part = TYPES.ISA95MaterialDataType(MaterialLotID=order.part_id, MaterialUse="Produced")
        job = TYPES.ISA95JobOrderDataType(
            JobOrderID=order.name,
            StartTime=_time(order.began_s),
            EndTime=_time(order.ended_s),
            MaterialRequirements=[part],
        )
        return TYPES.ISA95JobOrderAndStateDataType(JobOrder=job, State=self._states(order))

    def _response(self, order: OpcUaJob) -> Any:
        return TYPES.ISA95JobResponseDataType(
            JobResponseID=order.id, JobOrderID=order.name, JobState=self._states(order),
            Description=ua.LocalizedText(_description(order), "en"), StartTime=_time(order.began_s),
            EndTime=_time(order.ended_s), JobResponseData=[_parameter(one) for one in order.figures],
        )  # fmt: skip

    async def _by_id(self, _: Any, job: ua.Variant) -> Any:
        """RequestJobResponseByJobOrderID: the last job of that name."""
        if (reported := self._reported_jobs()) is None:
            return _unreadable()
        found = next((one for one in reversed(reported) if one.name == job.Value), None)
        answer = TYPES.ISA95JobResponseDataType() if found is None else self._response(found)
        return [ua.Variant(answer), _status(UNKNOWN_JOB if found is None else NO_ERROR)]

    async def _by_state(self, _: Any, states: ua.Variant) -> Any:
        """RequestJobResponseByJobOrderState: all jobs in that state; it has no substates."""
        if (reported := self._reported_jobs()) is None:
            return _unreadable()
        top = next((one for one in states.Value or () if not one.BrowsePath.Elements), None)
        if top is None:
            return [_several([]), _status(INVALID)]
        if (requested := _name(top)) is None or len(states.Value) > 1:
            return [_several([]), _status(UNKNOWN_STATE)]
        return [
            _several([self._response(one) for one in reported if self._state_name(one) == requested]),
            _status(NO_ERROR),
        ]

    def _reported_jobs(self) -> list[OpcUaJob] | None:
        """Jobs that have a response."""
        if self._published is None or self._is_running is None:
            return None
        return [one for one in self._published if one.number is not None]


def _result(order: OpcUaJob) -> Any:
    times = None
    if order.began_s is not None and order.ended_s is not None:
        times = TYPES.ProcessingTimesDataType(StartTime=_time(order.began_s), EndTime=_time(order.ended_s))
    verdicts = TYPES.ResultEvaluationEnum
    verdict = verdicts.OK if _accepted(order) else verdicts.NotOK if order.holds is False else verdicts.NotDecidable
    meta = TYPES.ResultMetaDataType(
        ResultId=order.id, IsPartial=False, ResultState=COMPLETED, PartId=order.part_id, JobId=order.name,
        CreationTime=_time(order.ended_s), ProcessingTimes=times, ResultEvaluation=verdict,
        ResultEvaluationDetails=ua.LocalizedText(_description(order), "en"),
    )  # fmt: skip
    content = [ua.Variant(_pair(one)) for one in (OpcUaResultValue("Outcome", order.end), *order.figures)]
    return TYPES.ResultDataType(ResultMetaData=meta, ResultContent=content)


def _accepted(order: OpcUaJob) -> bool:
    return order.end == Outcome.IN_TOLERANCE or (order.end == "accepted" and order.holds is not False)


def _description(order: OpcUaJob) -> str:
    """Texts of end and reason."""
    return ": ".join(filter(None, (order.end.replace("_", " "), order.why))) or "under way"


def _pair(figure: OpcUaResultValue) -> ua.KeyValuePair:
    """A property of the base model, which each client can read. Its name contains the unit."""
    unit = f" [{figure.unit}]" if figure.unit else ""
    return ua.KeyValuePair(ua.QualifiedName(figure.name + unit), ua.Variant(figure.value))


def _parameter(figure: OpcUaResultValue) -> Any:
    unit = None
    if figure.unit == "nm":
        text = ua.LocalizedText("nm"), ua.LocalizedText("nanometre", "en")
        unit = ua.EUInformation(UNITS, NANOMETRE, *text)
    described = None if unit or not figure.unit else [ua.LocalizedText(f"in {figure.unit}", "en")]
    value = ua.Variant(figure.value)
    return TYPES.ISA95ParameterDataType(ID=figure.name, Value=value, Description=described, EngineeringUnits=unit)


def _name(state: Any) -> str | None:
    """Name of a requested state, by number or text; None: unknown state."""
    if state.StateNumber:
        return STATES[state.StateNumber - 1] if state.StateNumber <= len(STATES) else None
    return state.StateText.Text if state.StateText.Text in STATES else None


def _status(bits: int) -> ua.Variant:
    return ua.Variant(bits, ua.VariantType.UInt64)


def _several(values: list[Any]) -> ua.Variant:
    return ua.Variant(values, ua.VariantType.ExtensionObject, is_array=True)


def _time(unix_s: float | None) -> Any:
    return None if unix_s is None else datetime.fromtimestamp(unix_s, UTC)


def _unreadable() -> ua.StatusCode:
    status: Any = Status.BadNoCommunication
    return ua.StatusCode(status)
