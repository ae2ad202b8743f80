"""The computer's figures and their limits, and that contact is left before one of them is reached."""

from __future__ import annotations

import asyncio
import os
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from polishd.daemon import health
from polishd.daemon.health import Health, HealthFigure
from polishd.model.errors import DeviceRefused, HostFault, LinkError
from polishd.model.events import CellHeld
from polishd.model.states import Outcome
from polishd.pipeline.disk_space import SPARE_FILES, SPARE_MB, SpaceNeeded
from tests.unit.daemon.small_job import Bench, open_journal
from tests.unit.daemon.test_app import SAFE, Running


class Disk:
    """What ``statvfs`` says."""

    def __init__(self) -> None:
        self.left_mb = 1e6
        self.free_inodes = self.inodes = 1_000_000

    def statvfs(self, folder: Path) -> Any:
        assert folder.exists()
        room = {"f_bavail": self.left_mb * 1e6 / 4096, "f_frsize": 4096}
        return SimpleNamespace(**room, f_favail=self.free_inodes, f_files=self.inodes)


async def at_once(work: Callable[..., Any], *arguments: Any) -> Any:
    return work(*arguments)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    found = Disk()
    monkeypatch.setattr(health, "SLOW_S", 0.0)
    monkeypatch.setattr(health, "BEAT_S", 0.0)
    monkeypatch.setattr(asyncio, "to_thread", at_once)  # the pass of fakes is over before a thread has looked
    monkeypatch.setattr(os, "statvfs", found.statvfs)
    return found


async def lifted_and_held(running: Running) -> str:
    """The reason, once contact was left in the usual order."""
    await running.held()
    assert running.bench.fake.of("make_safe")[3:6] == SAFE
    assert running.bench.fake.actuator.retracted
    assert running.bench.journal.passes[0].how == "interrupted"
    return running.daemon.reason


@pytest.mark.full
async def test_a_disk_that_fills_up_in_contact_is_left_before_it_is_full(bench: Bench, disk: Disk) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        disk.left_mb = 100.0
        reason = await lifted_and_held(running)
        assert reason.startswith("HostFault: state_disk_mb 100, at least 128")
        assert "make room on the disk of" in reason
        assert "pass 0 was interrupted" in reason
        (held,) = (event for event in running.published if isinstance(event, CellHeld))
        assert held.kind == "HostFault"
        with pytest.raises(DeviceRefused, match="the cell stays held: HostFault: state_disk_mb 100"):
            await running.daemon.handlers["resume"]()
        disk.left_mb = 1e6
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE


async def test_a_disk_that_is_full_at_the_start_holds_before_anything_is_measured(bench: Bench, disk: Disk) -> None:
    disk.left_mb = 0.0
    async with Running(bench) as running:
        await running.held()
        assert "state_disk_mb 0, at least" in running.daemon.reason
        assert bench.moved() == []
        assert "metrology.next_map" not in bench.fake.events
        figures = (await running.daemon.status())["health"]
        assert figures["run_disk_mb"]["fits"] is False
        assert figures["memory_mb"]["fits"] is True


@pytest.mark.full
async def test_a_disk_that_runs_out_of_inodes_in_contact_is_left_as_a_full_one(bench: Bench, disk: Disk) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        disk.free_inodes = 3
        reason = await lifted_and_held(running)
        assert reason.startswith("HostFault: state_disk_files 3, at least 256: delete files on the disk of")
        with pytest.raises(DeviceRefused, match="the cell stays held: HostFault: state_disk_files 3"):
            await running.daemon.handlers["resume"]()


async def test_no_free_inodes_at_the_start_hold_before_anything_is_measured(bench: Bench, disk: Disk) -> None:
    disk.free_inodes = 0
    async with Running(bench) as running:
        await running.held()
        assert "state_disk_files 0, at least 256" in running.daemon.reason
        assert bench.moved() == []
        assert "metrology.next_map" not in bench.fake.events


@pytest.mark.full
async def test_a_file_system_that_counts_no_inodes_is_no_alarm(bench: Bench, disk: Disk) -> None:
    disk.free_inodes = disk.inodes = 0
    async with Running(bench) as running:
        assert await running.outcome() is Outcome.IN_TOLERANCE
        assert "state_disk_files" not in (await running.daemon.status())["health"]


def all_below(folder: Path) -> Iterator[Path]:
    """Files and folders, whatever their depth."""
    yield from folder.rglob("*")


async def test_a_job_makes_fewer_files_than_are_kept_free_for_a_pass(bench: Bench, tmp_path: Path) -> None:
    async with Running(bench) as running:
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert bench.journal.passes
    assert 5 < sum(1 for _ in all_below(tmp_path)) < SPARE_FILES


async def test_a_pass_that_would_fill_the_disk_is_refused_before_contact(bench: Bench, disk: Disk) -> None:
    job = bench.job()
    solve = job.solve

    async def and_the_disk_fills_up(*arguments: Any) -> Any:
        solved = await solve(*arguments)
        disk.left_mb = 100.0
        return solved

    job.solve = and_the_disk_fills_up
    with pytest.raises(HostFault, match=r"a pass of \d+ blocks needs 128 MB on the disk of .*; nothing was moved"):
        await bench.polish(job)
    assert bench.moved() == []
    assert bench.journal.passes == (), "no pass is begun"


async def test_a_full_disk_ends_the_daemon_without_an_operator(bench: Bench, disk: Disk) -> None:
    disk.left_mb = 0.0
    async with Running(bench, holds=False) as running:
        with pytest.raises(HostFault, match="make room"):
            await running.outcome()


@pytest.mark.full
async def test_a_loop_that_is_late_twice_in_contact_is_no_loop_to_press_with(bench: Bench, disk: Disk) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        lags = running.daemon._health._lags
        while running.daemon.state == "polishing":  # it is cleared when contact begins
            lags.append((time.monotonic(), 0.6))
            await asyncio.sleep(0)
        reason = await lifted_and_held(running)
        assert re.match(r"HostFault: loop_lag_s 0\.[56]\d*, at most 0\.5: too much else runs", reason), reason
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE, "out of contact the loop may have been late"


async def test_a_loop_that_is_late_once_is_chance(bench: Bench) -> None:
    found = Health(bench.fake.cell, bench.job)
    found._lags.append((time.monotonic(), 0.6))
    assert found.wrong(in_contact=True) == ""
    found._lags.append((time.monotonic(), 0.7))
    assert found.wrong(in_contact=True).startswith("loop_lag_s 0.6, at most 0.5")
    assert found.wrong(in_contact=False) == ""


async def test_a_disk_that_hangs_in_contact_is_left(bench: Bench, disk: Disk, monkeypatch: pytest.MonkeyPatch) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        monkeypatch.setattr(type(bench.journal), "unsaved_s", 4.5)
        assert (await lifted_and_held(running)).startswith("HostFault: journal_s 4.5, at most 1.5: the disk of")


async def test_devices_that_answer_have_an_age(bench: Bench) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        devices = (await running.daemon.status())["devices"]
        assert all(0 <= devices[name]["heard_s_ago"] < 60 for name in ("robot", "actuator", "spindle", "metrology"))


async def test_while_it_is_held_every_device_is_asked_now_and_then(bench: Bench) -> None:
    fake = bench.fake
    async with Running(bench) as running:
        await running.in_contact()
        await running.daemon.handlers["hold"]()
        fake.cell.answered_s.clear()
        fake.spindle.acts.fails["status"] = LinkError("gone")
        asked = len(fake.events)
        while "metrology" not in fake.cell.answered_s:
            fake.clock.advance(1.0)
            await asyncio.sleep(0)
        assert fake.events[asked:] == [f"{name}.status" for name in fake.cell.devices]
        assert running.daemon.state == "held"
        assert set(fake.cell.answered_s) == {"actuator", "robot", "metrology"}


def test_a_figure_says_its_limit() -> None:
    assert str(HealthFigure("loop_lag_s", 0.25, 0.5, "")) == "loop_lag_s 0.25, at most 0.5"
    assert HealthFigure("memory_mb", 1.0, 1.0, "", least=True).fits


def test_what_must_be_left_falls_as_blocks_are_done(tmp_path: Path) -> None:
    run = tmp_path / "not" / "there"
    begun, ended, none = (
        health._left(tmp_path, run, writes)["state_disk_mb"].limit
        for writes in (SpaceNeeded.of(1_000_000), SpaceNeeded.of(1_000_000, done=1_000_000), SpaceNeeded.of(0))
    )
    assert none == pytest.approx(2 * SPARE_MB)
    assert begun - ended == pytest.approx(100.0), "the journal's rows are there; table and copy are written at the end"
    assert ended - none == pytest.approx(180.0)


def test_memory_is_not_judged_where_the_kernel_does_not_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "_memory_mb", lambda: None)
    figures = {f"{disk}_disk_{unit}" for disk in ("state", "run") for unit in ("mb", "files")}
    assert set(health._left(tmp_path, tmp_path, SpaceNeeded.of(0))) <= figures


@pytest.mark.parametrize("version", [1, 2])
def test_a_control_groups_limit_counts_where_less_is_left_in_it(tmp_path: Path, version: int) -> None:
    """The kernel ends a process over the limit of its service, however much the computer has."""
    own = tmp_path / "cgroup"
    own.write_text("1:name=systemd:/x\n4:memory:/system/cell\n" if version == 1 else "0::/system/cell\n")
    limit, used = health.V1_FILES if version == 1 else health.V2_FILES
    base = tmp_path / "memory" if version == 1 else tmp_path
    for folder, most, now in ((base / "system" / "cell", 400_000_000, 398_000_000), (base / "system", 1 << 60, 1)):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / limit).write_text(f"{most}\n")
        (folder / used).write_text(f"{now}\n")
        (folder / "memory.stat").write_text("anon 1\ninactive_file 1000000\n")
    if version == 2:
        (base / "system" / limit).write_text("max\n")
    assert list(health._group_memory_mb(tmp_path, own)) == [(400.0, 3.0)]
    assert list(health._group_memory_mb(tmp_path, tmp_path / "none")) == []


async def test_a_service_at_its_memory_limit_holds_before_anything_is_measured(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(health, "_group_memory_mb", lambda: iter([(400.0, 3.0)]))
    async with Running(bench) as running:
        await running.held()
        assert "memory_mb 3, at least 8: end other programs" in running.daemon.reason
        assert "give the service more (MemoryMax)" in running.daemon.reason
        assert bench.moved() == []
