"""Run the simulated robot controller on a real socket and record the motion that it reports to the plant."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.simulator import SimConfig
from polishd.sim_backends.common.runtime import SimRuntime, Start
from polishd.sim_backends.common.wire import SimTcpConnection, SimWire
from polishd.sim_backends.robot.device import RobotServer


class Witness:
    """Substitute for the link to the plant, which records motion and events."""

    def __init__(self) -> None:
        self.welcome: dict[str, Any] = {}
        self.port = 0
        self.server: RobotServer
        self._rows: list[np.ndarray] = []
        self.events: list[tuple[str, dict[str, Any]]] = []

    def rows(self, rows: np.ndarray, mark_s: float, pose: tuple[float, ...]) -> None:
        """Record the motion since the last call."""
        if len(rows):
            self._rows.append(rows)

    def event(self, name: str, at_s: float | None = None, **data: Any) -> None:
        """Record an event."""
        self.events.append((name, data))

    @property
    def moved(self) -> np.ndarray:
        """All recorded motion, (n, 9): seq, wall0, wall1, dt, x, y, z, a, c."""
        return np.concatenate(self._rows)

    def of(self, name: str) -> list[dict[str, Any]]:
        """Return the data of the events of that name."""
        return [data for event, data in self.events if event == name]


@asynccontextmanager
async def witnessed_robot(folder: Path, speed: float, **robot: Any) -> AsyncIterator[Witness]:
    """Run a simulated robot for the duration of the block."""
    witness = Witness()
    config = SimConfig.model_validate({"robot": {"port": 0, **robot}})
    async with asyncio.TaskGroup() as group:
        runtime = SimRuntime("robot", Start(config, folder, 1, speed), 1, witness, group)  # type: ignore[arg-type]
        witness.server = RobotServer(runtime)
        wire = SimWire(runtime, witness.server.connected)
        listening = await asyncio.get_running_loop().create_server(lambda: SimTcpConnection(wire), "127.0.0.1", 0)
        witness.port = listening.sockets[0].getsockname()[1]
        ticking = group.create_task(witness.server.run())
        try:
            yield witness
        finally:
            ticking.cancel()
            listening.close()
            for cut in list(wire.cuts):
                cut()
