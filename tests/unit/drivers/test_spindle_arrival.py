"""A speed is reached a little inside the tolerance in which samples are to stay."""

import pytest

from polishd.drivers.cia402 import spindle as cia402
from polishd.drivers.cia402.protocol import DriveState402
from polishd.drivers.profile_device import drives as profiled


@pytest.mark.parametrize(
    ("rpm", "at_speed", "arrived"), [(-789.0, True, True), (-784.1, True, False), (-783.9, False, False)]
)
def test_the_edge_of_the_tolerance_is_not_arrived(rpm: float, at_speed: bool, arrived: bool) -> None:
    drive = cia402.Cia402SpindleReading(DriveState402.ENABLED, rpm, -800.0, 0, "")
    assert (drive.at_speed, drive.arrived) == (at_speed, arrived)
    inverter = profiled.SpindleReading("running", rpm, 0, "")
    assert (inverter.at(-800.0), inverter.at(-800.0, profiled.ARRIVED)) == (at_speed, arrived)


def test_a_slow_spindle_has_a_still_one_s_room() -> None:
    assert cia402.Cia402SpindleReading(DriveState402.ENABLED, 9.2, 10.0, 0, "").arrived
