"""Orders on their way to the daemon: each in a thread of its own, so that none waits for anything else that hangs."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from polishd.daemon import client
from polishd.model.errors import PolishdError

TOLD_S = 5.0
"""After so long whoever ordered is told that it is not obeyed yet; the order stands."""


class CommandForwarder:
    """Those of one cell."""

    def __init__(self, state_dir: Path) -> None:
        self._state_dir = state_dir
        self._under_way: dict[tuple[str, str], asyncio.Future[dict[str, Any]]] = {}

    async def give(self, verb: str, args: Mapping[str, Any], *, joined: bool = False) -> dict[str, Any] | None:
        """The daemon's answer; None: it has not obeyed yet. PolishdError where there is no daemon.

        ``joined``: where the same order of the same person is under way already, its answer: who presses twice needs no
        second thread. Another person's is one of its own, with its own ``by`` in the journal.
        """
        under_way = self._under_way.get(_key(verb, args)) if joined else None
        if under_way is None:
            under_way = self._sent(verb, args)
        try:
            async with asyncio.timeout(TOLD_S):
                return await asyncio.shield(under_way)
        except TimeoutError:
            return None

    def _sent(self, verb: str, args: Mapping[str, Any]) -> asyncio.Future[dict[str, Any]]:
        loop, key = asyncio.get_running_loop(), _key(verb, args)
        answered: asyncio.Future[dict[str, Any]] = loop.create_future()
        answered.add_done_callback(lambda one: one.cancelled() or one.exception())  # heard, should nobody wait any more

        def settle(answer: dict[str, Any] | None, error: PolishdError | None) -> None:
            if self._under_way.get(key) is answered:
                del self._under_way[key]
            if answered.done():
                return
            if error is not None:
                answered.set_exception(error)
            else:
                answered.set_result(answer or {})

        def ask() -> None:
            answer, failure = None, None
            try:
                answer = client.request(self._state_dir, verb, args=args)
            except PolishdError as error:
                failure = error
            if not loop.is_closed():
                loop.call_soon_threadsafe(settle, answer, failure)

        self._under_way[key] = answered
        threading.Thread(target=ask, name=f"order {verb}", daemon=True).start()
        return answered


def _key(verb: str, args: Mapping[str, Any]) -> tuple[str, str]:
    """What is ordered, and by whom."""
    return verb, str(args.get("by", ""))
