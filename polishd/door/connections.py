"""Connections that cost: how many one address may hold open, and how long the head of a request may take to come."""

from __future__ import annotations

import asyncio

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

HEAD_S = 10.0
"""Within so long of its first byte, or of the connection, the head of a request must have come."""
MOST_OF_ADDRESS = 300
"""Open at once from one address: each page that watches has two or three."""
MOST = 1000
"""Open at once from all."""


class Bounded(H11Protocol):
    """Uvicorn's, with these bounds; what breaks them is closed without a word."""

    _head: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take it, or close it where there are too many."""
        super().connection_made(transport)
        host = self.client[0] if self.client else ""
        of_it = sum(1 for one in self.connections if isinstance(one, Bounded) and one.client and one.client[0] == host)
        if len(self.connections) > MOST or of_it > MOST_OF_ADDRESS:
            transport.abort()
        else:
            self._await_head()

    def data_received(self, data: bytes) -> None:
        """Of a request whose head has come nothing more is asked here: its body is the guard's business."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._rest()
        elif self._head is None:
            self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is awaited any more."""
        self._rest()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        self._head = self.loop.call_later(HEAD_S, self._too_slow)

    def _rest(self) -> None:
        if self._head is not None:
            self._head.cancel()
            self._head = None

    def _too_slow(self) -> None:
        self._head = None
        cycle: RequestResponseCycle | None = self.cycle  # before a first request there is none, whatever its type says
        if not self.transport.is_closing() and (cycle is None or cycle.response_complete):
            self.transport.abort()
