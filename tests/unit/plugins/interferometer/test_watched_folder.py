"""The watched folder: each map is taken once and whole, what is refused is kept with its reason."""

# ruff: noqa: ASYNC110, ASYNC240  (a test may block its own loop for a moment)

from __future__ import annotations

import asyncio
import json
import os
import struct
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from polishd.api import DeviceContext, DeviceFault, LinkError, Metrology, SurfaceError, SurfaceMap, SurfaceReader
from polishd.plugins.interferometer import polishd_device_types, polishd_surface_readers
from polishd.plugins.interferometer import watched_folder as folder_module
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.plugins.interferometer.watched_folder import WATCHED_FOLDER, FolderOptions, WatchedFolder
from tests.time_limits import SOON_S, OwnClock

PART = "DEMO-100"


def dat(seed: int = 0, *, part: str = PART, at: float | None = None, pitch_m: float = 5e-4, n: int = 40) -> bytes:
    """A MetroPro file with different content for each seed."""
    header = bytearray(834)
    for offset, code, value in (
        (0, "4s", b"\x88\x1b\x03\x6f"), (6, ">i", 834), (68, ">2H", (n, n)),
        (76, ">i", int(time.time() if at is None else at)), (164, ">f", 0.5), (168, ">f", 6.328e-7),
        (176, ">f", 1.0), (184, ">f", pitch_m), (218, ">h", 2), (320, "40s", part.encode()),
    ):  # fmt: skip
        struct.pack_into(code, header, offset, *(value if isinstance(value, tuple) else (value,)))
    return bytes(header) + np.random.default_rng(seed).integers(-9999, 9999, (n, n)).astype(">i4").tobytes()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "maps"
    path.mkdir()
    return path


@pytest.fixture
def make(tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., WatchedFolder]:
    """Makes the device; options as in the config. Its time is not up because the machine is busy."""
    monkeypatch.setattr(folder_module, "time", OwnClock())

    def build(readers: tuple[SurfaceReader, ...] = (METROPRO,), **options: Any) -> WatchedFolder:
        context = DeviceContext(base_dir=tmp_path, state_dir=tmp_path / "state", part_id=PART, readers=readers)
        quick = {"folder": "maps", "poll_s": 0.01, "stable_polls": 3, "stable_s": 0.05, "timeout_s": 20.0}
        device = WATCHED_FOLDER.build(FolderOptions.model_validate(quick | options), context)
        assert isinstance(device, WatchedFolder)
        return device

    return build


async def until(condition: Callable[[], bool]) -> None:
    """Wait until it holds."""
    async with asyncio.timeout(SOON_S):
        while not condition():
            await asyncio.sleep(0.005)


async def while_waiting(
    device: WatchedFolder, act: Callable[[], Awaitable[None]], after: str | None = None
) -> SurfaceMap:
    """The next map, while something happens to the folder."""
    async with asyncio.TaskGroup() as group:
        wanted = group.create_task(device.next_map(after))
        await act()
    return wanted.result()


def reasons(folder: Path) -> str:
    """All that the quarantine says."""
    return "".join(sorted(path.read_text() for path in (folder / "quarantine").glob("*.reason.txt")))


async def test_it_is_a_metrology_device(make: Callable[..., WatchedFolder], folder: Path) -> None:
    (device_type,) = polishd_device_types()
    assert (device_type.name, device_type.port) == ("watched_folder", "metrology")
    assert METROPRO in polishd_surface_readers()
    device = make()
    assert isinstance(device, Metrology)
    await device.make_safe()
    await device.open()
    await device.open()
    assert (await device.identify()).serial == str(folder)
    status = await device.status()
    assert (status.ready, status.safe, status.state) == (True, True, "watching")
    await device.close()
    await device.make_safe()
    folder.rmdir()
    status = await device.status()
    assert (status.ready, status.safe) == (False, True)
    assert "no such folder" in status.detail
    with pytest.raises(LinkError, match="no such folder"):
        await make().open()


@pytest.mark.parametrize(
    "options",
    [{"nonsense": 1}, {"poll_s": 0}, {"stable_polls": 1}, {"stable_polls": 2.5}, {"timeout_s": "5"}, {"folder": 5}],
)
def test_wrong_options(make: Callable[..., WatchedFolder], options: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        make(**options)


async def test_the_folder_may_lie_in_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    watched = WatchedFolder(FolderOptions(folder="~/maps"), DeviceContext(tmp_path, tmp_path / "state", PART, ()))
    with pytest.raises((LinkError, SurfaceError), match=f"{tmp_path}/home/maps"):
        await watched.open()


def test_whole_numbers_are_seconds_too(make: Callable[..., WatchedFolder]) -> None:
    assert make(timeout_s=60)


@pytest.mark.full
async def test_a_map_is_taken_once_and_kept_under_its_content(make: Callable[..., WatchedFolder], folder: Path) -> None:
    device = make()
    await device.open()
    (folder / "first.dat").write_bytes(dat(1))
    found = await device.next_map(None)
    assert found.path == folder / "taken" / f"{found.sha256}.dat"
    assert found.path.read_bytes() == dat(1, at=found.taken_at.timestamp() if found.taken_at else 0)
    assert not (folder / "first.dat").exists()
    assert found.part_id == PART


@pytest.mark.full
async def test_a_request_is_written_whole_and_withdrawn(make: Callable[..., WatchedFolder], folder: Path) -> None:
    device = make(request_file="measure.request")
    await device.open()
    request = folder / "measure.request"

    async def instrument() -> None:
        await until(request.exists)
        assert json.loads(request.read_text())["part"] == PART
        (folder / "m.dat").write_bytes(dat(2))

    assert (await while_waiting(device, instrument)).part_id == PART
    assert not request.exists()
    assert not reasons(folder)


async def test_a_request_without_an_answer(make: Callable[..., WatchedFolder], folder: Path) -> None:
    device = make(request_file="measure.request", timeout_s=0.1)
    with pytest.raises(SurfaceError) as caught:
        await device.next_map(None)
    assert str(folder) in str(caught.value)
    assert "in 0.1 s: no file came" in str(caught.value)
    assert list(folder.iterdir()) == []


async def test_a_request_that_cannot_be_written(make: Callable[..., WatchedFolder]) -> None:
    with pytest.raises(SurfaceError, match="the request cannot be written"):
        await make(request_file="no/such/folder/x").next_map(None)


@pytest.mark.full
@pytest.mark.parametrize("preallocated", [False, True])
async def test_a_slow_writer_is_waited_for(
    make: Callable[..., WatchedFolder], folder: Path, preallocated: bool
) -> None:
    """Pauses longer than ``stable_s`` make the file look at rest while it is torn."""
    device = make(stable_s=0.1)
    content = dat(3)
    path = folder / "slow.dat"

    async def write() -> None:
        with path.open("wb") as file:
            if preallocated:
                file.truncate(len(content))
            for part in range(0, len(content), 2500):
                file.write(content[part : part + 2500])
                file.flush()
                await asyncio.sleep(0.15)

    found = await while_waiting(device, write)
    assert found.path
    assert found.path.read_bytes() == content
    assert not (folder / "quarantine").exists()


@pytest.mark.full
async def test_files_of_one_chunk_after_another_under_another_suffix(
    make: Callable[..., WatchedFolder], folder: Path
) -> None:
    device = make()
    content = dat(4)

    async def write() -> None:
        temp = folder / "m.dat.part"
        temp.write_bytes(content)
        hidden = folder / ".m2.dat"
        hidden.write_bytes(dat(5))
        (folder / "link.dat").symlink_to(hidden)
        await asyncio.sleep(0.15)
        temp.rename(folder / "m.dat")

    found = await while_waiting(device, write)
    assert found.path
    assert found.path.read_bytes() == content
    assert {path.name for path in folder.iterdir()} == {".m2.dat", "link.dat", "taken"}


REFUSED = {
    "wrong part": (lambda: dat(1, part="OTHER"), "WrongPart: it shows part 'OTHER', the part is 'DEMO-100'"),
    "unnamed": (lambda: dat(1, part=""), "WrongPart: it does not say whose map it is"),
    "stale": (lambda: dat(1, at=time.time() - 60), "StaleMap: stale: measured at"),
    "no scale": (
        lambda: dat(1, pitch_m=0.0),
        "MapError: bad.dat: its file does not say its pitch, and there is no instrument's profile",
    ),
    "level": (
        lambda: dat(1)[:-6400] + bytes([0, 0, 0, 7]) * 1600,
        "MapError: all its heights are equal: nothing was measured",
    ),
    "torn": (lambda: dat(1)[:-7], "MapError: has 7227 bytes of 7234: torn"),
    "preallocated": (lambda: dat(1)[:-80] + bytes(80), "MapError: ends in a tail of zeros"),
    "empty": (lambda: b"", "MapError: is empty (known: metropro)"),
    "text": (lambda: b"hello", "MapError: is in no format that is known (known: metropro)"),
}


@pytest.mark.full
@pytest.mark.parametrize("case", REFUSED)
async def test_what_is_refused_is_kept_with_its_reason(
    make: Callable[..., WatchedFolder], folder: Path, case: str
) -> None:
    device = make(stable_s=0.02, request_file="measure.request")
    content, reason = REFUSED[case][0](), REFUSED[case][1]

    async def act() -> None:
        (folder / "bad.dat").write_bytes(content)
        await until(lambda: bool(reasons(folder)))
        (folder / "good.dat").write_bytes(dat(2))

    found = await while_waiting(device, act)
    assert found.part_id == PART
    assert (folder / "quarantine" / "bad.dat").read_bytes() == content
    assert f"bad.dat: {reason}" in (folder / "quarantine" / "bad.dat.reason.txt").read_text()


@pytest.mark.full
async def test_a_guessed_date_makes_no_map_new_and_none_out_of_order(
    make: Callable[..., WatchedFolder], folder: Path
) -> None:
    """A library took ``02:15:18`` for a time of today: when the file was written decides."""

    def read(path: Path) -> SurfaceMap:
        ahead = datetime.now(UTC) + timedelta(hours=3)
        return replace(METROPRO.read(path), taken_at=ahead, date_from="guessed")

    guessing = replace(METROPRO, sniff=lambda _, path: path.suffix == ".opd", read=read)
    device = make((guessing, METROPRO), stable_s=0.02, request_file="measure.request")

    async def act() -> None:
        await until((folder / "measure.request").exists)
        written = folder / ".old"
        written.write_bytes(dat(1))
        os.utime(written, (time.time() - 60, time.time() - 60))
        written.rename(folder / "old.opd")
        await until(lambda: bool(reasons(folder)))
        (folder / "new.opd").write_bytes(dat(2))

    first = await while_waiting(device, act)
    assert first.date_from == "guessed"
    assert "old.opd: StaleMap: stale: its header has no date that counts; written at" in reasons(folder)

    async def measure() -> None:
        await until((folder / "measure.request").exists)
        (folder / "later.dat").write_bytes(dat(3))

    later = await while_waiting(device, measure, first.sha256)
    assert later.date_from == "header"
    assert "later.dat" not in reasons(folder)


@pytest.mark.full
async def test_time_is_up(make: Callable[..., WatchedFolder], folder: Path) -> None:
    device = make(timeout_s=0.8, stable_s=0.02)
    (folder / "a.dat").write_bytes(dat(1, part="OTHER"))
    with pytest.raises(SurfaceError) as caught:
        await device.next_map(None)
    for expected in (str(folder), "0.8 s", "a.dat: WrongPart", "'OTHER'", "quarantine"):
        assert expected in str(caught.value)


@pytest.mark.full
async def test_unnamed_maps_can_be_allowed(make: Callable[..., WatchedFolder], folder: Path) -> None:
    (folder / "a.dat").write_bytes(dat(1, part=""))
    assert (await make(accept_without_part_id=True).next_map(None)).part_id == ""


@pytest.mark.full
async def test_the_same_content_is_never_taken_twice_also_after_a_restart(
    make: Callable[..., WatchedFolder], folder: Path, tmp_path: Path
) -> None:
    content = dat(1)
    (folder / "a.dat").write_bytes(content)
    device = make()
    await device.open()
    first = await device.next_map(None)

    again = make(timeout_s=0.8)
    await again.open()
    (folder / "b.dat").write_bytes(content)
    with pytest.raises(SurfaceError, match=r"b\.dat: StaleMap: duplicate: the same content"):
        await again.next_map(None)
    assert (folder / "quarantine" / "b.dat").read_bytes() == content

    # the record is lost: the claimed file itself, or the journal's word, is enough
    (tmp_path / "state" / "maps_taken.json").unlink()
    for after in (None, first.sha256):
        third = make(timeout_s=0.8)
        if after is None:
            await third.open()
        (folder / "b.dat").write_bytes(content)
        with pytest.raises(SurfaceError, match="the same content"):
            await third.next_map(after)
    assert len(list((folder / "quarantine").glob("*.dat"))) == 3
    assert len(list((folder / "quarantine").glob("*.reason.txt"))) == 3


@pytest.mark.parametrize("record", [b"{", b"[]", b'{"taken": 5}', b"\xff\xfe"])
async def test_a_broken_record(make: Callable[..., WatchedFolder], tmp_path: Path, record: bytes) -> None:
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "maps_taken.json").write_bytes(record)
    with pytest.raises(DeviceFault, match=r"maps_taken\.json"):
        await make().open()


@pytest.mark.full
async def test_maps_from_before_the_pass_are_stale_only_after_a_pass(
    make: Callable[..., WatchedFolder], folder: Path
) -> None:
    """Without a request, the first map may be older than the start of the daemon."""
    device = make(timeout_s=0.8)
    (folder / "old.dat").write_bytes(dat(1, at=time.time() - 3600))
    first = await device.next_map(None)
    (folder / "older.dat").write_bytes(dat(2, at=time.time() - 60))
    with pytest.raises(SurfaceError, match=r"older\.dat: StaleMap: stale: measured at"):
        await device.next_map(first.sha256)


@pytest.mark.full
async def test_without_a_timestamp_the_files_time_counts(make: Callable[..., WatchedFolder], folder: Path) -> None:
    path = folder / "old.dat"
    path.write_bytes(dat(1, at=0))
    os.utime(path, (time.time() - 60, time.time() - 60))
    with pytest.raises(SurfaceError, match="StaleMap"):
        await make(timeout_s=0.8).next_map("0" * 64)


@pytest.mark.full
async def test_the_oldest_of_several_maps_comes_first(make: Callable[..., WatchedFolder], folder: Path) -> None:
    for seed, age_s in ((1, 5.0), (2, 9.0), (3, 1.0)):
        path = folder / f"{seed}.dat"
        path.write_bytes(dat(seed))
        os.utime(path, (time.time() - age_s, time.time() - age_s))
    device = make()
    taken: list[SurfaceMap] = [await device.next_map(None) for _ in range(3)]
    expected = [dat(seed)[834:] for seed in (2, 1, 3)]
    assert [one.path.read_bytes()[834:] for one in taken if one.path] == expected


@pytest.mark.full
async def test_a_folder_that_is_away_for_a_while(make: Callable[..., WatchedFolder], folder: Path) -> None:
    device = make()
    away = folder.with_name("away")

    async def act() -> None:
        folder.rename(away)
        (away / "a.dat").write_bytes(dat(1))
        await asyncio.sleep(0.1)
        away.rename(folder)

    assert (await while_waiting(device, act)).part_id == PART


@pytest.mark.full
async def test_a_map_that_cannot_be_claimed(make: Callable[..., WatchedFolder], folder: Path) -> None:
    (folder / "taken").write_text("a file where the folder should be")
    (folder / "a.dat").write_bytes(dat(1))
    with pytest.raises(SurfaceError, match="cannot be moved to"):
        await make(refused_dir="../refused").next_map(None)
    assert (folder / "a.dat").exists()


async def test_cancelling_leaves_nothing(make: Callable[..., WatchedFolder], folder: Path) -> None:
    task = asyncio.create_task(make(request_file="measure.request").next_map(None))
    await until((folder / "measure.request").exists)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert list(folder.iterdir()) == []


@pytest.mark.full
async def test_many_writers_none_torn_lost_or_taken_twice(make: Callable[..., WatchedFolder], folder: Path) -> None:
    device = make(stable_s=0.1)
    contents = {seed: dat(seed, n=10 + seed) for seed in range(12)}

    async def write(seed: int) -> None:
        path, content = folder / f"{seed}.dat", contents[seed]
        cut = 200 * seed
        with path.open("wb") as file:
            if seed % 3 == 0:
                file.truncate(len(content))
            file.write(content[:cut])
            file.flush()
            await asyncio.sleep(0.01 * (seed % 5))
            file.write(content[cut:])
        if seed % 4 == 0:
            (folder / f"copy of {seed}.dat").write_bytes(content)

    async with asyncio.TaskGroup() as group:
        for seed in contents:
            group.create_task(write(seed))
        taken = [await device.next_map(None) for _ in contents]
    found = {one.path.read_bytes() for one in taken if one.path}
    assert found == set(contents.values())
    # copies that came to rest after the last map was taken may still lie there
    assert len([*folder.glob("*.dat"), *(folder / "quarantine").glob("*.dat")]) == 3


def of_part(make: Callable[..., WatchedFolder], part: str, **options: Any) -> WatchedFolder:
    """A device that accepts unnamed maps, with that part in."""
    device = make(accept_without_part_id=True, **options)
    device._rules = replace(device._rules, part_id=part)
    return device


@pytest.mark.full
async def test_an_unnamed_map_with_the_heights_of_another_parts_is_refused(
    make: Callable[..., WatchedFolder], folder: Path
) -> None:
    """The last part's map, exported again: another header, so another content, and a new date."""
    now = time.time()
    (folder / "a.dat").write_bytes(dat(1, part="P-1", at=now))
    first = await of_part(make, "P-1").next_map(None)
    second = of_part(make, "P-2", timeout_s=1.0)

    async def drop() -> None:
        await until(lambda: second._waits > 0)
        (folder / "again.dat").write_bytes(dat(1, part="", at=now + 5))

    with pytest.raises(BaseExceptionGroup):
        await while_waiting(second, drop, first.sha256)
    assert "again.dat: WrongPart: it does not say whose map it is, and has the heights of" in reasons(folder)
    assert "taken for part 'P-1'; the part is 'P-2'" in reasons(folder)
    # the same part's own heights are no news of another part, and other heights are another map
    (folder / "b.dat").write_bytes(dat(2, part="", at=now + 6))
    assert (await of_part(make, "P-2").next_map(first.sha256)).path is not None


@pytest.mark.full
async def test_what_was_asked_for_the_last_part_is_not_asked_for_this_one(
    make: Callable[..., WatchedFolder], folder: Path, tmp_path: Path
) -> None:
    """The map of the last part comes late, when this one is in: it was measured before this one's was asked for."""
    (folder / "a.dat").write_bytes(dat(1, part=""))
    first = await of_part(make, "P-1", clock_tolerance_s=0).next_map(None)
    waiting = of_part(make, "P-1", clock_tolerance_s=0, timeout_s=0.3)
    with pytest.raises(SurfaceError, match="no file came"):
        await waiting.next_map(first.sha256)
    token = json.loads((tmp_path / "state" / "maps_taken.json").read_text())["ask"]["token"]
    late = dat(2, part="", at=time.time() + 0.999)
    await asyncio.sleep(2.0)  # dates in files are whole seconds
    second = of_part(make, "P-2", clock_tolerance_s=0, timeout_s=1.0)
    (folder / "late.dat").write_bytes(late)
    with pytest.raises(SurfaceError, match=r"late\.dat: StaleMap: stale: measured at"):
        await second.next_map(first.sha256)
    assert json.loads((tmp_path / "state" / "maps_taken.json").read_text())["ask"]["token"] != token
    # the same part, started again: the same ask, so that a map that came meanwhile is taken
    (folder / "own.dat").write_bytes(dat(3, part="", at=time.time() + 1))
    assert (await of_part(make, "P-2", clock_tolerance_s=0).next_map(first.sha256)).sha256 != first.sha256


@pytest.mark.full
async def test_unnamed_maps_are_asked_to_be_new_once_one_was_taken(
    make: Callable[..., WatchedFolder], folder: Path
) -> None:
    """Also where the journal names no map, and no request is written."""
    (folder / "a.dat").write_bytes(dat(1, part=""))
    await of_part(make, "P-1").next_map(None)
    (folder / "b.dat").write_bytes(dat(2, part="", at=time.time() - 60))
    with pytest.raises(SurfaceError, match=r"b\.dat: StaleMap: (stale|out of order)"):
        await of_part(make, "P-2", timeout_s=1.0).next_map(None)


@pytest.mark.full
async def test_an_unnamed_map_that_was_claimed_for_the_last_part_is_not_handed_on_for_this_one(
    make: Callable[..., WatchedFolder], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The daemon was killed between claiming a map and handing it on; then another part was put in."""

    def die(*_: object) -> None:
        raise RuntimeError("killed")

    (folder / "a.dat").write_bytes(dat(1, part=""))
    device = of_part(make, "P-1")
    with monkeypatch.context() as patched:
        patched.setattr(device._load(), "hand_on", die)
        with pytest.raises(RuntimeError, match="killed"):
            await device.next_map(None)
    assert len(list((folder / "taken").glob("*.dat"))) == 1
    with pytest.raises(SurfaceError, match="WrongPart: it was claimed for part 'P-1', the part is 'P-2'"):
        await of_part(make, "P-2", timeout_s=0.5).next_map(None)
