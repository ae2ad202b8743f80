"""Daemon of a cell whose journal is damaged: it is held, opens no device, and answers until it is stopped.

The record of the last pass in a damaged journal is not reliable, and without a journal nothing is polished. So the cell
starts held, reports the reason as for any other error (socket, page, notifications, systemd), and ends by `stop`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from polishd.config.cell import CellConfig
from polishd.daemon.notifications.notifications import notifying
from polishd.daemon.notifications.sender import Notifier
from polishd.daemon.runtime.events import EventBus, record_exit, recording_exit
from polishd.daemon.runtime.exit_record import safety_sentence
from polishd.daemon.socket.client import SUBSCRIBE, VERBS
from polishd.daemon.socket.server import Handler, serving
from polishd.model import events
from polishd.model.errors import DeviceRefused, JournalDamage
from polishd.model.events import Event
from polishd.model.states import DaemonState

log = logging.getLogger(__name__)

NEXT = "repair the journal as the reason says, then polishd stop CELL.toml and polishd run CELL.toml"


class DamagedCell:
    """Handlers of the socket's commands; ``stop`` ends ``until_stopped``."""

    def __init__(self, config: CellConfig, damage: JournalDamage) -> None:
        self._config = config
        self.reason = f"{type(damage).__name__}: {damage}"
        self._stopped = asyncio.Event()

    @property
    def handlers(self) -> dict[str, Handler]:
        """Handlers of all commands; those that need a journal are refused with the reason."""
        answered = {"status": self._status, "live": self._live, "stop": self._stop, "hold": self._stay}
        answered |= {"estop": self._stay}
        return {**{verb: self._refuse for verb in VERBS if verb != SUBSCRIBE}, **answered}

    def stop(self) -> None:
        """End the daemon, as SIGTERM does."""
        self._stopped.set()

    def state_event(self, state: DaemonState | str) -> events.StateChanged:
        """Return the state as an event; no device is open."""
        standing = replace(safety_sentence("held", None), next=NEXT)
        return events.StateChanged(state=state, reason=self.reason, standing=standing)

    async def until_stopped(self, bus: EventBus, damage: JournalDamage) -> None:
        """Publish why the cell is held, and wait for ``stop``."""
        bus.publish(events.CellHeld(error=str(damage), kind=type(damage).__name__))
        bus.publish(self.state_event(DaemonState.HELD))
        await self._stopped.wait()

    def _facts(self) -> dict[str, Any]:
        return {
            "state": DaemonState.HELD,
            "reason": self.reason,
            "next": NEXT,
            "job": self._config.job.id,
            "part": self._config.part.id,
            "cycle": None,
            "phase": None,
            "unsafe": [],
            "signals": {},
            "health": {},
        }

    async def _status(self) -> Mapping[str, Any]:
        return {**self._facts(), "cycles": [], "tasks": len(asyncio.all_tasks()), "devices": {}}

    async def _live(self) -> Mapping[str, Any]:
        readings = dict.fromkeys(("force", "speed", "sensed", "robot"))
        return {**self._facts(), "pressing": False, "leaving": "", "approval": "", "readings": readings, "ages_s": {}}

    async def _stay(self, reason: str = "", by: str = "") -> Mapping[str, Any]:
        log.info("already held because the journal is damaged; command by %s: %s", by or "an operator", reason)
        return {"state": DaemonState.HELD, "reason": self.reason, "next": NEXT}

    async def _stop(self, reason: str = "", by: str = "") -> Mapping[str, Any]:
        log.info("stopped by %s: %s", by or "command", reason)
        self.stop()
        return {"state": DaemonState.FINISHED, "reason": self.reason, "next": NEXT}

    async def _refuse(self, **_: Any) -> Mapping[str, Any]:
        raise DeviceRefused(f"the cell stays held: {self.reason}")


async def hold_damaged(
    config: CellConfig,
    notifiers: Sequence[Notifier],
    cell: DamagedCell,
    damage: JournalDamage,
    *,
    listeners: Sequence[Callable[[Event], None]],
    sink: Callable[[Event], None],
) -> None:
    """Serve the socket, held, until the cell is stopped; write the exit record for ``polishd status``."""
    known = {"job": config.job.id, "part": config.part.id, "run_dir": ""}
    kept = recording_exit(config.state_dir, lambda: None)
    async with (
        notifying(config, notifiers, known, listeners, (kept, sink)) as bus,
        serving(config.state_dir, cell.handlers, bus),
    ):
        await cell.until_stopped(bus, damage)
        last = {**cell.state_event("failed").data, "exit_code": damage.exit_code, "causes": [], "notes": []}
        record_exit(config.state_dir, {**last, "run_dir": ""})
        bus.publish(cell.state_event(DaemonState.FINISHED))
