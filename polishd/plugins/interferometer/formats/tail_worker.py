"""The process that SurfaceTopography runs in: reads one file, prints one line of JSON and the heights, ends.

Run by its path (``python -P tail_worker.py FILE FORMAT BYTES SECONDS``), so it imports nothing of polishd: the standard
library, numpy and SurfaceTopography only. Its standard output is kept from whatever the libraries print.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import sys
from pathlib import Path
from typing import IO, Any

MOST_SAMPLES = 64_000_000


def main(arguments: list[str]) -> int:
    """Read a file of one format within so many bytes of memory and seconds; what fails is printed as JSON."""
    path, format_name, most_bytes, most_s = Path(arguments[0]), arguments[1], int(arguments[2]), int(arguments[3])
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (most_s, most_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with os.fdopen(os.dup(1), "wb") as output:
        os.dup2(2, 1)  # a library that prints does not print into the answer
        try:
            _answer(path, format_name, output)
        except ModuleNotFoundError as error:
            _say(output, {"missing": error.name})
        except Exception as error:  # noqa: BLE001  somebody else's parsers may raise anything
            _say(output, {"error": f"{type(error).__name__}: {error}"[:500]})
    return 0


def _answer(path: Path, format_name: str, output: IO[bytes]) -> None:
    import numpy as np
    from SurfaceTopography import open_topography  # type: ignore[import-not-found,unused-ignore]

    reader = open_topography(str(path), format=format_name)
    topography = reader.topography()
    if topography.dim != 2 or not topography.is_uniform:
        raise ValueError(f"holds a topography of {topography.dim - 1} lateral dimensions, not an even map")
    columns, rows = topography.nb_grid_pts
    if rows * columns > MOST_SAMPLES:
        raise ValueError(f"{rows} x {columns} samples are no map of a camera")
    head = {"rows": int(rows), "columns": int(columns), "unit": topography.unit, "format": str(reader.format())}
    if topography.unit is not None:
        topography = topography.to_unit("nm")
        head["pitch_nm"] = [float(step) for step in topography.pixel_size]
    head["channels"] = len(reader.channels)
    head.update(_info(topography.info))
    heights = topography.heights()
    heights_nm = np.ma.filled(np.ma.asarray(heights, dtype=np.float64), np.nan).T  # [x, y] -> [row, column]
    head["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    _say(output, head)
    output.write(np.ascontiguousarray(heights_nm, dtype="<f8").tobytes())


def _info(info: Any) -> dict[str, str]:
    """Instrument and time, where the library found them."""
    instrument = info.get("instrument")
    name = instrument.get("name") if isinstance(instrument, dict) else instrument
    taken = info.get("acquisition_time")
    return {"instrument": str(name or ""), "taken_at": taken.isoformat() if hasattr(taken, "isoformat") else ""}


def _say(output: IO[bytes], head: dict[str, Any]) -> None:
    output.write(json.dumps(head).encode() + b"\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
