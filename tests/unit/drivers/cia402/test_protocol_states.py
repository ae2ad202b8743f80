"""The power state machine of CiA 402, against the standard's table and against the simulated drive's own."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ProtocolError
from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.protocol import DriveState402, power_up, state_of
from polishd.sim_backends.cia402 import device as stage
from polishd.sim_backends.cia402.device import Power

# CiA 402-2, table of the status word: xxxx xxxx x0xx 0000 and so on, here as (bits that count, their value).
TABLE = {
    "xxxxxxxxx0xx0000": DriveState402.NOT_READY,
    "xxxxxxxxx1xx0000": DriveState402.SWITCH_ON_DISABLED,
    "xxxxxxxxx01x0001": DriveState402.READY,
    "xxxxxxxxx01x0011": DriveState402.SWITCHED_ON,
    "xxxxxxxxx01x0111": DriveState402.ENABLED,
    "xxxxxxxxx00x0111": DriveState402.QUICK_STOP,
    "xxxxxxxxx0xx1111": DriveState402.FAULT_REACTION,
    "xxxxxxxxx0xx1000": DriveState402.FAULT,
}
BITS = [
    (int(text.replace("0", "1").replace("x", "0"), 2), int(text.replace("x", "0"), 2), state)
    for text, state in TABLE.items()
]
"""(mask, value, state)."""
SIMULATED = dict(
    zip(
        range(7),
        [
            DriveState402.SWITCH_ON_DISABLED,
            DriveState402.READY,
            DriveState402.SWITCHED_ON,
            DriveState402.ENABLED,
            DriveState402.QUICK_STOP,
            DriveState402.FAULT_REACTION,
            DriveState402.FAULT,
        ],
        strict=True,
    )
)


def of_the_table(word: int) -> DriveState402 | None:
    found = [state for mask, value, state in BITS if word & mask == value]
    assert len(found) <= 1
    return found[0] if found else None


def test_every_status_word_is_the_tables_state_or_none() -> None:
    for word in (low | high for low in range(0x80) for high in (0, 0x80, 0x1600, 0xFF80)):
        expected = of_the_table(word)
        if expected is None:
            with pytest.raises(ProtocolError, match="no state"):
                state_of(word)
        else:
            assert state_of(word) is expected


@pytest.mark.parametrize("state", SIMULATED)
def test_the_simulated_drive_tells_its_state(state: int) -> None:
    assert state_of(Power(state).status) is SIMULATED[state]


@pytest.mark.parametrize("state", SIMULATED)
def test_the_way_up_leads_there_from_every_state_but_faults(state: int) -> None:
    power = Power(state)
    for control, wanted in power_up(SIMULATED[state]):
        power.command(control)
        assert state_of(power.status) is wanted
    assert (power.state == stage.ENABLED) != SIMULATED[state].failed


@given(st.lists(st.integers(0, 0xFF)), st.sampled_from([stage.QUICK_STOP, stage.ENABLED, stage.READY]))
def test_no_control_words_but_a_reset_lead_out_of_a_fault(words: list[int], state: int) -> None:
    power = Power(state)
    power.fault()
    power.stands()
    for word in words:
        power.command(word & 0x7F)
        assert state_of(power.status).failed
    power.command(protocol.DISABLE_VOLTAGE)
    power.command(protocol.FAULT_RESET)
    assert state_of(power.status) is DriveState402.SWITCH_ON_DISABLED


@given(st.sampled_from(range(7)), st.lists(st.integers(0, 0xFFFF), max_size=20))
def test_a_quick_stop_ends_without_power_whatever_went_before(state: int, words: list[int]) -> None:
    power = Power(state)
    for word in words:
        power.command(word)
    power.command(protocol.QUICK_STOP)
    power.stands()
    assert not state_of(power.status).drives
