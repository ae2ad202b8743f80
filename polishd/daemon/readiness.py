"""Whether a cell may go into contact: its links are up, its devices say that they may be used, its signals are right.

A device that is not ready would be found out at the first order, or in contact.
"""

from __future__ import annotations

from collections.abc import Callable

from polishd.daemon.cell import Cell
from polishd.daemon.progress import low_override
from polishd.daemon.signal_watch import until_ready
from polishd.model.devices import DeviceStatus, port_of
from polishd.model.errors import DeviceFault
from polishd.model.events import Event


async def before_contact(cell: Cell, publish: Callable[[Event], None], cycle: int) -> None:
    """Out of contact: lost links are opened again, and all that the job uses is ready; the robot is asked later.

    DeviceFault with the own words of each device that is not; LinkError; SignalFault.
    """
    found = {name: await cell.restored(name) for name in cell.devices}
    for name, status in found.items():
        if not status.ready and cell.uses(name) and port_of(name) != "robot":
            found[name] = await cell.cleared(name)
    _require({name: status for name, status in found.items() if cell.uses(name) and port_of(name) != "robot"})
    await until_ready(cell, publish, cycle)


async def require_robot(cell: Cell, least_override: float) -> None:
    """The job's robot is ready, once it has its program: getting that may take back an alarm. DeviceFault if not.

    It is not where its controller reports a speed override below ``least_override``.
    """
    name = cell.used["robot"]
    _require({name: await cell.asked(name)})
    if words := low_override(await cell.robot.progress(), least_override):
        raise DeviceFault(f"{words}; no pass was begun")


def _require(found: dict[str, DeviceStatus]) -> None:
    if said := [f"{name} is not ready: {_words(status)}" for name, status in found.items() if not status.ready]:
        raise DeviceFault(f"{'; '.join(said)}; see to it: no pass was begun")


def _words(status: DeviceStatus) -> str:
    return f"{status.state}: {status.detail}" if status.detail else status.state
