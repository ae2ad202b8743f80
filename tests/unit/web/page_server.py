"""Serve a cell's page and API for a test: a fake daemon on a real socket, and users of each role."""

from __future__ import annotations

import json
import os
import socketserver
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from starlette.testclient import TestClient

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.socket.client import SOCKET_NAME
from polishd.web.http.users import Role, UserFile, users_path
from polishd.web.routes import application

LIVE = {
    "state": "polishing",
    "reason": "",
    "next": "",
    "readings": {},
    "approval": "ab" * 32,
    "signals": {},
    "health": {},
}


@dataclass
class Answers:
    """A daemon with fixed answers that records its requests."""

    asked: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    refuse: str = ""
    hang: threading.Event | None = None
    subscribers: list[Any] = field(default_factory=list)
    looks: int = 0
    """Number of requests for the live values."""
    live: dict[str, Any] = field(default_factory=dict)
    """Live values that differ from ``LIVE``."""
    does: Callable[[str, dict[str, Any]], None] = lambda _verb, _args: None
    """Called with each command, as the action of the daemon."""

    def answer(self, verb: str, args: dict[str, Any]) -> dict[str, Any]:
        if verb not in {"live", "subscribe"}:
            self.asked.append((verb, args))
        if verb in {"live", "subscribe"}:
            self.looks += verb == "live"
            return {"ok": True, **LIVE, **self.live}
        if self.hang is not None and verb not in {"hold", "stop"}:
            self.hang.wait(60)
        self.does(verb, args)
        return {"ok": False, "error": self.refuse} if self.refuse else {"ok": True, "state": "held", "jobs": []}

    def send_event(self, event: dict[str, Any]) -> None:
        """Send an event to all subscribers."""
        self.say(json.dumps({"event": event}))

    def say(self, line: str) -> None:
        """Send a line to all subscribers."""
        for subscriber in self.subscribers:
            subscriber.write(line.encode() + b"\n")
            subscriber.flush()


@contextmanager
def answering(state_dir: Path) -> Iterator[Answers]:
    """Run the fake daemon for the duration of the block."""
    state_dir.mkdir(parents=True, exist_ok=True)
    answers = Answers()

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                request = json.loads(line)
                answer = answers.answer(request["verb"], request.get("args", {}))
                self.wfile.write(json.dumps(answer).encode() + b"\n")
                self.wfile.flush()
                if request["verb"] == "subscribe":
                    answers.subscribers.append(self.wfile)
                    self.rfile.read()

    class Server(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
        daemon_threads = True
        block_on_close = False

    path = state_dir / SOCKET_NAME
    with Server(str(path) if len(os.fsencode(path)) < 100 else os.path.relpath(path), Handler) as server:
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        try:
            yield answers
        finally:
            server.shutdown()
            path.unlink(missing_ok=True)


@dataclass
class Served:
    """Application with its daemon and a token of each role."""

    config: CellConfig
    client: TestClient
    daemon: Answers
    tokens: dict[Role, str]

    def ask(self, method: str, path: str, role: Role | None = Role.ENGINEER, **more: Any) -> Any:
        """Send a request as a program with that role's token; None: without a token."""
        headers = {} if role is None else {"Authorization": f"Bearer {self.tokens[role]}"}
        return self.client.request(method, path, headers={**headers, **more.pop("headers", {})}, **more)

    def sign_in(self, role: Role = Role.OPERATE) -> dict[str, str]:
        """Sign in as a browser: the client keeps the cookie; return the headers that the page sends."""
        answer = self.client.post("/api/session", json={"token": self.tokens[role]})
        assert answer.status_code == 200, answer.text
        return {"x-csrf-token": answer.json()["csrf"], "origin": "http://127.0.0.1"}


@contextmanager
def served(folder: Path) -> Iterator[Served]:
    """Serve the application for the duration of the block."""
    config = load_config(write_demo(folder / "demo", None, 2.0, 4, None).cell)
    users = UserFile(users_path(config))
    tokens = {role: users.add(f"{role}-person", role) for role in Role}
    with (
        answering(config.state_dir) as daemon,
        TestClient(application(config), base_url="http://127.0.0.1", raise_server_exceptions=False) as client,
    ):
        yield Served(config, client, daemon, tokens)
