"""Memory runs out in contact: by the limit of the process, by a plugin, and in a worker that the kernel kills."""

from __future__ import annotations

import os
import re
import resource
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.daemon.socket import client
from polishd.model.errors import HostFault
from tests.system.cell_rig import ONE_PASS, Daemon, events, small_cell, summary
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import require_nothing_twice, require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full]

GROWS = """
from pathlib import Path
from polishd.api import hookimpl

POLISHD_API = 1
HELD = []


@hookimpl
def polishd_on_event(event):
    if Path(FLAG).exists():
        for size in (1 << 20, 1 << 16, 1 << 12, 1 << 9):
            try:
                while True:
                    HELD.append(bytearray(size))
            except MemoryError:
                pass
"""
"""Event listener that allocates all memory that the process may have, down to the last half of a kilobyte."""


@pytest.fixture
def files(tmp_path: Path) -> Iterator[DemoFiles]:
    with small_cell(tmp_path / "cell", 2, 10.0, **ONE_PASS) as found:
        yield found


@pytest.fixture
def grows(tmp_path: Path, files: DemoFiles, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install the plugin and return the flag file that makes it allocate memory."""
    site, flag = tmp_path / "site", tmp_path / "grow"
    info = site / "grows-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "grows_plugin.py").write_text(f"FLAG = {str(flag)!r}\n{GROWS}")
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: grows\nVersion: 1.0\n")
    (info / "RECORD").write_text("")
    (info / "entry_points.txt").write_text("[polishd]\ngrows = grows_plugin\n")
    monkeypatch.setenv("PYTHONPATH", str(site))
    text, count = re.subn(r"(?m)^load = \[", 'load = ["grows", ', files.cell.read_text())
    assert count == 1
    files.cell.write_text(text)
    return flag


def limited(pid: int, left: int) -> None:
    """Limit the further memory of the process, in bytes."""
    lines = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    limit = int(lines["VmSize"].split()[0]) * 1024 + left
    resource.prlimit(pid, resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))


def moved(log: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [event for event in log if event["event"] in ("motion_started", "force_on")]


def require_goes_on(files: DemoFiles) -> None:
    """A restarted daemon is held, moves nothing before ``resume``, and polishes nothing twice after it."""
    before = len(events(files))
    with Daemon(files) as daemon:
        held = daemon.wait_for_state("held")
        assert re.search(
            "pass 0 was interrupted|this job was begun earlier", held["reason"]
        )  # where it is settled already
        assert not moved(events(files)[before:])
        client.request(files.state_dir, "resume")
        assert daemon.wait() in {0, 1}, daemon.output.read_text()
    require_nothing_twice(files)


def test_little_memory_left_is_reported_in_contact_and_holds_the_cell(files: DemoFiles) -> None:
    """The daemon monitors the memory limit of its process: it leaves contact while enough memory is left."""
    with Daemon(files) as daemon:
        daemon.wait_in_contact(60)
        limited(daemon.process.pid, 20 << 20)
        held = daemon.wait_for_state("held")
        assert re.search(r"HostFault: process_memory_mb [\d.e-]+, at least 48: raise the limit", held["reason"])
        assert "pass 0 was interrupted" in held["reason"]
        require_safe_order(events(files))
        resource.prlimit(daemon.process.pid, resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        before = len(events(files))
        daemon.wait_for_state("held")
        assert not moved(events(files)[before:])
        assert daemon.end() == HostFault.exit_code
    require_goes_on(files)


def test_a_process_without_memory_leaves_contact_and_says_so(files: DemoFiles, grows: Path) -> None:
    """All memory is used at once, before the daemon checks it: MemoryError may come anywhere."""
    with Daemon(files) as daemon:
        daemon.wait_in_contact(60)
        limited(daemon.process.pid, 8 << 20)
        grows.touch()
        wait_for(
            lambda: any(event["event"] == "motion_stopped" and event["detail"] == "hold" for event in events(files)),
            "its stop",
        )
        require_safe_order(events(files))
        wait_for(lambda: daemon.process.poll() is not None or daemon.status().get("state") == "held", "its end")
        reason = (
            summary(files)["reason"] if daemon.process.poll() is not None else daemon.wait_for_state("held")["reason"]
        )
        assert "out of memory" in reason or "process_memory_mb" in reason, reason
        if daemon.process.poll() is None:
            daemon.end()
    grows.unlink()
    require_goes_on(files)


def test_a_worker_that_the_kernel_ends_for_its_memory_is_replaced(files: DemoFiles) -> None:
    """The worker is idle in contact: the pass continues, and the next computation uses a new worker."""
    with Daemon(files) as daemon:
        daemon.wait_in_contact(60)
        children = Path(f"/proc/{daemon.process.pid}/task/{daemon.process.pid}/children").read_text().split()
        (worker,) = [
            pid for pid in map(int, children) if b"runtime.compute" in Path(f"/proc/{pid}/cmdline").read_bytes()
        ]
        os.kill(worker, signal.SIGKILL)
        assert daemon.wait() in {0, 1}, daemon.output.read_text()
    found = summary(files)
    assert found["outcome"] in {"in_tolerance", "cycles_used", "passes_used"}, found
    assert found["cycles"][0]["how"] == "done"
    assert len(found["cycles"]) > 1, "the next map was computed by another worker"
    require_nothing_twice(files)
