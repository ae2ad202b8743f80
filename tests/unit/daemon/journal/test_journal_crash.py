"""Killed writers and failing disks, with the real file: acknowledged rows survive, and a lost journal stops the job."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock
from polishd.model.errors import ConfigError, LinkError, SafetyStop
from polishd.model.states import CyclePhase


def opened(state_dir: Path) -> Journal:
    return Journal.open(state_dir, job="job", part_id="P1")


def block(seq: int) -> ExecutedBlock:
    return ExecutedBlock(seq, seq * 0.1, seq * 0.1 + 0.05)


WRITER = """
import sys
from pathlib import Path
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock
journal = Journal.open(Path(sys.argv[1]), job="job", part_id="P1")
if not journal.passes:
    journal.begin_pass(0, "prog", "boot", 10**6)
seq = journal.executed(0).seq.size
while True:
    for _ in range(7):
        journal.record_executed(0, [BlockRecord(ExecutedBlock(seq, seq * 1.0, seq + 0.5), True)])
        seq += 1
    journal.flush()
    print(seq, flush=True)
"""


def python(*arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen([*arguments], stdout=-1, stderr=-1, text=True, env=environment)


@pytest.mark.one_of_each
@pytest.mark.parametrize("after", [1, 40, 90, 160])
def test_kill_loses_nothing_acknowledged(tmp_path: Path, after: int) -> None:
    acknowledged = 0
    for _ in range(2):  # the second time over the first one's leftovers
        with python(sys.executable, "-c", WRITER, str(tmp_path)) as writer:
            assert writer.stdout is not None
            for _, line in zip(range(after), writer.stdout, strict=False):
                acknowledged = int(line)
            writer.send_signal(signal.SIGKILL)
            acknowledged = max([acknowledged, *(int(line) for line in writer.stdout if line.endswith("\n"))])
    with opened(tmp_path) as journal:
        found = journal.executed(0)
        assert found.seq.size >= acknowledged > 0
        np.testing.assert_array_equal(found.seq, np.arange(found.seq.size))
        np.testing.assert_allclose(found.duration_s, 0.5)
        interrupted = journal.unfinished()
        assert interrupted is not None
        assert journal.tally(interrupted.cycle).done == found.seq.size


FULL = "PRAGMA max_page_count = 30"


async def test_full_disk_loses_the_journal_for_good(tmp_path: Path) -> None:
    journal = opened(tmp_path)
    journal._store._connection.execute(FULL)
    journal.begin_pass(0, "prog", "boot", 10**6)
    watch = asyncio.create_task(journal.lost())
    await asyncio.sleep(0)
    big = ("INSERT INTO map VALUES (NULL, 1, 0, ?, '', '', 0, '')", ("x" * 1_000_000,))
    journal._store.buffer(big)  # the thread finds out
    with pytest.raises(SafetyStop, match=r"journal lost: .*journal\.sqlite: .*full"):
        await watch
    for act in (
        journal.flush,
        lambda: journal.record_executed(0, [BlockRecord(block(0), True)]),
        lambda: journal.end_pass(0, "done"),
    ):
        with pytest.raises(SafetyStop, match="does not polish without a record"):
            act()
    with pytest.raises(SafetyStop):
        journal.executed(0)
    assert journal.unfinished() is not None, "what is known is in memory"
    journal.close()


async def test_lost_journal_ends_a_phase_but_never_hides_its_error(tmp_path: Path) -> None:
    journal = opened(tmp_path)
    with pytest.raises(SafetyStop, match="journal lost"):
        async with journal.phase(0, CyclePhase.RUN):
            journal._store._fail(sqlite3.OperationalError("disk I/O error"))
    journal.close()
    journal = opened(tmp_path)

    async def lose_both() -> None:
        async with journal.phase(0, CyclePhase.RUN):
            journal._store._fail(sqlite3.OperationalError("disk I/O error"))
            raise LinkError("gone")

    with pytest.raises(LinkError, match="gone") as caught:
        await lose_both()
    assert "journal lost" in caught.value.__notes__[0]
    journal.close()


EIO = """
import sys
from pathlib import Path
from polishd.daemon.journal.journal import Journal
from polishd.model.errors import SafetyStop
journal = Journal.open(Path(sys.argv[1]), job="job", part_id="P1")
refused = 0
for cycle in range(50):
    try:
        journal.record_map(cycle, f"map{cycle}", "x", {})
        print(cycle)
    except SafetyStop as error:
        refused += 1
        if refused == 1:
            print("lost", error)
print("refused", refused)
"""


@pytest.mark.full
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace makes the I/O errors")
def test_io_error_of_the_disk_is_reported_and_never_forgotten(tmp_path: Path) -> None:
    """After a failed fdatasync SQLite would accept the next insert although rows are lost."""
    trace = ["strace", "-f", "-qq", "-o", "/dev/null", "-e", "trace=fdatasync,fsync"]
    inject = ["-e", "inject=fdatasync,fsync:error=EIO:when=12"]
    with python(*trace, *inject, sys.executable, "-c", EIO, str(tmp_path)) as process:
        out, err = process.communicate(timeout=60)
    if "PTRACE" in err or "ptrace" in err:
        pytest.skip("strace may not trace here")
    *done, lost, refused = out.splitlines()
    assert lost.startswith("lost journal lost: "), err
    assert "disk I/O error" in lost
    assert refused == f"refused {50 - len(done)}"
    assert 0 < len(done) < 50


def test_journal_of_another_format_is_refused(tmp_path: Path) -> None:
    opened(tmp_path).close()
    connection = sqlite3.connect(tmp_path / "journal.sqlite")
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(ConfigError, match="has format 99, this polishd writes format 7"):
        opened(tmp_path)


def test_file_that_is_no_journal_is_refused(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").write_bytes(b"not a database" * 100)
    with pytest.raises(ConfigError, match=r"cannot be used: file is not a database\. Move the file"):
        opened(tmp_path)
    with pytest.raises(ConfigError, match="cannot be opened"):
        opened(tmp_path / "none")
