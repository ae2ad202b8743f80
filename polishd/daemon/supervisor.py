"""What the daemon tells whoever supervises its process: sd_notify of systemd, over ``NOTIFY_SOCKET``.

READY once every cell answers, STATUS with each change of state, WATCHDOG while the event loop turns and every journal
is written, STOPPING when the end was asked for. Without a supervisor nothing is told.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from collections.abc import Callable, Mapping

from polishd.model.events import Event, StateChanged

log = logging.getLogger(__name__)

SOCKET, WATCHDOG_US, WATCHDOG_PID = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"


class SystemdNotifier:
    """Of the process in which so many cells run; ``environment`` is what systemd set."""

    def __init__(self, cells: int = 1, environment: Mapping[str, str] = os.environ) -> None:
        self._cells = cells
        self._address = environment.get(SOCKET, "")
        self.watchdog_s = _watchdog_s(environment)
        """It kills the process that says nothing for so long; 0 where it does not."""
        self._states: dict[str, str] = {}

    def stopping(self) -> None:
        """The end was asked for."""
        self._tell("STOPPING=1")

    def hears(self, cell: str) -> Callable[[Event], None]:
        """A sink for that cell's bus: its state, with the reason, is what the supervisor shows."""

        def hear(event: Event) -> None:
            if isinstance(event, StateChanged):
                self.status(cell, f"{cell}: {event.state}{f': {event.reason}' if event.reason else ''}")

        return hear

    def status(self, cell: str, text: str) -> None:
        """One line on a cell; with the last one's first the process is ready: all answer, or have ended already."""
        waited_for = len(self._states) < self._cells
        self._states[cell] = " ".join(text.split())
        ready = ["READY=1"] if waited_for and len(self._states) == self._cells else []
        self._tell("\n".join([*ready, "STATUS=" + "; ".join(self._states.values())]))

    async def feed(self, lives: Callable[[float], bool]) -> None:
        """Feed the watchdog for as long as ``lives`` (all is written that is older than so many seconds) says so.

        Only a loop that turns comes here at all.
        """
        while self.watchdog_s:
            if lives(self.watchdog_s / 2):
                self._tell("WATCHDOG=1")
            else:
                log.error("a journal is not written any more: the watchdog of the service is not fed")
            await asyncio.sleep(self.watchdog_s / 4)

    def _tell(self, text: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as told:
                told.setblocking(False)
                told.sendto(text.encode(), address)
        except OSError as error:
            log.warning("the supervisor of this process cannot be told %s: %s", text, error)


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """0 where it is another process's, or no number."""
    if environment.get(WATCHDOG_PID, str(os.getpid())) != str(os.getpid()):
        return 0.0
    text = environment.get(WATCHDOG_US, "")
    return int(text) / 1e6 if text.isdecimal() else 0.0
