"""A driver of one's own for the suites: how it is built, where its device is, and what may be asked of it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.api import DeviceContext, DeviceError, DeviceType, PluginError
from polishd.hooks.checks import misspelt_hooks, wrong_version
from polishd.ports.devices import Device
from polishd.testing.peer import started
from polishd.testing.rig import USUAL, Rig, TestScope

ENDPOINT = "{endpoint}"


@dataclass(frozen=True, kw_only=True)
class DriverCase:
    """An entry of a test module's ``CASES``: a simulator, whose link can be cut and muted, or a real device."""

    plugin: Any
    """The plugin: a module, or an object, with ``polishd_device_types``."""
    type: str
    """The name of the device type."""
    options: Mapping[str, Any]
    """The keys of its section besides ``type``; ``"{endpoint}"`` in a text is where the simulator answers."""
    simulator: Sequence[str] = ()
    """Command line of the simulator (polishd.testing.peer); none: the options name a real device."""
    scope: TestScope = USUAL
    whole_file: bool = False
    """Of a robot: it takes its program in one piece, so that nobody waits for credit."""
    soon_s: float = 60.0
    """What takes longer hangs."""

    @property
    def __name__(self) -> str:
        """In the names of tests."""
        return self.type

    @asynccontextmanager
    async def __call__(self, folder: Path) -> AsyncIterator[Rig[Device]]:
        """The rig of one test."""
        if not self.simulator:
            device = self.build(folder, "")
            try:
                yield Rig(device, whole_file=self.whole_file, scope=self.scope, soon_s=self.soon_s)
            finally:
                await device.make_safe()
                await device.close()
            return
        async with started(self.simulator) as peer:
            device = self.build(folder, peer.endpoint)
            safe = peer.safe if peer.tells_safe else None
            try:
                yield Rig(device, peer.cut, peer.mute, safe, self.whole_file, self.scope, self.soon_s)
            finally:
                with contextlib.suppress(DeviceError):
                    await device.close()

    def build(self, folder: Path, endpoint: str) -> Device:
        """The device, not open; PluginError or pydantic's ValidationError where plugin or options are wrong."""
        given = {
            key: value.replace(ENDPOINT, endpoint) if isinstance(value, str) else value
            for key, value in self.options.items()
        }
        kind = self._kind()
        device: Device = kind.build(kind.options.model_validate(given), DeviceContext(folder, folder, "P-1", ()))
        return device

    def _kind(self) -> DeviceType:
        for wrong in (wrong_version(self.plugin), misspelt_hooks(self.plugin)):
            if wrong:
                raise PluginError(f"{self.plugin!r}: {wrong}")
        kinds = {kind.name: kind for kind in self.plugin.polishd_device_types()}
        if self.type not in kinds:
            raise PluginError(f"{self.plugin!r} has no device type {self.type!r}; it has {', '.join(kinds)}")
        kind: DeviceType = kinds[self.type]
        return kind
