"""The simulator's plant in a process of its own, without wires: docs/protocols/batch_plant.md."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from typing import Any, BinaryIO, Self, cast

from polishd.model.errors import ComputeError
from polishd.model.program import Program
from polishd.model.surface import FloatArray
from polishd.util import array_stream

COMMAND = (sys.executable, "-m", "polishd.sim_backends.batch")
END_S = 5.0
"""It ends by itself at the end of its input."""
SAID = 500
"""Of what it printed as it died, so many characters are told."""


class PlantProcess:
    """One process, which polishes one part after the other. Used in a ``with``."""

    def __init__(self) -> None:
        """Start it."""
        self._broken = False
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  (closed with the process)
        self._process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._said)

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):  # what one that died has not read
                    pipe.close()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._said.close()

    @property
    def alive(self) -> bool:
        """Whether it takes another request."""
        return not self._broken and self._process.poll() is None

    def new(self, config: Mapping[str, Any], seed: int) -> None:
        """Draw another plant from SIM.toml's sections and a seed. ComputeError, as of all requests."""
        self._ask({"do": "new", "config": config, "seed": seed})

    def polish(self, program: Program, seconds: FloatArray, force_n: float, rpm: float) -> dict[str, FloatArray]:
        """Execute timed points, in the program's frame.

        Args:
            program: with n timed points.
            seconds: (n,) how long each lasts.
            force_n: as commanded, the same for all.
            rpm: the same of the speed.

        Returns:
            By name, (n,) each: ``contact_s``, and ``force_n`` and ``rpm`` as they truly acted.
        """
        even = {"force_n": seconds * 0.0 + force_n, "rpm": seconds * 0.0 + rpm, "seconds": seconds}
        path = {"begin_mm": program.start_mm, "end_mm": program.end_mm, "axis": program.axis}
        return self._ask({"do": "polish"}, {**path, **even})[1]

    def measure(
        self, wait_s: float = 0.0, angle_deg: float = 0.0, shift_px: tuple[int, int] = (0, 0)
    ) -> tuple[FloatArray, float]:
        """(ny, nx) heights, nm, as the instrument gives them, NaN where it has none; and their pitch, mm.

        The part is turned counter-clockwise by quarters, then moved by columns to the right and rows up.
        """
        columns, rows = shift_px
        pose = {"rotation_deg": angle_deg, "shift_columns": columns, "shift_rows": rows}
        told, arrays = self._ask({"do": "measure", "wait_s": wait_s, **pose})
        return arrays["height_nm"], float(told["pitch_mm"])

    def truth(self, *, held: bool = False) -> tuple[dict[str, Any], FloatArray]:
        """What was drawn, and (ny, nx) the part's true heights, nm; ``held``: as its mount has it."""
        told, arrays = self._ask({"do": "truth"})
        return told, arrays["held_nm" if held else "height_nm"]

    def _ask(
        self, request: Mapping[str, Any], arrays: Mapping[str, FloatArray] | None = None
    ) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        try:
            array_stream.write(cast(BinaryIO, self._process.stdin), request, arrays)
            answer = array_stream.read(cast(BinaryIO, self._process.stdout))
        except OSError:
            answer = None
        if answer is None:
            self._broken = True
            self._said.seek(0)
            last = self._said.read()[-SAID:].decode(errors="replace").strip() or "it said nothing"
            raise ComputeError(f"the plant's process ended at {request['do']!r}: {last}")
        if "error" in answer[0]:
            raise ComputeError(f"the plant refuses {request['do']!r}: {answer[0]['error']}")
        return answer
