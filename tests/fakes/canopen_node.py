"""Drive made of canopen's LocalNode, as a process: ``python -m tests.fakes.canopen_node PORT EDS``.

Objects, NMT, heartbeat and emergencies are the library's. Of CiA 402 there is only what its objects need to make sense.
"""

from __future__ import annotations

import sys
import threading
from typing import Any

import canopen

NODE = 5
LATCH_UP_UNITS = 7770
"""Target velocity at which the drive sends an emergency message."""
STATUS = {0x06: 0x231, 0x07: 0x233, 0x0F: 0x237}


class LocalDrive:
    """Drive that answers reads of objects without a value in its EDS file and follows control words at once."""

    def __init__(self, network: canopen.Network, eds: str) -> None:
        self.node = network.create_node(NODE, eds)
        self.values = {0x1001: 0, 0x6041: 0x250, 0x606C: 0, 0x603F: 0, 0x6061: 0}
        self.node.data_store[0x1018] = {4: (4020).to_bytes(4, "little")}
        self.node.add_read_callback(self._read)
        self.node.add_write_callback(self._written)
        self.node.nmt.state = "INITIALISING"  # the boot message
        self.node.nmt.state = "PRE-OPERATIONAL"

    def _read(self, index: int, subindex: int, od: Any) -> int | None:
        return self.values.get(index)

    def _written(self, index: int, subindex: int, od: Any, data: bytes) -> None:
        value = int.from_bytes(data, "little", signed=True)
        if index == 0x6040:
            self.values[0x6041] = STATUS.get(value & 0x0F, 0x250)
            self.values[0x606C] = self.values[0x606C] if value & 0x0F == 0x0F else 0
        elif index == 0x60FF:
            self.values[0x606C] = value
            self.node.network.send_message(0x180 + NODE, data + bytes(4))  # a PDO, as drives send them unasked
            if value == LATCH_UP_UNITS:
                self.node.emcy.send(0x4210, 0x09)
        elif index == 0x6060:
            self.values[0x6061] = value


def main() -> None:
    """Run the drive until standard input ends."""
    port, eds = sys.argv[1:]
    network = canopen.Network()
    network.connect(interface="socketcand", host="127.0.0.1", port=int(port), channel="can0")
    LocalDrive(network, eds)
    print("ready", flush=True)
    threading.Thread(target=sys.stdin.read, daemon=False).start()


if __name__ == "__main__":
    main()
