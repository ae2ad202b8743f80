"""Fake force sensor amplifier and input box according to the protocol documents, on ASCII lines."""

from __future__ import annotations

import time

from tests.fakes.wires import NumberedPeer

TARE_S = 0.1
RATE_HZ = 200.0


class FakeAmplifier(NumberedPeer):
    """Load cell with a weight that the test sets."""

    def __init__(self) -> None:
        super().__init__()
        self.weight_n = 3.0
        """Acting force with the weight of attached parts."""
        self.fault = 0
        self.stands = False
        """Whether conversion has stopped while the amplifier still answers."""
        self.shaken = False
        """Whether a tare does not complete."""
        self._zero_n = 0.0
        self._tared_s = 0.0
        self._stood: tuple[int, float] | None = None

    def _answer(self, request: str) -> str:
        if request == "ID?":
            return "ID,Fake Cells,FC-1,SN-3,1.4,2"
        if request == "F?":
            count, force_n = self._converted()
            return f"F,{self._state()},{count},{force_n:+.3f},{self.fault}"
        if request == "TARE":
            if self._state():
                return "ERR,busy,it tares" if self._state() == 1 else "ERR,fault,a fault is set"
            self._tared_s, self._zero_n = time.monotonic() + TARE_S, self.weight_n
            return "OK"
        return "ERR,unknown,what?"

    def _state(self) -> int:
        return 2 if self.fault else 1 if self.shaken or time.monotonic() < self._tared_s else 0

    def _converted(self) -> tuple[int, float]:
        now = int(time.monotonic() * RATE_HZ) % 65536, self.weight_n - self._zero_n
        self._stood = (self._stood or now) if self.stands else None
        return self._stood or now


class FakeInputs(NumberedPeer):
    """Inputs with names."""

    def __init__(self) -> None:
        super().__init__()
        self.values = {"flow": "1.25", "guard.closed": "ON", "vacuum": "-82.5", "level": "?"}

    def _answer(self, request: str) -> str:
        name, _, what = request.partition(",")
        if request == "ID?":
            return "ID,Fake Inputs,FI-8,SN-4,2.1,5"
        if name == "LS?" and what.isdigit():
            names = list(self.values)
            return f"LS,{what},{names[int(what)]}" if int(what) < len(names) else f"LS,{what}"
        if name == "V?" and what in self.values:
            return f"V,{what},{self.values[what]}"
        return "ERR,unknown,what?"
