"""A profile as its device reads it: what a motor's pairs of poles make of Hz."""

from __future__ import annotations

import pytest

from polishd.drivers.profiled.shelf import FOLDER
from polishd.sim_backends.profiled.sheet import Sheet


@pytest.mark.parametrize("pole_pairs", [1, 2, 3])
def test_fifty_hz_are_3000_rpm_over_the_pairs_of_poles(pole_pairs: int) -> None:
    sheet = Sheet.read(FOLDER / "delta_ms300.toml", pole_pairs)
    speed = sheet.quantity("speed")
    assert speed["unit"] == "Hz"
    wire = sheet.number("speed", 3000.0 / pole_pairs)
    assert wire * speed.get("scale", 1.0) == pytest.approx(50.0)
    assert sheet.physical("speed", wire) == pytest.approx(3000.0 / pole_pairs)
