"""The PLC's variables over OPC UA: asyncua's server, one node a variable."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import UTC
from functools import partial

from asyncua import Server, ua
from asyncua.server.address_space import NodeData

from polishd.sim_backends.handover.plc import Plc
from polishd.sim_backends.runtime import LOOPBACK

NAMESPACE = "urn:polishd:handover"
OPCUA_TYPES = {
    "start": ua.VariantType.Boolean,
    "hold": ua.VariantType.Boolean,
    "reset": ua.VariantType.Boolean,
    "load": ua.VariantType.Boolean,
    "program": ua.VariantType.String,
    "heartbeat": ua.VariantType.UInt32,
    "state": ua.VariantType.UInt16,
    "line": ua.VariantType.UInt32,
    "line_began": ua.VariantType.Double,
    "state_began": ua.VariantType.Double,
    "clock": ua.VariantType.Double,
    "loaded": ua.VariantType.String,
    "feed_override": ua.VariantType.Double,
    "feed_hold": ua.VariantType.Boolean,
    "in_motion": ua.VariantType.Boolean,
    "alarm": ua.VariantType.UInt32,
    "alarm_text": ua.VariantType.String,
    "controller_heartbeat": ua.VariantType.UInt32,
    "session": ua.VariantType.String,
}


@asynccontextmanager
async def served(plc: Plc) -> AsyncIterator[int]:
    """The server, for as long as the block lasts; its port on loopback."""
    logging.getLogger("asyncua").setLevel(logging.ERROR)
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://{LOOPBACK}:0")
    server.set_server_name("polishd simulated PLC")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace(NAMESPACE)
    space = server.iserver.aspace
    folder = await server.nodes.objects.add_object(index, "polishd")
    for name, kind in OPCUA_TYPES.items():
        value = plc.inputs[name] if name in plc.inputs else plc.shown[name]
        node = await folder.add_variable(ua.NodeId.from_string(f"ns={index};s={name}"), name, value, kind)
        if name in plc.inputs:
            await node.set_writable()
            space.set_attribute_value_setter(node.nodeid, ua.AttributeIds.Value, partial(_take, plc, name))
        else:
            server.set_attribute_value_callback(node.nodeid, partial(_tell, plc, name, kind))
    await server.start()
    try:
        assert server.bserver is not None
        yield server.bserver.port
    finally:
        await server.stop()


def _take(plc: Plc, name: str, node: NodeData, attribute: ua.AttributeIds, value: ua.DataValue) -> ua.DataValue:
    """A client writes: the controller sees it in its next cycle."""
    assert value.Value is not None
    node.attributes[attribute].value = value
    plc.inputs[name] = value.Value.Value
    return value


def _tell(plc: Plc, name: str, kind: ua.VariantType, _node: ua.NodeId, _attribute: ua.AttributeIds) -> ua.DataValue:
    """A client reads: it gets what the last report has."""
    return ua.DataValue(ua.Variant(plc.shown[name], kind), ServerTimestamp=ua.DateTime.now(UTC))
