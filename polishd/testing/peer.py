"""A simulator as a process: its end is a power cut, stopping it a half-open link.

It writes JSON lines on its standard output: ``{"endpoint": "tcp://127.0.0.1:4711"}``, once it answers there. One that
can tell adds ``"safe": true`` to that line, and later writes ``{"safe": false}`` before it exerts or moves anything,
and ``{"safe": true}`` when it no longer does, before it tells a driver so.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from subprocess import DEVNULL, PIPE, Popen, TimeoutExpired
from typing import Any

from polishd.api import DeviceFault

START_S = 60.0
END_S = 5.0


@dataclass
class ReplayPeer:
    """A running simulator."""

    process: Popen[bytes]
    output: int
    """Descriptor of its standard output."""
    told: dict[str, Any] = field(default_factory=dict)
    """The last word on each thing."""
    _rest: bytes = b""

    @property
    def endpoint(self) -> str:
        """Where it answers."""
        return str(self.told["endpoint"])

    @property
    def tells_safe(self) -> bool:
        """It says whether it exerts or moves anything."""
        return "safe" in self.told

    def safe(self) -> bool:
        """It exerts nothing and stands still, by its own word."""
        self.hear()
        return bool(self.told["safe"])

    def cut(self) -> None:
        """Cut its power."""
        self.process.kill()

    def mute(self) -> None:
        """It lives and says nothing more."""
        self.process.send_signal(signal.SIGSTOP)

    def hear(self) -> bool:
        """Take what it has written; False once it has ended, and nothing more will come."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self.output, 4096):
                *lines, self._rest = (self._rest + data).split(b"\n")
                for line in lines:
                    self.told |= _message(line)
            return False
        return True


@asynccontextmanager
async def started(command: Sequence[str]) -> AsyncIterator[ReplayPeer]:
    """The simulator of that command line, for the time of the block; DeviceFault where it does not come up."""
    with Popen(list(command), stdout=PIPE, stdin=DEVNULL) as process:  # noqa: ASYNC220 -- it is not waited for
        peer = ReplayPeer(process, process.stdout.fileno() if process.stdout else -1)
        os.set_blocking(peer.output, False)
        try:
            await _until_up(peer, " ".join(command))
            yield peer
        finally:
            await asyncio.to_thread(_end, process)


async def _until_up(peer: ReplayPeer, command: str) -> None:
    up = asyncio.Event()

    def hear() -> None:
        if not peer.hear() or "endpoint" in peer.told:
            up.set()

    loop = asyncio.get_running_loop()
    loop.add_reader(peer.output, hear)
    try:
        async with asyncio.timeout(START_S):
            await up.wait()
    except TimeoutError:
        peer.hear()
    finally:
        loop.remove_reader(peer.output)
    if "endpoint" not in peer.told:
        how = f"did not say within {START_S:g} s" if peer.hear() else "ended before it said"
        raise DeviceFault(f'the simulator {how} where it answers: {{"endpoint": "..."}} on a line; it is {command}')


def _message(line: bytes) -> dict[str, Any]:
    """What a line tells; nothing where it is another's: simulators may say what they like beside."""
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _end(process: Popen[bytes]) -> None:
    process.send_signal(signal.SIGCONT)
    process.terminate()
    try:
        process.wait(END_S)
    except TimeoutExpired:
        process.kill()
