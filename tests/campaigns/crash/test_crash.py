"""`make crash`: samples of it, tests that each of its checks can fail, and (slow) five minutes of it."""

from __future__ import annotations

import contextlib
import json
import random
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.daemon.journal.checksums import row_crc
from polishd.daemon.journal.journal import JOURNAL_NAME
from tests.campaigns.crash import kills
from tests.campaigns.crash.disk import Disk
from tests.campaigns.crash.figures import SAID
from tests.campaigns.crash.judge import Promises, cached_row_crc, digest
from tests.campaigns.crash.recorded_process import NO_STORE_SYNC, NORMAL
from tests.campaigns.crash.recording import STATE, Op, files_in, recorded
from tests.campaigns.crash.states import round_of
from tests.campaigns.site import Site
from tests.system.sim_rig import wait_for
from tests.unit.daemon.journal.test_journal import FORMAT_1, FORMAT_2, made

needs_strace = pytest.mark.skipif(shutil.which("strace") is None, reason="strace records the writes")


@pytest.mark.full
@needs_strace
def test_a_recording_without_a_crash_is_what_was_written(tmp_path: Path) -> None:
    disk = Disk()
    for op in recorded(tmp_path):
        disk.apply(op)
    disk.require_complete(tmp_path)
    assert len(disk.seen()) > 3, "the journal, and arrays"


@pytest.mark.full
@needs_strace
def test_no_crash_loses_or_repeats_anything(tmp_path: Path) -> None:
    tried = round_of(recorded(tmp_path), range(2), 1)
    assert len(tried.keys) > 200
    assert not tried.bad, tried.examples


@pytest.mark.full
@needs_strace
@pytest.mark.one_of_each
@pytest.mark.parametrize("weak", [NORMAL, NO_STORE_SYNC])
def test_what_is_not_synced_is_found_to_be_lost(tmp_path: Path, weak: str) -> None:
    tried = round_of(recorded(tmp_path, weak=weak), range(2), 1)
    assert tried.bad["lost"] > len(tried.keys) / 10
    assert tried.bad["twice_unmarked"]


@pytest.mark.full
@needs_strace
@pytest.mark.one_of_each
@pytest.mark.parametrize("script", [FORMAT_2, FORMAT_1], ids=["2", "1"])
def test_a_crash_amid_a_migration_leaves_the_old_journal_or_the_new_one(tmp_path: Path, script: str) -> None:
    (tmp_path / "state").mkdir()
    made(tmp_path / "state", script)
    before = files_in(tmp_path)
    tried = round_of(recorded(tmp_path, "open"), range(12), 1, before=before)
    assert len(tried.keys) > 50
    assert not tried.bad, tried.examples


def test_a_crash_keeps_what_was_synced_and_may_lose_all_else() -> None:
    """A file of four sectors, one of them overwritten after its sync, in a folder that was synced before the file."""
    disk, content = Disk(), bytes(range(256)) * 8
    acts = (
        Op("mkdir", "state", 1, 1),
        Op("sync", "", 2, 2),
        Op("create", "state/a", 3, 3),
        Op("write", "state/a", 4, 4, data=content),
        Op("sync", "state/a", 5, 5),
        Op("write", "state/a", 6, 6, offset=512, data=b"x" * 1024),
    )
    for op in acts:
        disk.apply(op)
    left = {tuple(disk.crashed(variant, "seed").items()) for variant in range(200)}
    assert () in left, "the name was not synced"
    found = {files[0][1] for files in left if files}
    assert {file[:512] for file in found} == {content[:512]}
    assert {file[512:1024] for file in found} == {file[1024:1536] for file in found} == {content[512:1024], b"x" * 512}
    assert len(found) == 4, "each sector by itself"


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(1800)
def test_five_minutes_of_make_crash(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "tests.campaigns.crash",
        "--states",
        "20000",
        "--kills",
        "60",
        "--minutes",
        "2",
        "--faults",
        "2",
    ]
    done = subprocess.run([*command, "--folder", str(tmp_path), "--json"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["states"] > 500
    assert found["kills"] > 5
    assert not any(found[name] for name in SAID)


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_plant_tells_what_a_journal_leaves_out(tmp_path: Path) -> None:
    """The witness can say no: a block in the middle of a pass is taken out of the journal."""
    with kills.attacked_cell(tmp_path / "cell", 1) as site:
        site.start()
        kills.Campaign(site, random.Random(1), kills.Count(), 0).begin()
        wait_for(lambda: _recorded(site) > 50, "blocks in the journal")
        site.kill()
        site.rest()
        site.start()
        wait_for(lambda: site.state().get("state") == "held", "the pass to be settled")
        site.kill()
        assert not site.contradictions()
        with sqlite3.connect(site.files.state_dir / "journal.sqlite") as journal:
            journal.execute("DELETE FROM segment WHERE seq = (SELECT max(seq) - 25 FROM segment WHERE touched)")
        assert site.contradictions()


def _recorded(site: Site) -> int:
    with contextlib.suppress(sqlite3.OperationalError), contextlib.closing(site.journal()) as journal:
        return int(journal.execute("SELECT count(*) FROM segment WHERE touched").fetchone()[0])
    return 0


def test_a_landing_that_was_ordered_before_a_start_is_not_its_own() -> None:
    def found(*names: str) -> list[str]:
        events = [{"event": name, "mono_s": float(at)} for at, name in enumerate(names)]
        return [event["event"] for event in kills.moved_since(events, since_s=0.5)]

    assert found("engage", "force_on", "tool_lifted", "retract") == []
    assert found("engage", "force_on", "force_on") == ["force_on"]  # no order had come for the second one
    assert found("engage", "tool_lifted", "force_on") == ["force_on"]
    assert found("retract", "force_on") == ["force_on"]
    assert found("engage", "engage", "force_on") == ["engage", "force_on"]
    assert found("engage", "force_on", "motion_started") == ["motion_started"]


def test_a_cached_checksum_is_that_of_the_same_values_and_types() -> None:
    for value in (1, 1.0, True, 0, 0.0, -0.0, False, None, "1", "-0.0", b"1", 0.1, -0.05):
        for row in (("segment", value, "-0.0"), ("segment", value)):
            assert cached_row_crc(*row) == row_crc(*row)
    assert len({cached_row_crc("segment", value) for value in (1, 1.0, True)}) == 3


def test_a_changed_row_gives_another_digest_and_an_unchanged_database_the_same(tmp_path: Path) -> None:
    with contextlib.closing(sqlite3.connect(tmp_path / "a", isolation_level=None)) as connection:
        found = [digest(connection)]
        for sql in ("PRAGMA journal_mode=WAL", "CREATE TABLE a (b)", "INSERT INTO a VALUES (1)", "UPDATE a SET b = 2"):
            connection.execute(sql)
            found.append(digest(connection))
            assert found[-1] == digest(connection)
        assert found[0] == found[1], "the mode is no content"
        assert len(set(found)) == 4


@pytest.mark.parametrize("committed", [False, True])
def test_a_commit_that_a_kill_interrupted_is_there_or_not(tmp_path: Path, committed: bool) -> None:
    """The next start of the program goes on from what the kill left."""

    def commit(*rows: int) -> list[Op]:
        return [Op("mark", what={"commit": [[f"INSERT INTO a VALUES ({row})", []] for row in rows]})]

    created, durable = Op("mark", what={"commit": [["CREATE TABLE a (b)", None]]}), Op("mark", what={"durable": True})
    left = tmp_path / JOURNAL_NAME
    with contextlib.closing(sqlite3.connect(left, isolation_level=None)) as journal:
        for sql in ("CREATE TABLE a (b)", *(["INSERT INTO a VALUES (1)"] if committed else [])):
            journal.execute(sql)
        promises = Promises()
        for mark in (created, durable, *commit(1)):
            promises.take(mark)
        assert len(promises.now().versions) == 2
        promises.start({f"{STATE}/{JOURNAL_NAME}": left.read_bytes()})
        assert promises.now().versions == (digest(journal),)
        journal.execute("INSERT INTO a VALUES (2)")
        for mark in (*commit(2), durable):
            promises.take(mark)
        assert promises.now().versions == (digest(journal),)
