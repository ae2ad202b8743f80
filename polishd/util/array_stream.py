"""Messages between a program and a worker process: a line of JSON, then the bytes of the arrays that it names.

docs/protocols/batch_plant.md describes the format. polishd's own workers also send bytes, as arrays of type ``u1``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from polishd.model.errors import FrameError
from polishd.util.serialization import plain

WIDTHS = {"f8": 8, "f4": 4, "u1": 1}
MAX_HEAD_BYTES = 1 << 22
MAX_ARRAY_BYTES = 1 << 32

Arrays = Mapping[str, NDArray[Any]]
Message = tuple[dict[str, Any], dict[str, NDArray[Any]]]


def read(stream: BinaryIO) -> Message | None:
    """Return the next message and its arrays (float64, or uint8), or None at the end. FrameError."""
    line = stream.readline(MAX_HEAD_BYTES + 1)
    if not line:
        return None
    if len(line) > MAX_HEAD_BYTES:
        raise FrameError(f"the JSON line is longer than {MAX_HEAD_BYTES} bytes. Send large values as arrays.")
    try:
        message = json.loads(line)
        shapes = {str(array["name"]): _layout(array) for array in message.get("arrays", ())}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FrameError(f"a message begins with a line of JSON that names its arrays, not {line[:80]!r}") from error
    arrays: dict[str, NDArray[Any]] = {}
    for name, (kind, shape) in shapes.items():
        values = np.empty(shape, f"<{kind}")
        count = stream.readinto(_as_bytes(values))  # type: ignore[attr-defined]
        if count < values.nbytes:
            raise FrameError(f"arrays: {name}: the stream ended after {count} of {values.nbytes} bytes")
        arrays[name] = values if kind == "u1" else values.astype(np.float64, copy=False)
    return message, arrays


def encode(message: Mapping[str, Any], arrays: Arrays | None = None) -> list[bytes | memoryview]:
    """Return the pieces of a message, without copying its arrays: uint8 goes as ``u1``, all else as float64."""
    given = {
        name: np.ascontiguousarray(values, values.dtype if values.dtype == np.uint8 else "<f8")
        for name, values in (arrays or {}).items()
    }
    named = [{"name": name, "type": one.dtype.str[1:], "shape": list(one.shape)} for name, one in given.items()]
    head = json.dumps({**message, "arrays": named}, default=plain).encode() + b"\n"
    if len(head) > MAX_HEAD_BYTES:
        raise FrameError(f"the JSON line has {len(head)} bytes, the limit is {MAX_HEAD_BYTES}")
    for name, one in given.items():
        if one.nbytes > MAX_ARRAY_BYTES:
            raise FrameError(f"arrays: {name} has {one.nbytes} bytes, the limit is {MAX_ARRAY_BYTES}")
    return [head, *map(_as_bytes, given.values())]


def write(stream: BinaryIO, message: Mapping[str, Any], arrays: Arrays | None = None) -> None:
    """Send a message."""
    stream.writelines(encode(message, arrays))
    stream.flush()


def _as_bytes(values: NDArray[Any]) -> memoryview:
    return values.reshape(-1).view(np.uint8).data


def _layout(array: Mapping[str, Any]) -> tuple[str, tuple[int, ...]]:
    """Return type and shape of an array as its message states them."""
    kind, shape = array["type"], tuple(array["shape"])
    if kind not in WIDTHS or any(not isinstance(n, int) or isinstance(n, bool) or n < 0 for n in shape):
        raise ValueError(kind)
    if WIDTHS[kind] * math.prod(shape) > MAX_ARRAY_BYTES:
        raise ValueError(shape)
    return kind, shape
