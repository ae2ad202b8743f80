"""After an interrupted pass: no block runs twice, and only blocks of unknown contact are uncertain."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from polishd.daemon.contact import interruption
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.interruption import mark_interrupted, settle_interrupted_pass
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.errors import LinkError
from polishd.model.program import Segment
from tests.fakes.devices import FakeCell
from tests.unit.daemon.small_job import open_journal

BLOCKS = 40
CONTACT = (5, 35)
REACH_S = 6.0
PLAN = {"block": np.arange(5, 35), "asked_s": np.full(30, 1.0), "expected_s": np.full(30, 1.2)}
"""Each block of contact is written to take a second."""


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


def interrupted(
    journal: Journal,
    until: int = 18,
    *,
    wall_s: float = 1.0,
    reach_s: float | None = REACH_S,
    off_from: int = BLOCKS,
    boot_id: str = "boot-1",
) -> None:
    """A pass that was begun; blocks of contact are recorded up to there, one reported each ``wall_s``."""
    plan = journal.arrays.put(PLAN)
    journal.begin_pass(2, "sha", boot_id, BLOCKS, contact=CONTACT, plan=plan, reach_s=reach_s)
    for seq in range(CONTACT[0], until):
        block = ExecutedBlock(seq, float(seq), seq + 1.0)
        journal.record_executed(2, [BlockRecord(block, seq < off_from, 12.0, 1000.0, 50.0 + seq * wall_s)])


def touched(journal: Journal) -> dict[int, str]:
    """Return for each recorded block whether it touched: ``+`` yes, ``-`` no, ``?`` unknown."""
    blocks = journal.executed(2)
    words = {1.0: "+", 0.0: "-"}
    return {int(seq): words.get(float(known), "?") for seq, known in zip(blocks.seq, blocks.touched, strict=True)}


async def test_nothing_to_settle(fake: FakeCell, journal: Journal) -> None:
    assert await settle_interrupted_pass(fake.cell, journal) == ""
    journal.begin_pass(0, "sha", "boot-1", BLOCKS)
    journal.end_pass(0, "done")
    assert await settle_interrupted_pass(fake.cell, journal) == ""


# the robot remembers


async def test_the_same_robot_run_tells_the_rest(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal)
    said = await settle_interrupted_pass(fake.cell, journal)
    assert "pass 2 was interrupted: 16 of 40 blocks are recorded as executed; uncertain: blocks 18 to 21." in said
    blocks = journal.executed(2)
    assert list(blocks.seq) == list(range(5, 21)), "each once"
    assert list(blocks.seq[blocks.recovered]) == [18, 19, 20]
    assert [touched(journal)[seq] for seq in (17, 18, 19, 20)] == ["+", "?", "?", "?"]
    assert journal.uncertain(2) == ((18, 22),), "the robot stands in the last one"
    assert journal.passes[0].how == "interrupted"
    assert next(journal.remaining(9)) == 3, "the pass is not begun again"
    assert fake.events == [], "it is only asked"


async def test_what_ran_after_the_actuator_must_have_let_go_was_not_touched(fake: FakeCell, journal: Journal) -> None:
    """The tool can have stayed on the part for six seconds more, which are as many blocks, and a little."""
    interrupted(journal)
    fake.robot.done = fake.robot.until = 33
    said = await settle_interrupted_pass(fake.cell, journal)
    found = touched(journal)
    # 12 s of the robot's in 12 s of ours, less what its words may be late: at most 1.14 s of its in one of ours
    assert [seq for seq in range(18, 33) if found[seq] == "-"] == list(range(25, 33))
    assert "uncertain: blocks 18 to 24." in said
    assert journal.passes[0].uncertain == (33, 33)


async def test_how_fast_the_robots_clock_went_counts(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, wall_s=0.5)
    fake.robot.done = fake.robot.until = 34
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, 35),), "twice as fast, and a little more: 16 s"


async def test_a_pass_that_has_just_begun_does_not_tell_how_fast(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, 7)
    fake.robot.done = fake.robot.until = 33
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((7, 34),)


async def test_blocks_off_the_part_are_recovered_as_such(fake: FakeCell, journal: Journal) -> None:
    """The daemon died on the way out: the tool was lifted by then."""
    interrupted(journal, 35)
    fake.robot.done = 38
    assert "no block is uncertain" in await settle_interrupted_pass(fake.cell, journal)
    assert [touched(journal)[seq] for seq in (34, 35, 37)] == ["+", "-", "-"]


async def test_what_follows_a_block_that_the_tool_was_off_in_is_not_touched(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, off_from=16)
    assert "no block is uncertain" in await settle_interrupted_pass(fake.cell, journal)
    assert touched(journal) == {seq: "+" if seq < 16 else "-" for seq in range(5, 21)}


async def test_nothing_recorded_yet(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, CONTACT[0])
    assert "21 of 40 blocks" in await settle_interrupted_pass(fake.cell, journal)
    assert touched(journal) == {seq: "-" if seq < CONTACT[0] else "?" for seq in range(21)}


async def test_the_block_under_way_is_uncertain_although_all_others_are_known(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, 21)
    assert "uncertain: blocks 21 to 21." in await settle_interrupted_pass(fake.cell, journal)
    assert not journal.executed(2).recovered.any()


async def test_the_way_in_is_not_touched(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, CONTACT[0])
    fake.robot.done = fake.robot.until = 3
    assert "no block is uncertain" in await settle_interrupted_pass(fake.cell, journal)
    assert touched(journal) == dict.fromkeys(range(3), "-")


async def test_what_was_marked_when_contact_was_left_is_the_bound(fake: FakeCell, journal: Journal) -> None:
    """The link was lost; now the robot reports what ran, and the lift was confirmed."""
    interrupted(journal)
    journal.mark_uncertain(2, 18, 20)
    await settle_interrupted_pass(fake.cell, journal)
    assert [touched(journal)[seq] for seq in (18, 19, 20)] == ["?", "?", "-"]
    assert journal.uncertain(2) == ((18, 20),)


async def test_a_robot_that_still_runs_is_not_taken_to_stand(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal)
    fake.robot.until = 30
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, 25),), "as far as it can come within the time"


# it has forgotten, or says nothing


@pytest.mark.parametrize("marked", [(18, 30), None])
async def test_what_a_robot_without_a_boot_id_does_not_tell_may_be_executed(
    fake: FakeCell, journal: Journal, marked: tuple[int, int] | None
) -> None:
    """The driver followed the robot until the link was lost; the robot went on without it."""
    interrupted(journal, boot_id="")
    fake.robot.boot_id, fake.robot.done, fake.robot.until = "", 18, 18
    if marked:
        journal.mark_uncertain(2, *marked)
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == (marked or (18, 25),), "as far as the tool can have come, not where it was last seen"


@pytest.mark.parametrize(("field", "value"), [("boot_id", "boot-2"), ("plan_sha256", "other"), ("plan_sha256", "")])
async def test_a_robot_that_has_forgotten(fake: FakeCell, journal: Journal, field: str, value: str) -> None:
    """What the tool can have reached within the time is marked, by the time that is written, and no more."""
    setattr(fake.robot, field, value)
    interrupted(journal)
    said = await settle_interrupted_pass(fake.cell, journal)
    assert "uncertain: blocks 18 to 24 (estimated: the robot has no record of this pass)" in said
    assert list(journal.executed(2).seq) == list(range(5, 18)), "what another run says is not believed"
    assert journal.passes[0].how == "interrupted"


@pytest.mark.parametrize(
    ("recorded", "wall_s", "reach_s", "end"),
    [
        (18, 1.0, 2.0, 21),
        (18, 0.5, 2.0, 24),  # twice the programmed speed: an operator raised the override
        (18, 5.0, 2.0, 20),  # slower; but it may have gone on at full speed
        (18, 1.0, None, 35),  # an earlier polishd did not say
        (7, 1.0, 2.0, 35),  # too little to know how fast
        (33, 1.0, 9.0, 35),
    ],
)
async def test_how_far_the_tool_can_have_come(
    fake: FakeCell, journal: Journal, recorded: int, wall_s: float, reach_s: float | None, end: int
) -> None:
    fake.robot.boot_id = "boot-2"
    interrupted(journal, recorded, wall_s=wall_s, reach_s=reach_s)
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((recorded, end),)


async def test_what_was_marked_stands_where_the_robot_has_forgotten(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal)
    journal.mark_uncertain(2, 18, 19)
    fake.robot.boot_id = "boot-2"
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.uncertain(2) == ((18, 19),)


async def test_a_tool_that_was_off_stays_off(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, off_from=16)
    fake.robot.boot_id = "boot-2"
    assert "no block is uncertain" in await settle_interrupted_pass(fake.cell, journal)


async def test_a_robot_whose_link_is_down(fake: FakeCell, journal: Journal) -> None:
    fake.robot.acts.fails["progress"] = LinkError("gone")
    interrupted(journal)
    assert "18 to 24" in await settle_interrupted_pass(fake.cell, journal)
    assert journal.passes[0].how == "interrupted"


async def test_a_robot_that_does_not_answer(fake: FakeCell, journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interruption, "ASK_S", 0.02)
    fake.robot.acts.hangs.add("progress")
    interrupted(journal)
    assert "18 to 24" in await settle_interrupted_pass(fake.cell, journal)


async def test_a_robot_that_stops_amid_its_account(
    fake: FakeCell, journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half an account is none, and nothing waits for ever."""
    monkeypatch.setattr(interruption, "ASK_S", 0.02)
    interrupted(journal)
    progress = fake.robot.progress

    async def boasts() -> object:
        found = await progress()
        return type(found)(found.state, found.program_sha256, 40, 30, 0.0, found.boot_id)

    fake.robot.progress = boasts  # type: ignore[method-assign, assignment]
    assert "18 to 24" in await settle_interrupted_pass(fake.cell, journal)


async def test_settling_twice_says_nothing_the_second_time(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal)
    assert await settle_interrupted_pass(fake.cell, journal)
    assert await settle_interrupted_pass(fake.cell, journal) == ""


# when contact is left


def left(journal: Journal, *, off_s: float, reported_s: float, seq: int = 17) -> ContactRecord:
    """A contact that was left: time of the robot's latest report, and from when on the tool is off."""
    touch = ContactRecord(lambda records: journal.record_executed(2, records), 1.5)
    touch.begin(0.0)
    touch.leave()
    touch.add_block(ExecutedBlock(seq, float(seq), seq + 1.0), reported_s)
    touch.off(off_s)
    return touch


@pytest.mark.parametrize(
    ("robot", "off_s", "marked"),
    [
        (RobotProgress("held", "sha", 40, 18, 0.0), 103.0, (18, 19)),  # it stands in this one
        (RobotProgress("running", "sha", 40, 18, 9.0), 103.0, (18, 23)),  # 3 s, and its word may have been late
        (None, 103.0, (18, 23)),
        (None, 98.0, (18, 18)),  # it was off before this one began
        (None, float("inf"), (18, 35)),  # not known to be off
    ],
)
async def test_what_can_be_touched_after_the_last_word(
    fake: FakeCell, journal: Journal, robot: RobotProgress | None, off_s: float, marked: tuple[int, int]
) -> None:
    interrupted(journal, 17)
    await mark_interrupted(fake.cell, journal, 2, left(journal, off_s=off_s, reported_s=100.0), robot)
    assert journal.passes[0].uncertain == marked
    assert journal.passes[0].ended_s is None, "the robot may still report"


async def test_a_tool_that_never_left_its_landing_point_has_touched_nothing(fake: FakeCell, journal: Journal) -> None:
    interrupted(journal, CONTACT[0])
    await mark_interrupted(fake.cell, journal, 2, ContactRecord(lambda records: None, 1.5), None)
    assert journal.uncertain(2) == ()


@pytest.mark.parametrize("robot", [None, RobotProgress("running", "sha", 40, CONTACT[0], 9.0)])
async def test_a_robot_that_took_the_tool_off_its_landing_point_moved_in_the_first_block(
    fake: FakeCell, journal: Journal, robot: RobotProgress | None
) -> None:
    interrupted(journal, CONTACT[0])
    touch = ContactRecord(lambda records: None, 1.5)
    touch.leave()
    touch.lifts(3.0)
    touch.off(3.5)
    await mark_interrupted(fake.cell, journal, 2, touch, robot)
    assert journal.passes[0].uncertain == (CONTACT[0], CONTACT[0] + 1)


@pytest.mark.parametrize(("lifts_s", "marked"), [(101.0, (CONTACT[1], CONTACT[1] + 1)), (104.0, (CONTACT[1],) * 2)])
async def test_a_robot_that_took_the_tool_off_at_the_end_moved_in_the_block_after_it(
    fake: FakeCell, journal: Journal, lifts_s: float, marked: tuple[int, int]
) -> None:
    """The actuator fell silent at the retract on the other landing point; the next start reports the same."""
    interrupted(journal, CONTACT[1] - 1)
    touch = left(journal, seq=CONTACT[1] - 1, off_s=103.0, reported_s=100.0)
    touch.lifts(lifts_s)
    await mark_interrupted(fake.cell, journal, 2, touch, None)
    assert journal.passes[0].uncertain == marked
    fake.robot.done = fake.robot.until = CONTACT[1]
    await settle_interrupted_pass(fake.cell, journal)
    assert journal.passes[0].uncertain == marked
