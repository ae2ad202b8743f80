"""Run a shop and its cells as processes. A caller restarts a process that it killed, as systemd does."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.daemon.socket import client
from polishd.model.errors import PolishdError
from tests.system.cell_rig import with_keys, write_small
from tests.system.sim_rig import ROOT, wait_for
from tests.time_limits import SOON_S

EVERY_S = 0.3


def polishd(*words: object) -> str:
    """Run a command of polishd and return its output. AssertionError where it fails."""
    command = [sys.executable, "-m", "polishd", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


class Process:
    """Process of a polishd command that runs until it is ended, with its log."""

    def __init__(self, log: Path, *words: object) -> None:
        self.log, self._words = log, [sys.executable, "-m", "polishd", *map(str, words)]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the process, or start it again."""
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(self._words, stdout=log, stderr=log, stdin=subprocess.DEVNULL, cwd=ROOT)

    @property
    def up(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def exit_code(self) -> int | None:
        """Exit code; None while the process runs."""
        return None if self._process is None else self._process.poll()

    def kill(self) -> None:
        """Kill the process, as the kernel does when memory is short. The process may have ended already."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(SOON_S)

    def end(self) -> int:
        """Send SIGTERM, as systemd does, and return the exit code."""
        assert self._process is not None
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait(SOON_S)


class Shop:
    """Shop with its configuration file, database and server."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.file, self.port = folder, folder / "shop.toml", free_port()
        self.file.write_text(f'[shop]\nname = "office"\nstate_dir = "state"\n[web]\nport = {self.port}\n')
        self.server = Process(folder / "server.log", "shop", "serve", self.file)

    @property
    def url(self) -> str:
        """URL of the server."""
        return f"http://127.0.0.1:{self.port}"

    def token(self, cell: str) -> str:
        """Create a token for that cell and return it."""
        return polishd("shop", "serve", self.file, "--add-cell", cell).strip()

    def add(self, jobs: Sequence[tuple[str, str]], tolerance_nm: float = 5.0, cycles: int = 3) -> None:
        """Add jobs; each is a pair of job name and part."""
        paths = [self.folder / f"{name}.toml" for name, _ in jobs]
        for path, (name, part) in zip(paths, jobs, strict=True):
            job = f'[job]\nid = "{name}"\ntolerance_nm = {tolerance_nm}\nmax_cycles = {cycles}\n'
            path.write_text(f'{job}[part]\nid = "{part}"\n')
        polishd("shop", "add", self.file, *paths)

    def rows(self, sql: str) -> list[tuple[Any, ...]]:
        """Return the rows of a query to the database while the server runs."""
        path = self.folder / "state" / "shop.sqlite"
        with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=30.0)) as database:
            return database.execute(sql).fetchall()

    def states(self) -> dict[str, str]:
        """Return the state of each job's part."""
        return dict(self.rows("SELECT job, state FROM part ORDER BY id"))


class ShopCell:
    """Simulated cell with a loader, the process of its daemon and that of its link to the shop."""

    def __init__(self, name: str, files: DemoFiles) -> None:
        self.name, self.files = name, files
        self.daemon = Process(files.daemon_log, "run", files.cell, "--queue")
        self.link = Process(files.out / "link.log", "shop", "connect", files.cell)

    def status(self) -> dict[str, Any]:
        """Return the daemon's answer to ``status``; empty where none answers."""
        try:
            return client.request(self.files.state_dir, "status", 5.0)
        except PolishdError:
            return {}

    def resume(self) -> None:
        """Send ``resume``, as an operator does. The daemon may end before it answers."""
        with contextlib.suppress(PolishdError):
            client.request(self.files.state_dir, "resume", 60.0, {"by": "the campaign"})

    def put_aside(self, job: str) -> None:
        """Remove the job over which the cell is held, as an operator does."""
        with contextlib.suppress(PolishdError):
            args = {"job": job, "reason": "it does not go on", "by": "the campaign"}
            client.request(self.files.state_dir, "queue_remove", 60.0, args)

    def rows(self, sql: str) -> list[tuple[Any, ...]]:
        """Return the rows of a query to the cell's journal."""
        path = self.files.state_dir / "journal.sqlite"
        with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=30.0)) as journal:
            return journal.execute(sql).fetchall()


def write_shop_cell(out: Path, name: str, shop: Shop) -> DemoFiles:
    """Write the small cell's files with a loader and a token of the shop."""
    files = write_small(out)
    port = free_port()
    cell = files.cell.read_text()
    cell += f'\n[loader]\ntype = "loader_line"\naddress = "tcp://127.0.0.1:{port}"\n'
    cell += f'\n[shop]\nurl = "{shop.url}"\ntoken = "file:shop.token"\nevery_s = {EVERY_S}\n'
    files.cell.write_text(with_keys(cell, {"metrology": {"timeout_s": 20.0}, "cell": {"name": name}}))
    handle = os.open(out / "shop.token", os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o600)
    with os.fdopen(handle, "w") as file:
        file.write(shop.token(name))
    return files


@contextlib.contextmanager
def shop_cell(out: Path, name: str, shop: Shop, seed: int = 1, speed: float = 40.0) -> Iterator[ShopCell]:
    """Run the cell's simulator for the duration of the block; the caller starts daemon and link."""
    files = write_shop_cell(out, name, shop)
    options = ["--state", str(files.sim_dir), "--seed", str(seed), "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        cell = ShopCell(name, files)
        try:
            yield cell
        finally:
            cell.link.kill()
            cell.daemon.kill()


def wait_attended(cells: Sequence[ShopCell], condition: Callable[[], Any], what: str) -> Any:
    """Wait until the condition is true and return its value; meanwhile resume each cell that is held."""

    def looked() -> Any:
        for cell in cells:
            if cell.status().get("state") == "held":
                cell.resume()
        return condition()

    return wait_for(looked, what, 2 * SOON_S)


def over(shop: Shop) -> bool:
    """Return whether all parts of the shop have ended."""
    return set(shop.states().values()) <= {"done", "aside"}


def parts_of(shop: Shop) -> list[dict[str, Any]]:
    """Return the output of ``polishd shop list``."""
    return list(json.loads(polishd("shop", "list", shop.file, "--json"))["parts"])
