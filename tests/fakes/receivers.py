"""Receivers of notifications: a mail server and a web server on loopback that are slow, refuse, or hang."""

from __future__ import annotations

import base64
import json
import socketserver
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from email import message_from_bytes, policy
from email.message import EmailMessage
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from tests.time_limits import SOON_S


@dataclass
class MailServer:
    """Behavior of an SMTP server, and the mails that it received."""

    port: int = 0
    refuses: dict[str, str] = field(default_factory=dict)
    """Refusals by recipient, ``MAIL`` or ``AUTH``."""
    context: ssl.SSLContext | None = None
    """Context for STARTTLS; None: not offered."""
    silent: threading.Event = field(default_factory=threading.Event)
    """While set, the server sends nothing, not even the greeting; clients stay connected."""
    taken: list[tuple[list[str], EmailMessage]] = field(default_factory=list)
    """Received mails: (recipients, mail)."""
    logins: list[str] = field(default_factory=list)
    asked: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    """Released for each connection."""
    came: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    """Released for each mail."""
    read: int = 0
    """Number of mails that ``wait`` has returned."""

    def wait(self) -> EmailMessage:
        """Wait for the next mail and return it."""
        assert self.came.acquire(timeout=SOON_S)
        self.read += 1
        return self.taken[self.read - 1][1]


class _Smtp(socketserver.StreamRequestHandler):
    """Connection of one client. The server has ``mail``."""

    def handle(self) -> None:
        self.mail: MailServer = self.server.mail  # type: ignore[attr-defined]
        self.to: list[str] = []
        self.mail.asked.release()
        self._say("220 at your service")
        while line := self.rfile.readline():
            verb, _, rest = line.decode().strip().partition(" ")
            getattr(self, f"_{verb.lower()}")(rest)

    def finish(self) -> None:
        super().finish()
        self.connection.close()

    def _ehlo(self, _: str) -> None:
        tls = self.mail.context is not None and not isinstance(self.connection, ssl.SSLSocket)
        self._say("250-here", *(["250-STARTTLS"] if tls else []), "250 AUTH PLAIN")

    def _starttls(self, _: str) -> None:
        assert self.mail.context is not None
        self._say("220 go on")
        self.connection = self.mail.context.wrap_socket(self.connection, server_side=True)
        self.rfile, self.wfile = self.connection.makefile("rb"), self.connection.makefile("wb", 0)

    def _auth(self, rest: str) -> None:
        self.mail.logins.append(base64.b64decode(rest.split()[1]).decode())
        self._say(self.mail.refuses.get("AUTH", "235 welcome"))

    def _mail(self, _: str) -> None:
        self._say(self.mail.refuses.get("MAIL", "250 yes"))

    def _rcpt(self, rest: str) -> None:
        address = rest.partition("<")[2].rstrip(">")
        self.to += [] if address in self.mail.refuses else [address]
        self._say(self.mail.refuses.get(address, "250 yes"))

    def _data(self, _: str) -> None:
        self._say("354 give")
        lines = iter(self.rfile.readline, b".\r\n")
        text = b"".join(line.removeprefix(b".") if line.startswith(b"..") else line for line in lines)
        self.mail.taken.append((self.to, message_from_bytes(text, policy=policy.default)))
        self.to = []
        self._say("250 taken")
        self.mail.came.release()

    def _rset(self, _: str) -> None:
        self._say("250 yes")

    def _quit(self, _: str) -> None:
        self._say("221 bye")

    def _say(self, *lines: str) -> None:
        while self.mail.silent.is_set():
            if not self.rfile.readline():
                return
        self.wfile.write("".join(f"{line}\r\n" for line in lines).encode())


class _Threads(socketserver.ThreadingTCPServer):
    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that disconnect."""


@contextmanager
def mail_server(port: int = 0, **behaviour: Any) -> Iterator[MailServer]:
    """Run a server for the duration of the block."""
    mail = MailServer(**behaviour)
    with _Threads(("127.0.0.1", port), _Smtp) as server:
        server.mail = mail  # type: ignore[attr-defined]
        mail.port = server.server_address[1]
        with _serving(server):
            yield mail


@dataclass
class Hook:
    """Behavior of a web server, and the requests that it received."""

    url: str = ""
    status: int = 200
    answer: str = "ok"
    posted: list[tuple[str, dict[str, str], bytes]] = field(default_factory=list)
    """Requests: (path, headers in lower case, body)."""
    came: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    read: int = 0
    """Number of bodies that ``wait`` has returned."""

    def wait(self) -> dict[str, Any]:
        """Wait for the next body and return it."""
        assert self.came.acquire(timeout=SOON_S)
        self.read += 1
        return dict(json.loads(self.posted[self.read - 1][2]))


class _Http(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        hook: Hook = self.server.hook  # type: ignore[attr-defined]
        body = self.rfile.read(int(self.headers["Content-Length"]))
        hook.posted.append((self.path, {name.lower(): value for name, value in self.headers.items()}, body))
        self.send_response(hook.status)
        self.end_headers()
        self.wfile.write(hook.answer.encode())
        hook.came.release()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - as http.server calls it
        """Log nothing."""


@contextmanager
def web_server(context: ssl.SSLContext | None = None, **behaviour: Any) -> Iterator[Hook]:
    """Run a server for the duration of the block."""
    hook = Hook(**behaviour)
    with ThreadingHTTPServer(("127.0.0.1", 0), _Http) as server:
        if context is not None:
            server.socket = context.wrap_socket(server.socket, server_side=True)
        server.hook = hook  # type: ignore[attr-defined]
        hook.url = f"http{'s' if context else ''}://127.0.0.1:{server.server_address[1]}"
        with _serving(server):
            yield hook


@contextmanager
def _serving(server: socketserver.BaseServer) -> Iterator[None]:
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
