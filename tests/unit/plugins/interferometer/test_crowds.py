"""The watched folder among thousands of files that are no maps, and on a share that hangs or goes stale."""

from __future__ import annotations

import asyncio
import errno
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.api import LinkError, SurfaceError
from polishd.plugins.interferometer import map_files, watched_folder
from polishd.plugins.interferometer.map_files import FolderListing
from tests.time_limits import SOON_S
from tests.unit.plugins.interferometer.test_restarts import NOW, Daemon, dat


@pytest.fixture
def maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder, whose clock says NOW."""
    path = tmp_path / "maps"
    path.mkdir()
    monkeypatch.setattr(map_files, "clock_of", lambda folder: NOW)
    return path


def junk(maps: Path, count: int, *, old_s: float = 86_400.0) -> None:
    """Files that are no maps, and come before any map by name."""
    at_s = NOW.timestamp() - old_s
    for number in range(count):
        path = maps / f"a{number:06d}.dat"
        path.write_bytes(b"no map %d" % number)
        os.utime(path, (at_s, at_s))


def test_a_map_among_thousands_of_files_is_taken_at_once(
    tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watched_folder, "READ_S", 0.0)  # as if each file took a second to read
    monkeypatch.setattr(watched_folder, "CROWDED", 100)
    junk(maps, 150)
    daemon = Daemon(tmp_path, None)
    assert daemon.poll(4) is None
    assert daemon.device._trouble.startswith(f"{maps}: holds 150 files, which delay a map")
    (maps / "z.dat").write_bytes(dat(1))
    found = daemon.poll(4)
    assert found is not None
    assert found.sha256 == map_files.sha256_of(maps / "taken" / f"{found.sha256}.dat")


async def test_the_state_says_that_files_delay_a_map(
    tmp_path: Path, maps: Path, caplog: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watched_folder, "CROWDED", 30)
    junk(maps, 31)
    daemon = Daemon(tmp_path, None)
    daemon.poll(3)
    status = await daemon.device.status()
    assert (status.ready, status.state) == (False, "in trouble")
    assert "Move files that are no maps out of it" in status.detail
    assert sum("which delay a map" in record.message for record in caplog.records) == 1, "once a wait"


def test_every_file_is_read_before_any_is_read_again(
    tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watched_folder, "READ_S", 0.0)
    junk(maps, 12)
    reads: list[str] = []
    real = map_files.read_map
    monkeypatch.setattr(map_files, "read_map", lambda path, readers: reads.append(path.name) or real(path, readers))
    daemon = Daemon(tmp_path, None)
    daemon.poll(2 + 12)
    assert sorted(reads[:12]) == [f"a{number:06d}.dat" for number in range(12)], "one a poll, none of them twice"


def test_an_old_map_among_files_that_are_none_is_found(
    tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watched_folder, "READ_S", 0.0)
    (maps / "z.dat").write_bytes(dat(1))
    junk(maps, 8, old_s=-5.0)
    os.utime(maps / "z.dat", (NOW.timestamp() - 9, NOW.timestamp() - 9))
    assert Daemon(tmp_path, None).poll(3 + 9) is not None


def test_names_are_looked_at_in_bounded_time_the_newest_always(maps: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_files, "LEAST_LOOKS", 2)
    junk(maps, 10)
    listing = FolderListing(maps, [])
    looked: list[set[str]] = []
    for _ in range(4):
        found, others = listing.look(0.0)
        looked.append({path.name for path in found})
        assert len(found) == 4
        assert not found.keys() & others
    assert set().union(*looked) == {path.name for path in maps.iterdir()}
    assert len(listing) == 10
    (maps / "new.dat").write_bytes(b"")
    for _ in range(5):
        found, others = listing.look(0.0)
        assert next(iter(found)).name == "new.dat", "the newest first, in each poll"
    assert len(found) + len(others) == len(listing) == 11
    (maps / "new.dat").unlink()
    found, others = listing.look(9.0)
    assert (len(found), len(others), len(listing)) == (10, 0, 10)


@pytest.mark.full
@pytest.mark.slow
def test_fifty_thousand_files_delay_a_map_by_a_few_polls(tmp_path: Path, maps: Path) -> None:
    junk(maps, 50_000)
    daemon = Daemon(tmp_path, None)
    began_s = time.process_time()
    daemon.poll(3)
    (maps / "z.dat").write_bytes(dat(1))
    assert daemon.poll(4) is not None
    assert time.process_time() - began_s < 7 * 5.0, "seven polls"


# a share that hangs


class Share:
    """The folder's file system: while it hangs, each reader waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.answers = threading.Event()
        self.answers.set()
        self.hanging = 0
        self.error: int | None = None
        for name in ("scandir", "lstat", "access"):
            monkeypatch.setattr(
                map_files.os if name == "scandir" else watched_folder.os, name, self._slow(getattr(os, name))
            )

    def _slow(self, act: Callable[..., Any]) -> Callable[..., Any]:
        def acts(path: Any, *args: Any, **named: Any) -> Any:
            if threading.current_thread().name != "maps folder":
                return act(path, *args, **named)
            if not self.answers.is_set():
                self.hanging += 1
                self.answers.wait()
                self.hanging -= 1
            if self.error is not None:
                raise OSError(self.error, os.strerror(self.error), str(path))
            return act(path, *args, **named)

        return acts


@pytest.fixture
def share(monkeypatch: pytest.MonkeyPatch) -> Iterator[Share]:
    found = Share(monkeypatch)
    yield found
    found.answers.set()


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Silence is noticed after a twentieth of a second."""
    monkeypatch.setattr(watched_folder, "SILENT_S", 0.05)
    monkeypatch.setattr(watched_folder, "ANSWER_S", 0.05)
    monkeypatch.setattr(watched_folder, "WITHDRAW_S", 0.05)
    monkeypatch.setattr(watched_folder.FolderThread.run, "__kwdefaults__", {"within_s": 0.05})


def folder_threads() -> int:
    return sum(thread.name == "maps folder" for thread in threading.enumerate())


async def until(there: Callable[[], bool]) -> None:
    async with asyncio.timeout(SOON_S):
        while not there():  # noqa: ASYNC110
            await asyncio.sleep(0.005)


@pytest.mark.usefixtures("quick")
async def test_a_share_that_hangs_takes_no_thread_more_and_the_map_comes_when_it_is_back(
    tmp_path: Path, maps: Path, share: Share
) -> None:
    daemon = Daemon(tmp_path, None, poll_s=0.01, stable_s=0.0, stable_polls=2)
    device = daemon.device
    await device.open()
    threads = folder_threads()
    share.answers.clear()
    task = asyncio.create_task(device.next_map(None))
    await until(lambda: "has not answered for" in device._trouble)
    for _ in range(20):  # as the daemon asks it while a person has the word
        status = await device.status()
        assert (status.ready, status.safe, status.state) == (False, True, "absent")
        assert "the file system has not answered for" in status.detail
    assert folder_threads() == threads
    assert share.hanging == 1
    task.cancel()  # held, and resumed: the call that hangs is waited for, none is added
    with pytest.raises(asyncio.CancelledError):
        await task
    task = asyncio.create_task(device.next_map(None))
    await asyncio.sleep(0.2)
    assert folder_threads() == threads
    (maps / "m.dat").write_bytes(dat(1))
    share.answers.set()
    assert (await task).part_id == "P-1"
    assert (await device.status()).state == "watching"


@pytest.mark.usefixtures("quick")
async def test_a_share_that_hangs_for_the_whole_wait_is_named_in_the_error(
    tmp_path: Path, maps: Path, share: Share
) -> None:
    device = Daemon(tmp_path, None, timeout_s=0.3).device
    share.answers.clear()
    with pytest.raises(SurfaceError, match=r"no map of part 'P-1' in 0\.3 s: .*the file system has not answered for"):
        await device.next_map(None)


@pytest.mark.usefixtures("quick")
async def test_a_cell_does_not_open_on_a_share_that_hangs(tmp_path: Path, maps: Path, share: Share) -> None:
    share.answers.clear()
    with pytest.raises(LinkError, match=r"has not answered for 0 s\. To do: check the mount and its server"):
        await Daemon(tmp_path, None).device.open()


async def test_a_stale_handle_is_said_and_waited_for(tmp_path: Path, maps: Path, share: Share) -> None:
    device = Daemon(tmp_path, None, poll_s=0.01, stable_s=0.0, stable_polls=2).device
    await device.open()
    share.error = errno.ESTALE
    task = asyncio.create_task(device.next_map(None))
    await until(lambda: "Stale file handle" in device._trouble)
    share.error = None
    (maps / "m.dat").write_bytes(dat(1))
    assert (await task).sha256


@pytest.mark.usefixtures("quick")
async def test_a_request_is_taken_back_once_the_share_answers(tmp_path: Path, maps: Path, share: Share) -> None:
    device = Daemon(tmp_path, None, request_file="ask.json", poll_s=0.01).device
    task = asyncio.create_task(device.next_map(None))
    await until((maps / "ask.json").exists)
    share.answers.clear()
    await until(lambda: share.hanging == 1)
    began_s = time.monotonic()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert time.monotonic() - began_s < SOON_S
    assert (maps / "ask.json").exists()
    share.answers.set()
    await until(lambda: not (maps / "ask.json").exists())
