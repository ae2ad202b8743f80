"""What a daemon's state is called in OPC 40001-1: of the machine, and of its mode of operation."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple


class Item(IntEnum):
    """States of MachineryItemState: their nodes in the namespace of Machinery."""

    OutOfService = 5004
    NotAvailable = 5005
    Executing = 5006
    NotExecuting = 5007


class Mode(IntEnum):
    """States of MachineryOperationMode: their nodes, too. ``Nothing`` is called None there."""

    Nothing = 5024
    Maintenance = 5025
    Processing = 5026
    Setup = 5027

    @property
    def said(self) -> str:
        """Its browse name."""
        return "None" if self is Mode.Nothing else self.name


class MachineStates(NamedTuple):
    """Both."""

    item: Item
    mode: Mode


STATES: Mapping[str, MachineStates] = {
    "starting": MachineStates(Item.NotExecuting, Mode.Setup),
    "idle": MachineStates(Item.NotExecuting, Mode.Processing),
    "changing": MachineStates(Item.NotExecuting, Mode.Setup),
    "polishing": MachineStates(Item.Executing, Mode.Processing),
    "held": MachineStates(Item.OutOfService, Mode.Processing),
    "finished": MachineStates(Item.NotAvailable, Mode.Nothing),
}
"""Of a daemon. Held is out of service: it does nothing until a person has mended the cause, and said so."""
NO_DAEMON = MachineStates(Item.NotAvailable, Mode.Nothing)
GOING = {"starting", "changing", "polishing"}
"""A job under way is worked in these, and stands still in the others."""
