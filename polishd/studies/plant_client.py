"""The simulator's plant in a worker process, without device protocols: docs/protocols/batch_plant.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

from polishd.model.errors import ComputeError, WorkerError
from polishd.model.program import Program
from polishd.model.surface import FloatArray
from polishd.util.worker_process import WorkerProcess

TARGET = "polishd.sim_backends.batch:start_worker"


class PlantProcess:
    """One process, which polishes one part after the other. Use it in a ``with``."""

    def __init__(self) -> None:
        """Start it."""
        self._worker = WorkerProcess(TARGET, "the plant")

    def __enter__(self) -> Self:
        """Enter the context."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        self._worker.end()

    @property
    def alive(self) -> bool:
        """True if it takes another request."""
        return self._worker.alive

    def new(self, config: Mapping[str, Any], seed: int) -> None:
        """Draw another plant from SIM.toml's sections and a seed. ComputeError, as of all requests."""
        self._request({"do": "new", "config": config, "seed": seed})

    def polish(self, program: Program, seconds: FloatArray, force_n: float, rpm: float) -> dict[str, FloatArray]:
        """Execute timed points, in the program's frame.

        Args:
            program: with n timed points.
            seconds: (n,) duration of each.
            force_n: set point, the same for all.
            rpm: set point, the same for all.

        Returns:
            (n,) arrays by name: ``contact_s``, and the true ``force_n`` and ``rpm``.
        """
        even = {"force_n": seconds * 0.0 + force_n, "rpm": seconds * 0.0 + rpm, "seconds": seconds}
        path = {"begin_mm": program.start_mm, "end_mm": program.end_mm, "axis": program.axis}
        return self._request({"do": "polish"}, {**path, **even})[1]

    def measure(
        self, wait_s: float = 0.0, angle_deg: float = 0.0, shift_px: tuple[int, int] = (0, 0)
    ) -> tuple[FloatArray, float]:
        """Return (ny, nx) heights, nm, as the instrument measures them, NaN without data; and their pitch, mm.

        The part is turned counterclockwise by quarters, then moved by columns to the right and rows up.
        """
        columns, rows = shift_px
        pose = {"rotation_deg": angle_deg, "shift_columns": columns, "shift_rows": rows}
        answer, arrays = self._request({"do": "measure", "wait_s": wait_s, **pose})
        return arrays["height_nm"], float(answer["pitch_mm"])

    def truth(self, *, held: bool = False) -> tuple[dict[str, Any], FloatArray]:
        """Return the draws, and (ny, nx) true heights of the part, nm; ``held``: deformed by its mount."""
        answer, arrays = self._request({"do": "truth"})
        return answer, arrays["held_nm" if held else "height_nm"]

    def patch(self) -> tuple[FloatArray, float] | None:
        """Return (n, n) removal so far in the fine patch, nm, and its pitch in mm; None where there is none."""
        answer, arrays = self._request({"do": "truth"})
        if "patch_nm" not in arrays:
            return None
        return arrays["patch_start_nm"] - arrays["patch_nm"], float(answer["patch_pitch_mm"])

    def _request(
        self, request: Mapping[str, Any], arrays: Mapping[str, FloatArray] | None = None
    ) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        try:
            return self._worker.request(request, arrays)
        except WorkerError:
            raise
        except ComputeError as error:
            raise ComputeError(f"the plant refuses {request['do']!r}: {error}") from error
