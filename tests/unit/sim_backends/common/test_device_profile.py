"""A profile as its simulated device reads it: what a motor's pairs of poles make of Hz, which writes make an order."""

from __future__ import annotations

import pytest

from polishd.config.simulator_faults import FaultSection
from polishd.sim_backends.common.device_profile import SimDeviceProfile
from polishd.sim_backends.profile_device.device import Inverter
from tests.fakes.devices_by_profile import file_of

RUNNING = {"set_point": 300.0, "direction": 0.0, "run": 1.0}


@pytest.mark.parametrize("pole_pairs", [1, 2, 3])
def test_fifty_hz_are_3000_rpm_over_the_pairs_of_poles(pole_pairs: int) -> None:
    sheet = SimDeviceProfile.read(file_of("delta_ms300"), pole_pairs)
    speed = sheet.quantity("speed")
    assert speed["unit"] == "Hz"
    wire = sheet.number("speed", 3000.0 / pole_pairs)
    assert wire * speed.get("scale", 1.0) == pytest.approx(50.0)
    assert sheet.physical("speed", wire) == pytest.approx(3000.0 / pole_pairs)


@pytest.mark.parametrize(
    ("register", "stored", "order"),
    [
        ("run", RUNNING, ("forward", 1800.0)),
        ("direction", RUNNING | {"direction": 1.0}, ("reverse", 1800.0)),
        ("set_point", RUNNING | {"set_point": 600.0}, ("forward", 3600.0)),
        ("run", RUNNING | {"run": 0.0}, ("stop", 0.0)),
        ("set_point", RUNNING | {"run": 0.0}, None),
        ("direction", RUNNING | {"run": 0.0, "direction": 1.0}, None),
    ],
)
def test_a_drive_obeys_any_write_while_it_runs(
    register: str, stored: dict[str, float], order: tuple[str, float] | None
) -> None:
    found = SimDeviceProfile.read(file_of("automationdirect_gs2")).written(register, stored)
    assert found == (order and (order[0], pytest.approx(order[1])))


def test_an_inverter_without_an_encoder_does_not_know_that_its_motor_turns_the_other_way() -> None:
    drive = Inverter(lambda *_, **__: None, 0.0, 3000.0, 2000.0, 2000.0, 10.0, {})
    drive.suffer(FaultSection(device="spindle", what="reverse", at_s=0.0), True)
    drive.order("forward", 1000.0)
    drive.step(1.0)
    assert (drive.values()["speed"], drive.samples[-1][1]) == (1000.0, -1000.0)
