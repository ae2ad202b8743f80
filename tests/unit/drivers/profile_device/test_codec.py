"""What profiles make of words and lines: against the examples that the manuals print, and against nonsense."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import DeviceRefused, ProtocolError
from polishd.commissioning.device_profiles import TEMPLATES
from polishd.config.device_profile import Register, StateCondition
from polishd.config.device_profile_checks import device_profile_of
from polishd.drivers.profile_device import codec
from polishd.drivers.transport.modbus_link import read_frame, write_frame
from tests.fakes.devices_by_profile import shipped

MS300, GS2, WJ200 = shipped("delta_ms300"), shipped("automationdirect_gs2"), shipped("hitachi_wj200")
TEMPLATE = TEMPLATES / "force_sensor_modbus.toml"
TLB, MARK10 = shipped("laumas_tlb"), shipped("mark10_series5")


def hexed(frame: bytes) -> str:
    return frame.hex(" ").upper()


# the manuals' own examples


def test_the_ms300_manuals_read_example() -> None:
    """Appendix A, page A-5: two registers from 2102H; the answer says 60.00 Hz asked, 0 Hz turning."""
    assert hexed(read_frame(1, "holding", 0x2102, 2)) == "01 03 21 02 00 02 6F F7"
    speed = MS300.registers["commanded"]
    assert codec.worth(speed, codec.unpack(speed, [0x1770], "high_first"), 1) == pytest.approx(3600.0)
    assert codec.worth(speed, codec.unpack(speed, [0x1770], "high_first"), 2) == pytest.approx(1800.0), "two pole pairs"


def test_the_hitachi_manuals_run_examples() -> None:
    """Write in Coil [05h]: run, at unit 1 (WJ C1) and at unit 8 (MX2); coil 1 of the manual is address 0."""
    run = WJ200.registers["run"]
    assert hexed(write_frame(1, run.table, run.address, [1], many=False)) == "01 05 00 00 FF 00 8C 3A"
    assert hexed(write_frame(8, run.table, run.address, [1], many=False)) == "08 05 00 00 FF 00 8C A3"


@pytest.mark.parametrize(("said", "force_n"), [("4.285 N", 4.285), ("-18.78 N", -18.78), ("0 N", 0.0), ("+0.5 N", 0.5)])
def test_a_gauges_answers(said: str, force_n: float) -> None:
    assert codec.fields_of(MARK10, MARK10.asks["reading"], said)["force"] == force_n


@pytest.mark.parametrize("said", ["4.285", "4.285 lbF", "*10", "", "N", "4,285 N"])
def test_a_gauge_in_another_unit_is_no_reading(said: str) -> None:
    with pytest.raises(ProtocolError, match="no such answer"):
        codec.fields_of(MARK10, MARK10.asks["reading"], said)


def test_a_weight_has_its_sign_in_the_status() -> None:
    (block,) = codec.blocks(TLB.registers, TLB.polled, 32)
    assert (block.address, block.count) == (6, 5)
    for status, force_n in ((0x0800, 12.34), (0x0900, -12.34)):
        words = [status, 0, 0, 0, 1234]
        assert codec.signed(TLB, codec.values_of(TLB, block, words))["force"] == pytest.approx(force_n)
    broken = codec.signed(TLB, codec.values_of(TLB, block, [0x0801, 0, 0, 0, 0]))
    assert codec.fault_words(TLB, codec.fault_of(TLB, broken)) == "load cell"


@pytest.mark.parametrize(
    ("status", "state", "rpm"), [(0, "stopped", 600.0), (3, "running", 600.0), (0x1B, "running", -600.0)]
)
def test_an_inverters_status(status: int, state: str, rpm: float) -> None:
    (block,) = codec.blocks(GS2.registers, GS2.polled, 125)
    assert (block.address, block.count) == (0x2100, 4), "with one request"
    values = codec.signed(GS2, codec.values_of(GS2, block, [0, status, 100, 100]))
    assert (codec.state_of(GS2, values), values["speed"]) == (state, pytest.approx(rpm))


def test_a_fault_comes_before_any_other_state() -> None:
    (block,) = codec.blocks(MS300.registers, MS300.polled, 125)
    values = codec.values_of(MS300, block, [0x0100 | 58, 3, 0, 0])
    assert codec.state_of(MS300, values) == "fault"
    assert codec.fault_of(MS300, values) == 58, "without the warning in the high byte"
    assert codec.fault_words(MS300, 58) == "the line was silent"
    assert "fault 99" in codec.fault_words(MS300, 99)


# words


KINDS = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i"}


@pytest.mark.parametrize("order", ["high_first", "low_first"])
@given(data=st.data())
def test_whole_numbers_go_both_ways(order: str, data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(sorted(KINDS)))
    bits, signed = int(kind[1:]), kind[0] == "i"
    number = data.draw(st.integers(-(1 << bits - 1) if signed else 0, (1 << bits - signed) - 1))
    register = Register(address=0, type=kind, word_order=order)
    words = codec.pack(register, float(number), "high_first")
    assert codec.unpack(register, words, "high_first") == number
    raw = b"".join(word.to_bytes(2, "big") for word in (words if order == "high_first" else words[::-1]))
    assert struct.unpack(KINDS[kind], raw) == (number,)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False).filter(lambda one: not 0.0 < abs(one) < 1e-30))
def test_floats_go_both_ways(number: float) -> None:
    register = Register(address=0, type="f32", word_order="low_first")
    low, high = codec.pack(register, number, "high_first")
    assert codec.unpack(register, [low, high], "high_first") == number
    assert struct.unpack(">f", struct.pack(">HH", high, low)) == (number,)


@pytest.mark.parametrize(("asked", "said"), [(-0.01, "no room"), (655.36, "no room"), (float("nan"), "no room")])
def test_what_does_not_fit_is_refused(asked: float, said: str) -> None:
    with pytest.raises(DeviceRefused, match=said):
        codec.words_for(Register(address=0, unit="N", scale=0.01), "x", asked, "high_first", 1)


@pytest.mark.parametrize(
    ("unit", "raw", "worth"),
    [("kgf", 1.0, 9.80665), ("mN", 500.0, 0.5), ("um", 5000.0, 5.0), ("Hz", 50.0, 3000.0), ("s", 1.5, 1500.0)],
)
def test_units(unit: str, raw: float, worth: float) -> None:
    register = Register(address=0, unit=unit)
    assert codec.worth(register, raw, 1) == pytest.approx(worth)
    assert codec.steps_of(register, worth, 1) == pytest.approx(raw)


@pytest.mark.parametrize("force_n", [12.5, 12.34, -3.21, 0.07, 150.0])
def test_the_wrong_word_order_cannot_be_true(force_n: float) -> None:
    text = TEMPLATE.read_text().replace('"i32"', '"f32"').replace("scale = 0.01", "scale = 1.0")
    mine = device_profile_of(text, TEMPLATE)
    (block,) = codec.blocks(mine.registers, ["force"], 125)
    words = codec.pack(mine.registers["force"], force_n, "high_first")
    assert codec.signed(mine, codec.values_of(mine, block, words))["force"] == pytest.approx(force_n)
    with pytest.raises(ProtocolError, match=r"words are in the other order|force reads .* cannot be: -200 to 200"):
        codec.signed(mine, codec.values_of(mine, block, words[::-1]))


# requests


REGISTERS = {
    "a": Register(address=10),
    "b": Register(address=11, type="u32"),
    "c": Register(address=14),
    "d": Register(address=13),
    "far": Register(address=100),
    "in": Register(address=12, table="input"),
}


@pytest.mark.parametrize(
    ("names", "most", "asked"),
    [
        (["a"], 125, [("holding", 10, 1)]),
        (["b", "a"], 125, [("holding", 10, 3)]),
        (["a", "c"], 125, [("holding", 10, 5)]),  # b and d are known, so they may be read between
        (["a", "c"], 4, [("holding", 10, 1), ("holding", 14, 1)]),
        (["c", "far"], 125, [("holding", 14, 1), ("holding", 100, 1)]),
        (["a", "in"], 125, [("holding", 10, 1), ("input", 12, 1)]),
    ],
)
def test_requests_read_what_is_together(names: list[str], most: int, asked: list[tuple[str, int, int]]) -> None:
    found = codec.blocks(REGISTERS, names, most)
    assert [(one.table, one.address, one.count) for one in found] == asked
    assert {name for one in found for name in one.names} == set(names)


@pytest.mark.parametrize(
    ("rule", "value", "holds"),
    [
        ({"equals": [1, 2]}, 2.0, True),
        ({"equals": [1]}, 3.0, False),
        ({"equals": [1], "mask": 1}, 3.0, True),
        ({"unlike": [0]}, 0.0, False),
        ({"above": 0.5, "below": 1.0}, 0.7, True),
        ({"above": 0.5, "below": 1.0}, 1.0, False),
        ({"equals": ["U"]}, "U", True),
        ({"equals": ["U"]}, "D", False),
        ({"above": 0.0}, "D", False),
    ],
)
def test_conditions(rule: dict[str, object], value: float | str, holds: bool) -> None:
    assert StateCondition.model_validate({"when": "x", **rule}).holds(value) is holds
