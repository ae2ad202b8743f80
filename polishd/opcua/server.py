"""``polishd opcua``: read the daemon once a second and publish its values to OPC UA clients, read only."""

from __future__ import annotations

import asyncio
import logging
import re
import signal
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime, timedelta
from enum import IntEnum
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from asyncua import Node, Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.user_managers import UserManager

from polishd import __version__
from polishd.config.server_sections import OpcUaSection
from polishd.daemon.socket import client
from polishd.model.errors import ConfigError, NoDaemon, PolishdError
from polishd.opcua.jobs import (
    JOB_MANAGEMENT,
    JOBS,
    RESULT_MANAGEMENT,
    RESULTS,
    OpcUaJob,
    OpcUaJobs,
    Status,
    data_value,
    good,
    node_id,
    nothing,
    read_work,
)
from polishd.web.watcher import OLD_S

# States of OPC 40001-1 for the daemon's states: machine state and operation mode.


class ItemState(IntEnum):
    """States of MachineryItemState: their nodes in the namespace of Machinery."""

    OutOfService = 5004
    NotAvailable = 5005
    Executing = 5006
    NotExecuting = 5007


class OperationMode(IntEnum):
    """States of MachineryOperationMode: their nodes, too. ``Nothing`` is called None there."""

    Nothing = 5024
    Maintenance = 5025
    Processing = 5026
    Setup = 5027

    @property
    def browse_name(self) -> str:
        """Browse name of the state."""
        return "None" if self is OperationMode.Nothing else self.name


class MachineStates(NamedTuple):
    """Both states."""

    item: ItemState
    mode: OperationMode


STATES: Mapping[str, MachineStates] = {
    "starting": MachineStates(ItemState.NotExecuting, OperationMode.Setup),
    "idle": MachineStates(ItemState.NotExecuting, OperationMode.Processing),
    "changing": MachineStates(ItemState.NotExecuting, OperationMode.Setup),
    "polishing": MachineStates(ItemState.Executing, OperationMode.Processing),
    "held": MachineStates(ItemState.OutOfService, OperationMode.Processing),
    "finished": MachineStates(ItemState.NotAvailable, OperationMode.Nothing),
}
"""States by the daemon's state. A held cell is out of service until a person has removed the cause and resumed it."""
NO_DAEMON = MachineStates(ItemState.NotAvailable, OperationMode.Nothing)
CONTINUING = {"starting", "changing", "polishing"}
"""States in which a job under way continues; in the others it is interrupted."""


DI, MACHINERY = "http://opcfoundation.org/UA/DI/", "http://opcfoundation.org/UA/Machinery/"
FILES = (
    "Opc.Ua.Di.NodeSet2.xml", "Opc.Ua.IA.NodeSet2.xml", "Opc.Ua.Machinery.NodeSet2.xml",
    "Opc.Ua.Isa95JobControl.NodeSet2.xml", "Opc.Ua.Machinery.Jobs.NodeSet2.xml", "Opc.Ua.Machinery.Result.NodeSet2.xml",
)  # fmt: skip
"""In the order of their dependences."""
DEFAULTS = re.compile(
    r'(<UAVariable(?:Type)? [^>]*DataType="(?:Result|ProcessingTimes)\w*DataType"(?:(?!</UAVariable).)*?)'
    r"<Value>.*?</Value>",
    re.DOTALL,
)
"""Empty values of types' structures, which asyncua cannot read; a type's value is never used."""
MACHINES, ITEM_STATE, IDENTIFICATION, OPERATION_MODE = 1001, 1002, 1012, 1008
"""Nodes of Machinery: the folder of machines, and types."""
TEXT, NUMBER, INTEGER, BOOLEAN = (
    ua.VariantType.String, ua.VariantType.Double, ua.VariantType.Int64, ua.VariantType.Boolean,
)  # fmt: skip
EMPTY: Mapping[ua.VariantType, Any] = {TEXT: "", NUMBER: 0.0, INTEGER: 0, BOOLEAN: False}
"""Initial values of variables; they are set to unknown before a client can connect."""


class OpcUaVariable(NamedTuple):
    """A variable of polishd: its path in ``live``, and its type."""

    name: str
    path: tuple[str, ...]
    kind: ua.VariantType
    what: str


SHOWN = (
    OpcUaVariable("State", ("state",), TEXT, "What the daemon does."),
    OpcUaVariable("Reason", ("reason",), TEXT, "Why it is held, or ended."),
    OpcUaVariable("Next", ("next",), TEXT, "What a person is to do."),
    OpcUaVariable("Job", ("job",), TEXT, "The job under way."),
    OpcUaVariable("Part", ("part",), TEXT, "Its part."),
    OpcUaVariable("Cycle", ("cycle",), INTEGER, "Number of the cycle under way; the first is 0."),
    OpcUaVariable("Phase", ("phase",), TEXT, "Of the cycle."),
    OpcUaVariable("Pressing", ("pressing",), BOOLEAN, "The tool is on the part."),
    OpcUaVariable("Force_N", ("readings", "force", "force_n"), NUMBER, "Force that the actuator measures, N."),
    OpcUaVariable("SensedForce_N", ("readings", "sensed", "force_n"), NUMBER, "Force of the independent sensor, N."),
    OpcUaVariable("SpindleSpeed_rpm", ("readings", "speed", "rpm"), NUMBER, "Speed of the spindle, 1/min."),
)


class OpcUaMachine:
    """One cell's node and the updates of its values; made by ``added``."""

    def __init__(
        self,
        server: Server,
        namespace: int,
        own: Mapping[OpcUaVariable, Node],
        item: tuple[Node, Node],
        jobs: OpcUaJobs,
    ) -> None:
        self._server, self._namespace, self._variable_nodes = server, namespace, own
        (self._state, self._mode), self._jobs = item, jobs

    @classmethod
    async def added(cls, server: Server, name: str, section: OpcUaSection) -> OpcUaMachine:
        """Import the companion models, and put the cell under ``Machines``."""
        await _models(server)
        machinery = await server.get_namespace_index(MACHINERY)
        own = await server.register_namespace(f"urn:polishd:{name}")

        def id_(path: str) -> ua.NodeId:
            """Node id that stays the same after each start, for clients."""
            return node_id(path, own)

        machines = server.get_node(node_id(MACHINES, machinery))
        machine = await machines.add_object(id_("Machine"), ua.QualifiedName(name, own))
        blocks = await machine.add_folder(id_("Blocks"), ua.QualifiedName("MachineryBuildingBlocks", machinery))

        async def block(bname: str, kind: int, space: int, types: int | None = None) -> Node:
            name = ua.QualifiedName(bname, space)
            type_ = node_id(kind, space if types is None else types)
            node = await machine.add_object(id_(bname), name, objecttype=type_, instantiate_optional=False)
            await machine.delete_reference(node.nodeid, ua.ObjectIds.HasComponent)
            for parent in (blocks, machine):
                await parent.add_reference(node.nodeid, ua.ObjectIds.HasAddIn)
            return node

        di = await server.get_namespace_index(DI)
        identification = await block("Identification", IDENTIFICATION, di, machinery)
        await _identify(identification, name, section, (di, machinery, own))
        state = await block("MachineryItemState", ITEM_STATE, machinery)
        mode = await block("MachineryOperationMode", OPERATION_MODE, machinery)
        management = await block("JobManagement", JOB_MANAGEMENT, await server.get_namespace_index(JOBS))
        results = await block("ResultManagement", RESULT_MANAGEMENT, await server.get_namespace_index(RESULTS))
        jobs = await OpcUaJobs.added(server, management, results)
        cell = await machine.add_object(id_("Cell"), ua.QualifiedName("Cell", own))
        shown = {}
        for one in SHOWN:
            bname, type_ = ua.QualifiedName(one.name, own), node_id(getattr(ua.ObjectIds, one.kind.name), 0)
            node = shown[one] = await cell.add_variable(
                id_(f"Cell.{one.name}"), bname, EMPTY[one.kind], one.kind, type_
            )
            await node.write_attribute(ua.AttributeIds.Description, good(ua.LocalizedText(one.what)))
        found = cls(server, machinery, shown, (state, mode), jobs)
        await found.silent(None)
        return found

    async def update(self, live: Mapping[str, Any], orders: Sequence[OpcUaJob] | None) -> None:
        """Show the daemon's answer to ``live``, and the jobs of the journal (None: it cannot be read)."""
        now = datetime.now(UTC)
        await self._show_states(STATES[live["state"]])
        await self._jobs.update(orders, live["state"] in CONTINUING)
        for one, node in self._variable_nodes.items():
            await self._server.write_attribute_value(node.nodeid, _of(live, one, now))

    async def no_daemon(self, orders: Sequence[OpcUaJob] | None) -> None:
        """Show that no daemon runs: the machine is not available, and only the journal is known."""
        await self._show_states(NO_DAEMON)
        await self._jobs.update(orders, is_running=False)
        await self._unknown(self._variable_nodes.values(), Status.BadNoCommunication)

    async def silent(self, orders: Sequence[OpcUaJob] | None) -> None:
        """Show a daemon that does not answer (yet): only the ends of earlier jobs are known."""
        nodes = [part for machine in (self._state, self._mode) for part in await _current(machine)]
        await self._jobs.update(orders, is_running=None)
        await self._unknown([*nodes, *self._variable_nodes.values()], Status.BadNoCommunication)

    async def _show_states(self, states: MachineStates) -> None:
        for machine, state, word in (
            (self._state, states.item, states.item.name),
            (self._mode, states.mode, states.mode.browse_name),
        ):
            current, number = await _current(machine)
            node = node_id(int(state), self._namespace)
            text = ua.LocalizedText(word, "en")
            await self._server.write_attribute_value(current.nodeid, good(text))
            await self._server.write_attribute_value(number.nodeid, good(node))

    async def _unknown(self, nodes: Any, status: int) -> None:
        for node in nodes:
            await self._server.write_attribute_value(node.nodeid, nothing(status))


async def _models(server: Server) -> None:
    """Import the companion models, and make classes of their structures."""
    for file in FILES:
        text = (resources.files("polishd.opcua") / "nodesets" / file).read_text(encoding="utf-8")
        await server.import_xml(xmlstring=DEFAULTS.sub(r"\1", text), auto_load_definitions=False)
    await server.load_data_type_definitions()


async def _current(machine: Node) -> tuple[Node, Node]:
    """CurrentState of a state machine, and its Id."""
    current = await machine.get_child("0:CurrentState")
    return current, await current.get_child("0:Id")


async def _identify(node: Node, name: str, section: OpcUaSection, spaces: tuple[int, int, int]) -> None:
    """Set the mandatory properties of the type; add the others where they are known."""
    di, machinery, own = spaces
    mandatory = {
        "Manufacturer": ua.LocalizedText(section.manufacturer),
        "SerialNumber": section.serial_number,
        "ProductInstanceUri": section.product_instance_uri,
    }
    for key, value in mandatory.items():
        child = await node.get_child(ua.QualifiedName(key, di))
        await child.write_value(good(value))
    await node.add_property(
        node_id("Identification.ComponentName", own), ua.QualifiedName("ComponentName", di), ua.LocalizedText(name)
    )
    await node.add_property(
        node_id("Identification.SoftwareRevision", own),
        ua.QualifiedName("SoftwareRevision", di),
        f"polishd {__version__}",
    )
    if section.model is not None:
        await node.add_property(
            node_id("Identification.Model", own), ua.QualifiedName("Model", di), ua.LocalizedText(section.model)
        )
    if section.location is not None:
        await node.add_property(
            node_id("Identification.Location", own), ua.QualifiedName("Location", machinery), section.location
        )


def _of(live: Mapping[str, Any], one: OpcUaVariable, now: datetime) -> ua.DataValue:
    """Data value of one variable: Bad where it is missing, Uncertain with its source time where it is old."""
    found: Any = live
    age_s = 0.0
    for key in one.path:
        if (found := found.get(key)) is None:
            return nothing(Status.BadNoData)
        if isinstance(found, Mapping):
            age_s = found.get("age_s", age_s)
    status = Status.UncertainLastUsableValue if age_s > OLD_S else Status.Good
    return data_value(ua.Variant(found, one.kind), status, now - timedelta(seconds=age_s))


POLL_S = 1.0
"""Interval between two requests."""
REPLY_TIMEOUT_S = 0.8
"""Time without an answer after which the daemon counts as silent."""
ADDRESS = "127.0.0.1"
"""OPC UA beyond this computer needs certificates on both sides, which polishd lacks: docs/how-to/plant-systems.md."""


class ReadOnlyUsers(UserManager):
    """Access rights: all users may read, none may write."""

    def get_user(self, iserver: Any, username: str | None = None, password: str | None = None,
                 certificate: Any = None) -> User:  # fmt: skip
        """User of a client that opens a session."""
        del iserver, username, password, certificate
        return User(role=UserRole.User)


@asynccontextmanager
async def serving(name: str, state_dir: Path, section: OpcUaSection) -> AsyncIterator[str]:
    """Serve inside this block; yield the address. OSError where the port is taken."""
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # it logs a warning at each start
    server = Server(user_manager=ReadOnlyUsers())
    await server.init()
    server.set_server_name(f"polishd {name}")
    await server.set_application_uri(f"urn:polishd:{name}:server")
    server.set_endpoint(f"opc.tcp://{ADDRESS}:{section.port}/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    server.set_identity_tokens([ua.AnonymousIdentityToken])
    machine = await OpcUaMachine.added(server, name, section)
    # a fault of the polling task ends the server, so that no stale values remain
    async with server, asyncio.TaskGroup() as group:
        polling = group.create_task(_poll_daemon(machine, state_dir))
        try:
            port = section.port if server.bserver is None else server.bserver.port
            yield f"opc.tcp://{ADDRESS}:{port}/"
        finally:
            polling.cancel()


async def serve(name: str, state_dir: Path, section: OpcUaSection) -> None:
    """Serve until Ctrl-C or SIGTERM, and print the address. OSError where the port is taken."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    async with serving(name, state_dir, section) as address:
        print(address, flush=True)  # noqa: T201 - the starting process waits for this line
        await stop.wait()


async def _poll_daemon(machine: OpcUaMachine, state_dir: Path) -> None:
    while True:
        orders = await asyncio.to_thread(_orders, state_dir)
        try:
            live = await asyncio.to_thread(client.request, state_dir, "live", REPLY_TIMEOUT_S)
        except NoDaemon:
            await machine.no_daemon(orders)
        except (PolishdError, OSError):  # OSError: too many open files
            await machine.silent(orders)
        else:
            await (machine.update(live, orders) if live.get("state") in STATES else machine.silent(orders))
        await asyncio.sleep(POLL_S)


def _orders(state_dir: Path) -> tuple[OpcUaJob, ...] | None:
    """Jobs of the journal; None: it cannot be read."""
    try:
        return read_work(state_dir)
    except ConfigError:
        return None
