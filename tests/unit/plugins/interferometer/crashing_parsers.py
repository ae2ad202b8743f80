"""Parsers that do what C libraries do on broken files; run by the worker of ``sandbox``."""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import MapInput, MapStep, MaskCount
from tests.unit.util.worker_targets import answers_pipe

EVERYTHING = SurfaceMap(
    height_nm=np.array([[1.0, np.nan], [-3.5, 4.0]]),
    pitch_mm=0.25,
    part_id="lens",
    instrument="an instrument",
    taken_at=datetime(2026, 1, 2, 3, 4, 5, 678, tzinfo=UTC),
    date_from="guessed",
    sha256="ab",
    format="datx",
    factors={"wavelength_nm": np.float64(632.8), "flipped": True, "of": [1, "x", None]},
    warnings=("one", "two"),
    unsaid=frozenset({"surface", "unit"}),
    doubts={"surface": "it may be a wavefront"},
    orientation="upside down",
    fiducials_px=((1.0, 2.5),),
    reader_version=3,
    pitches_mm=(0.25, 0.5),
    masks=(MaskCount("0..1", 3, 4),),
    history=MapStep("average", "1.0", {"profile": "p"}, (MapInput("map", "a.datx", "cd"),), 0.5),
)


class Evil:
    """Touches a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path.with_suffix(".run"),)


def parse(path: Path) -> SurfaceMap:  # noqa: C901
    """Do what the file's text says."""
    match path.read_text().strip():
        case "map":
            return SurfaceMap(height_nm=np.arange(6.0).reshape(2, 3), pitch_mm=0.5, path=path, part_id=str(os.getpid()))
        case "environment":
            return SurfaceMap(height_nm=np.zeros((1, 1)), pitch_mm=None, part_id=" ".join(os.environ))
        case "all":
            return EVERYTHING
        case "half":
            return SurfaceMap(height_nm=np.zeros((1, 1)), pitch_mm=None, part_id="a\udcffb")
        case "pickle":  # as a file would that has taken the worker over
            os.write(answers_pipe(), pickle.dumps(Evil(path)) + b"\n")
        case "no map":
            heights = b'{"name": "height_nm", "type": "f8", "shape": [3]}'
            head = b'{"reason": "", "errno": 0, "map": {"has_path": true}, "arrays": [%b]}\n'
            os.write(answers_pipe(), head % heights + bytes(24))
        case "huge":
            huge = b'{"arrays": [{"name": "height_nm", "type": "f8", "shape": [1073741824, 1073741824]}]}\n'
            os.write(answers_pipe(), huge)
        case "refuse":
            raise MapError(f"{path}: torn")
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
