"""The worker's side of the pipe, without a process: messages, answers and what cannot travel."""

from __future__ import annotations

import io
import math
import operator
import os
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.daemon.runtime import compute_worker
from polishd.daemon.runtime.compute_worker import LENGTH, pack, unpack
from polishd.model.errors import ComputeError, PolishdError, ProgramError

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def message(value: object) -> bytes:
    return b"".join(bytes(piece) for piece in pack(value))


def received(content: bytes) -> Any:
    pieces = compute_worker._read(io.BytesIO(content))
    assert pieces is not None
    return unpack(pieces)


def answered(function: Callable[..., Any], *arguments: Any) -> tuple[str, Any]:
    pieces = compute_worker._read(io.BytesIO(message((function, arguments))))
    assert pieces is not None
    return compute_worker._answer(pieces)


@given(VALUES)
def test_any_value_travels(value: object) -> None:
    assert received(message(value)) == value


@pytest.mark.full
@given(st.lists(VALUES, max_size=5))
def test_messages_do_not_run_into_each_other(values: list[object]) -> None:
    stream = io.BytesIO(b"".join(map(message, values)))
    found = []
    while (pieces := compute_worker._read(stream)) is not None:
        found.append(unpack(pieces))
    assert found == values


@pytest.mark.parametrize("dtype", ["f8", "i8", "?", "f4", "c16"])
@pytest.mark.parametrize("shape", [(0,), (1,), (7, 3), (2, 0, 4)])
def test_arrays_travel_beside_the_pickle_and_arrive_writable(dtype: str, shape: tuple[int, ...]) -> None:
    array = np.ones(shape, dtype)
    found = received(message({"a": array, "b": [array.T]}))
    np.testing.assert_array_equal(found["a"], array)
    np.testing.assert_array_equal(found["b"][0], array.T)
    assert found["a"].dtype == array.dtype
    assert found["a"].flags.writeable


def test_arrays_are_not_copied_on_the_way_out() -> None:
    """Copying tens of megabytes would stall the event loop."""
    array = np.zeros(1000)
    pieces = [piece for piece in pack(array) if isinstance(piece, memoryview)]
    array[0] = 7.0
    assert len(pieces) == 1
    assert np.frombuffer(pieces[0])[0] == 7.0


def test_strided_arrays_travel_too() -> None:
    array = np.arange(100.0).reshape(10, 10)[::2, ::3]
    np.testing.assert_array_equal(received(message(array)), array)


def test_end_of_stream_ends_the_worker() -> None:
    assert compute_worker._read(io.BytesIO(b"")) is None
    assert compute_worker._read(io.BytesIO(LENGTH.pack(1)[:5])) is None


def test_result_of_a_call() -> None:
    assert answered(operator.add, 2, 3) == ("result", 5)
    assert answered(math.hypot, 3.0, 4.0) == ("result", 5.0)


def test_error_of_a_call() -> None:
    kind, error = answered(math.sqrt, -1.0)
    assert kind == "error"
    assert type(error) is ComputeError
    assert str(error).startswith("sqrt failed: ValueError: ")
    assert "Traceback" in error.__notes__[0]


def refuse(text: str) -> None:
    raise ProgramError(text)


def test_our_error_of_a_call() -> None:
    kind, error = answered(refuse, "part.rnc:3: no")
    assert (kind, type(error), str(error)) == ("error", ProgramError, "part.rnc:3: no")


def test_a_function_that_is_gone_is_an_error_of_the_call() -> None:
    """The worker may not be able to import what the daemon could."""
    kind, error = compute_worker._answer([b"cno_such_module\nfunction\n."])
    assert kind == "error"
    assert str(error).startswith("a call failed: ModuleNotFoundError: ")


def test_garbage_is_an_error_of_the_call() -> None:
    kind, error = compute_worker._answer([b"\x00garbage"])
    assert (kind, type(error)) == ("error", ComputeError)


class Local(PolishdError):
    """Pickles, but does not come back."""

    def __init__(self, one: str, *, two: str) -> None:
        super().__init__(one + two)


def test_an_error_that_does_not_survive_becomes_a_compute_error() -> None:
    portable = compute_worker._portable(Local("a", two="b"))
    assert (type(portable), str(portable)) == (ComputeError, "Local: ab")
    known = ProgramError("x")
    assert compute_worker._portable(known) is known


def test_a_result_that_does_not_travel_becomes_an_error() -> None:
    stream = io.BytesIO()
    compute_worker._write(stream, ("result", lambda: None))
    kind, error = received(stream.getvalue())
    assert (kind, type(error)) == ("error", ComputeError)
    assert str(error).startswith("the result cannot be sent back: ")


def test_functions_travel_by_name_only() -> None:
    """So that a worker runs the installed code, and a lambda is refused where it is called."""
    assert pickle.loads(message(os.getpid)[2 * LENGTH.size :]) is os.getpid
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pack(lambda: None)
