"""The watched folder when things go wrong around it: killed, a share that lies, a full disk, wrong clocks."""

from __future__ import annotations

import errno
import json
import os
import resource
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.api import DeviceContext, MapError, SurfaceError, SurfaceMap, SurfaceReader
from polishd.model.instrument import Instrument
from polishd.model.surface import MapInput, MapStep
from polishd.plugins.interferometer import map_files, watched_folder
from polishd.plugins.interferometer.formats.datx import DATX
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.plugins.interferometer.formats.x3p import X3P
from polishd.plugins.interferometer.map_files import SettledFiles
from polishd.plugins.interferometer.watched_folder import FolderOptions, MapWait, WatchedFolder
from polishd.sim_backends.common.metropro import DatMap, pack

PART, JOURNALLED = "P-1", "a" * 64
NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)


def dat(seed: int, *, after_s: float = 60.0, part: str = PART) -> bytes:
    """A map that was measured so long after ``NOW``."""
    height = np.random.default_rng(seed).normal(0.0, 30.0, (12, 14))
    return pack(DatMap(height, 0.5, part=part, taken_s=int((NOW + timedelta(seconds=after_s)).timestamp())))


class Daemon:
    """A process of the daemon, polled in virtual time."""

    def __init__(self, base: Path, after: str | None, **options: Any) -> None:
        readers = options.pop("readers", (METROPRO,))
        context = DeviceContext(base, base / "state", PART, readers, options.pop("instrument", None))
        known = {"folder": "maps", "stable_s": 1.0, "poll_s": 0.5} | options
        self.device = WatchedFolder(FolderOptions.model_validate(known), context)
        self.ask(after)

    def ask(self, after: str | None) -> None:
        """Wait for the map after that one."""
        self.wait = MapWait(after, SettledFiles(3, 1.0))
        self.now_s = 0.0

    def poll(self, times: int = 4) -> SurfaceMap | None:
        """Poll a number of times, half a second apart, or until a map is claimed."""
        for _ in range(times):
            self.now_s += 0.5
            found = self.device._poll(self.wait, self.now_s)
            if found is not None:
                self.device._load().handed(found.sha256)
                return found
        return None


class Died(BaseException):
    """The process is killed."""


@pytest.fixture
def maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder, whose clock says NOW."""
    path = tmp_path / "maps"
    path.mkdir()
    monkeypatch.setattr(map_files, "clock_of", lambda folder: NOW)
    return path


def failing(error: BaseException, *, late: bool = False, times: int = 1) -> Callable[..., Any]:
    """Path.rename that fails so often, before or after it is done."""
    real, left = Path.rename, [times]

    def rename(self: Path, target: Path) -> Path:
        if left[0] <= 0:
            return real(self, target)
        left[0] -= 1
        if late:
            real(self, target)
        raise error

    return rename


def reason(maps: Path, name: str) -> str:
    """Why that file lies in quarantine."""
    return (maps / "quarantine" / f"{name}.reason.txt").read_text()


@pytest.mark.parametrize("after", [None, JOURNALLED])
@pytest.mark.parametrize("late", [False, True])
def test_killed_around_the_rename(
    tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch, after: str | None, late: bool
) -> None:
    daemon = Daemon(tmp_path, after)
    daemon.poll(1)
    (maps / "a.dat").write_bytes(dat(1))
    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", failing(Died(), late=late))
        with pytest.raises(Died):
            daemon.poll()
    again = Daemon(tmp_path, after)
    found = again.poll()
    assert found
    assert found.path == maps / "taken" / f"{found.sha256}.dat"
    assert found.path.read_bytes() == dat(1)
    assert again.poll() is None
    assert not (maps / "quarantine").exists()


def test_handed_on_and_not_journalled(tmp_path: Path, maps: Path) -> None:
    """The daemon dies with the map in its hands: the journal does not name it, so it comes again; not for ever."""
    daemon = Daemon(tmp_path, JOURNALLED)
    daemon.poll(1)
    (maps / "a.dat").write_bytes(dat(1))
    first = daemon.poll()
    assert first
    daemon.ask(JOURNALLED)
    assert daemon.poll() is None, "this process had it, and did not want it"
    for _ in range(2):
        again = Daemon(tmp_path, JOURNALLED).poll(1)
        assert again
        assert (again.sha256, again.path) == (first.sha256, first.path)
        assert np.array_equal(again.height_nm, first.height_nm)
    assert Daemon(tmp_path, JOURNALLED).poll() is None
    assert "MapError: it was handed on 3 times and never journalled" in reason(maps, f"{first.sha256}.dat")


def test_a_new_journal_is_not_given_old_maps(tmp_path: Path, maps: Path) -> None:
    (maps / "a.dat").write_bytes(dat(1))
    first = Daemon(tmp_path, None).poll()
    assert first
    again = Daemon(tmp_path, None)
    assert again.poll() is None
    assert first.path
    first.path.rename(maps / "b.dat")  # as docs/how-to/maps-folder.md says
    found = again.poll()
    assert found
    assert found.sha256 == first.sha256


@pytest.mark.parametrize("after", [None, JOURNALLED])
def test_a_wait_that_was_cancelled_in_the_last_moment(tmp_path: Path, maps: Path, after: str | None) -> None:
    """The poll's thread continued and claimed a map that was not delivered."""
    daemon = Daemon(tmp_path, after)
    daemon.poll(1)
    (maps / "a.dat").write_bytes(dat(1))
    claimed = [daemon.device._poll(daemon.wait, 1.0 + 0.5 * k) for k in range(4)]
    assert any(claimed)
    daemon.ask(after)
    assert daemon.poll(1)
    daemon.ask(after)
    assert daemon.poll() is None


def test_the_journal_names_it(tmp_path: Path, maps: Path) -> None:
    daemon = Daemon(tmp_path, JOURNALLED)
    daemon.poll(1)
    (maps / "a.dat").write_bytes(dat(1))
    first = daemon.poll()
    assert first
    after = Daemon(tmp_path, first.sha256)
    assert after.poll() is None
    (maps / "b.dat").write_bytes(dat(1))
    assert after.poll() is None
    assert "StaleMap: duplicate: the same content" in reason(maps, "b.dat")
    assert json.loads((tmp_path / "state" / "maps_taken.json").read_text())["taken"] == [first.sha256]


def test_the_part_was_changed_while_the_daemon_was_down(
    tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = Daemon(tmp_path, None)
    (maps / "a.dat").write_bytes(dat(1))
    monkeypatch.setattr(Path, "rename", failing(Died(), late=True))
    with pytest.raises(Died):
        daemon.poll()
    again = Daemon(tmp_path, None)
    again.device._rules = replace(again.device._rules, part_id="P-2")
    assert again.poll() is None
    assert "WrongPart: it shows part 'P-1', the part is 'P-2'" in "".join(
        path.read_text() for path in (maps / "quarantine").glob("*.reason.txt")
    )


def test_asked_once_also_across_restarts(tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What comes while the daemon is down was measured after the ask: no map but that one has been taken since."""
    first = Daemon(tmp_path, JOURNALLED, request_file="ask")
    first.poll(1)
    token = json.loads((maps / "ask").read_text())["token"]
    (maps / "a.dat").write_bytes(dat(1))
    monkeypatch.setattr(map_files, "clock_of", lambda folder: NOW + timedelta(hours=1))
    again = Daemon(tmp_path, JOURNALLED, request_file="ask")
    found = again.poll()
    assert found
    assert json.loads((maps / "ask").read_text())["token"] == token
    later = Daemon(tmp_path, found.sha256, request_file="ask")
    later.poll(1)
    assert json.loads((maps / "ask").read_text())["token"] != token


@pytest.mark.parametrize("number", [errno.ESTALE, errno.EBUSY, errno.ENOSPC])
@pytest.mark.parametrize("late", [False, True])
def test_a_share_that_fails_or_says_so(
    tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch, number: int, late: bool
) -> None:
    daemon = Daemon(tmp_path, None)
    content = dat(1)
    (maps / "a.dat").write_bytes(content)
    monkeypatch.setattr(Path, "rename", failing(OSError(number, os.strerror(number)), late=late))
    assert daemon.poll(3) is None
    assert os.strerror(number) in daemon.wait.trouble
    found = daemon.poll(1)
    assert found
    assert found.path
    assert found.path.read_bytes() == content
    assert (maps / "a.dat").exists() is False
    assert not daemon.wait.trouble


async def test_waiting_does_not_mend_everything(tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Daemon(tmp_path, None)
    (maps / "a.dat").write_bytes(dat(1))
    monkeypatch.setattr(Path, "rename", failing(OSError(errno.EXDEV, "Invalid cross-device link")))
    with pytest.raises(SurfaceError, match="one file system"):
        daemon.poll()
    status = await daemon.device.status()
    assert (status.ready, status.state) == (False, "in trouble")
    assert "cross-device" in status.detail
    assert (maps / "a.dat").exists()


def test_a_writer_continues_while_the_file_is_claimed(
    tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Path.rename
    daemon, path = Daemon(tmp_path, None), maps / "a.dat"
    path.write_bytes(dat(1))
    kept = path.stat()

    def rename(self: Path, target: Path) -> Path:
        monkeypatch.setattr(Path, "rename", real)
        result = real(self, target)
        target.write_bytes(dat(2))
        os.utime(target, ns=(kept.st_atime_ns, kept.st_mtime_ns))  # even so: the content differs
        return result

    monkeypatch.setattr(Path, "rename", rename)
    assert daemon.poll(3) is None
    assert path.read_bytes() == dat(2)
    found = daemon.poll()
    assert found
    assert found.path
    assert found.path.read_bytes() == dat(2)


def test_a_full_disk_loses_nothing(tmp_path: Path, maps: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Daemon(tmp_path, None)
    daemon.poll(1)
    (maps / "a.dat").write_bytes(dat(1))
    (maps / "b.dat").write_bytes(dat(2, part="OTHER"))
    with monkeypatch.context() as patch:
        for module in (map_files, map_files):
            patch.setattr(module, "write_atomic", full)
        assert daemon.poll(6) is None
        assert "No space left" in daemon.wait.trouble
        assert {path.name for path in maps.iterdir() if path.is_file()} == {"a.dat", "b.dat"}
    found = daemon.poll()
    assert found
    assert found.path
    assert found.path.read_bytes() == dat(1)
    assert "WrongPart" in reason(maps, "b.dat")
    assert (maps / "quarantine" / "b.dat").read_bytes() == dat(2, part="OTHER")


def full(path: Path, content: bytes) -> None:
    """A disk without room."""
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def test_a_real_limit_of_the_file_system(tmp_path: Path, maps: Path) -> None:
    """The kernel cuts the record's write off in the middle."""
    daemon = Daemon(tmp_path, None)
    daemon.poll(1)
    record = (tmp_path / "state" / "maps_taken.json").read_bytes()
    (maps / "a.dat").write_bytes(dat(1))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50, before[1]))
    try:
        assert daemon.poll(3) is None
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "File too large" in daemon.wait.trouble
    assert (tmp_path / "state" / "maps_taken.json").read_bytes() == record
    assert [path.name for path in (tmp_path / "state").iterdir()] == ["maps_taken.json"]
    assert daemon.poll(1)


@pytest.mark.parametrize("mtime_s", [2e9, 2.0**33, 0.0])
def test_a_file_dated_in_the_future_or_never(tmp_path: Path, maps: Path, mtime_s: float) -> None:
    daemon = Daemon(tmp_path, JOURNALLED)
    daemon.poll(1)
    (maps / "a.dat").write_bytes(dat(1))
    os.utime(maps / "a.dat", (mtime_s, mtime_s))
    assert daemon.poll()


def test_out_of_order_stale_and_the_way_out(tmp_path: Path, maps: Path) -> None:
    daemon = Daemon(tmp_path, JOURNALLED)
    (maps / "lay.dat").write_bytes(dat(2, after_s=50.0))
    (maps / "old.dat").write_bytes(dat(3, after_s=-50.0))
    daemon.poll(1)
    (maps / "a.dat").write_bytes(dat(1, after_s=60.0))
    first = daemon.poll()
    assert first
    assert "lay.dat: StaleMap: stale: it lay there when" in reason(maps, "lay.dat")
    assert "old.dat: StaleMap: stale: measured at 2026-03-01T11:59:10" in reason(maps, "old.dat")

    daemon.ask(first.sha256)
    daemon.poll(1)
    (maps / "back.dat").write_bytes(dat(4, after_s=59.0))
    assert daemon.poll() is None
    text = reason(maps, "back.dat")
    assert "back.dat: StaleMap: out of order: measured at 2026-03-01T12:00:59" in text
    hint = text.split("move it back as ")[1].split(" while")[0]
    (maps / "quarantine" / "back.dat").rename(maps / hint)
    second = daemon.poll()
    assert second
    assert second.taken_at == NOW + timedelta(seconds=59)

    # the clock that was set back goes on from there; the token was for that ask only
    daemon.ask(second.sha256)
    daemon.poll(1)
    (maps / hint).write_bytes(dat(5, after_s=58.0))
    assert daemon.poll() is None
    assert "out of order" in reason(maps, hint)
    (maps / "c.dat").write_bytes(dat(6, after_s=59.5))
    assert daemon.poll()


def test_the_one_measured_first_comes_first_whatever_the_files_dates(tmp_path: Path, maps: Path) -> None:
    for seed, after_s in ((1, 30.0), (2, 10.0), (3, 20.0)):
        (maps / f"{seed}.dat").write_bytes(dat(seed, after_s=after_s))
        os.utime(maps / f"{seed}.dat", (1e9 + seed, 1e9 + seed))
    daemon, seconds = Daemon(tmp_path, None), []
    for _ in range(3):
        found = daemon.poll()
        assert found
        assert found.taken_at
        seconds.append((found.taken_at - NOW).total_seconds())
        daemon.ask(None)
    assert seconds == [10.0, 20.0, 30.0]


def test_the_profile_judges_and_the_map_stays_as_it_is(tmp_path: Path, maps: Path) -> None:
    path = maps / "a.dat"
    path.write_bytes(dat(1))
    plain = METROPRO.read(path)
    of_another = Instrument("other", serials=("no such instrument",))
    daemon = Daemon(tmp_path, None, instrument=of_another)
    assert daemon.poll() is None
    assert "MapError: a.dat is of the instrument" in reason(maps, "a.dat")
    path.write_bytes(dat(1))
    answers = frozenset({"surface", "orientation", "unit", "pitch"})
    found = Daemon(tmp_path, None, instrument=Instrument("ours", mirror=True, sign=-1, gives=answers)).poll()
    assert found
    assert np.array_equal(found.height_nm, plain.height_nm, equal_nan=True)


ANSWERS_ALL = Instrument("ours", gives=frozenset({"surface", "orientation"}), pitch_mm=0.5, unit_nm=1.0)
BARE = SurfaceMap(np.random.default_rng(1).normal(0.0, 30.0, (12, 14)), 0.5, PART, taken_at=NOW + timedelta(minutes=1))


def stepped(verb: str, **options: Any) -> MapStep:
    return MapStep(verb, "0.1.0", options, (MapInput("map", "m.dat", "ab" * 32),))


BY_HAND = stepped("convert", profile="by hand")
LESS = MapStep("subtract", "0.1.0", {}, (MapInput("map", "a.dat", ""), MapInput("subtracted", "b.dat", "", BY_HAND)))


@pytest.mark.parametrize("ending", [".dat", ".datx", ".x3p"])
@pytest.mark.parametrize(
    ("history", "why"),
    [
        (BY_HAND, "had the profile applied before"),
        (LESS, "had the profile applied before"),
        (stepped("average", mixed=True), "holds a mean of mixed repeats"),
        (MapStep("convert", "0.1.0", {}, (MapInput("map", "m", "", stepped("average", mixed=True)),)), "mixed repeats"),
        (stepped("average"), None),
        (stepped("convert", mask=["circle:0,0,3"]), None),
    ],
)
def test_files_made_by_hand_have_no_effect(
    tmp_path: Path, maps: Path, ending: str, history: MapStep, why: str | None
) -> None:
    """An unproved scale or orientation stays marked in every written format."""
    writer = {reader.suffixes[0]: reader for reader in (METROPRO, DATX, X3P)}[ending]
    assert writer.write is not None
    (maps / f"a{ending}").write_bytes(writer.write(replace(BARE, history=history)))
    options = {"accept_without_part_id": True}  # X3P has no field for the part
    daemon = Daemon(tmp_path, None, instrument=ANSWERS_ALL, readers=(METROPRO, DATX, X3P), **options)
    found = daemon.poll()
    assert (found is None) == (why is not None)
    if why:
        assert f"MapError: a{ending}" in reason(maps, f"a{ending}")
        assert why in reason(maps, f"a{ending}")


@pytest.mark.parametrize("word", ["unit", "surface", "orientation", "pitch"])
@pytest.mark.parametrize("instrument", [None, Instrument("looks", serials=())])
def test_what_a_file_leaves_open_and_no_profile_answers_is_refused_by_name(
    tmp_path: Path, maps: Path, word: str, instrument: Instrument | None
) -> None:
    """A list of numbers read as a map, in any format."""
    opened = replace(METROPRO, read=lambda path: replace(METROPRO.read(path), unsaid=frozenset({word})))
    (maps / "a.dat").write_bytes(dat(1))
    assert Daemon(tmp_path, None, instrument=instrument, readers=(opened,)).poll() is None
    assert f"MapError: a.dat: its file does not say its {word}" in reason(maps, "a.dat")
    (maps / "b.dat").write_bytes(dat(2))
    answers = replace(ANSWERS_ALL, pitch_mm=0.5)
    assert Daemon(tmp_path, None, instrument=answers, readers=(opened,)).poll()


@pytest.mark.parametrize(
    ("content", "torn"),
    [
        (b"x" * 100 + bytes(4096), False),
        (b"x" * 100 + bytes(4097), True),
        (bytes(10), True),
        (map_files.HDF5 + b"x" * 100_000 + bytes(6000), False),
        (map_files.HDF5 + b"x" * 10_000 + bytes(6000), True),
        (b"x" * 100 + bytes(200_000), True),
    ],
)
def test_tails_of_zeros(tmp_path: Path, content: bytes, torn: bool) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(content)
    surface = SurfaceMap(np.ones((2, 2)), 1.0)
    reader = SurfaceReader("any", lambda head, path: True, lambda path: surface)
    if torn:
        with pytest.raises(MapError, match=r"tail of zeros, \d+ of \d+ bytes"):
            map_files.read_map(path, [reader])
    else:
        found = map_files.read_map(path, [reader])
        assert (found.sha256, found.path) == (map_files.sha256_of(path), path)


def test_a_file_that_changes_under_the_reader(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    path.write_bytes(dat(1))

    def read(path: Path) -> SurfaceMap:
        path.write_bytes(dat(2))
        return METROPRO.read(path)

    with pytest.raises(MapError, match="written to while it was read"):
        map_files.read_map(path, [replace(METROPRO, read=read)])


def test_a_share_that_fails_while_a_reader_reads(tmp_path: Path) -> None:
    path = tmp_path / "a.dat"
    path.write_bytes(dat(1))

    def read(path: Path) -> SurfaceMap:
        raise MapError(f"{path}: cannot be read") from OSError(errno.ESTALE, "stale")

    with pytest.raises(OSError, match="stale"):
        map_files.read_map(path, [replace(METROPRO, read=read)])


def test_the_folders_own_clock(tmp_path: Path) -> None:
    now = datetime.now(UTC)
    assert abs(map_files.clock_of(tmp_path) - now) < timedelta(seconds=60)
    assert list(tmp_path.iterdir()) == []


def test_defaults_take_a_map_within_three_seconds() -> None:
    options = FolderOptions.model_validate({"folder": "maps"})
    assert options.stable_s >= 2.0
    assert options.stable_polls >= 3
    assert options.poll_s * options.stable_polls <= options.stable_s
    assert options.stable_s + 2 * options.poll_s <= 2.5
    assert watched_folder.MOST_TIMES >= 2
