"""Commands of operators: which of them ends what work, and that none is lost."""

from __future__ import annotations

import asyncio

import pytest

from polishd.daemon.job_runner import OperatorCommand, OperatorCommandQueue, run_unless_commanded
from polishd.daemon.state_machine import StateEvent
from polishd.model.errors import DeviceFault, ForcesApart, LinkError, PolishdError, SafetyStop


def verbs(*orders: OperatorCommand) -> list[StateEvent]:
    return [order.verb for order in orders]


async def test_only_stop_ends_the_opening_and_all_orders_stay_as_they_came() -> None:
    orders = OperatorCommandQueue()
    opening = asyncio.ensure_future(orders.stop_command())
    orders.give(OperatorCommand(StateEvent.HOLD))
    orders.give(OperatorCommand(StateEvent.RESUME))
    for _ in range(4):
        await asyncio.sleep(0)
    assert not opening.done()
    orders.give(OperatorCommand(StateEvent.STOP, "tea"))
    assert (await opening).reason == "tea"
    assert verbs(*[await orders.next() for _ in range(3)]) == [StateEvent.HOLD, StateEvent.RESUME, StateEvent.STOP]


async def test_orders_that_came_while_the_cell_was_opened_come_next() -> None:
    orders = OperatorCommandQueue()
    orders.give(OperatorCommand(StateEvent.HOLD))
    opening = asyncio.ensure_future(orders.stop_command())
    for _ in range(4):
        await asyncio.sleep(0)
    opening.cancel()
    await asyncio.gather(opening, return_exceptions=True)
    assert (await orders.interrupting()).verb is StateEvent.HOLD


async def test_to_go_on_ends_no_work_and_is_not_kept_for_later() -> None:
    orders, hold = OperatorCommandQueue(), OperatorCommand(StateEvent.HOLD)
    orders.give(OperatorCommand(StateEvent.RESUME))
    orders.give(hold)
    assert await orders.interrupting() is hold


@pytest.mark.parametrize(("reason", "said"), [("", "held"), ("tea", "held: tea")])
def test_what_is_said_of_an_order(reason: str, said: str) -> None:
    order = OperatorCommand(StateEvent.HOLD, reason)
    assert order.describe("held") == said
    assert not order.refused
    assert not order.taken


async def test_the_end_of_any_work_that_is_done_beside_it_ends_the_first_and_no_order_came() -> None:
    """The first of several works decides: it was cancelled, or came to its end."""
    orders, ended = OperatorCommandQueue(), []

    async def first() -> None:
        ended.append("first")

    async def beside() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("beside")

    late: list[OperatorCommand] = []
    assert await run_unless_commanded(orders.interrupting(), first(), beside(), late=late.append) is None
    assert ended in (["first"], ["first", "beside"])
    assert late == []


async def test_work_that_fails_without_an_order_tells_why_and_no_order_is_late() -> None:
    orders, late = OperatorCommandQueue(), []

    async def fails() -> None:
        raise LinkError("cut")

    with pytest.raises(LinkError, match="cut"):
        await run_unless_commanded(orders.interrupting(), fails(), late=late.append)
    assert late == []
    hold = OperatorCommand(StateEvent.HOLD)
    orders.give(hold)
    assert await orders.next() is hold, "the one who waited for it is gone"


async def test_where_taking_an_order_fails_too_the_more_useful_error_is_reported() -> None:
    async def no_order() -> OperatorCommand:
        raise LinkError("the socket is gone")

    async def work() -> None:
        raise SafetyStop("force")

    late: list[OperatorCommand] = []
    with pytest.raises(SafetyStop, match="force"):
        await run_unless_commanded(no_order(), work(), late=late.append)
    assert late == []


def test_an_order_needs_no_reason() -> None:
    assert OperatorCommand(StateEvent.STOP).describe("stopped") == "stopped"


@pytest.mark.parametrize(
    ("first", "then", "stands", "reason"),
    [
        (LinkError, SafetyStop, SafetyStop, "the force; the link"),
        (LinkError, DeviceFault, LinkError, "the link"),
        (SafetyStop, LinkError, SafetyStop, "the link"),
        (SafetyStop, ForcesApart, SafetyStop, "the link"),
    ],
)
def test_an_error_that_forbids_to_resume_counts_more_than_one_with_a_remedy(
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
