"""Exit codes of outcomes, and what to do at a machine that did not confirm that it is safe."""

from __future__ import annotations

import pytest

from polishd.model.states import EXIT_CODES, NOT_ASKED, CellSafety, Outcome


def test_each_outcome_has_its_exit_code() -> None:
    assert {outcome.value: code for outcome, code in EXIT_CODES.items()} == {
        "in_tolerance": 0,
        "as_programmed": 0,
        "cycles_used": 1,
        "stalled": 1,
        "stopped": 1,
        "diverged": 6,
    }
    assert set(EXIT_CODES) == set(Outcome)


@pytest.mark.parametrize(
    ("device", "todo"),
    [
        ("actuator", "switch the actuator off"),
        ("robot", "stop it at its own controller"),
        ("robot.right", "stop it at its own controller"),
        ("spindle", "switch its drive off"),
        ("loader", "it may still move, or hold a part"),
        ("monitor", "look at it"),
    ],
)
def test_a_device_that_did_not_confirm_is_named_with_what_to_do(device: str, todo: str) -> None:
    safety = CellSafety(tool_off="yes", robot_at_rest="yes", unsafe=(f"{device}: no answer",), next="")
    *_, (what, text) = safety.rows()
    assert what == f"{device} did not confirm"
    assert text.startswith("no answer; ")
    assert todo in text


def test_of_a_cell_that_was_not_asked_nothing_follows() -> None:
    assert CellSafety(tool_off="not asked", robot_at_rest="not asked", unsafe=(), next="") == NOT_ASKED
