"""Device types of all drivers: each module or package of ``polishd.drivers`` declares its ``DEVICE_TYPES``."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from polishd import drivers
from polishd.api import DeviceType, hookimpl

POLISHD_API = 1
HOMES = ("device_types", "driver")
"""Modules of a package that may declare them: the first that exists."""


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """All ``DEVICE_TYPES`` below ``polishd.drivers``. Drivers import optional libraries when they build a device."""
    return [device_type for module in _modules() for device_type in module.DEVICE_TYPES]


def _modules() -> Iterator[ModuleType]:
    for found in pkgutil.iter_modules(drivers.__path__, f"{drivers.__name__}."):
        homes = [f"{found.name}.{home}" for home in HOMES] if found.ispkg else [found.name]
        for name in homes:
            if find_spec(name) is not None:
                yield import_module(name)
                break
