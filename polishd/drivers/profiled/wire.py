"""What a profile's device is asked and told, whatever its link."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from polishd.config.device_profile import DeviceProfile
from polishd.drivers.profiled.codec import Values


class ProfileTransport(Protocol):
    """One request and one answer at a time. A call raises LinkError or ProtocolError and is never repeated."""

    profile: DeviceProfile

    @property
    def connected(self) -> bool:
        """False before ``connect``, and as soon as answers can no longer be trusted."""
        ...

    @property
    def name(self) -> str:
        """Address, for messages."""
        ...

    async def connect(self) -> None:
        """Open the wire; waits until a late answer to an earlier request can no longer come."""
        ...

    async def disconnect(self) -> None:
        """Idempotent."""
        ...

    async def read(self, names: Sequence[str]) -> Values:
        """These values, in N, mm, rpm or ms; others that came with them may be there, too."""
        ...

    async def order(self, name: str, asked: float = 0.0) -> None:
        """Write the steps of an order in turn; one that the profile does not have is no step."""
        ...
