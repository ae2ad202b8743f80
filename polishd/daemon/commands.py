"""Commands of operators: in the order in which they came, and as the end of the work that they interrupt."""

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
    """One of ``state_machine.ORDERS`` with its reason; or ``UNFIT``, which the computer or a signal gives."""

    verb: StateEvent
    reason: str = ""
    error: type[PolishdError] = HostFault
    """Of ``UNFIT``: what the cell is held over, or its daemon ends with."""
    refused: bool = False
    """It was tried, and the cell stays in its state."""
    taken: bool = False
    """It was tried, and the cell goes on by it, perhaps through states that are left at once."""

    def worsen(self, reason: str, error: type[PolishdError]) -> None:
        """Of ``UNFIT``, also once it is taken: an error that cannot be mended replaces one that can."""
        if self.error.mendable and not error.mendable:
            self.error, self.reason = error, f"{reason}; {self.reason}"

    def said(self, word: str) -> str:
        """With the reason that was given."""
        return f"{word}: {self.reason}" if self.reason else word


class OperatorCommandQueue:
    """Commands that were given and are not taken yet, in the order in which they came."""

    def __init__(self) -> None:
        self._waiting: asyncio.Queue[OperatorCommand] = asyncio.Queue()

    def give(self, order: OperatorCommand) -> None:
        """It is taken as soon as what happens now can be ended."""
        self._waiting.put_nowait(order)

    async def next(self) -> OperatorCommand:
        """The next one of an operator."""
        return await self._but(StateEvent.UNFIT)

    async def interrupting(self) -> OperatorCommand:
        """The next one that ends work: any but to go on."""
        return await self._but(StateEvent.RESUME)

    async def _but(self, passed: StateEvent) -> OperatorCommand:
        while (order := await self._waiting.get()).verb is passed:
            pass
        return order

    async def asked_to_stop(self) -> OperatorCommand:
        """The order to stop, while the cell is opened. All orders stay in the queue, for when it is open."""
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
    """The order that ended the work, or None where the work, the first of them, came to its end.

    An order that comes just then, or over which the work fails, is given to ``late``: it is for whatever comes next.
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
