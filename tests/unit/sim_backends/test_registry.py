"""Simulated devices declare themselves: each is found by its section, and by the device types that name it."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.simulator import SimConfig
from polishd.config.simulator_cell import KINDS, SECTIONS
from polishd.model.errors import ConfigError
from polishd.plugin_loader import load_own
from polishd.sim_backends.common.registry import SimDevice, find_device, sim_devices
from polishd.sim_backends.common.runtime import read_config

OWN = load_own().device_types()
BY_KIND = [(device, kind) for device in sim_devices() for kind in device.links]


def test_each_device_type_names_a_simulated_device_of_its_port() -> None:
    known = {(device.name, device.device) for device in sim_devices()}
    named = {
        (kind.simulated_by, SECTIONS.get(kind.port, kind.port))
        for kind in load_own().device_types().values()
        if kind.simulated_by
    }
    assert named == known


def test_a_port_has_one_substitute_at_most() -> None:
    own = load_own()
    ports = [kind.port for kind in own.device_types().values() if kind.substitute is not None]
    assert len(ports) == len(set(ports))
    for port in ports:
        kind = own.substitute(port)
        assert kind is not None
        assert set(kind.substitute or {}) <= kind.options.model_fields.keys()
        assert kind.simulated_by


@pytest.mark.parametrize(("device", "kind"), BY_KIND, ids=[f"{device.name}-{kind}" for device, kind in BY_KIND])
def test_a_section_finds_its_device(device: SimDevice, kind: str, tmp_path: Path) -> None:
    (tmp_path / "sim.toml").write_text(f'[{device.device}]\nkind = "{kind}"\n')
    assert find_device(read_config(tmp_path / "sim.toml"), device.device) is device


@pytest.mark.parametrize("name", sorted(KINDS | {k: v for k, v in OWN.items() if v.simulated_by}))
def test_the_simulator_finds_the_device_of_each_shipped_type(name: str) -> None:
    """The table of kinds and the registration agree."""
    kind, section = OWN[name], SECTIONS.get(OWN[name].port, OWN[name].port)
    links = {k for one in sim_devices() if (one.name, one.device) == (kind.simulated_by, section) for k in one.links}
    assert links
    assert {k for k in KINDS[name] if k} <= links


def test_the_default_cell_has_all_its_devices() -> None:
    config = SimConfig()
    found = [find_device(config, name).name for name in ("robot", "actuator", "spindle", "interferometer")]
    assert found == ["robot_link", "actuator", "cia402", "interferometer"]


def test_an_unknown_kind_is_refused_with_its_key(tmp_path: Path) -> None:
    (tmp_path / "sim.toml").write_text('[robot]\nkind = "gantry"\n')
    with pytest.raises(ConfigError, match=r"sim\.toml:2: robot\.kind"):
        read_config(tmp_path / "sim.toml")
