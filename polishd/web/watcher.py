"""One watcher of the daemon for all pages: it polls twice a second, receives events, and publishes both.

A hundred pages cost the daemon as much as one. The watcher has separate threads, which no other work can fill.
"""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

from polishd.daemon.runtime.exit_record import last_ending
from polishd.daemon.socket import client
from polishd.model.errors import NoDaemon, PolishdError
from polishd.util.serialization import finite
from polishd.web.overview import reading_row

log = logging.getLogger(__name__)

POLL_S = 0.5
"""Interval between two requests."""
REPLY_TIMEOUT_S = 1.0
"""Time without an answer after which the daemon counts as silent."""
KEPT_READINGS = 1200
"""Readings that are kept for charts: ten minutes."""
OLD_S = 2.0
"""Age from which a reading is not live: on the page, in metrics, in OPC UA and in ``polishd top``."""
MOST_BEHIND = 200
"""Messages that a page may be behind; then it is disconnected, and connects again."""


class Watcher:
    """Watcher of one cell; see ``polling_daemon``."""

    def __init__(self, state_dir: Path) -> None:
        self._state_dir = state_dir
        self._pages: set[asyncio.Queue[str | None]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended, self._wake = threading.Event(), threading.Event()
        self._live: dict[str, Any] = {}
        self._last_reply_s: float | None = None
        self._readings: deque[tuple[float, float | None, float | None, float | None]] = deque(maxlen=KEPT_READINGS)
        self.daemon = "none"
        """``up``, ``silent`` or ``none``."""
        self.number = 0
        """Number of events so far: data of the journal are read again when it grows."""

    def state(self) -> dict[str, Any]:
        """State of the daemon and its age."""
        age_s = None if self._last_reply_s is None else round(time.monotonic() - self._last_reply_s, 3)
        facts = {"daemon": self.daemon, "age_s": age_s, "number": self.number, "live": self._live or None}
        return facts if self.daemon != "none" else {**facts, "ending": last_ending(self._state_dir)}

    def readings(self) -> list[tuple[float, float | None, float | None, float | None]]:
        """Unix time, force (N), its set point (N) and speed (rpm) of the last minutes; None: there was no reading."""
        return list(self._readings)

    @contextmanager
    def page(self) -> Iterator[AsyncIterator[str]]:
        """Messages for a page: ``event: state`` twice a second, ``event: happened`` for each event."""
        messages: asyncio.Queue[str | None] = asyncio.Queue()
        messages.put_nowait(_message("state", self.state()))
        self._pages.add(messages)
        try:
            yield _until_none(messages)
        finally:
            self._pages.discard(messages)

    @property
    def pages(self) -> int:
        """Number of connected pages."""
        return len(self._pages)

    def _start(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        for work in (self._poll_daemon, self._follow_events):
            threading.Thread(target=work, name="watcher", daemon=True).start()

    def _end(self) -> None:
        self._ended.set()
        self._wake.set()
        for page in tuple(self._pages):
            page.put_nowait(None)

    def _in_loop(self, function: Callable[..., None], *arguments: Any) -> None:
        if self._loop is not None and not self._ended.is_set():
            try:
                self._loop.call_soon_threadsafe(function, *arguments)
            except RuntimeError:  # closed in this moment
                self._ended.set()

    def _poll_daemon(self) -> None:
        while not self._ended.is_set():
            daemon, reply = self._request_live()
            if daemon == "silent":
                daemon, reply = self._request_live()  # the daemon may have been killed during the request
            self._in_loop(self._on_reply, daemon, reply)
            self._wake.wait(POLL_S)
            self._wake.clear()

    def _request_live(self) -> tuple[str, dict[str, Any] | None]:
        try:
            return "up", client.request(self._state_dir, "live", REPLY_TIMEOUT_S / 2)
        except NoDaemon:
            return "none", None
        except PolishdError:
            return "silent", None
        except Exception:  # the thread must survive any answer of the daemon
            log.exception("asking the daemon failed; the watcher asks again")
            return "silent", None

    def _follow_events(self) -> None:
        while not self._ended.is_set():
            try:
                for event in client.subscribe(self._state_dir, REPLY_TIMEOUT_S):
                    if self._ended.is_set():
                        return
                    self._in_loop(self._on_event, event)
            except (PolishdError, OSError) as error:
                log.debug("no events: %s", error)
            except Exception:  # the thread must survive any event of the daemon
                log.exception("listening to the daemon failed; the watcher listens again")
            self._wake.set()  # report the end at once
            self._ended.wait(POLL_S)

    def _on_reply(self, daemon: str, reply: dict[str, Any] | None) -> None:
        self.daemon = daemon
        if reply is not None:
            self._live, self._last_reply_s = reply, time.monotonic()
            self._readings.append(reading_row(reply, time.time(), OLD_S))
        self._send(_message("state", self.state()))

    def _on_event(self, event: dict[str, Any]) -> None:
        self.number += 1
        self._send(_message("happened", event))
        if event.get("name") != "pass_progressed":
            self._wake.set()

    def _send(self, message: str) -> None:
        for page in tuple(self._pages):
            if page.qsize() >= MOST_BEHIND:
                self._pages.discard(page)
                page.put_nowait(None)
            else:
                page.put_nowait(message)


@asynccontextmanager
async def polling_daemon(state_dir: Path) -> AsyncIterator[Watcher]:
    """A watcher that runs inside this block."""
    watcher = Watcher(state_dir)
    watcher._start(asyncio.get_running_loop())
    try:
        yield watcher
    finally:
        watcher._end()


def _message(kind: str, facts: dict[str, Any]) -> str:
    return f"event: {kind}\ndata: {json.dumps(finite(facts))}\n\n"


async def _until_none(messages: asyncio.Queue[str | None]) -> AsyncIterator[str]:
    while (message := await messages.get()) is not None:
        yield message
