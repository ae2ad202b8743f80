"""Flipped bits anywhere in a journal's files: an error that names the location, or no loss."""

from __future__ import annotations

import asyncio
import logging
import random
import shutil
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.journal import checksums
from polishd.daemon.journal import store as journal_schema
from polishd.daemon.journal.checksums import KEYS, CommitRecord, row_crc
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.daemon.journal.store import Store, connect, require_sound
from polishd.daemon.queue.queue import Queue
from polishd.daemon.runtime.exit_record import last_ending
from polishd.daemon.socket.client import request
from polishd.model.devices import ExecutedBlock
from polishd.model.errors import ConfigError, JournalDamage
from polishd.model.events import AlarmAcknowledged
from polishd.model.states import CyclePhase, Outcome
from tests.unit.daemon.test_app import Site, run_cell

BLOCKS, GROUP = 40, 7
WAL_NAME = f"{JOURNAL_NAME}-wal"
FILES = (JOURNAL_NAME, WAL_NAME, CommitRecord.NAME)

Content = dict[str, list[tuple[Any, ...]]]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    return Site(tmp_path, monkeypatch)


async def two_jobs(state: Path) -> Journal:
    """A journal with an ended job and one that is interrupted in its second pass; open."""
    for job in ("first", "second"):
        journal = Journal.open(state, job=job, part_id="P1", terms={"process.load_n": 20.0})
        for cycle in range(2):
            async with journal.phase(cycle, CyclePhase.MEASURE):
                journal.record_map(cycle, f"{job} {cycle}" * 6, "map.dat", {"rms_nm": 1.5 - cycle, "what": "é"}, "x")
            journal.begin_pass(cycle, f"program {job} {cycle}", "boot", BLOCKS, contact=(2, 38), facts={"rate": 1.0})
            for seq in range(BLOCKS):
                record = BlockRecord(ExecutedBlock(seq, seq * 0.1, seq + 0.05), 2 <= seq < 38, 9.9 + seq / 7, 500.0)
                journal.record_executed(cycle, [record])
                if seq % GROUP == 0:
                    journal.flush()
            journal.record_event(AlarmAcknowledged(alarms=[cycle], by="me"))
            if cycle == 0 or job == "first":
                journal.end_pass(cycle, "done")
        if job == "first":
            journal.record_outcome(Outcome.CYCLES_USED)
            journal.close()
    journal.flush()
    return journal


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """State folders as a kill leaves one, half of its WAL in the database, and as an end in order does."""
    base = tmp_path_factory.mktemp("left")
    work = base / "work"
    work.mkdir()
    journal = asyncio.run(two_jobs(work))
    found = {name: base / name for name in ("killed", "moved", "closed")}
    kept = ((JOURNAL_NAME, WAL_NAME, CommitRecord.NAME), (JOURNAL_NAME, CommitRecord.NAME))
    copied(work, found["killed"], kept[0])
    with closing(connect(work / JOURNAL_NAME)) as other:
        other.execute("PRAGMA wal_checkpoint(PASSIVE)")
    journal.record_event(AlarmAcknowledged(alarms=[7], by="me"))
    journal.flush()
    copied(work, found["moved"], kept[0])
    journal.close()
    copied(work, found["closed"], kept[1])
    return found


def copied(source: Path, target: Path, names: tuple[str, ...] = FILES) -> Path:
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir()
    for name in names:
        if (source / name).exists():
            shutil.copy(source / name, target / name)
    return target


def content(state: Path) -> Content:
    with closing(sqlite3.connect(state / JOURNAL_NAME)) as file:
        return {table: file.execute(f"SELECT * FROM {table}").fetchall() for table in KEYS if table != "commits"}


def files(state: Path) -> dict[str, bytes]:
    return {name: (state / name).read_bytes() for name in FILES if (state / name).exists()}


def flip(path: Path, at: int, bit: int) -> None:
    whole = bytearray(path.read_bytes())
    whole[at] ^= 1 << bit
    path.write_bytes(whole)


def flipped_row(state: Path, value: bytes) -> None:
    """One bit of the last place where that value lies."""
    at = (state / JOURNAL_NAME).read_bytes().rindex(value)
    flip(state / JOURNAL_NAME, at, 0)


def used(state: Path) -> None:
    """What a start and a history read."""
    with Journal.open(state, job="second", part_id="P1") as journal:
        for cycle in range(2):
            journal.executed(cycle)
        journal.errors()
        journal.held_last()
        journal.cut_off()
        journal.phase_times_s()
        journal.passes_before(2, 9)
        Queue(journal.store).entries()


def tried(left: Mapping[str, Path], state: Path, flips: int, seed: int) -> dict[str, int]:
    """Flip one bit at a time, and open; return the number of errors and of openings without a loss."""
    luck, found = random.Random(seed), {"error": 0, "nothing is lost": 0}
    wanted = {name: content(copied(folder, state)) for name, folder in left.items()}
    for number in range(flips):
        name = luck.choice(sorted(left))
        copied(left[name], state)
        target = luck.choice([path for path in sorted(state.iterdir()) if path.name != CommitRecord.NAME])
        at, bit = luck.randrange(target.stat().st_size), luck.randrange(8)
        flip(target, at, bit)
        before, where = files(state), f"{number}: {name} {target.name} byte {at} bit {bit}"
        said = refusal(state)
        if said:
            assert "\n" not in said, where
            assert "Check the disk" in said or "Move the file" in said or "format" in said, where
            assert files(state) == before, f"{where}: what was found is left as it is"
        else:
            assert content(state) == wanted[name], where
        found["error" if said else "nothing is lost"] += 1
    return found


def refusal(state: Path) -> str:
    """Return the error of a refused start; empty where it starts."""
    try:
        used(state)
    except ConfigError as error:
        return str(error)
    return ""


def test_no_flipped_bit_is_silent(left: Mapping[str, Path], tmp_path: Path) -> None:
    found = tried(left, tmp_path / "state", flips=30, seed=1)
    assert found["error"] > 5
    assert found["nothing is lost"] > 5, "free pages, and pages that the WAL replaces"


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_no_flipped_bit_is_silent_in_thousands(left: Mapping[str, Path], tmp_path: Path) -> None:
    """The counts are a claim of docs/explanation/reliability.md: ``-s`` prints them."""
    found = tried(left, tmp_path / "state", flips=3000, seed=2)
    print(found)
    assert found["error"] > 600


@pytest.mark.parametrize("name", ["killed", "moved", "closed"])
def test_a_sound_journal_opens(left: Mapping[str, Path], tmp_path: Path, name: str) -> None:
    used(copied(left[name], tmp_path / "state"))


def test_a_damaged_row_is_named_with_what_to_do(left: Mapping[str, Path], tmp_path: Path) -> None:
    state = copied(left["closed"], tmp_path / "state")
    flipped_row(state, b"program second 0")
    with pytest.raises(JournalDamage) as found:
        used(state)
    assert str(found.value) == (
        f"{state / JOURNAL_NAME}: the journal is damaged: the row job = 2 AND cycle = 0 of pass does not match its "
        f"checksum. Check the disk and the memory of this computer, then restore {state} from a backup, or move "
        "journal.sqlite, journal.sqlite-wal and journal.commits to another folder to begin an empty journal"
    )


def test_a_damaged_event_may_be_deleted_by_the_command_that_is_reported(
    left: Mapping[str, Path], tmp_path: Path
) -> None:
    state = copied(left["closed"], tmp_path / "state")
    flipped_row(state, b'{"alarms": [1], "by": "me"}')
    with pytest.raises(JournalDamage, match=r'sqlite3 \S+journal\.sqlite "DELETE FROM event WHERE id = 2"\)'):
        used(state)
    with closing(sqlite3.connect(state / JOURNAL_NAME, isolation_level=None)) as file:  # as the sqlite3 shell
        file.execute("DELETE FROM event WHERE id = 2")
    used(state)


def test_a_wal_whose_last_commit_is_damaged_is_missing_commits(left: Mapping[str, Path], tmp_path: Path) -> None:
    state = copied(left["killed"], tmp_path / "state")
    flip(state / WAL_NAME, (state / WAL_NAME).stat().st_size - 100, 3)
    with pytest.raises(JournalDamage, match=r"the last 1 commits are missing: it ends at commit \d+, \S+ names commit"):
        used(state)
    (state / CommitRecord.NAME).unlink()  # as the message says
    used(state)


def test_a_wal_that_was_deleted_is_missing_commits(left: Mapping[str, Path], tmp_path: Path) -> None:
    state = copied(left["moved"], tmp_path / "state")
    (state / WAL_NAME).unlink()
    with pytest.raises(JournalDamage, match="the last 1 commits are missing"):
        used(state)


def test_a_new_journal_beside_an_old_record_is_none_of_its_business(left: Mapping[str, Path], tmp_path: Path) -> None:
    state = copied(left["killed"], tmp_path / "state")
    for name in (JOURNAL_NAME, WAL_NAME):
        (state / name).unlink()
    used(state)
    used(state)


def test_a_torn_end_of_the_wal_is_no_damage(left: Mapping[str, Path], tmp_path: Path) -> None:
    """A power cut tore off a commit that had not returned."""
    state = copied(left["killed"], tmp_path / "state")
    (state / CommitRecord.NAME).unlink()
    whole = (state / WAL_NAME).read_bytes()
    (state / WAL_NAME).write_bytes(whole[:-3000] + bytes(3000))
    used(state)


def test_a_torn_commit_over_an_interrupted_one_is_no_damage(tmp_path: Path) -> None:
    """A kill as a long transaction was written, then a power failure as the next one overwrote it."""
    state = tmp_path / "state"
    state.mkdir()
    journal = Journal.open(state, job="first", part_id="P1")
    journal.begin_pass(0, "program", "boot", BLOCKS)
    journal.flush()
    held, record = (state / WAL_NAME).read_bytes(), (state / CommitRecord.NAME).read_bytes()
    journal.record_event(AlarmAcknowledged(alarms=list(range(20_000)), by="me"))
    journal.flush()
    killed = copied(state, tmp_path / "killed")
    journal.close()
    frame = checksums.FRAME_HEADER.size + 4096
    (killed / WAL_NAME).write_bytes((killed / WAL_NAME).read_bytes()[:-frame])  # without the frame that commits
    (killed / CommitRecord.NAME).write_bytes(record)
    journal = Journal.open(killed, job="first", part_id="P1")
    journal.record_event(AlarmAcknowledged(alarms=[1], by="me"))
    journal.flush()
    cut = copied(killed, tmp_path / "cut")
    journal.close()
    whole = (cut / WAL_NAME).read_bytes()
    commits = [at for at in range(32, len(whole), frame) if checksums.FRAME_HEADER.unpack_from(whole, at)[1]]
    assert len(whole) > commits[-1] + 3 * frame, "frames of the interrupted transaction follow"
    assert commits[-1] >= len(held), "the last commit was written over it"
    torn = bytearray(whole)
    torn[commits[-1] + 24 : commits[-1] + frame] = bytes(4096)
    (cut / WAL_NAME).write_bytes(torn)
    (cut / CommitRecord.NAME).write_bytes(record)
    with Journal.open(cut, job="first", part_id="P1") as opened:
        assert [one.cycle for one in opened.passes] == [0]


@pytest.mark.parametrize("content", [b"", b"\0" * 47, b"no record at all", b"\xff\xfe"])
def test_a_record_that_is_not_whole_says_nothing(left: Mapping[str, Path], tmp_path: Path, content: bytes) -> None:
    state = copied(left["closed"], tmp_path / "state")
    (state / CommitRecord.NAME).write_bytes(content)
    used(state)


def test_a_journal_of_an_earlier_format_with_broken_json_is_not_brought_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / JOURNAL_NAME
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.executescript(f"PRAGMA journal_mode=WAL; {FORMAT_5}")
        file.execute("INSERT INTO event (job, at, name, data) VALUES (0, 1.0, 'held', '{\"a\": ')")
    with pytest.raises(JournalDamage, match=r"data of the row rowid = 1 of event is not JSON\. Check "):
        Store.open(path)
    with closing(sqlite3.connect(path)) as file:
        assert file.execute("PRAGMA user_version").fetchone() == (5,)


def _unchecked(sql: str) -> str:
    """A table of this format as format 5 had it."""
    columns, crc, rest = sql.partition(", crc INTEGER")
    return columns + rest.split(" STORED", 1)[1] if crc else sql


FORMAT_5 = "".join(f"{_unchecked(line)}\n" for line in journal_schema.TABLES.splitlines())
FORMAT_5 += f"{journal_schema.MADE_INDEXES} PRAGMA user_version = 5;"


def test_a_journal_of_format_5_has_checksums_afterwards(left: Mapping[str, Path], tmp_path: Path) -> None:
    source = content(copied(left["closed"], tmp_path / "source"))
    path = tmp_path / JOURNAL_NAME
    with closing(sqlite3.connect(path, isolation_level=None)) as file:
        file.executescript(f"PRAGMA journal_mode=WAL; {FORMAT_5}")
        for table, rows in source.items():
            for row in rows:
                file.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * (len(row) - 1))})", row[:-1])
    used(tmp_path)
    rows = content(tmp_path)
    assert {table: len(found) for table, found in rows.items()} == {
        table: len(found) for table, found in source.items()
    }
    assert rows["segment"] == source["segment"], "with the same checksums"
    assert (tmp_path / "journal.v5.sqlite").exists()
    flipped_row(tmp_path, b"program second 1")
    with pytest.raises(JournalDamage, match="the row job = 2 AND cycle = 1 of pass does not match"):
        used(tmp_path)


@pytest.mark.parametrize("value", [0.0, -0.0, 3.0, -7.0, 1e300, 5e-324, 2.0**62, 0.1, None])
def test_a_number_has_the_checksum_of_what_is_read_back(tmp_path: Path, value: float | None) -> None:
    store = Store.open(tmp_path / JOURNAL_NAME)
    sql = "INSERT INTO segment (job, cycle, seq, start_s, end_s, touched, recovered, force_n) VALUES (1,0,0,?,?,?,?,?)"
    store.write((sql, (value or 0.0, value or 0.0, True, False, value)))
    store.close()
    Store.open(tmp_path / JOURNAL_NAME).close()


def test_texts_of_any_kind_have_a_checksum(tmp_path: Path) -> None:
    store = Store.open(tmp_path / JOURNAL_NAME)
    for text in ("", "é", "-0.0", "\x00", "\U0001f600", "'", "\u2028", "x" * 100_000):
        store.write(("INSERT INTO job (name, part_id, terms, started) VALUES (?, ?, ?, ?)", (text, text, text, 1)))
    store.close()
    Store.open(tmp_path / JOURNAL_NAME).close()


def test_a_large_journal_is_checked_from_its_newest_rows_on(
    left: Mapping[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    state = copied(left["closed"], tmp_path / "state")
    path = state / JOURNAL_NAME
    definitions = {journal_schema.SCHEMA_VERSION: journal_schema._definitions()}
    require_sound(path)
    assert "only the newest rows" not in caplog.text
    assert checksums.check_journal(path, definitions).is_complete
    monkeypatch.setattr(checksums, "ROWS_PER_LOOK", 10)
    found = checksums.check_journal(path, definitions, within_s=-1.0)
    assert (found.damage, found.is_complete) == (None, False)
    monkeypatch.setattr(journal_schema, "check_journal", partial(checksums.check_journal, within_s=-1.0))
    require_sound(path)
    assert "only the newest rows were checked: a complete check takes longer than" in caplog.text
    used(state)


def test_a_checksum_covers_table_and_place() -> None:
    assert row_crc("map", 1, "a") != row_crc("pass", 1, "a")
    assert row_crc("map", 1, "a") != row_crc("map", "a", 1)
    assert row_crc("map", "1") != row_crc("map", 1)


def test_verbs_that_read_the_queue_beside_no_daemon_say_it_in_one_sentence(
    left: Mapping[str, Path], tmp_path: Path
) -> None:
    state = copied(left["closed"], tmp_path / "state")
    flipped_row(state, b"program second 0")
    with pytest.raises(ConfigError, match="the journal is damaged: the row"), Queue.at_rest(state):
        pytest.fail("it was opened")


async def until(there: Callable[[], bool]) -> None:
    """pytest's timeout is the limit."""
    while not there():  # noqa: ASYNC110
        await asyncio.sleep(0.01)


def states(site: Site) -> list[str]:
    return [str(event.data["state"]) for event in site.published if event.name == "state_changed"]


async def test_a_cell_with_a_damaged_journal_comes_up_held_and_moves_nothing(site: Site) -> None:
    await run_cell(site.config, site.hooks)
    state, program = site.config.state_dir, site.program.sha256.encode()
    flipped_row(state, program)
    before = files(state)
    site.published.clear()
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell_or_error(site))
        await until(lambda: "held" in states(site))
        status = await asyncio.to_thread(request, state, "status")
        assert (status["state"], status["job"]) == ("held", "small")
        assert "JournalDamage: " in status["reason"]
        assert "does not match its checksum. Check " in status["reason"]
        for verb in ("resume", "queue_list"):
            refused = await asyncio.to_thread(request, state, verb)
            assert refused["error"].startswith("the cell stays held: JournalDamage: "), verb
        assert (await asyncio.to_thread(request, state, "hold"))["state"] == "held"
        assert (await asyncio.to_thread(request, state, "live"))["pressing"] is False
        assert (await asyncio.to_thread(request, state, "stop"))["state"] == "finished"
    assert isinstance(task.result(), JournalDamage)
    assert site.bench is not None
    assert site.bench.fake.events == [], "no device was opened"
    assert [event.data["kind"] for event in site.published if event.name == "cell_held"] == ["JournalDamage"]
    assert files(state) == before, "the file is unchanged, for repair"
    assert last_ending(state)["reason"].startswith("JournalDamage: ")


async def run_cell_or_error(site: Site) -> Any:
    """Return the summary, or the error that ended it."""
    try:
        return await run_cell(site.config, site.hooks)
    except JournalDamage as error:
        return error


async def test_without_a_person_it_ends_with_the_damage(site: Site) -> None:
    await run_cell(site.config, site.hooks)
    flipped_row(site.config.state_dir, site.program.sha256.encode())
    with pytest.raises(JournalDamage, match="does not match its checksum"):
        await run_cell(site.config, site.hooks, holds=False)
