"""Read a cell's OPC UA server as a client: its machine, a value with its status, the missing parts of a type."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from asyncua import Client, Node, ua

from polishd.config.server_sections import OpcUaSection
from polishd.opcua import server
from polishd.opcua.jobs import node_id
from polishd.opcua.server import MACHINERY
from tests.time_limits import SOON_S

SECTION = OpcUaSection(
    port=0, manufacturer="Maker", serial_number="7", product_instance_uri="urn:maker:7", model="P", location="Hall 2"
)
MANDATORY = node_id(ua.ObjectIds.ModellingRule_Mandatory, 0)


@asynccontextmanager
async def watching(folder: Path) -> AsyncIterator[Node]:
    """Connect a client on loopback for the duration of the block; the node of the machine."""
    async with server.serving("cell 7", folder, SECTION) as address, Client(address) as client:
        await client.load_data_type_definitions()
        space = await client.get_namespace_index(MACHINERY)
        yield (await client.get_node(node_id(1001, space)).get_children(ua.ObjectIds.Organizes))[0]


async def inner(node: Node, *names: str) -> Node:
    """Return the child node with these browse names, in any namespaces."""
    for name in names:
        found = [one for one in await node.get_children() if (await one.read_browse_name()).Name == name]
        assert len(found) == 1, (name, found)
        node = found[0]
    return node


async def seen(node: Node, *names: str) -> tuple[Any, str]:
    found = await (await inner(node, *names)).read_data_value(raise_on_bad_status=False)
    assert found.StatusCode is not None
    value = None if found.Value is None else found.Value.Value
    return value.Text if isinstance(value, ua.LocalizedText) else value, found.StatusCode.name


async def until(look: Callable[[], Awaitable[bool]]) -> None:
    async with asyncio.timeout(SOON_S):
        while not await look():  # noqa: ASYNC110 - what a server shows has no event here
            await asyncio.sleep(0.02)


async def missing(instance: Node, kind: Node) -> list[str]:
    """Return the mandatory parts of a type, its supertypes and interfaces that the instance lacks, at any depth."""
    lacks = []
    has = {(await one.read_browse_name()).to_string(): one for one in await instance.get_children()}
    for part in await kind.get_children():
        rules = await part.get_references(ua.ObjectIds.HasModellingRule, ua.BrowseDirection.Forward)
        if MANDATORY in [rule.NodeId for rule in rules]:
            name = (await part.read_browse_name()).to_string()
            if name not in has:
                lacks.append(name)
            else:
                lacks += await missing(has[name], part)
    above = await kind.get_references(ua.ObjectIds.HasSubtype, ua.BrowseDirection.Inverse)
    beside = await kind.get_references(ua.ObjectIds.HasInterface, ua.BrowseDirection.Forward)
    for other in (*above, *beside):
        lacks += await missing(instance, Node(instance.session, other.NodeId))
    return lacks


async def type_of(node: Node) -> Node:
    """Return the type definition of a node."""
    found = await node.read_type_definition()
    assert found is not None
    return Node(node.session, found)
