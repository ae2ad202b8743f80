"""Fake part loader according to the protocol document, on ASCII lines."""

from __future__ import annotations

import time

from tests.fakes.wires import NumberedPeer

MOVE_S = 0.3
VENDOR, MODEL, SERIAL, FIRMWARE = "Fake Loaders", "FL-9", "SN-0077", "2.0"


class FakeLoader(NumberedPeer):
    """Loader with its line."""

    def __init__(self) -> None:
        super().__init__()
        self.magazine = ["P-1", "lens 7"]
        self.seat = ""
        self.fault = 0
        self.faults_amid = 0
        """Fault bits with which the next change ends."""
        self.brings = ""
        """Part that is loaded instead of the requested one."""
        self.move_s = MOVE_S
        self._order = ""
        self._until = 0.0
        self._stopped = False

    @property
    def state(self) -> int:
        self._update()
        return 3 if self.fault else 2 if self._stopped else 1 if self._order else 0

    def _update(self) -> None:
        if not self._order or self._stopped or time.monotonic() < self._until:
            return
        order, self._order = self._order, ""
        self.fault, self.faults_amid = self.faults_amid, 0
        if not self.fault:
            self.seat = (self.brings or order.removeprefix("LD,")) if order.startswith("LD,") else ""

    def _answer(self, request: str) -> str:
        self._update()
        name, _, part = request.partition(",")
        if name == "ID?":
            return f"ID,{VENDOR},{MODEL},{SERIAL},{FIRMWARE},4"
        if name == "ST?":
            return f"ST,{self.state},{self.fault},{self.seat}"
        if name == "STOP":
            self._stopped = self._stopped or bool(self._order)
            return "OK"
        if name not in {"LD", "UL"}:
            return "ERR,unknown,what?"
        if self.state in {1, 3}:
            return "ERR,busy,it moves" if self.state == 1 else "ERR,fault,a fault is set"
        if name == "LD" and part.replace("%20", " ") not in self.magazine:
            return "ERR,part,no such part"
        if name == "LD" and self.seat == part:
            return "OK"
        if name == "LD" and self.seat:
            return "ERR,occupied,a part is on the seat"
        self._order, self._until, self._stopped = request, time.monotonic() + self.move_s, False
        return "OK"
