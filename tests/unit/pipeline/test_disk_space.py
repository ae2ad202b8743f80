"""What a pass writes, against what the disks have."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from polishd.model.errors import HostFault
from polishd.pipeline import disk_space
from polishd.pipeline.disk_space import SPARE_MB, SpaceNeeded


@pytest.fixture
def left_mb(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """How much each folder's disk has, by the folder's name; folders that are not named are on one with plenty."""
    found: dict[str, float] = {}

    def statvfs(folder: Path) -> Any:
        blocks = found.get(folder.name, 1e6) * 1e6 / 4096
        inodes = found.get(f"{folder.name} inodes", 1e6)
        return SimpleNamespace(f_bavail=blocks, f_frsize=4096, f_favail=inodes, f_files=found.get("inodes in all", 2e6))

    monkeypatch.setattr(os, "statvfs", statvfs)
    return found


def test_two_million_blocks() -> None:
    writes = SpaceNeeded.of(2_000_000)
    assert writes.state_mb == pytest.approx(SPARE_MB + 200)
    assert writes.run_mb == pytest.approx(SPARE_MB + 360)


def test_what_is_recorded_is_written_into_the_run_folder_only_at_the_end() -> None:
    writes = SpaceNeeded.of(2_000_000, done=2_000_000, before=1_000_000)
    assert writes.state_mb == pytest.approx(SPARE_MB)
    assert writes.run_mb == pytest.approx(SPARE_MB + 360 + 100), "the copy has the job's earlier passes, too"


def test_on_one_disk_it_is_the_sum(tmp_path: Path, left_mb: dict[str, float]) -> None:
    state, run = disk_space.free_space(tmp_path, tmp_path / "runs" / "later", SpaceNeeded.of(1_000_000))
    assert (state.name, run.name) == ("state_disk_mb", "run_disk_mb")
    assert state.folder == run.folder == tmp_path, "the nearest that exists"
    assert state.needed_mb == run.needed_mb == pytest.approx(2 * SPARE_MB + 280)


def test_a_pass_that_fits_is_let_go(tmp_path: Path, left_mb: dict[str, float]) -> None:
    left_mb[tmp_path.name] = 2 * SPARE_MB + 281
    disk_space.require_room(tmp_path, tmp_path, 1_000_000)


def test_a_pass_that_does_not_is_refused_with_what_where_and_what_to_do(
    tmp_path: Path, left_mb: dict[str, float]
) -> None:
    left_mb[tmp_path.name] = 300
    with pytest.raises(HostFault) as refused:
        disk_space.require_room(tmp_path, tmp_path, 1_000_000)
    assert str(refused.value) == (
        f"a pass of 1000000 blocks needs 408 MB on the disk of {tmp_path}, which has 300 MB: make room there, or set "
        "cell.state_dir to a folder on a larger disk; nothing was moved"
    )


def test_earlier_passes_of_the_job_count(tmp_path: Path, left_mb: dict[str, float]) -> None:
    left_mb[tmp_path.name] = 2 * SPARE_MB + 281
    with pytest.raises(HostFault, match="needs 608 MB"):
        disk_space.require_room(tmp_path, tmp_path, 1_000_000, before=2_000_000)


def test_a_pass_is_refused_where_the_disk_has_no_free_inodes(tmp_path: Path, left_mb: dict[str, float]) -> None:
    left_mb[f"{tmp_path.name} inodes"] = 2 * disk_space.SPARE_FILES - 1
    with pytest.raises(HostFault) as refused:
        disk_space.require_room(tmp_path, tmp_path, 1000)
    assert str(refused.value) == (
        f"a pass needs 256 free inodes on the disk of {tmp_path}, which has 255: delete files there (df -i shows the "
        "inodes), or set cell.state_dir to a folder on another disk; nothing was moved"
    )
    left_mb[f"{tmp_path.name} inodes"] += 1
    disk_space.require_room(tmp_path, tmp_path, 1000)


def test_a_file_system_without_a_number_of_inodes_refuses_nothing(tmp_path: Path, left_mb: dict[str, float]) -> None:
    """As btrfs, which reports 0 inodes in total and 0 that are free."""
    left_mb |= {f"{tmp_path.name} inodes": 0, "inodes in all": 0}
    disk_space.require_room(tmp_path, tmp_path, 1000)
    assert [room.left_files for room in disk_space.free_space(tmp_path, tmp_path, SpaceNeeded.of(0))] == [None, None]


def test_a_disk_that_cannot_be_asked_refuses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def hung(_: Path) -> Any:
        raise OSError("stale")

    monkeypatch.setattr(os, "statvfs", hung)
    disk_space.require_room(tmp_path, tmp_path, 10**12)


def test_words_say_what_a_block_takes(tmp_path: Path, left_mb: dict[str, float]) -> None:
    words = disk_space.pass_words(tmp_path, tmp_path, 2_000_000, passes=3)
    assert words == (
        "100 bytes of journal, 80 of executed.csv and 100 of the journal's copy a block: 200.0 MB and 360.0 MB for a "
        "pass of 2000000; 1680 MB for all 3 passes of the job"
    )


def test_words_say_that_run_will_refuse(tmp_path: Path, left_mb: dict[str, float]) -> None:
    left_mb[tmp_path.name] = 10
    assert "run will refuse: a pass of 2000000 blocks needs 688 MB" in disk_space.pass_words(
        tmp_path, tmp_path, 2_000_000, 1
    )
