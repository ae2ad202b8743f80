"""Registration of simulated devices: each module declares its ``SIM_DEVICES``, and nothing lists them."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, get_args

from pydantic import BaseModel, create_model

from polishd import sim_backends
from polishd.config.simulator import SimConfig
from polishd.config.toml_loader import section_of, toml_type

SHARED = ("__main__", "batch", "common", "plant")
"""Modules and packages of ``sim_backends`` that are no devices."""
HOME = "device"
"""Module of a package that declares its devices."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimDevice:
    """A simulated device."""

    name: str
    """As ``simulated_by`` of the device types whose protocol it speaks."""
    device: str
    """Section of SIM.toml."""
    section: type[BaseModel]
    """Keys of that section."""
    links: Mapping[str, Mapping[str, str]]
    """By ``kind`` of the section: protocol of each link, by the link's name; ``""`` where a device has one link."""
    main: Callable[[Any], Coroutine[Any, Any, None]]
    """Coroutine of its process. Takes a ``SimRuntime``."""
    faults: Sequence[str] = ()
    """States of ``[[fault]]`` that it can be in."""

    def fits(self, device: str, section: Any) -> bool:
        """The section of SIM.toml describes this device."""
        return self.device == device and getattr(section, "kind", "") in self.links


def find_device(config: SimConfig, device: str) -> SimDevice:
    """The simulated device that a section of SIM.toml describes."""
    section = getattr(config, device)
    hints = (device, getattr(section, "kind", ""))
    return next(found for found in sim_devices(hints) if found.fits(device, section))


def sim_devices(hints: Sequence[str] = ()) -> Iterator[SimDevice]:
    """All simulated devices. Modules with a name of ``hints`` are imported first: some others take seconds."""
    modules = [found for found in pkgutil.iter_modules(sim_backends.__path__) if found.name not in SHARED]
    for found in sorted(modules, key=lambda module: module.name not in hints):
        name = f"{sim_backends.__name__}.{found.name}"
        if found.ispkg:
            name = f"{name}.{HOME}"
        if find_spec(name) is not None:
            yield from import_module(name).SIM_DEVICES


def config_model(raw: Mapping[str, Any]) -> type[SimConfig]:
    """``SimConfig`` for the text of a SIM.toml: with the sections that its devices declare themselves."""
    declared: dict[str, Any] = {}
    for name, given in raw.items():
        kind = given.get("kind") if isinstance(given, Mapping) else None
        field = SimConfig.model_fields.get(name)
        shipped = None if field is None else section_of(toml_type(field.annotation))
        if shipped is None or kind is None or kind in get_args(shipped.model_fields["kind"].annotation):
            continue
        for found in sim_devices((kind,)):
            if found.device == name and kind in found.links:
                declared[name] = (found.section, ...)
                break
    return create_model("SimConfig", __base__=SimConfig, **declared) if declared else SimConfig
