"""Frames of a CAN bus, and the CANopen nodes that send them. Without python-can, whose import is slow."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress


class CanFrame(NamedTuple):
    """A classic CAN frame with an 11-bit identifier."""

    identifier: int
    data: bytes


OnFrame = Callable[[CanFrame], None]


# CANopen nodes that send on a bus, to explain why a node does not answer.

OF_NODES = frozenset({1, 3, 5, 7, 9, 11, 14})
"""Function codes of CiA 301 that a node sends: emergency, process data, SDO answers, heartbeat."""


class NodesHeard:
    """Nodes from which a frame was received."""

    def __init__(self) -> None:
        self._nodes: set[int] = set()

    def add(self, frame: CanFrame) -> None:
        """Record the sender of a frame."""
        function, node = divmod(frame.identifier, 0x80)
        if node and function in OF_NODES:
            self._nodes.add(node)

    def without(self, node: int, address: SlcanAddress | SocketcandAddress) -> str:
        """Return the likely reason why that node does not answer, and what to do."""
        if node in self._nodes:
            return f"node {node} sends, but not as this device. Check the node number."
        if self._nodes:
            return f"only nodes {', '.join(map(str, sorted(self._nodes)))} send. Check the node number."
        adapter = f", and the adapter's {address.baud} baud" if isinstance(address, SlcanAddress) else ""
        return f"the bus is silent. Check power, bit rate, wires and termination{adapter}."
