"""A CAN bus as its hosts hear it: whoever has opened the adapter or the server gets every frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from polishd.sim_backends.can_hosts import Frame, SlcanHost, SocketcandHost
from polishd.sim_backends.faults.outlet import FaultyLink
from polishd.sim_backends.runtime import SimRuntime
from polishd.sim_backends.wire import Feed, SimWire

ADAPTER_BAUD = 1_000_000
"""Of the slcan adapter's serial side."""


@dataclass(slots=True)
class CanWire:
    """The bus of one simulated device."""

    runtime: SimRuntime
    kind: str
    """``slcan`` or ``socketcand``."""
    port: int
    on_frame: Callable[[int, bytes], list[Frame]]
    """Hears a host's frame; what the device answers at once."""
    hosts: list[tuple[SlcanHost | SocketcandHost, FaultyLink]] = field(default_factory=list)

    async def open(self) -> None:
        """Be reachable, and say where."""
        wire = SimWire(self.runtime, self._connected)
        if self.kind == "slcan":
            wire.open_pty(ADAPTER_BAUD)
            wire.ready(f"slcan:{self.runtime.start.state / self.runtime.name}?bitrate=500000")
        else:
            wire.ready(f"socketcand://{await wire.open_tcp(self.port, SocketcandHost.greeting)}/can0")

    def say(self, frames: list[Frame]) -> None:
        """Each host hears the bus once it has opened it: before that, a client waits for an answer."""
        for host, outlet in self.hosts if frames else []:
            for frame in frames:
                if heard := host.send([frame]):
                    outlet.send(heard)

    def _connected(self, outlet: FaultyLink) -> Feed:
        host = (SlcanHost if self.kind == "slcan" else SocketcandHost)(self.on_frame)
        self.hosts.append((host, outlet))
        outlet.on_closed = lambda: self.hosts.remove((host, outlet))

        def feed(data: bytes) -> None:
            if answer := host.feed(data):
                outlet.send(answer)

        return feed
