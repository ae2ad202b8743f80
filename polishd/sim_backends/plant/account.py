"""The plant's own account of dwell: the witness that nothing was polished twice."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from polishd.model.surface import FloatArray
from polishd.sim_backends.plant.part import TruePart
from polishd.sim_backends.runtime import replace_file


@dataclass(slots=True)
class ContactExitRecord:
    """What the part lost from a moment on: the cost of leaving contact, marked by whoever causes it (SIGUSR1)."""

    from_s: float
    """Wall time (monotonic) of the mark."""
    removed_nm: FloatArray
    standing_nm: FloatArray
    contact_s: float = 0.0
    standing_s: float = 0.0
    until_s: float = 0.0
    """Wall time of the last contact."""

    def report(self) -> dict[str, float]:
        """Seconds of contact (process time) and the deepest place, in all and at standstill."""
        seconds = {name: getattr(self, name) for name in ("from_s", "until_s", "contact_s", "standing_s")}
        return {
            **seconds,
            "peak_nm": float(self.removed_nm.max()),
            "standing_peak_nm": float(self.standing_nm.max()),
        }


@dataclass(slots=True)
class Pit:
    """Removal beyond plan from the first wrong moment on: what a fault of motion or force costs the part.

    Planned is the set point of the force for as long as the motion planned takes. A tool that stands, or is slow, or
    presses more, removes more than that; one that is being lifted removes less.
    """

    from_s: float
    """Wall time (monotonic) of the first wrong moment."""
    excess_nm: FloatArray
    contact_s: float = 0.0
    """Process time of contact since."""
    until_s: float = 0.0
    """Wall time of the last contact."""

    def report(self, part: TruePart) -> dict[str, Any]:
        """Times, and the worst place in the part's own x and y."""
        row, column = np.unravel_index(int(self.excess_nm.argmax()), self.excess_nm.shape)
        return {
            **{name: getattr(self, name) for name in ("from_s", "until_s", "contact_s")},
            "peak_nm": float(self.excess_nm.max()),
            "at_mm": [float(part.grid.x_mm[column]), float(part.grid.y_mm[row])],
            **self._on_part(part),
        }

    def _on_part(self, part: TruePart) -> dict[str, float]:
        """Worst place of the part itself, without the ring on which the tool lands, and what was planned there."""
        on_part = np.pad(part.valid, part.pad)
        worst = int(np.where(on_part, self.excess_nm, -np.inf).argmax())
        planned_nm = part.start_nm - part.height_nm - self.excess_nm
        return {"part_nm": float(self.excess_nm.flat[worst]), "planned_nm": float(planned_nm.flat[worst])}


@dataclass(slots=True)
class DwellAccount:
    """Contact seconds (process time) for each block of each program, and at standstill."""

    programs: dict[str, FloatArray] = field(default_factory=dict)
    loads: dict[str, int] = field(default_factory=dict)
    current: str = ""
    standstill_s: float = 0.0
    stands: list[dict[str, float]] = field(default_factory=list)
    way_out: ContactExitRecord | None = None
    pit: Pit | None = None

    def load(self, sha256: str, blocks: int) -> None:
        """A program was loaded; one that was loaded before goes on with its old account."""
        self.current = sha256
        self.loads[sha256] = self.loads.get(sha256, 0) + 1
        known = self.programs.get(sha256)
        if known is None or len(known) != blocks:
            self.programs[sha256] = np.zeros(blocks)

    def dwell(self, program: str, seq: FloatArray, seconds: FloatArray) -> None:
        """Contact in blocks."""
        book = self.programs.get(program)
        if book is not None and len(seq):
            np.add.at(book, seq.astype(np.int64), seconds)

    def stand(
        self, x_mm: float, y_mm: float, at_s: float, seconds: float, *, force_n: float = 0.0, rpm: float = 0.0
    ) -> None:
        """Contact at standstill, under that force and at that speed of the spindle."""
        self.standstill_s += seconds
        last = self.stands[-1] if self.stands else None
        if last and at_s - last["until_s"] < 0.5 and abs(last["x_mm"] - x_mm) + abs(last["y_mm"] - y_mm) < 0.01:
            last["seconds"] += seconds
            last["until_s"] = at_s
            last["most_n"], last["most_rpm"] = max(last["most_n"], force_n), max(last["most_rpm"], rpm)
        else:
            times = {"from_s": at_s, "until_s": at_s, "seconds": seconds}
            self.stands.append({"x_mm": x_mm, "y_mm": y_mm, **times, "most_n": force_n, "most_rpm": rpm})

    def write(self, folder: Path, part: TruePart, process_s: float, until_s: float) -> None:
        """``dwell_account.json`` and ``truth.npz``, each replaced whole; all is in them up to that wall time."""
        rms, pv = part.stats()
        books: list[dict[str, Any]] = [
            {"sha256": sha, "blocks": len(book), "loads": self.loads[sha], "contact_s": np.round(book, 7).tolist()}
            for sha, book in self.programs.items()
        ]
        message = {
            "process_s": process_s,
            "until_s": until_s,
            "rms_nm": rms,
            "pv_nm": pv,
            "standstill_contact_s": self.standstill_s,
            "stands": self.stands,
            "way_out": self.way_out.report() if self.way_out is not None else None,
            "pit": self.pit.report(part) if self.pit is not None else None,
            "programs": books,
            "truth": "truth.npz",
        }
        replace_file(folder / "dwell_account.json", json.dumps(message).encode())
        part.write(folder / "truth.npz")
