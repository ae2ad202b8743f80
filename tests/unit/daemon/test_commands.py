"""Orders, and the work that they end."""

from __future__ import annotations

import asyncio

import pytest

from polishd.daemon.commands import OperatorCommand, OperatorCommandQueue, run_unless_commanded
from polishd.daemon.state_machine import StateEvent
from polishd.model.errors import DeviceFault, ForcesApart, LinkError, PolishdError, SafetyStop


@pytest.mark.parametrize(
    ("first", "then", "stands", "reason"),
    [
        (LinkError, SafetyStop, SafetyStop, "the force; the link"),
        (LinkError, DeviceFault, LinkError, "the link"),
        (SafetyStop, LinkError, SafetyStop, "the link"),
        (SafetyStop, ForcesApart, SafetyStop, "the link"),
    ],
)
def test_what_nobody_should_go_on_from_counts_more_than_what_can_be_mended(
    first: type[PolishdError], then: type[PolishdError], stands: type[PolishdError], reason: str
) -> None:
    order = OperatorCommand(StateEvent.UNFIT, "the link", error=first)
    order.worsen("the force", then)
    assert (order.error, order.reason) == (stands, reason)


async def test_an_order_ends_the_work() -> None:
    orders, stop = OperatorCommandQueue(), OperatorCommand(StateEvent.STOP)
    orders.give(stop)
    assert await run_unless_commanded(orders.interrupting(), asyncio.Event().wait()) is stop  # type: ignore[arg-type]


async def test_an_order_that_comes_as_the_work_ends_is_not_lost() -> None:
    """Both are done in one turn of the loop: the order is for what comes next."""
    orders, done, stop = OperatorCommandQueue(), asyncio.Event(), OperatorCommand(StateEvent.STOP)

    async def work() -> None:
        await done.wait()

    def both() -> None:
        done.set()
        orders.give(stop)

    asyncio.get_running_loop().call_soon(both)
    assert await run_unless_commanded(orders.interrupting(), work(), late=orders.give) is None
    async with asyncio.timeout(10):
        assert await orders.next() is stop


async def test_an_order_over_which_the_work_fails_is_not_lost() -> None:
    orders, stop = OperatorCommandQueue(), OperatorCommand(StateEvent.STOP)

    async def work() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            raise LinkError("the wire is cut")

    orders.give(stop)
    with pytest.raises(LinkError, match="cut"):
        await run_unless_commanded(orders.interrupting(), work(), late=orders.give)
    assert await orders.next() is stop


async def test_what_the_computer_asks_for_is_nothing_to_one_who_waits_for_a_person() -> None:
    orders, unfit, hold = OperatorCommandQueue(), OperatorCommand(StateEvent.UNFIT), OperatorCommand(StateEvent.HOLD)
    orders.give(unfit)
    assert await orders.interrupting() is unfit
    for order in (unfit, hold):
        orders.give(order)
    assert await orders.next() is hold
