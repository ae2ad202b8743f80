"""``python -m polishd.sim_backends.batch``: requests on stdin, answers on stdout, until the end of the input."""

from __future__ import annotations

import sys
from typing import Any, BinaryIO

import numpy as np
from pydantic import ValidationError

from polishd.model import frames
from polishd.model.errors import BatchRequestError, FrameError, PolishdError
from polishd.model.surface import FloatArray
from polishd.sim_backends.batch import plant

Answer = tuple[dict[str, Any], dict[str, FloatArray]]


def serve(requests: BinaryIO, answers: BinaryIO) -> int:
    """Answer all of them; the process's exit code."""
    current: plant.BatchPlant | None = None
    while True:
        try:
            request = frames.read(requests)
        except FrameError as error:
            frames.write(answers, {"error": str(error)})
            return 1
        if request is None:
            return 0
        message, arrays = request
        try:
            if message.get("do") == "new":
                current = plant.of(_section(message, "config"), _whole(message, "seed"))
                answer: Answer = {"done": "new"}, {}
            else:
                answer = _answer(current, message, arrays)
            frames.write(answers, *answer)
        except ValidationError as error:
            frames.write(answers, {"error": "; ".join(f"{_key(one['loc'])}: {one['msg']}" for one in error.errors())})
        except PolishdError as error:
            frames.write(answers, {"error": str(error)})


def _answer(current: plant.BatchPlant | None, message: dict[str, Any], arrays: dict[str, FloatArray]) -> Answer:
    verb = message.get("do")
    if verb not in {"polish", "measure", "truth"}:
        raise BatchRequestError(f"do: {verb!r} is none of new, polish, measure, truth")
    if current is None:
        raise BatchRequestError(f"do: {verb} before there is a plant; send new first")
    if verb == "polish":
        executed = current.polish(arrays)
        return {"done": verb, "now_s": current.now_s}, executed
    if verb == "truth":
        told, figure = current.truth()
        return {"done": verb, **told}, figure
    wait_s, turn = _number(message, "wait_s"), _number(message, "rotation_deg")
    if wait_s < 0.0:
        raise BatchRequestError(f"wait_s: {wait_s:g} is negative")
    shift = (_whole(message, "shift_columns") or 0, _whole(message, "shift_rows") or 0)
    height = current.measure(wait_s, turn, shift)
    return {"done": verb, "now_s": current.now_s, "pitch_mm": current.world.part.grid.pitch_mm}, {"height_nm": height}


def _section(message: dict[str, Any], name: str) -> dict[str, Any]:
    value = message.get(name, {})
    if not isinstance(value, dict):
        raise BatchRequestError(f"{name}: the sections of SIM.toml as an object, not {value!r}")
    return value


def _number(message: dict[str, Any], name: str) -> float:
    value = message.get(name, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise BatchRequestError(f"{name}: a finite number, not {value!r}")
    return float(value)


def _whole(message: dict[str, Any], name: str) -> int | None:
    value = message.get(name)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
        raise BatchRequestError(f"{name}: a whole number, not {value!r}")
    return value


def _key(place: tuple[int | str, ...]) -> str:
    return ".".join(["config", *map(str, place)])


if __name__ == "__main__":
    sys.exit(serve(sys.stdin.buffer, sys.stdout.buffer))
