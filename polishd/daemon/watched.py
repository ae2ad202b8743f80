"""What those ask who watch a cell, often and many: answered from memory, in bounded time, and no device is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

from polishd.daemon.cell import Cell
from polishd.daemon.clearance import approve
from polishd.daemon.events import EventBus
from polishd.daemon.health import Health
from polishd.daemon.service import Handler
from polishd.model import events
from polishd.model.errors import ConfigError

MOST_ALARMS = 1000
"""That are acknowledged at once."""


def status_snapshot(
    cell: Cell, health: Health, bus: EventBus, standing: Callable[[], Mapping[str, Any]]
) -> dict[str, Handler]:
    """Who obeys the verbs of those who watch; ``standing`` says what the daemon does."""
    return {
        "live": partial(_live, cell, health, standing),
        "acknowledge": partial(_acknowledge, bus),
        "approve": partial(approve, cell, bus.publish),
    }


async def _live(cell: Cell, health: Health, standing: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
    return {
        **standing(),
        "pressing": cell.pressing,
        "leaving": cell.leaving if cell.pressing else "",
        "approval": cell.approval.wanted,
        "told": cell.live.facts(),
        "ages_s": health.ages_s(),
        **health_snapshot(cell, health),
    }


def health_snapshot(cell: Cell, health: Health) -> dict[str, Any]:
    """Who did not confirm being safe, the last refused map while another is waited for, signals, and the computer."""
    return {
        "unsafe": list(cell.unsafe),
        "map_refused": None if cell.map_refusal is None else asdict(cell.map_refusal),
        "signals": cell.signals.facts(),
        "health": {figure.name: {**asdict(figure), "fits": figure.fits} for figure in health.figures()},
    }


async def _acknowledge(bus: EventBus, alarms: Sequence[Any], by: str = "") -> Mapping[str, Any]:
    """It is journalled, and told; which alarms are there is the business of whoever reads the journal."""
    if len(alarms) > MOST_ALARMS or not all(type(one) is int and one > 0 for one in alarms):
        raise ConfigError(f"alarms are numbers of events in the journal, {MOST_ALARMS} at most; look at them again")
    bus.publish(events.AlarmAcknowledged(alarms=list(alarms), by=by))
    return {"acknowledged": list(alarms)}
