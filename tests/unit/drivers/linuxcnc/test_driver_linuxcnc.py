"""The device type ``linuxcnc``: options in, driver out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from polishd.api import ConfigError, DeviceContext, Robot
from polishd.drivers.linuxcnc.driver import DEVICE_TYPES, LinuxCnc

(LINUXCNC,) = DEVICE_TYPES
(LINUXCNC,) = DEVICE_TYPES
(LINUXCNC,) = DEVICE_TYPES
OPTIONS = {"address": "tcp://127.0.0.1:5007", "program_dir": "nc"}


def built(folder: Path, **options: Any) -> LinuxCnc:
    context = DeviceContext(base_dir=folder, state_dir=folder, part_id="P", readers=())
    device = LINUXCNC.build(LINUXCNC.options.model_validate({**OPTIONS, **options}), context)
    assert isinstance(device, LinuxCnc)
    return device


def test_it_makes_a_robot_that_is_not_connected(tmp_path: Path) -> None:
    device = built(tmp_path)
    assert isinstance(device, Robot)
    assert device.buffer_s == 0.0
    assert (LINUXCNC.name, LINUXCNC.port) == ("linuxcnc", "robot")


@pytest.mark.parametrize("address", ["serial:dev", "tcp://host", "http://x:1"])
def test_an_address_that_is_no_tcp_peer_is_refused(tmp_path: Path, address: str) -> None:
    with pytest.raises(ConfigError, match="address"):
        built(tmp_path, address=address)


@pytest.mark.parametrize("options", [{"colour": "red"}, {"password": ""}, {"enable_password": "a b"}, {"port": 5}])
def test_options_are_checked(tmp_path: Path, options: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        built(tmp_path, **options)
