"""RTDE packages as a real controller sends them, dribbled, cut short, and worse."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceBusy, DeviceRefused, ProtocolError
from polishd.config.simulator_devices import SimRobotSection
from polishd.drivers.universal_robots import rtde
from polishd.drivers.universal_robots.rtde import FORMATS, Package, PackageReader, PackageType, RtdeRecipe
from polishd.sim_backends.universal_robots import device as fields
from polishd.sim_backends.universal_robots.arm import UrArm
from polishd.sim_backends.universal_robots.controller import UrController
from polishd.sim_backends.universal_robots.device import InputOwnership, RtdeClient
from tests.vectors import vectors

NAMES = ("timestamp", "runtime_state", "target_TCP_speed", "output_int_register_24")
TYPES = ("DOUBLE", "UINT32", "VECTOR6D", "INT32")
RECIPE = RtdeRecipe(1, NAMES, TYPES)
VALUES = struct.pack(">dI6di", 12.5, 2, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0, -7)


def test_what_we_ask_is_as_the_guide_says() -> None:
    assert rtde.encode(PackageType.VERSION, b"\0\2") == b"\0\5V\0\2"
    assert rtde.encode(PackageType.START) == b"\0\3S"
    assert rtde.ask_inputs(["a", "b"]) == b"\0\6Ia,b"
    assert rtde.ask_outputs(125.0, ["timestamp"]) == b"\0\x14O" + struct.pack(">d", 125.0) + b"timestamp"


def test_values_come_by_name() -> None:
    found = RECIPE.unpack(b"\1" + VALUES)
    assert found == {
        "timestamp": (12.5,),
        "runtime_state": (2,),
        "target_TCP_speed": (0.1, 0.2, 0.3, 0.0, 0.0, 0.0),
        "output_int_register_24": (-7,),
    }


def test_a_package_of_another_recipe_is_not_ours() -> None:
    assert RECIPE.unpack(b"\2" + VALUES) is None
    assert RECIPE.unpack(b"") is None


@pytest.mark.parametrize("cut", [1, 8, len(VALUES) - 1])
def test_a_package_of_another_length_is_never_taken_for_values(cut: int) -> None:
    with pytest.raises(ProtocolError, match="bytes"):
        RECIPE.unpack(b"\1" + VALUES[:cut])
    with pytest.raises(ProtocolError, match="bytes"):
        RECIPE.unpack(b"\1" + VALUES + VALUES[:cut])


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_no_value(odd: float) -> None:
    with pytest.raises(ProtocolError, match="not a number"):
        RECIPE.unpack(b"\1" + struct.pack(">d", odd) + VALUES[8:])


@given(st.integers(2, 255), st.lists(st.binary(max_size=40), max_size=6), st.data())
def test_packages_come_whole_however_they_are_dribbled(kind: int, payloads: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(struct.pack(">HB", 3 + len(payload), kind) + payload for payload in payloads)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    reader = PackageReader()
    found = [
        package
        for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)
        for package in reader.feed(stream[begin:end])
    ]
    assert found == [Package(kind, payload) for payload in payloads]


@given(st.binary(max_size=200))
def test_no_bytes_make_values_of_nothing(data: bytes) -> None:
    """Whatever comes is a whole package, a wait for more, or a ProtocolError; never a value that does not fit."""
    try:
        for package in PackageReader().feed(data):
            found = RECIPE.unpack(package.payload)
            assert found is None or len(package.payload) == 1 + len(VALUES)
    except ProtocolError:
        return


def test_a_length_that_cannot_be_ends_the_link() -> None:
    with pytest.raises(ProtocolError, match="2 bytes"):
        list(PackageReader().feed(b"\0\2U"))


@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (b"\0DOUBLE,IN_USE", DeviceBusy, "b is written by another"),
        (b"\0NOT_FOUND,DOUBLE", DeviceRefused, "has no a"),
        (b"\0DOUBLE,DOUBLE", DeviceRefused, "refuses a setup"),
        (b"\1DOUBLE", ProtocolError, "2 inputs were requested, 1"),
        (b"\1DOUBLE,STRING", ProtocolError, "unknown type"),
        (b"", ProtocolError, "2 inputs were requested, 1"),
    ],
)
def test_a_setup_that_fails_says_why(answer: bytes, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        RtdeRecipe.answered(("a", "b"), answer, "inputs")


def test_inputs_are_packed_in_the_order_of_their_recipe() -> None:
    recipe = RtdeRecipe.answered(("b", "a"), b"\3INT32,INT32,", "inputs")
    assert recipe.pack({"a": 1, "b": -2}) == b"\0\x0cU\3" + struct.pack(">ii", -2, 1)


def test_answers_are_read() -> None:
    assert rtde.accepted(b"\1")
    assert not rtde.accepted(b"\0")
    assert rtde.controller_of(struct.pack(">4I", 5, 11, 0, 7)) == "5.11.0.7"
    for nonsense in (b"", b"\2", b"\1\1"):
        with pytest.raises(ProtocolError):
            rtde.accepted(nonsense)
    with pytest.raises(ProtocolError):
        rtde.controller_of(b"\0" * 15)


def test_both_sides_pack_types_alike() -> None:
    """The simulator has a separate codec."""
    assert fields.FORMATS == FORMATS
    assert {fields.OUTPUTS[name] for name in fields.OUTPUTS} <= set(FORMATS)


def test_driver_and_simulator_speak_the_documents_vectors() -> None:
    expected = {name: bytes.fromhex(value) for name, value in vectors("universal_robots").items()}
    outputs = ("timestamp", "runtime_state", "output_int_register_24")
    inputs = ("input_int_register_24", "input_int_register_25")
    machine = UrController(SimRobotSection(), UrArm.at((0.0, 0.0, 60.0, 0.0, 0.0)), 0.008, 0.0, 1.0, 0.0)
    said: list[bytes] = []
    client = RtdeClient(machine, InputOwnership(), said.append)
    assert rtde.encode(PackageType.VERSION, b"\0\2") == expected["version_ask"]
    assert rtde.ask_outputs(125.0, outputs) == expected["outputs_ask"]
    assert rtde.ask_inputs(inputs) == expected["inputs_ask"]
    for name in ("version", "outputs", "inputs", "start"):
        client.feed(expected[f"{name}_ask"])
    assert said[:3] == [expected[f"{name}_answer"] for name in ("version", "outputs", "inputs")]
    answers = [package.payload for data in said for package in PackageReader().feed(data)]
    writes = RtdeRecipe.answered(inputs, answers[2], "inputs")
    assert writes.pack({inputs[0]: 7, inputs[1]: 4711}) == expected["orders"]
    client.feed(expected["orders"])
    assert machine.ints_in[24:26] == [7, 4711]
    machine.time_s, machine.runtime, machine.ints_out[24] = 12.5, 2, 4711
    client.tick(12.492)
    assert said[-1] == expected["sample"]
    reads = RtdeRecipe.answered(outputs, answers[1], "outputs")
    assert reads.unpack(said[-1][3:]) == {outputs[0]: (12.5,), outputs[1]: (2,), outputs[2]: (4711,)}
