"""Which CANopen nodes are heard on a bus: what is said of one that does not answer."""

from __future__ import annotations

from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress
from polishd.drivers.transport.can_bus import CanFrame

OF_NODES = frozenset({1, 3, 5, 7, 9, 11, 14})
"""Function codes of CiA 301 that a node sends by: emergency, process data, answers to SDO, heartbeat."""


class NodesHeard:
    """The nodes that were heard."""

    def __init__(self) -> None:
        self._nodes: set[int] = set()

    def add(self, frame: CanFrame) -> None:
        """A frame came."""
        function, node = divmod(frame.identifier, 0x80)
        if node and function in OF_NODES:
            self._nodes.add(node)

    def without(self, node: int, address: SlcanAddress | SocketcandAddress) -> str:
        """Why that node does not answer, most likely, and what to do."""
        if node in self._nodes:
            return f"node {node} is there, but is no such device: is it another one?"
        if self._nodes:
            return f"heard are nodes {', '.join(map(str, sorted(self._nodes)))}: see the node number"
        adapter = f", and the adapter's {address.baud} baud" if isinstance(address, SlcanAddress) else ""
        return f"nothing is heard on the bus: see power, bit rate, wires and termination{adapter}"
