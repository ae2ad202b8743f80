"""Who is connected to the robot controller, and which of them may write."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from polishd.sim_backends.robot import frames

CHUNK = 2000
"""Blocks in one EXECUTED frame."""
BACKLOG = 1 << 19
"""Bytes on their way to a client beyond which records wait for the next tick."""


@dataclass(eq=False, slots=True)
class Client:
    """One connection."""

    send: Callable[[bytes], None]
    backlog: Callable[[], int] = lambda: 0
    """Bytes that it has not taken yet."""
    role: str = ""
    told: int = 0
    """Executed blocks of the program that it was told of."""
    credit: tuple[int, int] = (-1, -1)
    awaits: list[int] = field(default_factory=list)
    """Types (HOLD, ABORT) whose ACK waits for standstill."""

    def ack(self, kind: int, status: dict[str, Any]) -> None:
        """It was done."""
        self.send(frames.pack_json(frames.ACK, {"of": kind, "status": status}))

    def tell(self, credit: tuple[int, int], ahead_s: float, executed: Sequence[tuple[int, float, float]]) -> None:
        """ACCEPTED where ``credit`` changed, EXECUTED where there is more and it takes it."""
        if self.credit != credit:
            self.credit = credit
            self.send(frames.pack(frames.ACCEPTED, struct.pack(">IId", *credit, ahead_s)))
        while self.told < len(executed) and self.backlog() < BACKLOG:
            part = executed[self.told : self.told + CHUNK]
            self.send(frames.pack_executed(part))
            self.told += len(part)

    def nak(self, kind: int, code: str, text: str) -> None:
        """It was refused."""
        self.send(frames.pack_json(frames.NAK, {"of": kind, "code": code, "text": text}))


@dataclass(slots=True)
class Lease:
    """The right to write. Each frame of its writer renews it; it lapses when nothing is heard for its time."""

    lasts_s: float
    name: str = ""
    """The last one given."""
    writer: Client | None = None
    """None while its holder is away."""
    _heard_s: float = float("-inf")
    _count: int = 0

    def take(self, client: Client, name: str, now_s: float, *, standing: bool) -> bool:
        """Whether this connection may write from now on; the one that could until now may only read on.

        Where the robot stands, nobody is waited for whose connection has ended.
        """
        taken = self.silent_s(now_s) <= self.lasts_s and not (standing and self.writer is None)
        if not self.name or name != self.name:
            if taken:
                return False
            self._count += 1
            self.name = f"lease-{self._count}"
        if self.writer is not None:
            self.writer.role = "reader"
        self.writer, self._heard_s = client, now_s
        return True

    def heard(self, client: Client, now_s: float) -> None:
        """A frame of this connection was sound."""
        if client is self.writer:
            self._heard_s = now_s

    def silent_s(self, now_s: float) -> float:
        """How long nothing was heard of the writer."""
        return now_s - self._heard_s

    def leave(self, client: Client) -> None:
        """A connection ended."""
        if client is self.writer:
            self.writer = None
