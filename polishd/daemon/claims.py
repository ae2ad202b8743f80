"""Parts that a shop gave to this cell, and what it says of them: none begins before the shop has said that it may.

The claim is in the queue's row, and so in the journal. That it still stands must be heard anew by each run of the
daemon: while none ran, somebody may have given the part to another cell (``polishd shop release --cell-is-gone``).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from polishd.daemon.queue import Queue, QueueEntry
from polishd.daemon.service import Handler
from polishd.model.errors import ConfigError
from polishd.model.events import Event, ShopRateReceived

BACK = "given back to the shop, where it was released"
LOST = "the shop gave it away, as somebody said that this cell is gone; polishd shop list says who"
OFFER = {"recipe": str, "cell": str, "job": str, "of_cycle": int, "at_s": float, "rate": float, "sigma": float}
"""What an offer is made of."""


class ShopAssignments:
    """What was heard in this run of the daemon; used on the event loop's thread."""

    def __init__(self, queue: Queue, changed: Callable[[], None]) -> None:
        """``changed`` is called where another part may begin now."""
        self._queue, self._changed = queue, changed
        self._stands: set[str] = set()
        self._lost: set[str] = set()
        self._heard = asyncio.Event()

    def handlers(self, tell: Callable[[Event], None]) -> dict[str, Handler]:
        """Who obeys the verbs of the shop's link; ``tell`` is told what is offered."""

        async def offered(offers: Sequence[Any]) -> Mapping[str, Any]:
            for event in [_offer(one) for one in offers]:
                tell(event)
            return {"offers": len(offers)}

        return {"shop_word": self.told, "shop_offer": offered}

    async def told(
        self, stands: Sequence[Any] = (), back: Sequence[Any] = (), lost: Sequence[Any] = ()
    ) -> Mapping[str, Any]:
        """The shop's word on these claims. What waits and is not this cell's any more is taken out of the queue."""
        self._lost |= set(map(str, lost))
        self._stands = (self._stands | set(map(str, stands))) - self._lost
        for claims, why in ((back, BACK), (lost, LOST)):
            for claim in map(str, claims):
                await asyncio.to_thread(self._take_out, claim, why)
        self._heard.set()
        self._changed()
        return {"waiting": len(self._queue.waiting())}

    def first(self) -> QueueEntry | None:
        """The first that waits and may begin."""
        return self._queue.next(lambda entry: not entry.claim or entry.claim in self._stands)

    async def settled(self, entry: QueueEntry | None) -> str:
        """Why the job under way may not go on, once that is known; empty where it may."""
        claim = "" if entry is None else entry.claim
        while claim and claim not in self._stands | self._lost:
            self._heard.clear()
            await self._heard.wait()
        return LOST if claim in self._lost else ""

    def facts(self) -> dict[str, str]:
        """For ``status``: what waits for the shop's word; empty where nothing does."""
        unheard = [one.name for one in self._queue.to_do() if one.claim and one.claim not in self._stands | self._lost]
        if not unheard:
            return {}
        said = f"it has not said since this start that these are ours: {', '.join(unheard)}; is polishd shop link up?"
        return {"shop": said}

    def _take_out(self, claim: str, why: str) -> None:
        entry = self._queue.of_claim(claim)
        if entry is not None and entry.state == "waiting":
            with suppress(ConfigError):  # it begins in the same moment: the next report says so
                self._queue.remove_waiting(entry.name, why)


def _offer(given: Any) -> ShopRateReceived:
    """ConfigError where it is none."""
    if not isinstance(given, dict) or {key: type(one) for key, one in given.items()} != OFFER:
        raise ConfigError(f"an offer has {', '.join(OFFER)}, as polishd shop link sends them")
    return ShopRateReceived(**given)
