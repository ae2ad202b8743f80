"""Reports to a supervisor over a socket of the test, and without one."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sqlite3
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from polishd.daemon import app
from polishd.daemon.journal.journal import Journal
from polishd.daemon.runtime.process import SystemdNotifier
from polishd.model.events import CellOpened, StateChanged
from polishd.model.states import NOT_ASKED
from tests.unit.daemon.small_job import run_cell
from tests.unit.daemon.test_app import Site


class Systemd:
    """systemd's end of the socket; the name of an abstract socket begins with @."""

    def __init__(self, address: str, **environment: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self.environment = {"NOTIFY_SOCKET": address, **environment}

    def received(self) -> list[str]:
        """Return the messages since the last call."""
        found = []
        try:
            while True:
                found.append(self._socket.recv(4096).decode())
        except BlockingIOError:
            return found

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest) -> Iterator[Systemd]:
    """Open a socket with a short path, as systemd's: 107 characters are permitted, and ``tmp_path`` may be longer."""
    with tempfile.TemporaryDirectory(prefix="polishd-", dir="/tmp") as folder:
        address = f"{folder}/notify" if request.param == "path" else f"@polishd-test-{os.getpid()}"
        found = Systemd(address, WATCHDOG_USEC="40000", WATCHDOG_PID=str(os.getpid()))
        yield found
        found.close()


def test_ready_is_said_once_when_the_last_cell_has_spoken(systemd: Systemd) -> None:
    supervisor = SystemdNotifier(2, systemd.environment)
    left, right = supervisor.status_sink("left"), supervisor.status_sink("right")
    left(CellOpened(devices={}))
    left(StateChanged(state="starting", reason="", standing=NOT_ASKED))
    left(StateChanged(state="held", reason="late\nmap", standing=NOT_ASKED))
    assert systemd.received() == ["STATUS=left: starting", "STATUS=left: held: late map"]
    right(StateChanged(state="starting", reason="", standing=NOT_ASKED))
    supervisor.stopping()
    assert systemd.received() == ["READY=1\nSTATUS=left: held: late map; right: starting", "STOPPING=1"]


async def test_the_watchdog_is_fed_only_while_all_is_written(systemd: Systemd) -> None:
    asked: list[float] = []
    enough = asyncio.Event()

    def lives(within_s: float) -> bool:
        asked.append(within_s)
        if len(asked) == 4:
            enough.set()
        return len(asked) <= 2

    feeding = asyncio.create_task(SystemdNotifier(1, systemd.environment).feed(lives))
    await enough.wait()
    feeding.cancel()
    assert asked == [0.02] * 4
    assert systemd.received() == ["WATCHDOG=1"] * 2


@pytest.mark.parametrize("environment", [{}, {"WATCHDOG_USEC": "40000", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "x"}])
async def test_without_a_supervisor_no_watchdog_is_fed(environment: dict[str, str]) -> None:
    await SystemdNotifier(1, environment).feed(lambda _: pytest.fail("called without a watchdog"))


def test_a_missing_supervisor_is_logged_and_does_not_block(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    SystemdNotifier(1, {"NOTIFY_SOCKET": str(tmp_path / "gone")}).stopping()
    assert "STOPPING=1 cannot be sent to the supervisor of this process" in caplog.text


@pytest.mark.full
async def test_a_run_tells_its_supervisor_what_it_does(
    site: Site, systemd: Systemd, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (systemd.environment | {"WATCHDOG_USEC": "60000000"}).items():
        monkeypatch.setenv(name, value)  # it is fed once: unread messages fill the socket
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await site.in_contact()
        os.kill(os.getpid(), signal.SIGTERM)
    assert task.result()["outcome"] == "stopped"
    received = systemd.received()
    said = [text for text in received if text != "WATCHDOG=1"]
    assert said == [
        "READY=1\nSTATUS=bench (cell.toml): starting",
        "STATUS=bench (cell.toml): polishing",
        "STOPPING=1",
        "STATUS=bench (cell.toml): finished: stopped",
    ]
    assert "WATCHDOG=1" in received


def test_no_cell_lives_whose_journal_waits_for_its_disk() -> None:
    cells: list[Any] = [SimpleNamespace(journal=SimpleNamespace(unsaved_s=seconds)) for seconds in (0.0, 3.0)]
    assert app._written(cells, 4.0)
    assert not app._written(cells, 2.0)


def test_a_record_that_the_disk_has_not_has_an_age(tmp_path: Path) -> None:
    begun, lets = threading.Event(), threading.Event()

    class Hanging(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            if sql == "COMMIT" and begun.is_set():
                lets.wait()
            return super().execute(sql, *values)

    def connect(path: Path) -> sqlite3.Connection:
        return sqlite3.connect(path, isolation_level=None, check_same_thread=False, factory=Hanging)

    with Journal.open(tmp_path, job="small", part_id="P-1", connect=connect) as journal:
        journal.flush()
        assert journal.unsaved_s == 0.0
        begun.set()
        journal.record_event(CellOpened(devices={}))
        young = journal.unsaved_s
        while journal.unsaved_s < young + 0.3:  # the thread is in its commit by then
            lets.wait(0.01)
        lets.set()
        journal.flush()
        assert journal.unsaved_s == 0.0


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    return Site(tmp_path, monkeypatch)
