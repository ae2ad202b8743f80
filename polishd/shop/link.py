"""``polishd shop link``: a cell's side of the shop, a process of its own beside the daemon.

Its outbox is the cell's journal: what the shop has not taken yet is read from there, by the events' own numbers. What
it wants of the daemon it asks over the daemon's socket, as the command line does.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.config.shop_link import ShopLinkSection
from polishd.daemon import client
from polishd.daemon.checking import check_jobs
from polishd.daemon.journal import JOURNAL_NAME
from polishd.daemon.lock import locked
from polishd.files import make_folder, write_atomic
from polishd.hooks.loader import Hooks
from polishd.model.errors import ConfigError, LinkError, NoDaemon, PolishdError, TokenRefused
from polishd.shop import told
from polishd.shop.wire import ShopClient

log = logging.getLogger(__name__)

LONGEST_PAUSE_S = 15.0
"""While the shop is away it is asked ever less often, down to this."""
REFUSED_S = 90.0
"""Between two trials of a token that the shop refuses: longer than a shop locks a cell out, and than it is away for."""
NOT_NOW = frozenset({"starting", "held", "finished"})
"""States of a daemon that asks for nothing more."""
FOLDER = "shop"


class ShopLink:
    """Of one cell; ``turn`` is one report, and what follows from it."""

    def __init__(self, config: CellConfig, hooks: Hooks, section: ShopLinkSection) -> None:
        """ConfigError where there is no token."""
        self._config, self._hooks, self._section = config, hooks, section
        self._wire = ShopClient(section, config.base_dir)
        self._folder = config.state_dir / FOLDER
        self._upto = 0
        self._open: list[str] = []
        """Claims that the shop takes for this cell's."""
        self._judged: set[str] = set()
        """What was judged already, but for its name and part."""
        self._seen: set[tuple[Any, ...]] = set()
        """Offers that were looked at."""

    def run(self, stop: threading.Event) -> None:
        """Until that is set. ConfigError where another link serves this cell."""
        with locked(self._folder):
            pause_s, away = 0.0, ""
            while not stop.wait(pause_s):
                try:
                    pause_s = 0.0 if self.turn() else self._section.every_s
                    if away:
                        log.warning("%s: the shop answers again", self._config.cell.name)
                    away = ""
                except TokenRefused as error:
                    if str(error) != away:
                        log.warning("%s: %s; the cell goes on with what it has", self._config.cell.name, error)
                    away = str(error)
                    pause_s = self._until_new_token(stop)
                except PolishdError as error:
                    pause_s = min(max(2 * pause_s, self._section.every_s), max(LONGEST_PAUSE_S, self._section.every_s))
                    if str(error) != away:
                        log.warning("%s: %s; the cell goes on with what it has", self._config.cell.name, error)
                    away = str(error)

    def turn(self) -> bool:
        """Report, heed what the shop says, and ask it for a part where one is wanted; whether more is to be told.

        LinkError where the shop is away, ConfigError where it refuses: nothing is lost by either.
        """
        status = self._status()
        if not (self._config.state_dir / JOURNAL_NAME).exists():
            return False
        found = told.read_report(self._config.state_dir, self._upto, _now(status), self._open, self._asking())
        if found is None:
            return False
        report, more = found
        answer = self._wire.ask("/api/cell/report", told.facts(report))
        behind = int(answer["upto"]) != report.last
        self._upto = int(answer["upto"])
        self._heed(answer, status)
        return more or behind or self._wants(status)

    def _until_new_token(self, stop: threading.Event) -> float:
        """Ask nothing until there is another token, or ``REFUSED_S`` are over; the pause before the next turn.

        The shop counts wrong tokens: with each one that a link brings, its address has fewer left.
        """
        end_s = time.monotonic() + REFUSED_S
        while not self._wire.has_new_token() and time.monotonic() < end_s:
            if stop.wait(self._section.every_s):
                break
        return 0.0

    # what the shop says

    def _heed(self, answer: Mapping[str, Any], status: Mapping[str, Any]) -> None:
        word = {key: list(answer[key]) for key in ("stands", "back", "lost")}
        self._open = [*word["stands"], *word["back"]]
        if "waiting" in status:
            self._daemon("shop_word", word)
            self._offer([one for one in answer["offers"] if tuple(one.values()) not in self._seen])

    def _offer(self, offers: list[dict[str, Any]]) -> None:
        """What others have learned is told to the daemon where it is of use; each is looked at once."""
        if offers and (wanted := told.wanted_rates(self._config.state_dir, offers)):
            self._daemon("shop_offer", {"offers": wanted})
        self._seen |= {tuple(one.values()) for one in offers}

    # parts

    def _wants(self, status: Mapping[str, Any]) -> bool:
        """Ask for a part where fewer wait than should; whether one came, of which the shop is to be told at once."""
        waiting = status.get("waiting")
        if waiting is None or waiting >= self._section.ahead or status.get("state") in NOT_NOW:
            return False
        request = self._asking() or self._asked_by(uuid.uuid4().hex)
        if told.has_claim(self._config.state_dir, request):  # it was added just before the link ended
            self._settled()
            return True
        answer = self._wire.ask("/api/cell/claim", {"request": request})
        if answer.get("over"):
            self._settled()
        if (part := answer["part"]) is None:
            return False
        path = self._written(request, part)
        try:
            check_jobs(self._config, self._hooks, [path], self._judged)
            self._add(request, path, part["content"])
        except LinkError:
            raise
        except PolishdError as error:
            self._wire.ask("/api/cell/refuse", {"request": request, "why": str(error)})
            log.warning("%s: the part of job %r was refused: %s", self._config.cell.name, part["job"], error)
        self._settled()
        return True

    def _add(self, request: str, path: Path, content: str) -> None:
        """Into the cell's own queue, and journal. LinkError where nobody knows whether it is there."""
        job = {"path": str(path), "content": content}
        answer = self._daemon("job_add", {"files": [job], "claim": request, "by": f"shop {self._section.url}"})
        if not answer.get("ok"):
            known = answer.get("exit_code") == ConfigError.exit_code
            raise (ConfigError if known else LinkError)(str(answer.get("error")))

    def _written(self, request: str, part: Mapping[str, Any]) -> Path:
        """The job's file, with those that it names, in a folder of its own."""
        folder = make_folder_of(self._folder / "jobs" / request)
        for name, digest in part["files"].items():
            write_atomic(folder / Path(name).name, self._wire.fetch("/api/cell/file", {"sha256": digest}))
        path = folder / "job.toml"
        write_atomic(path, str(part["content"]).encode())
        return path.absolute()

    # what was asked, and not answered yet: durable before it is asked

    def _asking(self) -> str:
        with suppress(FileNotFoundError):
            return (self._folder / "asking").read_text(encoding="ascii").strip()
        return ""

    def _asked_by(self, request: str) -> str:
        write_atomic(make_folder_of(self._folder) / "asking", request.encode())
        return request

    def _settled(self) -> None:
        (self._folder / "asking").unlink(missing_ok=True)

    # the daemon

    def _status(self) -> dict[str, Any]:
        try:
            return self._daemon("status")
        except NoDaemon:
            return {}
        except LinkError as error:  # what the journal says can be told all the same
            return {"state": "does not answer", "reason": str(error)}

    def _daemon(self, verb: str, args: Mapping[str, Any] | None = None) -> dict[str, Any]:
        return client.request(self._config.state_dir, verb, args=args or {})


def make_folder_of(path: Path) -> Path:
    """The same, made."""
    make_folder(path, mode=0o700)
    return path


def _now(status: Mapping[str, Any]) -> dict[str, Any]:
    """What people want to know of a cell."""
    if not status:
        return {"state": "no daemon"}
    return {key: status.get(key) for key in ("state", "reason", "job", "part", "waiting", "next_job", "cycle")}
