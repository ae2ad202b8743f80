"""After an interrupted pass: nothing is run twice, and what is not known is said."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.daemon import interruption
from polishd.daemon.interruption import settle
from polishd.daemon.journal import Journal
from polishd.model.devices import Executed
from polishd.model.errors import LinkError
from polishd.model.program import Segment
from tests.fakes.devices import FakeCell
from tests.unit.daemon.small import open_journal

BLOCKS = 40
CONTACT = (5, 35)


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with open_journal(tmp_path) as found:
        yield found


@pytest.fixture
def fake() -> FakeCell:
    """A robot that has executed 21 blocks of program "sha"."""
    fake = FakeCell()
    fake.robot.plan_sha256, fake.robot.done, fake.robot.until = "sha", 21, 21
    fake.robot.loaded = [Segment(seq, b"") for seq in range(BLOCKS)]
    return fake


def interrupted(journal: Journal, until: int = 18) -> None:
    """A pass that was begun; blocks of contact are recorded up to there."""
    journal.begin_pass(2, "sha", "boot-1", BLOCKS, contact=CONTACT)
    for seq in range(CONTACT[0], until):
        journal.executed_segment(2, Executed(seq, seq, seq + 1.0), contact=True)


async def test_nothing_to_settle(fake: FakeCell, journal: Journal) -> None:
    assert await settle(fake.cell, journal) == ""
    journal.begin_pass(0, "sha", "boot-1", BLOCKS)
    journal.end_pass(0, "done")
    assert await settle(fake.cell, journal) == ""


async def test_the_same_robot_run_tells_the_rest(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal)
    said = await settle(fake.cell, journal)
    assert "pass 2 was interrupted: 13 of 40 blocks are recorded as executed in contact" in said
    assert "uncertain: blocks 18 to 21." in said
    blocks = journal.executed(2)
    assert list(blocks.seq) == list(range(5, 21)), "each once"
    assert list(blocks.seq[blocks.recovered]) == [18, 19, 20]
    assert blocks.contact.all()
    assert journal.passes[0].how == "interrupted"
    assert next(journal.remaining(9)) == 3, "the pass is not begun again"
    assert fake.events == [], "it is only asked"


async def test_blocks_off_the_part_are_recovered_as_such(fake: FakeCell, journal: Journal) -> None:
    """The daemon died on the way out: the tool was lifted by then."""
    interrupted(journal, 35)
    fake.robot.done = 38
    said = await settle(fake.cell, journal)
    assert "uncertain: blocks 35 to 38." in said
    blocks = journal.executed(2)
    assert not blocks.contact[blocks.recovered].any()


async def test_nothing_recorded_yet(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, CONTACT[0])
    assert "0 of 40 blocks" in await settle(fake.cell, journal)
    blocks = journal.executed(2)
    assert list(blocks.seq) == list(range(21))
    assert list(blocks.seq[blocks.contact]) == list(range(5, 21))


async def test_the_block_under_way_is_uncertain_although_all_others_are_known(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, 21)
    assert "uncertain: blocks 21 to 21." in await settle(fake.cell, journal)
    assert not journal.executed(2).recovered.any()


async def test_the_end_of_the_program_is_the_end_of_doubt(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, 35)
    fake.robot.done = BLOCKS
    assert "uncertain: blocks 35 to 39." in await settle(fake.cell, journal)


@pytest.mark.parametrize(("field", "value"), [("boot_id", "boot-2"), ("plan_sha256", "other"), ("plan_sha256", "")])
async def test_a_robot_that_has_forgotten(fake: FakeCell, journal: Journal, field: str, value: str) -> None:
    setattr(fake.robot, field, value)
    interrupted(journal)
    said = await settle(fake.cell, journal)
    assert "uncertain: blocks 18 to 39 (the robot has forgotten them)" in said
    assert list(journal.executed(2).seq) == list(range(5, 18)), "what another run says is not believed"
    assert journal.passes[0].how == "interrupted"


async def test_a_robot_whose_link_is_down(fake: FakeCell, journal: Journal) -> None:
    fake.robot.acts.fails["progress"] = LinkError("gone")
    interrupted(journal)
    assert "18 to 39" in await settle(fake.cell, journal)
    assert journal.passes[0].how == "interrupted"


async def test_a_robot_that_does_not_answer(fake: FakeCell, journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interruption, "ASK_S", 0.02)
    fake.robot.acts.hangs.add("progress")
    interrupted(journal)
    assert "18 to 39" in await settle(fake.cell, journal)


async def test_a_robot_that_stops_amid_its_account(
    fake: FakeCell, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half an account is none: all is uncertain, and nothing waits for ever."""
    monkeypatch.setattr(interruption, "ASK_S", 0.02)
    interrupted(journal)
    progress = fake.robot.progress

    async def boasts() -> object:
        told = await progress()
        return type(told)(told.state, told.program_sha256, 40, 30, 0.0, told.boot_id)

    fake.robot.progress = boasts  # type: ignore[method-assign, assignment]
    assert "18 to 39" in await settle(fake.cell, journal)


async def test_settling_twice_says_nothing_the_second_time(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal)
    assert await settle(fake.cell, journal)
    assert await settle(fake.cell, journal) == ""
