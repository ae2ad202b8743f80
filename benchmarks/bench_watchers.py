"""What 50 pages cost a daemon in contact: its CPU time, how late its loop wakes, and how late it sees a lost link.

CPU time: pages alone, against a page server without pages. The other rows: pages and 200 requests a second,
against the same load from other processes, which use as much CPU and send the daemon nothing. Wall time of the loop: a
task in it that sleeps 5 ms records how late it wakes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import MIN_REPEATS, Progress, Row
from polishd.cli.demo import commission_demo
from polishd.commissioning.rehearsal.simulated_cell import (
    DemoFiles,
    demo_program,
    simulated_cell,
    with_values,
    write_demo,
)
from polishd.config.cell import load_config
from polishd.daemon.socket import client
from polishd.model.errors import PolishdError
from polishd.model.events import ContactAborted
from polishd.model.surface import FloatArray
from polishd.util.worker_process import process_cpu_s
from polishd.web.http.users import Role, UserFile, users_path

WATCHERS, ASKED_PER_S = 50, 200.0
USERS = 8
"""Each may send 50 requests a second."""
PATHS = ("/api/state", "/api/health", "/api/jobs", "/api/alarms")
NO_PAGES = "without pages"
TURN_S, SETTLE_S = 12.0, 1.0
COST_S = 6.0
"""Of a turn in which the daemon's CPU time is counted, to 0.01 s."""
REPORTED_S = 30.0
"""By then the daemon has reported a silent actuator, or it never will."""
CONTACT_S = 180.0
"""By then the tool is on the part, or the run has failed."""


@dataclass(frozen=True, slots=True)
class Watched:
    """What was measured on a cell whose pages are watched."""

    cpu_percent: Mapping[str, list[float]]
    """CPU time of the daemon in each turn, % of a core, with and without pages."""
    late_ms: Mapping[str, FloatArray]
    """Lateness of each wake, by load."""
    lost_ms: float
    """Time until a lost link is reported."""
    share: float
    """Cores that pages, requests and the page server used."""


def rows(progress: Progress) -> Iterator[Row]:
    """Of turns with our load and of those in between; and of a link that is lost under each."""
    with tempfile.TemporaryDirectory() as scratch:
        found = asyncio.run(watched(Path(scratch) / "watched", progress))
        lost_beside = asyncio.run(beside(Path(scratch) / "beside", found.share, progress))
    cost = {who: statistics.median(percent) for who, percent in found.cpu_percent.items()}
    quarters = {who: statistics.quantiles(turns, method="inclusive") for who, turns in found.cpu_percent.items()}
    spread = {who: (low, high) for who, (low, _, high) in quarters.items()}
    yield Row(
        f"daemon in contact, {WATCHERS} watchers: its CPU time", cost["ours"], {NO_PAGES: cost[NO_PAGES]},
        "% of a core", spread,
    )  # fmt: skip
    load, peer = f"{WATCHERS} watchers and {ASKED_PER_S:g} requests/s", "the same CPU used by others"
    for name, part in (("99th percentile", 99.0), ("99.9th percentile", 99.9)):
        ours, other = (float(np.percentile(found.late_ms[who], part)) for who in ("watched", "beside"))
        yield Row(f"loop in contact, {load}: late, {name}", ours, {peer: other}, "ms")
    yield Row(f"actuator silent in contact, {load}: until it is reported", found.lost_ms, {peer: lost_beside}, "ms")


async def watched(folder: Path, progress: Progress) -> Watched:
    """Measure with pages, in turns with other loads."""
    late: dict[str, list[FloatArray]] = {"watched": [], "beside": []}
    share = 0.0
    async with running(folder, progress) as cell:
        cpu_percent = await cell.cpu_percent(progress)
        for turn in range(1, MIN_REPEATS + 1):
            progress(f"watchers: watched {turn}/{MIN_REPEATS}")
            used_s, begun_s = cell.load_cpu_s(), time.monotonic()
            async with watching(cell.port, cell.tokens):
                await asyncio.sleep(SETTLE_S)
                settled_s = time.monotonic()
                await ask(cell.port, cell.tokens)
                late["watched"].append(cell.late_ms(settled_s))
            share = (cell.load_cpu_s() - used_s) / (time.monotonic() - begun_s)
            progress(f"watchers: beside {share:.2f} of a core {turn}/{MIN_REPEATS}")
            with burning(share):
                await asyncio.sleep(SETTLE_S)
                settled_s = time.monotonic()
                await asyncio.sleep(TURN_S)
                late["beside"].append(cell.late_ms(settled_s))
        progress("watchers: a link is lost")
        async with watching(cell.port, cell.tokens), asyncio.TaskGroup() as group:
            asking = group.create_task(ask(cell.port, cell.tokens))
            await asyncio.sleep(SETTLE_S)
            lost_ms = await cell.silenced_ms()
            asking.cancel()
    return Watched(cpu_percent, {who: np.concatenate(turns) for who, turns in late.items()}, lost_ms, share)


async def beside(folder: Path, share: float, progress: Progress) -> float:
    """ms until a lost link is reported, under a load that is not ours."""
    async with running(folder, progress) as cell:
        with burning(share):
            await asyncio.sleep(SETTLE_S)
            return await cell.silenced_ms()


@dataclass(frozen=True, slots=True)
class Running:
    """A cell in contact, and its page."""

    files: DemoFiles
    note: Path
    """Of its daemon's loop."""
    daemon: subprocess.Popen[bytes]
    web: subprocess.Popen[bytes]
    port: int
    tokens: list[str]

    def load_cpu_s(self) -> float:
        """Seconds that the page's server and this client have used so far."""
        return process_cpu_s(self.web.pid) + time.process_time()

    async def cpu_percent(self, progress: Progress) -> dict[str, list[float]]:
        """CPU time of the daemon, % of a core, in turns with pages ("ours") and without."""
        found: dict[str, list[float]] = {"ours": [], NO_PAGES: []}
        for turn in range(1, MIN_REPEATS + 1):
            for who, percent in found.items():
                progress(f"watchers: CPU time, {who} {turn}/{MIN_REPEATS}")
                async with watching(self.port, self.tokens) if who == "ours" else contextlib.nullcontext():
                    await asyncio.sleep(SETTLE_S)
                    used_s, begun_s = process_cpu_s(self.daemon.pid), time.monotonic()
                    await asyncio.sleep(COST_S)
                    used_s = process_cpu_s(self.daemon.pid) - used_s
                    percent.append(100 * used_s / (time.monotonic() - begun_s))
        self.require_contact()
        return found

    def require_contact(self) -> None:
        """RuntimeError where the pass has ended."""
        if not pressing(self.files):
            said = self.files.daemon_log.read_text()
            raise RuntimeError(f"the pass ended before its loop was measured: {said[-999:]}")

    def late_ms(self, since_s: float) -> FloatArray:
        """Lateness of each wake of the daemon's loop since then, all of them in contact."""
        self.require_contact()
        rows = [line.split() for line in self.note.read_text().splitlines()[:-1]]
        return np.array([float(late_ms) for due_s, late_ms in rows if float(due_s) >= since_s])

    async def silenced_ms(self) -> float:
        """Time from the actuator's last frame until the daemon reports its loss; RuntimeError where it does not."""
        heard = client.subscribe(self.files.state_dir, CONTACT_S)
        actuator = json.loads((self.files.sim_dir / "pids.json").read_text())["actuator"]
        os.kill(actuator, signal.SIGSTOP)
        begun_s = time.monotonic()
        try:
            async with asyncio.timeout(REPORTED_S):
                await asyncio.to_thread(first_event, heard, ContactAborted.name)
            return 1e3 * (time.monotonic() - begun_s)
        except TimeoutError:
            raise RuntimeError(f"no event {ContactAborted.name} came within {REPORTED_S:g} s") from None
        finally:
            os.kill(actuator, signal.SIGCONT)  # the simulated cell waits for it when it ends


def first_event(events: Iterable[Mapping[str, Any]], name: str) -> Mapping[str, Any]:
    """The first event of that name; RuntimeError where they end before it.

    Not ``next``: its StopIteration cannot be raised into a Future, and who awaits the thread would wait for ever.
    """
    for event in events:
        if event["name"] == name:
            return event
    raise RuntimeError(f"the daemon ended before its event {name}: read its log")


@contextlib.asynccontextmanager
async def running(folder: Path, progress: Progress) -> AsyncIterator[Running]:
    """Run it for the time of the block."""
    files, note = small(folder / "cell"), folder / "late.txt"
    users = UserFile(users_path(load_config(files.cell)))
    tokens = [users.add(f"user{k}", Role.WATCH) for k in range(USERS)]
    with simulated_cell(files.sim, ["--state", str(files.sim_dir), "--speed", "1"], folder / "sim.stderr"):
        command = ["benchmarks.probed_daemon", str(note), "run", str(files.cell)]
        page = ["polishd", "web", str(files.cell)]
        with process(files.daemon_log, *command) as daemon, process(folder / "web.log", *page) as web:
            port = await asyncio.to_thread(port_of, folder / "web.log")
            progress("watchers: until the tool is on the part")
            await in_contact(files, daemon)
            yield Running(files, note, daemon, web, port, tokens)


def small(out: Path) -> DemoFiles:
    """The demo's cell with a part of which a pass takes minutes, and a page at any port."""
    files = write_demo(out, None, 0.1, 1, None)
    part = {"part": {"aperture_mm": 60.0}}
    files.cell.write_text(with_values(files.cell.read_text(), {**part, "web": {"port": 0}}))
    files.sim.write_text(with_values(files.sim.read_text(), {"plant": {"pv_nm": 400.0}}))
    commission_demo(files)
    config = load_config(files.cell)
    config.program_path.write_bytes(demo_program(config))
    return files


@contextlib.contextmanager
def process(log: Path, module: str, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Python module for the time of the block."""
    command = [sys.executable, "-m", module, *words]
    with log.open("wb") as out, subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT) as running:
        try:
            yield running
        finally:
            running.kill()


def port_of(log: Path) -> int:
    """Return the page's URL from its first line."""
    end_s = time.monotonic() + CONTACT_S
    while (found := re.search(r"://[\d.]+:(\d+)/", log.read_text())) is None:
        if time.monotonic() > end_s:
            raise TimeoutError(f"{log}: the page does not say where it is")
        time.sleep(0.1)
    return int(found[1])


def pressing(files: DemoFiles) -> bool:
    """Whether the tool presses on the part, by the daemon."""
    try:
        return bool(client.request(files.state_dir, "live", 5.0)["pressing"])
    except PolishdError:
        return False


async def in_contact(files: DemoFiles, daemon: subprocess.Popen[bytes]) -> None:
    """Wait until the tool is on the part; RuntimeError where it does not come down."""
    end_s = time.monotonic() + CONTACT_S
    while not await asyncio.to_thread(pressing, files):
        if daemon.poll() is not None or time.monotonic() > end_s:
            why = (
                f"within {CONTACT_S:g} s"
                if daemon.returncode is None
                else f"before the daemon ended with {daemon.returncode}"
            )
            raise RuntimeError(f"no contact {why}: {files.daemon_log.read_text()[-999:]}")
        await asyncio.sleep(0.5)


@contextlib.asynccontextmanager
async def watching(port: int, tokens: list[str]) -> AsyncIterator[None]:
    """Streams of events, read as they come."""
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(watch(port, tokens[k % len(tokens)])) for k in range(WATCHERS)]
        yield
        for task in tasks:
            task.cancel()


async def watch(port: int, token: str) -> None:
    """One of them, until it is cancelled."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(request("/api/events", token, port))
        if b" 200 " not in await reader.readline():
            raise RuntimeError("a watcher was refused")
        while await reader.read(1 << 16):
            pass
        raise RuntimeError("a watcher was let go")
    finally:
        writer.close()


async def ask(port: int, tokens: list[str]) -> None:
    """Requests, evenly for a turn; each user has a connection."""
    end_s = time.monotonic() + TURN_S

    async def of_user(token: str) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            asked = 0
            due_s = time.monotonic()
            while (due_s := due_s + USERS / ASKED_PER_S) < end_s:
                await asyncio.sleep(due_s - time.monotonic())
                writer.write(request(PATHS[asked % len(PATHS)], token, port))
                asked += 1
                head = await reader.readuntil(b"\r\n\r\n")
                if b" 200 " not in head.partition(b"\r\n")[0]:
                    raise RuntimeError(f"a request was refused: {head!r}")
                length = next(line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
                await reader.readexactly(int(length.partition(b":")[2]))
            if asked < 0.9 * TURN_S * ASKED_PER_S / USERS:
                raise RuntimeError(f"only {asked} requests of a user were answered in {TURN_S:g} s")
        finally:
            writer.close()

    async with asyncio.TaskGroup() as group:
        for token in tokens:
            group.create_task(of_user(token))


def request(path: str, token: str, port: int) -> bytes:
    """A GET of HTTP/1.1."""
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {token}\r\n\r\n".encode()


BURN = """
import sys, time
share = float(sys.argv[1])
while True:
    begun = time.monotonic()
    while time.monotonic() - begun < 0.01 * share: pass
    time.sleep(0.01 * (1 - share))
"""


@contextlib.contextmanager
def burning(share: float) -> Iterator[None]:
    """Run two processes that use that many cores between them, as a server and its clients would."""
    command = [sys.executable, "-c", BURN, str(min(share / 2, 1.0))]
    running = [subprocess.Popen(command) for _ in range(2)]
    try:
        yield
    finally:
        for one in running:
            one.kill()
            one.wait()
