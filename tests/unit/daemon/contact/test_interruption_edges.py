"""After an interrupted pass, at the very edges: of time, of contact, and of what the robot says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.daemon.contact.interruption import mark_interrupted, settle_interrupted_pass
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.program import Segment
from tests.fakes.devices import FakeCell
from tests.unit.daemon.contact.test_interruption import BLOCKS, CONTACT, interrupted, left, touched
from tests.unit.daemon.small_job import open_journal


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with open_journal(tmp_path) as found:
        yield found


@pytest.fixture
def fake() -> FakeCell:
    fake = FakeCell()
    fake.robot.plan_sha256, fake.robot.done, fake.robot.until = "sha", 21, 21
    fake.robot.loaded = [Segment(seq, b"") for seq in range(BLOCKS)]
    return fake


@pytest.mark.parametrize(
    ("reach_s", "end"),
    [
        (2.4, 21),  # twelve blocks from the first word to the last, in 12 s less 1.5: 1.14 of its seconds in one
        (2.6, 21),
        (2.8, 22),
    ],
)
async def test_how_fast_it_ran_counts_from_the_first_word_to_the_last(
    fake: FakeCell, journal: Journal, reach_s: float, end: int
) -> None:
    fake.robot.boot_id = "boot-2"
    interrupted(journal, reach_s=reach_s)
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, end),)


@pytest.mark.parametrize(
    ("wall_s", "reach_s", "last"), [(1.0, 5.6, 24), (1.0, 6.2, 25), (5.0, 6.0, 24), (5.0, 5.9, 23)]
)
async def test_what_began_within_the_time_is_uncertain_and_later_it_was_off(
    fake: FakeCell, journal: Journal, wall_s: float, reach_s: float, last: int
) -> None:
    """With a robot that runs as slowly as that, its own clock counts as it is."""
    interrupted(journal, wall_s=wall_s, reach_s=reach_s)
    fake.robot.done = fake.robot.until = 33
    await settle_interrupted_pass(fake.cell, journal)
    assert [seq for seq, word in touched(journal).items() if word == "?"] == list(range(18, last + 1))
    assert journal.uncertain(2) == ((18, last + 1),)


async def test_the_block_in_which_it_stands_may_begin_later_than_the_tool_can_have_stayed(
    fake: FakeCell, journal: Journal
) -> None:
    interrupted(journal, wall_s=5.0, reach_s=6.0)
    fake.robot.done = fake.robot.until = 25
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, 25),)
    assert journal.passes[0].uncertain == (25, 25)


async def test_the_way_in_says_nothing_of_the_tool_in_contact(fake: FakeCell, journal: Journal) -> None:
    """It was off there, and lands after it."""
    interrupted(journal, CONTACT[0])
    for seq in range(CONTACT[0]):
        journal.record_executed(2, [BlockRecord(ExecutedBlock(seq, float(seq), seq + 1.0), False)])
    fake.robot.boot_id = "boot-2"
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == (CONTACT,)


async def test_a_tool_that_was_off_in_the_first_block_of_contact_stays_off(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, CONTACT[0] + 1, off_from=CONTACT[0])
    fake.robot.boot_id = "boot-2"
    assert "no block is uncertain" in await settle_interrupted_pass(fake.cell, journal)


async def test_nothing_recorded_and_nothing_remembered_leaves_all_of_the_contact(
    fake: FakeCell, journal: Journal
) -> None:
    interrupted(journal, CONTACT[0])
    fake.robot.done = fake.robot.until = 0
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == (), "it stands before its first block, on the way in"
    assert touched(journal) == {}


async def test_the_first_and_the_last_block_of_contact_are_in_it(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, CONTACT[0], reach_s=None)
    fake.robot.done = fake.robot.until = BLOCKS
    await settle_interrupted_pass(fake.cell, journal)
    assert [seq for seq, word in touched(journal).items() if word == "?"] == list(range(*CONTACT))


async def test_what_was_marked_then_is_the_bound_also_for_a_robot_that_runs_on(
    fake: FakeCell, journal: Journal
) -> None:
    interrupted(journal)
    journal.mark_uncertain(2, 18, 23)
    fake.robot.until = 30
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, 23),)


async def test_the_pass_that_is_marked_is_the_one_that_was_left(fake: FakeCell, journal: Journal) -> None:
    journal.begin_pass(1, "other", "boot-1", 3)
    journal.end_pass(1, "done")
    interrupted(journal, 17)
    await mark_interrupted(fake.cell, journal, 2, left(journal, off_s=103.0, reported_s=100.0), None)
    assert [(one.cycle, one.uncertain) for one in journal.passes] == [(1, None), (2, (18, 23))]


@pytest.mark.parametrize("executed", [19, 25])
async def test_a_robot_that_stands_beyond_its_report_may_have_touched_all_up_to_there(
    fake: FakeCell, journal: Journal, executed: int
) -> None:
    interrupted(journal, 17)
    robot = RobotProgress("held", "sha", BLOCKS, executed, 0.0)
    await mark_interrupted(fake.cell, journal, 2, left(journal, off_s=103.0, reported_s=100.0), robot)
    assert journal.passes[0].uncertain == (18, 23)


async def test_a_pass_of_which_no_plan_is_kept_leaves_all_of_its_contact(fake: FakeCell, journal: Journal) -> None:
    journal.begin_pass(2, "sha", "boot-2", BLOCKS, contact=CONTACT, reach_s=1.0)
    for seq in range(5, 18):
        journal.record_executed(
            2, [BlockRecord(ExecutedBlock(seq, float(seq), seq + 1.0), True, None, None, 50.0 + seq)]
        )
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, CONTACT[1]),)


async def test_without_a_bound_on_contact_time_all_blocks_that_ran_are_uncertain(
    fake: FakeCell, journal: Journal
) -> None:
    interrupted(journal, reach_s=None)
    fake.robot.done = fake.robot.until = 33
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, 34),)


async def test_all_that_is_uncertain_is_said(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, 10)
    for seq in (10, 11):
        journal.record_executed(
            2, [BlockRecord(ExecutedBlock(seq, float(seq), seq + 1.0), None, 12.0, 1000.0, 50.0 + seq)]
        )
    for seq in range(12, 18):
        journal.record_executed(
            2, [BlockRecord(ExecutedBlock(seq, float(seq), seq + 1.0), True, 12.0, 1000.0, 50.0 + seq)]
        )
    said = await settle_interrupted_pass(fake.cell, journal)
    assert "; uncertain: blocks 10 to 11, 18 to 21. None of them is run again" in said
