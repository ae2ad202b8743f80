"""Messages of the batch plant: a line of JSON, then the bytes of the arrays that it names."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from polishd.model.errors import FrameError
from polishd.model.surface import FloatArray

WIDTHS = {"f8": 8, "f4": 4}
MOST_VALUES = 1 << 27


def read(stream: BinaryIO) -> tuple[dict[str, Any], dict[str, FloatArray]] | None:
    """The next message and its arrays as float64; None at the end."""
    line = stream.readline()
    if not line:
        return None
    try:
        message = json.loads(line)
        shapes = {str(array["name"]): _shape(array) for array in message.get("arrays", ())}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise FrameError(f"a line of JSON that names its arrays comes first, not {line[:80]!r}") from error
    arrays = {}
    for name, (kind, shape) in shapes.items():
        size = WIDTHS[kind] * math.prod(shape)
        data = stream.read(size)
        if len(data) < size:
            raise FrameError(f"arrays: {name}: {len(data)} of {size} bytes came before the end")
        arrays[name] = np.frombuffer(data, f"<{kind}").astype(np.float64).reshape(shape)
    return message, arrays


def write(stream: BinaryIO, message: Mapping[str, Any], arrays: Mapping[str, FloatArray] | None = None) -> None:
    """Send a message; arrays go as float64."""
    given = arrays or {}
    named = [{"name": name, "type": "f8", "shape": list(values.shape)} for name, values in given.items()]
    stream.write(json.dumps({**message, "arrays": named}).encode() + b"\n")
    stream.writelines(np.ascontiguousarray(values, "<f8").tobytes() for values in given.values())
    stream.flush()


def _shape(array: Mapping[str, Any]) -> tuple[str, tuple[int, ...]]:
    kind, shape = array["type"], tuple(array["shape"])
    if kind not in WIDTHS or any(not isinstance(n, int) or n < 0 for n in shape) or math.prod(shape) > MOST_VALUES:
        raise ValueError(kind)
    return kind, shape
