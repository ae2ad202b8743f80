"""The real server, as a process: its stream, and TLS."""

from __future__ import annotations

import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.web.api import MOST_OF_USER
from polishd.web.http.users import Role, UserFile, users_path
from tests.time_limits import SOON_S
from tests.unit.web.page_server import answering


@contextmanager
def serving(cell: Path) -> Iterator[tuple[str, int]]:
    """Run the page's server for the duration of the block; its address."""
    with serving_verb("web", str(cell)) as at:
        yield at


@contextmanager
def serving_verb(*words: str) -> Iterator[tuple[str, int]]:
    """Run a command that serves for the duration of the block; its address."""
    command = [sys.executable, "-m", "polishd.cli.app", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            host, port = process.stdout.readline().strip().rpartition("//")[2].rstrip("/").split(":")
            yield host, int(port)
        finally:
            process.terminate()
            process.wait(SOON_S)


@pytest.mark.full
def test_the_stream_tells_the_state_and_ends_with_the_server(tmp_path: Path) -> None:
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    cell.write_text(cell.read_text().replace("port = 8750", "port = 0"))
    config = load_config(cell)
    token = UserFile(users_path(config)).add("anna", Role.WATCH)
    head = f"GET /api/events HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\n\r\n"
    with answering(config.state_dir), serving(cell) as at, socket.create_connection(at, SOON_S) as watcher:
        watcher.sendall(head.encode())
        received = b""
        while b'"daemon": "up"' not in received:
            part = watcher.recv(65536)
            assert part
            received += part
        assert b"content-type: text/event-stream" in received.lower()
        assert received.count(b"event: state") >= 1


@pytest.mark.full
def test_one_user_holds_ten_streams_and_leaves_the_others_theirs(tmp_path: Path) -> None:
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    cell.write_text(cell.read_text().replace("port = 8750", "port = 0"))
    users = UserFile(users_path(load_config(cell)))
    tokens = {name: users.add(name, Role.WATCH) for name in ("anna", "bob")}
    with ExitStack() as stack:
        at = stack.enter_context(serving(cell))

        def stream(name: str) -> tuple[socket.socket, bytes]:
            watcher = stack.enter_context(socket.create_connection(at, SOON_S))
            head = f"GET /api/events HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {tokens[name]}\r\n\r\n"
            watcher.sendall(head.encode())
            return watcher, watcher.recv(12)

        mine = [stream("anna") for _ in range(MOST_OF_USER)]
        assert {said for _, said in mine} == {b"HTTP/1.1 200"}
        assert stream("anna")[1] == b"HTTP/1.1 429"
        assert stream("bob")[1] == b"HTTP/1.1 200"
        mine[0][0].close()
        end_s = time.monotonic() + SOON_S
        while stream("anna")[1] != b"HTTP/1.1 200":  # the server has still to see that it was closed
            assert time.monotonic() < end_s
            time.sleep(0.05)


@pytest.mark.full
def test_with_a_certificate_it_speaks_tls_and_nothing_else(tmp_path: Path) -> None:
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("openssl is not installed: apt-get install openssl")
    cell = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell
    folder = cell.parent
    command = [openssl, "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", "key.pem", "-out", "cert.pem"]
    subprocess.run(command, cwd=folder, capture_output=True, check=True)
    keys = 'port = 0\ncert = "cert.pem"\nkey = "key.pem"'
    cell.write_text(cell.read_text().replace("port = 8750", keys))
    UserFile(users_path(load_config(cell))).add("anna", Role.WATCH)
    request = b"GET /api/state HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"
    with serving(cell) as at:
        context = ssl.create_default_context(cafile=str(folder / "cert.pem"))
        with (
            socket.create_connection(at, SOON_S) as plain,
            context.wrap_socket(socket.create_connection(at, SOON_S), server_hostname="127.0.0.1") as secure,
        ):
            secure.sendall(request)
            assert secure.recv(1000).startswith(b"HTTP/1.1 401")
            plain.sendall(request)
            try:
                answer = plain.recv(1000)
            except ConnectionError:
                answer = b""
            assert not answer.startswith(b"HTTP")
