"""Disk space of a pass: the bytes of each block, and checks of the disks.

Measured with 2 million blocks (``make bench`` of ``long_programs``): a row of the journal is 76 to 87 bytes, one of
``executed.csv`` at most 72. The constants here are rounded up, and a test compares them with written files.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from polishd.model.errors import HostFault

MB = 1e6
ROW_BYTES = 100
"""Bytes of a block in the journal, with its share of events and of the index."""
CSV_BYTES = 80
"""Bytes of a block in ``executed.csv``."""
SPARE_MB = 64.0
"""MB beside the blocks: WAL, log, the arrays of a measurement, pictures and pages of the report."""
SPARE_FILES = 128
"""Files that a pass and the end of its job make on each disk; one file takes one inode. A test counts them."""


@dataclass(frozen=True, slots=True)
class SpaceNeeded:
    """MB to be written until a pass is over, and its job if it is the last pass."""

    state_mb: float
    """In ``cell.state_dir``: rows of the journal."""
    run_mb: float
    """In the run folder: ``executed.csv``, and at the end a copy of the rows of all passes of the job."""

    @classmethod
    def of(cls, blocks: int, done: int = 0, before: int = 0) -> SpaceNeeded:
        """Needs of a pass of so many blocks, ``done`` of them recorded, after ``before`` blocks of earlier passes."""
        state = (blocks - done) * ROW_BYTES
        run = blocks * (CSV_BYTES + ROW_BYTES) + before * ROW_BYTES
        return cls(SPARE_MB + state / MB, SPARE_MB + run / MB)


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """One disk, as one figure of the daemon's health."""

    name: str
    folder: Path
    """The nearest existing folder."""
    left_mb: float
    needed_mb: float
    files_name: str
    """Name of the figure of its free inodes."""
    left_files: int | None
    """Free inodes; None where the file system has no fixed number of them (btrfs)."""
    needed_files: int

    @property
    def has_inodes(self) -> bool:
        """Whether there are inodes for the new files."""
        return self.left_files is None or self.left_files >= self.needed_files

    @property
    def fits(self) -> bool:
        """Whether the data fit."""
        return self.left_mb >= self.needed_mb and self.has_inodes


def free_space(state_dir: Path, run_dir: Path, writes: SpaceNeeded) -> tuple[FreeSpace, FreeSpace]:
    """Free space of the disks of state folder and run folder; the sum on one disk. OSError."""
    state, run = _there(state_dir), _there(run_dir)
    state_mb, run_mb = writes.state_mb, writes.run_mb
    files = SPARE_FILES
    if state.stat().st_dev == run.stat().st_dev:
        state_mb = run_mb = state_mb + run_mb
        files = 2 * SPARE_FILES
    return (
        _room("state_disk", state, state_mb, files),
        _room("run_disk", run, run_mb, files),
    )


def require_room(state_dir: Path, run_dir: Path, blocks: int, before: int = 0) -> None:
    """HostFault where a pass of so many blocks would fill a disk; an unreadable disk refuses nothing."""
    if reason := disk_full_reason(state_dir, run_dir, blocks, before):
        raise HostFault(f"{reason}; nothing was moved")


def disk_full_reason(state_dir: Path, run_dir: Path, blocks: int, before: int = 0) -> str:
    """Name the disk that a pass of so many blocks would fill, and advice; empty with enough or unknown room."""
    try:
        found = free_space(state_dir, run_dir, SpaceNeeded.of(blocks, before=before))
    except OSError:
        return ""
    keys = {"state_disk_mb": "cell.state_dir", "run_disk_mb": "cell.run_dir"}
    for room in found:
        if not room.has_inodes:
            return (
                f"a pass needs {room.needed_files} free inodes on the disk of {room.folder}, which has "
                f"{room.left_files}: delete files there (df -i shows the inodes), or set {keys[room.name]} to a folder "
                "on another disk"
            )
        if not room.fits:
            return (
                f"a pass of {blocks} blocks needs {room.needed_mb:.0f} MB on the disk of {room.folder}, which has "
                f"{room.left_mb:.0f} MB: make room there, or set {keys[room.name]} to a folder on a larger disk"
            )
    return ""


def pass_words(state_dir: Path, run_dir: Path, blocks: int, passes: int) -> str:
    """Data that passes of so many blocks write, and the free space."""
    one, all_of_them = SpaceNeeded.of(blocks), SpaceNeeded.of(blocks, before=(passes - 1) * blocks)
    sizes = (
        f"{ROW_BYTES} bytes of journal, {CSV_BYTES} of executed.csv and {ROW_BYTES} of the journal's copy a block: "
        f"{one.state_mb - SPARE_MB:.1f} MB and {one.run_mb - SPARE_MB:.1f} MB for a pass of {blocks}"
    )
    if reason := disk_full_reason(state_dir, run_dir, blocks):
        return f"{sizes}; run will refuse: {reason}"
    journal_mb = passes * blocks * ROW_BYTES / MB
    rest_mb = all_of_them.run_mb - SPARE_MB + (passes - 1) * blocks * CSV_BYTES / MB
    return f"{sizes}; {journal_mb + rest_mb:.0f} MB for all {passes} passes of the job"


def _room(name: str, folder: Path, needed_mb: float, needed_files: int) -> FreeSpace:
    disk = os.statvfs(folder)
    left_files = int(disk.f_favail) if disk.f_files else None
    left_mb = disk.f_bavail * disk.f_frsize / MB
    return FreeSpace(f"{name}_mb", folder, left_mb, needed_mb, f"{name}_files", left_files, needed_files)


def _there(folder: Path) -> Path:
    """The folder, or the nearest existing one above it."""
    return next(path for path in (folder, *folder.parents) if os.path.exists(path))  # noqa: PTH110 - a share that went stale is none: pathlib's raises
