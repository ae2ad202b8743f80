"""``polishd shop connect``: a cell's side of the shop, a separate process beside the daemon.

Its outbox is the cell's journal: it reads the events that the shop does not have, by their numbers. It sends requests
to the daemon over the daemon's socket, as the command line does.
"""

from __future__ import annotations

import hashlib
import json
import logging
import shutil
import sqlite3
import ssl
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from polishd.config.cell import CellConfig
from polishd.config.server_sections import CERTIFICATE_WARNING_S, ShopLinkSection
from polishd.daemon.checks import check_jobs
from polishd.daemon.job.initial_estimates import FORGOTTEN
from polishd.daemon.journal.history import read_only
from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.runtime.exit_record import locked
from polishd.daemon.socket import client
from polishd.model.errors import ConfigError, LinkError, NoDaemon, PolishdError, TokenRefused
from polishd.model.events import PassProgressed, ShopRateReceived
from polishd.plugin_loader import Hooks
from polishd.shop.database import CellReport
from polishd.shop.parts import DONE
from polishd.util.files import make_folder, named_path, read_secret, redact_secrets, write_atomic

# Requests of a cell to its shop: HTTP with its token, over TLS or on this computer.

log = logging.getLogger(__name__)

STEP_S = 15.0
"""Time limit of one step of a request."""
MOST_BYTES = 32 << 20
SERVER_ERRORS = 500
AGAIN_S = 86400.0
"""Time until the warning that the shop's certificate expires is repeated."""
NOT_YET_VALID, EXPIRED = 9, 10
UNKNOWN_ISSUER, OTHER_NAME = (18, 19, 20, 21), (62, 64)
"""OpenSSL's reasons to distrust a certificate (X509_V_ERR_...)."""


class ShopClient:
    """Send one request after the other, each on a new connection. No proxy, no redirection."""

    def __init__(self, section: ShopLinkSection, base_dir: Path) -> None:
        """ConfigError where there is no token, or the trusted certificates cannot be read."""
        self._section, self._base_dir = section, base_dir
        self._ca_file = None if section.ca_file is None else named_path(base_dir, section.ca_file)
        self._context, self._trusted = self._trusting(), self._signature()
        self._refused = ""
        """Hash of the last refused token."""
        self._warned_s = float("-inf")
        read_secret(section.token, base_dir)

    def has_new_token(self) -> bool:
        """Return whether there is a token that the shop has not refused."""
        try:
            return _hash(read_secret(self._section.token, self._base_dir)) != self._refused
        except ConfigError:
            return False

    def request(self, path: str, body: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request; ConfigError where the shop refuses, LinkError where it is away or did not accept it."""
        content = self.fetch(path, body)
        try:
            found = json.loads(content)
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise LinkError(f"{self._section.url}: its answer is no JSON object; is that a shop?")
        return found

    def fetch(self, path: str, body: Mapping[str, Any]) -> bytes:
        """Fetch bytes. TokenRefused where the shop does not accept the token."""
        token = read_secret(self._section.token, self._base_dir)
        if (trusted := self._signature()) != self._trusted:
            self._context, self._trusted = self._trusting(), trusted
        try:
            status, content = self._post(path, json.dumps(dict(body)).encode(), token)
        except ssl.SSLCertVerificationError as error:
            raise LinkError(f"{self._section.url}: {self._distrust(error)}") from None
        except (OSError, HTTPException, ValueError) as error:
            raise LinkError(redact_secrets(f"{self._section.url}: {type(error).__name__}: {error}", token)) from None
        if status == 200:
            return content
        if status == 401:
            self._refused = _hash(token)
            raise TokenRefused(self._refusal(_error(content)))
        why = f"{self._section.url}: answered {status}: {_error(content)}"
        raise LinkError(why) if status >= SERVER_ERRORS or status in {408, 429} else ConfigError(why)

    def _post(self, path: str, body: bytes, token: str) -> tuple[int, bytes]:
        parts = urlsplit(self._section.url)
        host = str(parts.hostname)
        if parts.scheme == "https":
            connection: HTTPConnection = HTTPSConnection(host, parts.port, timeout=STEP_S, context=self._context)
        else:
            connection = HTTPConnection(host, parts.port, timeout=STEP_S)
        try:
            connection.connect()
            self._check_certificate(connection.sock)
            headers = {"Content-Type": "application/json", "Authorization": f"Bearer {token}"}
            connection.request("POST", path, body, headers)
            with connection.getresponse() as response:
                content = response.read(MOST_BYTES)
                if not response.isclosed():
                    raise HTTPException(f"its answer is more than {MOST_BYTES} bytes")
                return response.status, content
        finally:
            connection.close()

    # trust

    def _trusting(self) -> ssl.SSLContext:
        try:
            return ssl.create_default_context(cafile=self._ca_file)
        except (OSError, ssl.SSLError) as error:
            raise ConfigError(f"{self._ca_file}: cannot be read: {error}; name a file of certificates (PEM)") from error

    def _signature(self) -> tuple[int, int, int] | None:
        """Whether the file is still the one that was read."""
        if self._ca_file is None:
            return None
        try:
            stat = self._ca_file.stat()
        except OSError:
            return (0, 0, 0)
        return (stat.st_mtime_ns, stat.st_ino, stat.st_size)

    def _check_certificate(self, connection: Any) -> None:
        """Warn once a day where the shop's certificate expires soon."""
        if not isinstance(connection, ssl.SSLSocket):
            return
        ends = str((connection.getpeercert() or {}).get("notAfter", ""))
        left_s = ssl.cert_time_to_seconds(ends) - time.time() if ends else CERTIFICATE_WARNING_S
        if left_s < CERTIFICATE_WARNING_S and time.monotonic() - self._warned_s >= AGAIN_S:
            self._warned_s = time.monotonic()
            log.warning(
                "%s: the shop's TLS certificate expires on %s, in %.1f days. Renew it at the shop: cert and key in "
                "[web] of SHOP.toml; then nothing here stops",
                self._section.url, ends, left_s / 86400,
            )  # fmt: skip

    def _distrust(self, error: ssl.SSLCertVerificationError) -> str:
        """Problem of the shop's certificate and advice, by OpenSSL's number."""
        ca_file = "the system's authorities" if self._ca_file is None else str(self._ca_file)
        todo = {
            EXPIRED: "Renew it at the shop: cert and key in [web] of SHOP.toml. If it is not expired, set this "
            "computer's clock",
            NOT_YET_VALID: "Set the clocks of this computer and of the shop's",
            **dict.fromkeys(
                UNKNOWN_ISSUER,
                f"It is signed by none of {ca_file}. Name the file of the authority that signed it with shop.ca_file",
            ),
            **dict.fromkeys(OTHER_NAME, "It is another host's. Write in shop.url the name that is in the certificate"),
        }.get(error.verify_code, "Look at cert in [web] of SHOP.toml, and at shop.ca_file")
        return f"certificate verify failed: {error.verify_message}. {todo}. The link tries again; nothing was sent"

    def _refusal(self, reason: str) -> str:
        kind, _, name = self._section.token.partition(":")
        where = f"write it into {named_path(self._base_dir, name)}; the link reads it without a restart"
        if kind == "env":
            where = f"put it into {name}, and start the link again"
        return (
            f"{self._section.url}: the shop does not take this cell's token ({reason}). Make a new one at the shop: "
            f"polishd shop serve SHOP.toml --add-cell NAME, and {where}"
        )


def _hash(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()


def _error(content: bytes) -> str:
    try:
        return str(json.loads(content)["error"])[:500]
    except (ValueError, KeyError, TypeError):
        return " ".join(content[:200].decode("utf-8", "replace").split())


# Report of a cell's journal to a shop, read beside the daemon that writes it, from any event on.

MOST_EVENTS = 500
"""Most events in one report."""
RETENTION_S = 3600.0
"""Time for which a job's files are kept after its end: its run folder may still be written."""
LESSON_AGAIN_S = 86400.0
"""Least age difference for a repeated offer of another cell's rate."""

_JOBS = "SELECT id, name, part_id, started, ended, outcome, detail FROM job WHERE id = ?"
_PASSES = "SELECT job, cycle, program_sha256, started, ended, how, facts FROM pass WHERE job = ? ORDER BY cycle"
_MAPS = "SELECT job, cycle, taken, stats FROM map WHERE job = ? ORDER BY id"


def read_report(
    state_dir: Path, upto: int, now: dict[str, Any], also: Sequence[str], open_request: str
) -> tuple[CellReport, bool] | None:
    """Report the events after ``upto``, and whether more follow; None where the journal is still empty.

    ``also``: claims of interest to the shop that may have ended. ``open_request``: the request that may
    not be a claim yet. ConfigError where the journal cannot be read.
    """
    with read_only(state_dir) as journal:
        first = journal.execute("SELECT id, job, at, cycle, name, data FROM event ORDER BY id LIMIT 1").fetchone()
        if first is None:
            return None
        sql = "SELECT id, job, at, cycle, name, data FROM event WHERE id >= ? ORDER BY id LIMIT ?"
        rows = journal.execute(sql, (upto, MOST_EVENTS + 2)).fetchall()
        before = [row for row in rows if row[0] == upto]
        rows = [row for row in rows if row[0] > upto]
        more, rows = len(rows) > MOST_EVENTS, rows[:MOST_EVENTS]
        touched = {row[1] for row in rows} | {journal.execute("SELECT ifnull(max(id), 0) FROM job").fetchone()[0]}
        passes = _of(journal, _PASSES, touched)
        jobs = _of(journal, _JOBS, touched)
        return CellReport(
            journal=_row_hash(first),
            first=upto + 1,
            last=rows[-1][0] if rows else upto,
            before=_row_hash(before[0]) if before else "",
            tail=_row_hash(rows[-1]) if rows else "",
            now=now,
            events=[row for row in rows if row[4] != PassProgressed.name],
            jobs=jobs,
            passes=passes,
            maps=_of(journal, _MAPS, touched),
            lessons=_lessons({row[0]: row[1] for row in jobs}, passes),
            claims=_claims(journal, also, open_request),
        ), more


def facts(report: CellReport) -> dict[str, Any]:
    """The report as it is sent."""
    return asdict(report)


def has_claim(state_dir: Path, claim: str) -> bool:
    """Whether the cell's queue has, or had, the part of a claim. ConfigError where the journal cannot be read."""
    with read_only(state_dir) as journal:
        return journal.execute("SELECT 1 FROM queue WHERE claim = ?", (claim,)).fetchone() is not None


def wanted_rates(state_dir: Path, offers: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Offers for which this cell has neither its own rate nor a recent offer."""
    with read_only(state_dir) as journal:
        return [offer for offer in offers if not _is_known(journal, offer)]


def _is_known(journal: sqlite3.Connection, offer: dict[str, Any]) -> bool:
    own = "SELECT 1 FROM pass WHERE instr(facts, ?) LIMIT 1"  # facts may contain NaN, which SQLite refuses as JSON
    if journal.execute(own, (json.dumps({"recipe": offer["recipe"]})[1:-1],)).fetchone():
        return True
    sql = (
        "SELECT max(json_extract(data, '$.at_s')) FROM event WHERE name = ? AND json_extract(data, '$.recipe') = ? "
        "AND id > ifnull((SELECT max(id) FROM event WHERE name = ?), 0)"
    )
    (at_s,) = journal.execute(sql, (ShopRateReceived.name, offer["recipe"], FORGOTTEN)).fetchone()
    return at_s is not None and offer["at_s"] < at_s + LESSON_AGAIN_S


def _of(journal: sqlite3.Connection, sql: str, jobs: Iterable[int]) -> list[tuple[Any, ...]]:
    return [row for job in sorted(jobs) for row in journal.execute(sql, (job,))]


def _lessons(names: dict[int, str], passes: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """The last rate of each recipe; none where a person had to service the tool, and none without uncertainty."""
    found: dict[str, tuple[Any, ...]] = {}
    for job, cycle, _, _, ended, how, text in passes:
        record = json.loads(text)
        learned = record.get("taught") or {}
        recipe, rate = learned.get("recipe"), learned.get("believed", {}).get("removal", {}).get("rate", {})
        has_cell_stop = any(one["stops"] == "cell" for one in record.get("findings", ()))
        if recipe and how == "done" and rate.get("sigma") is not None and not has_cell_stop:
            found[recipe] = (recipe, names[job], cycle, ended, learned["tool"], rate["value"], rate["sigma"])
    return list(found.values())


def _claims(journal: sqlite3.Connection, also: Sequence[str], open_request: str) -> dict[str, dict[str, str]]:
    """State and reason of the claims that are open here or in the shop."""
    rows = journal.execute("SELECT claim, begun, verdict, reason, ended FROM queue WHERE claim != ''").fetchall()
    states = {
        claim: {"state": verdict or ("under way" if begun else "waiting"), "reason": reason or ""}
        for claim, begun, verdict, reason, ended in rows
        if ended is None or claim in also
    }
    unknown = set(also) - {row[0] for row in rows} - {open_request}
    return {**states, **{claim: {"state": "unknown"} for claim in unknown}}


def _row_hash(row: tuple[Any, ...]) -> str:
    return hashlib.sha256(json.dumps(row).encode()).hexdigest()[:16]


def finished_claims(state_dir: Path) -> set[str]:
    """Claims whose part was finished before the last job of the cell began, and ``RETENTION_S`` ago.

    A job that was removed or set aside is none of them: an operator may add its file again.
    """
    sql = "SELECT claim, verdict FROM queue WHERE ended < ? AND job < (SELECT max(id) FROM job)"
    with read_only(state_dir) as journal:
        rows = journal.execute(sql, (time.time() - RETENTION_S,)).fetchall()
    return {claim for claim, verdict in rows if claim and verdict in DONE}


# Answers of the shop. ``of`` raises KeyError, TypeError, ValueError or AttributeError for any other answer.

Reply = TypeVar("Reply")


@dataclass(frozen=True, slots=True)
class _ReportReply:
    upto: int
    """Number of the last event that the shop has."""
    assignments: dict[str, list[str]]
    """Claims by their state: stands, back, lost."""
    offers: list[dict[str, Any]]

    @classmethod
    def of(cls, reply: Mapping[str, Any]) -> _ReportReply:
        assignments = {key: [_text(one, key) for one in reply[key]] for key in ("stands", "back", "lost")}
        for offer in reply["offers"]:
            _text(offer["recipe"], "recipe of an offer")
            if not isinstance(offer["at_s"], int | float):
                raise TypeError(f"at_s of an offer is {offer['at_s']!r}, not a time")
            hash(tuple(offer.values()))  # TypeError of a list or an object
        if type(reply["upto"]) is not int or reply["upto"] < 0:
            raise ValueError(f"upto is {reply['upto']!r}, not the number of an event")
        return cls(reply["upto"], assignments, list(reply["offers"]))


@dataclass(frozen=True, slots=True)
class _ClaimedPart:
    job: str
    content: str
    """The job's file."""
    files: dict[str, str]
    """SHA-256 of the files that it names, by name."""

    @classmethod
    def of(cls, part: Mapping[str, Any]) -> _ClaimedPart:
        files = {_file_name(name): _text(digest, name) for name, digest in part["files"].items()}
        return cls(_text(part["job"], "job"), _text(part["content"], "content"), files)


@dataclass(frozen=True, slots=True)
class _ClaimReply:
    part: _ClaimedPart | None
    is_over: bool
    """The part of this request was given back or has ended."""

    @classmethod
    def of(cls, reply: Mapping[str, Any]) -> _ClaimReply:
        part = reply["part"]
        return cls(None if part is None else _ClaimedPart.of(part), reply.get("over") is True)


def _text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{what} is {value!r}, not a text")
    value.encode()  # ValueError of half a character
    return value


def _file_name(name: str) -> str:
    if Path(name).name != name or name == ".." or "\0" in name:
        raise ValueError(f"{name!r} is not the name of a file")
    return name


LONGEST_PAUSE_S = 15.0
"""Longest pause between requests while the shop is away."""
REFUSED_S = 90.0
"""Pause between two trials of a refused token: longer than a lockout of the shop, and than its absence."""
NOT_NOW = frozenset({"starting", "held", "finished"})
"""States of a daemon that needs no more parts."""
FOLDER = "shop"


class ShopLink:
    """Link of one cell; ``turn`` sends one report and applies the answer."""

    def __init__(self, config: CellConfig, hooks: Hooks, section: ShopLinkSection) -> None:
        """ConfigError where there is no token."""
        self._config, self._hooks, self._section = config, hooks, section
        self._wire = ShopClient(section, config.base_dir)
        self._folder = config.state_dir / FOLDER
        self._upto = 0
        self._open: list[str] = []
        """Claims of this cell in the shop."""
        self._judged: set[str] = set()
        """Jobs that were checked, without name and part."""
        self._considered: set[tuple[Any, ...]] = set()
        """Offers that were considered."""

    def run(self, stop: threading.Event) -> None:
        """Run until ``stop`` is set. ConfigError where another link serves this cell."""
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
        """Report, apply the shop's answer, and request a part where one is needed; True where more must be reported.

        LinkError where the shop is away, ConfigError where it refuses; neither loses anything.
        """
        status = self._status()
        if not (self._config.state_dir / JOURNAL_NAME).exists():
            return False
        found = read_report(self._config.state_dir, self._upto, _now(status), self._open, self._open_request())
        if found is None:
            return False
        report, more = found
        reply = self._request("report", facts(report), _ReportReply.of)
        behind, self._upto = reply.upto != report.last, reply.upto
        self._apply_reply(reply, status)
        return more or behind or self._wants(status)

    def _request(self, verb: str, body: Mapping[str, Any], parse: Callable[[dict[str, Any]], Reply]) -> Reply:
        """Send a request and parse its answer; LinkError where it is not the answer of a shop."""
        found = self._wire.request(f"/api/cell/{verb}", body)
        try:
            return parse(found)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise LinkError(
                f"{self._section.url}: its answer to {verb} cannot be used: {type(error).__name__}: {error}. Check "
                "that shop.url is a shop's, and that cell and shop have the same release of polishd"
            ) from error

    def _until_new_token(self, stop: threading.Event) -> float:
        """Wait for another token, ``REFUSED_S`` at most; return the pause before the next turn.

        The shop counts the wrong tokens of each address and locks it out.
        """
        end_s = time.monotonic() + REFUSED_S
        while not self._wire.has_new_token() and time.monotonic() < end_s:
            if stop.wait(self._section.every_s):
                break
        return 0.0

    # answers of the shop

    def _apply_reply(self, reply: _ReportReply, status: Mapping[str, Any]) -> None:
        self._open = [*reply.assignments["stands"], *reply.assignments["back"]]
        self._remove_files()
        if "waiting" in status:
            self._daemon("shop_assignments", reply.assignments)
            self._offer([one for one in reply.offers if tuple(one.values()) not in self._considered])

    def _remove_files(self) -> None:
        """Remove the files of parts that the shop knows as finished, and that were finished before the present job.

        The page reads the files of the last job.
        """
        present = {path.name for path in (self._folder / "jobs").glob("*")} - {*self._open, self._open_request()}
        for request in present & finished_claims(self._config.state_dir) if present else ():
            shutil.rmtree(self._folder / "jobs" / request, ignore_errors=True)

    def _offer(self, offers: list[dict[str, Any]]) -> None:
        """Send the rates of other cells to the daemon where it needs them; consider each offer once."""
        if offers and (useful := wanted_rates(self._config.state_dir, offers)):
            self._daemon("shop_rates", {"offers": useful})
        self._considered |= {tuple(one.values()) for one in offers}

    # parts

    def _wants(self, status: Mapping[str, Any]) -> bool:
        """Request a part where too few wait; True where one came, which must be reported at once."""
        waiting = status.get("waiting")
        if waiting is None or waiting >= self._section.max_assigned or status.get("state") in NOT_NOW:
            return False
        request = self._open_request() or self._store_request(uuid.uuid4().hex)
        if has_claim(self._config.state_dir, request):  # it was added just before the link ended
            self._clear_request()
            return True
        reply = self._request("claim", {"request": request}, _ClaimReply.of)
        if reply.is_over:
            self._clear_request()
        if (part := reply.part) is None:
            return False
        path = self._write_job(request, part)
        try:
            check_jobs(self._config, self._hooks, [path], self._judged)
            self._add(request, path, part.content)
        except LinkError:
            raise
        except PolishdError as error:
            self._wire.request("/api/cell/refuse", {"request": request, "why": str(error)})
            log.warning("%s: the part of job %r was refused: %s", self._config.cell.name, part.job, error)
            if not has_claim(self._config.state_dir, request):  # the daemon may have taken it at an earlier trial
                shutil.rmtree(path.parent, ignore_errors=True)
        self._clear_request()
        return True

    def _add(self, request: str, path: Path, content: str) -> None:
        """Add the part to the cell's queue and journal. LinkError where the result is unknown."""
        job = {"path": str(path), "content": content}
        reply = self._daemon("queue_add", {"files": [job], "claim": request, "by": f"shop {self._section.url}"})
        if not reply.get("ok"):
            is_config_error = reply.get("exit_code") == ConfigError.exit_code
            raise (ConfigError if is_config_error else LinkError)(str(reply.get("error")))

    def _write_job(self, request: str, part: _ClaimedPart) -> Path:
        """Write the job's file, and the files that it names, into a new folder. LinkError where the disk refuses."""
        folder = self._folder / "jobs" / request
        try:
            make_folder_of(folder)
            for name, digest in part.files.items():
                write_atomic(folder / name, self._wire.fetch("/api/cell/file", {"sha256": digest}))
            write_atomic(folder / "job.toml", part.content.encode())
        except OSError as error:
            raise LinkError(
                f"{folder}: the files of job {part.job!r} cannot be written: {error}. Check the disk"
            ) from error
        return (folder / "job.toml").absolute()

    # the open request: durable before it is sent

    def _open_request(self) -> str:
        with suppress(FileNotFoundError):
            return (self._folder / "asking").read_text(encoding="ascii").strip()
        return ""

    def _store_request(self, request: str) -> str:
        write_atomic(make_folder_of(self._folder) / "asking", request.encode())
        return request

    def _clear_request(self) -> None:
        (self._folder / "asking").unlink(missing_ok=True)

    # the daemon

    def _status(self) -> dict[str, Any]:
        try:
            return self._daemon("status")
        except NoDaemon:
            return {}
        except LinkError as error:  # the journal can still be reported
            return {"state": "does not answer", "reason": str(error)}

    def _daemon(self, verb: str, args: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Send a request to the daemon and return its reply. NoDaemon, or LinkError where that fails."""
        try:
            return client.request(self._config.state_dir, verb, args=args or {})
        except OSError as error:  # too many open files
            raise LinkError(f"{self._config.state_dir}: the daemon cannot be asked: {error}") from error


def make_folder_of(path: Path) -> Path:
    """Make the folder and return its path."""
    make_folder(path, mode=0o700)
    return path


def _now(status: Mapping[str, Any]) -> dict[str, Any]:
    """State of a cell for people."""
    if not status:
        return {"state": "no daemon"}
    return {key: status.get(key) for key in ("state", "reason", "job", "part", "waiting", "next_job", "cycle")}
