"""Devices that only look, on numbered lines: nothing to make safe."""

from __future__ import annotations

from polishd.drivers.transport.line_device import ANSWERS_S, LineDevice


class ReadOnlyLineDevice(LineDevice):
    """What their drivers share."""

    async def make_safe(self) -> None:
        """See Device. It exerts nothing: that it answers is all that can be confirmed."""
        await self._rest(self._look, ANSWERS_S, f"no answer within {ANSWERS_S:g} s")
