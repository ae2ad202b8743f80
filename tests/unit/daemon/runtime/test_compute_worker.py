"""The worker's side of a call, without a process: pickles, answers and what cannot be pickled."""

from __future__ import annotations

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

from polishd.daemon.runtime import compute
from polishd.daemon.runtime.compute import pack, unpack
from polishd.model.errors import ComputeError, PolishdError, ProgramError

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


def received(pieces: compute.Pickled) -> Any:
    """The value as the other end has it: its pieces are copies that can be written."""
    return unpack({name: piece.copy() for name, piece in pieces.items()})


def answered(function: Callable[..., Any], *arguments: Any) -> tuple[str, Any]:
    return received(compute._answer({}, pack((function, arguments)))[1])


def answer_to(call: bytes) -> tuple[str, Any]:
    return received(compute._answer({}, {"0": np.frombuffer(call, np.uint8)})[1])


@given(VALUES)
def test_any_value_travels(value: object) -> None:
    assert received(pack(value)) == value


@pytest.mark.parametrize("dtype", ["f8", "i8", "?", "f4", "c16"])
@pytest.mark.parametrize("shape", [(0,), (1,), (7, 3), (2, 0, 4), (70, 300)])
def test_arrays_travel_beside_the_pickle_and_arrive_writable(dtype: str, shape: tuple[int, ...]) -> None:
    array = np.ones(shape, dtype)
    found = received(pack({"a": array, "b": [array.T]}))
    np.testing.assert_array_equal(found["a"], array)
    np.testing.assert_array_equal(found["b"][0], array.T)
    assert found["a"].dtype == array.dtype
    assert found["a"].flags.writeable


def test_arrays_are_not_copied_on_the_way_out() -> None:
    """Copying tens of megabytes would stall the event loop."""
    array = np.zeros(1000)
    _, piece = pack(array).values()
    array[0] = 7.0
    assert piece.view(np.float64)[0] == 7.0


def test_strided_arrays_travel_too() -> None:
    array = np.arange(100.0).reshape(10, 10)[::2, ::3]
    np.testing.assert_array_equal(received(pack(array)), array)


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
    """The worker may be unable to import a module that the daemon has."""
    kind, error = answer_to(b"cno_such_module\nfunction\n.")
    assert kind == "error"
    assert str(error).startswith("a call failed: ModuleNotFoundError: ")


def test_garbage_is_an_error_of_the_call() -> None:
    kind, error = answer_to(b"\x00garbage")
    assert (kind, type(error)) == ("error", ComputeError)


class Local(PolishdError):
    """Pickles, but does not come back."""

    def __init__(self, one: str, *, two: str) -> None:
        super().__init__(one + two)


def test_an_error_that_does_not_survive_becomes_a_compute_error() -> None:
    portable = compute._portable(Local("a", two="b"))
    assert (type(portable), str(portable)) == (ComputeError, "Local: ab")
    known = ProgramError("x")
    assert compute._portable(known) is known


def a_function() -> object:
    return lambda: None


def test_a_result_that_does_not_travel_becomes_an_error() -> None:
    kind, error = answered(a_function)
    assert (kind, type(error)) == ("error", ComputeError)
    assert str(error).startswith("the result cannot be sent back: ")


def test_functions_travel_by_name_only() -> None:
    """So that a worker runs the installed code, and a lambda is refused where it is called."""
    assert pickle.loads(pack(os.getpid)["0"].data) is os.getpid
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pack(lambda: None)
