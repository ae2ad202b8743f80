"""A device that sends broken, doubled, late and lost replies, and a client that must take none of them for a value.

Each good reply has another value, so that the value shows which request it answers. What a protocol cannot distinguish
from an answer (a changed digit where there is no checksum) is counted as left out, and not sent.
"""

from __future__ import annotations

import asyncio
import itertools
import random
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pytest

from polishd.api import LinkError, PolishdError
from tests.fakes.wires import Peer

SILENCE_S = 0.5
BAD = ("broken replies", "doubled", "late")
WEIGHTS = {"good": 30, "broken": 55, "doubled": 8, "late": 2, "lost": 1, "refused": 2, "dribbled": 2}
IN_PLACE = WEIGHTS | {"good": 40, "broken": 20}
"""Where a broken one comes in place of the good one."""
SELDOM = WEIGHTS | {"good": 80, "broken": 20}
"""Where each broken one costs the connection, and opening needs several that are good."""
NEVER_ON_WIRES = ("late", "lost")
"""There time is real: waiting would take long."""
IN_A_ROW = 3
ENOUGH = 50
"""Tries for a damage that the protocol can detect."""
EXAMPLES = 3


class Talk(ABC):
    """One codec: the driver's end, what its device answers, and what the protocol can distinguish from an answer."""

    name: str
    driver: str
    """Its folder in polishd/drivers."""
    resyncs = True
    """After nonsense an answer may still be found: broken replies come before a good one, and else in its place."""
    ends = False
    """Nonsense ends the connection even so."""
    pauses = False
    """It waits a little before it asks again: a double comes as a message apart, and before that."""
    kinds = frozenset(WEIGHTS)
    """What happens to its replies."""
    least = 0.5
    """Share of good replies that must come through."""
    answers_in_s = 0.001
    """Time from a request to its answer."""

    def __init__(self, silence_s: float = SILENCE_S) -> None:
        self.silence_s = silence_s
        self.numbers = itertools.count(1)
        self.say: Callable[[bytes], None] = lambda reply: None
        """Sends what comes without a request."""
        self.truth: Any = None
        """The value of the last good reply."""
        self.taken: list[str] = []
        """The first of what was taken for a value that it is not."""

    @abstractmethod
    async def open(self) -> None:
        """Connect anew."""

    @abstractmethod
    async def close(self) -> None:
        """Idempotent."""

    @abstractmethod
    async def ask(self) -> Any:
        """A value."""

    @abstractmethod
    def replies(self, data: bytes) -> Iterable[bytes]:
        """Good ones, to the requests in the data."""

    @abstractmethod
    def distinguishes(self, sent: bytes, reply: bytes) -> bool:
        """Return whether nothing in what is sent could be another answer than that reply."""

    def distinguishes_each(self, sent: Sequence[bytes], reply: bytes) -> bool:
        """The same for messages, one after the other: together they are a stream of bytes."""
        return self.distinguishes(b"".join(sent), reply)

    def wired(self, monkeypatch: pytest.MonkeyPatch, peer: FaultyPeer) -> None:
        """Patch in the simulated bus, where the driver needs one."""
        return

    def greets(self) -> Iterable[bytes]:
        """What the device says first."""
        return ()

    def refusal(self, reply: bytes) -> bytes:
        """In place of that reply; empty where it cannot refuse."""
        return b""

    def damages(self, rng: random.Random, reply: bytes) -> Sequence[bytes]:
        """Damages of this protocol's own."""
        return ()


class FaultyPeer(Peer):
    """The far end of a talk."""

    def __init__(self, talk: Talk, seed: int, without: Sequence[str] = ()) -> None:
        super().__init__()
        self.talk = talk
        talk.say = self.treat
        self.rng = random.Random(seed)
        self.counts = Counter[str]()
        weights = SELDOM if talk.ends else WEIGHTS if talk.resyncs else IN_PLACE
        self._kinds = [kind for kind in weights if kind in talk.kinds and kind not in without]
        self._weights = [weights[kind] for kind in self._kinds]
        self._older: deque[bytes] = deque([b"\0"], maxlen=8)

    @property
    def bad(self) -> int:
        """Malformed and late replies so far."""
        return sum(self.counts[kind] for kind in BAD)

    def on_connect(self) -> None:
        for reply in self.talk.greets():
            self.treat(reply)

    def on_bytes(self, data: bytes) -> None:
        for reply in self.talk.replies(data):
            self.treat(reply)

    def treat(self, reply: bytes) -> None:
        """Send the reply as it is, damaged, several times, late, or not at all."""
        [kind] = self.rng.choices(self._kinds, self._weights)
        self.counts[kind] += 1
        sent, delay_s = [reply], self.talk.answers_in_s
        if kind == "broken":
            sent = self._broken(reply)
        elif kind == "doubled":
            sent = [reply, reply] if self.talk.pauses else [reply + reply]
        elif kind == "dribbled":
            at = self.rng.randrange(len(reply))
            sent = [reply[:at], reply[at:]]
        elif kind == "late":
            delay_s = self.talk.silence_s * (1.05 + 0.8 * self.rng.random())
        elif kind == "refused":
            sent = [self.talk.refusal(reply) or reply]
        elif kind == "lost":
            sent = []
        self._older.append(reply)
        for at, data in enumerate(filter(None, sent)):
            asyncio.get_running_loop().call_later(delay_s + 1e-6 * at, self.write, data)

    def _broken(self, reply: bytes) -> list[bytes]:
        """Return three damaged ones and the good one, or a damaged one instead of it."""
        after = [reply] if self.talk.resyncs else []
        for _ in range(ENOUGH):
            sent = [self._damaged(reply) for _ in range(3 if self.talk.resyncs else 1)]
            if self.talk.distinguishes_each(sent + after, reply):
                self.counts["broken replies"] += len(sent)
                return sent + after
            self.counts["left out"] += 1
        return [reply]

    def _damaged(self, reply: bytes) -> bytes:
        rng = self.rng
        own = self.talk.damages(rng, reply)
        if own and rng.random() < 0.5:
            return rng.choice(own)
        at, to, byte = rng.randrange(len(reply)), rng.randrange(len(reply)), rng.randrange(256)
        older = rng.choice(self._older)
        cut = rng.randrange(len(older))
        swapped = bytearray(reply)
        swapped[at], swapped[to] = swapped[to], swapped[at]
        return rng.choice([
            reply[:at],
            reply[at:],
            reply[:at] + bytes([reply[at] ^ 1 << byte % 8]) + reply[at + 1 :],
            reply[:at] + reply[at + 1 :],
            reply[:at] + bytes([byte]) + reply[at:],
            reply[:at] + older[cut:],
            reply[: max(at, to)] + reply[min(at, to) :],
            bytes(swapped),
            older,
            rng.randbytes(1 + byte % 24),
        ])  # fmt: skip


async def ask_until(talk: Talk, peer: FaultyPeer, bad: int) -> Counter[str]:
    """Ask until so many malformed or late replies came; open again what is lost. Return how often each outcome came."""
    outcomes = Counter[str]()
    while peer.bad < bad:
        try:
            await talk.open()
            refused = 0  # in a row: a link that ended because of nonsense refuses each request
            while peer.bad < bad and refused < IN_A_ROW:
                refused = 0 if await _ask(talk, outcomes) else refused + 1
        except PolishdError:
            outcomes["lost"] += 1
        finally:
            await talk.close()
    return outcomes


async def _ask(talk: Talk, outcomes: Counter[str]) -> bool:
    try:
        value = await talk.ask()
    except LinkError:
        raise
    except PolishdError:
        outcomes["refused"] += 1
        return False
    outcomes["value"] += 1
    if value != talk.truth:
        outcomes["taken"] += 1
        talk.taken = [*talk.taken, f"{value!r} is not the answer to this request, which is {talk.truth!r}"][:EXAMPLES]
    return True


def require_all_kinds(peer: FaultyPeer, outcomes: Counter[str]) -> None:
    """Assert that all kinds of replies came, and that most of the good ones got through."""
    counts, talk = peer.counts, peer.talk
    good = sum(counts[kind] for kind in ("good", "doubled", "dribbled", *(["broken"] if talk.resyncs else [])))
    assert min(counts[kind] for kind in BAD if kind in talk.kinds or kind == "broken replies") > 0, counts
    assert outcomes["value"] > talk.least * good, (counts, outcomes)


def require_none_taken(peer: FaultyPeer, outcomes: Counter[str]) -> None:
    """Assert that, and that no reply was taken for a value that it is not."""
    require_all_kinds(peer, outcomes)
    assert outcomes["taken"] == 0, (peer.talk.name, outcomes["taken"], peer.talk.taken)
