"""Commands of operators, in the order of arrival; a command ends the work that it interrupts."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from polishd.daemon.cell.device_polling import root_cause
from polishd.daemon.state_machine import StateEvent
from polishd.model.errors import HostFault, PolishdError


@dataclass(slots=True)
class OperatorCommand:
    """One of ``state_machine.ORDERS`` with its reason, or ``UNFIT`` from the computer's health or a signal."""

    verb: StateEvent
    reason: str = ""
    error: type[PolishdError] = HostFault
    """For ``UNFIT``: the class of the error that holds the cell or ends its daemon."""
    refused: bool = False
    """The command failed, and the cell stays in its state."""
    taken: bool = False
    """The command succeeded, and the cell goes on, perhaps through states that it leaves at once."""

    def worsen(self, reason: str, error: type[PolishdError]) -> None:
        """Replace the error of ``UNFIT`` by one that an operator cannot mend, also after the command was taken."""
        if self.error.mendable and not error.mendable:
            self.error, self.reason = error, f"{reason}; {self.reason}"

    def describe(self, what: str) -> str:
        """Return ``what`` with the reason of the command, if it has one."""
        return f"{what}: {self.reason}" if self.reason else what


class OperatorCommandQueue:
    """Commands that were given and are not taken yet, in the order of arrival."""

    def __init__(self) -> None:
        self._waiting: asyncio.Queue[OperatorCommand] = asyncio.Queue()

    def give(self, order: OperatorCommand) -> None:
        """Add a command; it is taken as soon as the present work can be ended."""
        self._waiting.put_nowait(order)

    async def next(self) -> OperatorCommand:
        """Return the next command of an operator."""
        return await self._but(StateEvent.UNFIT)

    async def interrupting(self) -> OperatorCommand:
        """Return the next command that ends work: any except ``RESUME``."""
        return await self._but(StateEvent.RESUME)

    async def _but(self, passed: StateEvent) -> OperatorCommand:
        while (order := await self._waiting.get()).verb is passed:
            pass
        return order

    async def stop_command(self) -> OperatorCommand:
        """Wait for the command to stop while the cell is opened. All commands stay in the queue for later."""
        seen: list[OperatorCommand] = []
        try:
            while not seen or seen[-1].verb is not StateEvent.STOP:
                seen.append(await self._waiting.get())
            return seen[-1]
        finally:
            for order in seen:
                self._waiting.put_nowait(order)


async def run_unless_commanded(
    order: Coroutine[Any, Any, OperatorCommand],
    *work: Coroutine[Any, Any, None],
    late: Callable[[OperatorCommand], None] = lambda _: None,
) -> OperatorCommand | None:
    """Return the command that ended the work, or None if the first work ended before a command.

    A command that arrives at that moment, or with which the work fails, goes to ``late`` for the next state.
    """
    ordered: asyncio.Task[OperatorCommand] | None = None
    try:
        async with asyncio.TaskGroup() as group:
            ordered = group.create_task(order, name="orders")
            tasks = [group.create_task(one, name="work") for one in work]
            await asyncio.wait({ordered, *tasks}, return_when=asyncio.FIRST_COMPLETED)
            for task in (ordered, *tasks):
                task.cancel()
    except BaseExceptionGroup as errors:
        if ordered is not None and not ordered.cancelled() and ordered.exception() is None:
            late(ordered.result())
        raise root_cause(errors) from errors
    if tasks[0].cancelled():
        return ordered.result()
    if not ordered.cancelled():
        late(ordered.result())
    return None
