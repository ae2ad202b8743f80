"""``polishd web`` killed in its steps, beside the daemon's own socket: the daemon goes on, and it starts again."""

from __future__ import annotations

import asyncio
import json
import socket
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import free_port, write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.runtime.events import EventBus
from polishd.daemon.socket.client import request
from polishd.daemon.socket.server import serving
from polishd.model.events import CellHeld
from polishd.web.http.users import Role, UserFile, users_path
from tests.time_limits import SOON_S
from tests.unit.web.page_server import LIVE

BODY = b'{"reason": "look"}'


class Cell:
    """What the daemon's socket is given: it obeys when it is let."""

    def __init__(self, config: CellConfig, port: int, token: str) -> None:
        self.config, self.port, self.token = config, port, token
        self.begun: list[str] = []
        self.obeyed: list[str] = []
        self.let = asyncio.Event()
        self.came = asyncio.Event()
        self.bus = EventBus()

    async def live(self) -> dict[str, Any]:
        return dict(LIVE)

    async def hold(self, reason: str = "", by: str = "") -> dict[str, Any]:
        self.begun.append(by)
        self.came.set()
        await self.let.wait()
        self.obeyed.append(by)
        return {"state": "held"}

    def head(self, method: str, path: str, length: int = 0) -> bytes:
        return (
            f"{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {self.token}\r\n"
            f"Content-Type: application/json\r\nContent-Length: {length}\r\n\r\n"
        ).encode()

    async def asked(self, path: str, body: bytes = b"") -> dict[str, Any]:
        """The answer's JSON, of a request that is whole."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        with closing(writer):
            writer.write(self.head("POST" if body else "GET", path, len(body)) + body)
            head = await reader.readuntil(b"\r\n\r\n")
            length = next(int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
            return dict(json.loads(await reader.readexactly(length)))


@asynccontextmanager
async def web_of(cell: Cell) -> AsyncIterator[asyncio.subprocess.Process]:
    """``polishd web`` as a process that listens; killed at the end, if it is not dead by then."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "polishd.cli.app", "web", str(cell.config.path)), stdout=asyncio.subprocess.PIPE
    )
    try:
        assert process.stdout is not None
        async with asyncio.timeout(SOON_S):
            assert await process.stdout.readline()
            while (await cell.asked("/api/state"))["daemon"] != "up":  # noqa: ASYNC110 - it is another process
                await asyncio.sleep(0.02)
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


@pytest.fixture
async def cell(tmp_path: Path) -> AsyncIterator[Cell]:
    path, port = write_demo(tmp_path / "demo", None, 2.0, 4, None).cell, free_port()
    path.write_text(path.read_text().replace("port = 8750", f"port = {port}"))
    config = load_config(path)
    found = Cell(config, port, UserFile(users_path(config)).add("anna", Role.OPERATE))
    config.state_dir.mkdir(parents=True, exist_ok=True)
    async with serving(config.state_dir, {"live": found.live, "hold": found.hold}, found.bus):
        yield found


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(SOON_S):
        while not condition():  # noqa: ASYNC110 - what other processes do
            await asyncio.sleep(0.02)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("step", ["obeying", "half of the order", "stream"])
async def test_a_daemon_whose_page_is_killed_goes_on_and_the_page_starts_again(cell: Cell, step: str) -> None:
    bus: Any = cell.bus
    async with web_of(cell) as web:
        await until(lambda: len(bus._subscribers) == 1)
        reader, writer = await asyncio.open_connection("127.0.0.1", cell.port)
        with closing(writer):
            if step == "obeying":
                writer.write(cell.head("POST", "/api/orders/hold", len(BODY)) + BODY)
                await asyncio.wait_for(cell.came.wait(), SOON_S)
            elif step == "half of the order":
                writer.write(cell.head("POST", "/api/orders/hold", len(BODY)) + BODY[:5])
                await writer.drain()
            else:
                writer.write(cell.head("GET", "/api/events"))
                await asyncio.wait_for(reader.readuntil(b"event: state"), SOON_S)
            web.kill()
            await web.wait()
            with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):  # the client sees that it is gone
                await asyncio.wait_for(reader.readuntil(b"no such words"), SOON_S)
    await until(lambda: not bus._subscribers)
    answer = await asyncio.to_thread(request, cell.config.state_dir, "live")
    assert answer["state"] == "polishing", "the daemon answers others all the while"
    cell.bus.publish(CellHeld(error="a scratch", kind="SafetyStop"))
    cell.let.set()
    given = ["anna (web)"] if step == "obeying" else []
    await until(lambda: cell.obeyed == given)
    assert cell.begun == given, "an order that it had is obeyed once, half of one never"
    async with web_of(cell):
        await until(lambda: len(bus._subscribers) == 1)
        said = await asyncio.wait_for(cell.asked("/api/orders/hold", BODY), SOON_S)
        assert said == {"ok": True, "state": "held"}
        reader, writer = await asyncio.open_connection("127.0.0.1", cell.port)
        with closing(writer):
            writer.write(cell.head("GET", "/api/events"))
            await asyncio.wait_for(reader.readuntil(b"event: state"), SOON_S)
            cell.bus.publish(CellHeld(error="after it came back", kind="SafetyStop"))
            await asyncio.wait_for(reader.readuntil(b"after it came back"), SOON_S)
    assert cell.begun == cell.obeyed == [*given, "anna (web)"]


@pytest.mark.full
async def test_its_port_is_free_at_once_and_no_lock_is_left(cell: Cell) -> None:
    for _ in range(2):
        async with web_of(cell) as web:
            open_ = [socket.create_connection(("127.0.0.1", cell.port), SOON_S) for _ in range(3)]
            web.kill()
            await web.wait()
            for one in open_:
                one.close()
