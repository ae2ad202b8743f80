"""Parsers that do what C libraries do on broken files; run by the worker of ``apart``."""

from __future__ import annotations

import ctypes
import os
import signal
import time
from pathlib import Path

import numpy as np

from polishd.api import BadMap, SurfaceMap


def parse(path: Path) -> SurfaceMap:
    """Do what the file's text says."""
    match path.read_text().strip():
        case "map":
            return SurfaceMap(height_nm=np.arange(6.0).reshape(2, 3), pitch_mm=0.5, path=path, part_id=str(os.getpid()))
        case "refuse":
            raise BadMap(f"{path}: torn")
        case "raise":
            raise ZeroDivisionError("of a parser")
        case "crash":
            ctypes.string_at(0)
        case "die":
            signal.raise_signal(signal.SIGKILL)
        case "allocate":
            np.ones(2**28)
        case "spin":
            while True:
                pass
        case _:
            time.sleep(600)
    raise AssertionError("came back from the dead")
