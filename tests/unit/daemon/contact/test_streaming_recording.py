"""Blocks in contact are recorded from before the robot starts until it stands again, whatever ends contact."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.contact import streaming
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.interruption import settle_interrupted_pass
from polishd.daemon.contact.streaming import TURN_BLOCKS, Recorder
from polishd.daemon.journal import store
from polishd.daemon.journal.journal import Journal
from polishd.model.devices import ExecutedBlock, ForceSample
from polishd.model.errors import LinkError, SafetyStop
from tests.fakes.devices import FakeCell
from tests.unit.daemon.small_job import open_journal

LATE_S = 1.5
BLOCKS = 40
CONTACT = (5, 35)


class Robot:
    """Replaces a stream: reports blocks on command of the test."""

    def __init__(self) -> None:
        self.words: asyncio.Queue[ExecutedBlock | BaseException | None] = asyncio.Queue()
        self.left = False

    def reports(self, *seqs: int) -> None:
        for seq in seqs:
            self.words.put_nowait(ExecutedBlock(seq, float(seq), seq + 1.0))

    def fails(self, error: BaseException) -> None:
        self.words.put_nowait(error)

    def stands(self) -> None:
        self.words.put_nowait(None)

    async def polish(self) -> AsyncIterator[ExecutedBlock]:
        while (word := await self.words.get()) is not None:
            if isinstance(word, BaseException):
                raise word
            yield word

    def leave(self) -> None:
        self.left = True


class Pass:
    """One pass that was begun, with the tool on its landing point."""

    def __init__(self, journal: Journal) -> None:
        self.fake, self.robot, self.journal = FakeCell(), Robot(), journal
        self.touch = ContactRecord(lambda records: journal.record_executed(0, records), LATE_S)
        journal.begin_pass(0, "sha", "boot-1", BLOCKS, contact=CONTACT, reach_s=6.0)
        self.fake.robot.plan_sha256 = "sha"
        self.presses()

    def presses(self, times: int = 1) -> None:
        for _ in range(times):
            self.touch.force(ForceSample(self.fake.clock.at_s, 12.0, 12.0, True, False))

    def recording(self) -> Any:
        return streaming.recording(self.fake.cell, self.journal, 0, self.touch)

    async def follow(self, recorder: Recorder) -> None:
        await recorder.follow(self.robot)  # type: ignore[arg-type]

    async def whole(self) -> None:
        """Contact within the recording, as a job has it."""
        async with self.recording() as recorder:
            try:
                await self.follow(recorder)
            finally:
                self.touch.leave()

    def done(self) -> list[int]:
        return [int(seq) for seq in self.journal.executed(0).seq]


@pytest.fixture
def contact(tmp_path: Path) -> Iterator[Pass]:
    with open_journal(tmp_path) as journal:
        yield Pass(journal)


async def until(begun: Pass, seq: int) -> None:
    """Wait until the recorder has that block; pytest's timeout is the limit."""
    while begun.touch.last_seq < seq:  # noqa: ASYNC110
        await asyncio.sleep(0)


async def test_the_end_waits_until_the_last_block_is_judged(contact: Pass) -> None:
    task = asyncio.ensure_future(contact.whole())
    contact.robot.reports(5, 6)
    contact.robot.stands()
    while not contact.robot.left:  # noqa: ASYNC110
        await asyncio.sleep(0)
    assert not task.done(), "no sample has come since"
    contact.presses(2)
    await task
    assert contact.done() == [5, 6]
    assert contact.journal.tally(0).contact_s == 2.0
    assert contact.journal.uncertain(0) == ()


async def test_a_robot_that_is_lost_in_contact_ends_it_and_its_reports_stay(contact: Pass) -> None:
    contact.robot.reports(5, 6, 7)
    contact.robot.fails(LinkError("robot: gone"))
    contact.fake.robot.acts.fails["progress"] = LinkError("robot: gone")
    with pytest.raises(LinkError, match="robot: gone"):
        await contact.whole()
    assert contact.robot.left
    assert contact.done() == [5, 6, 7]
    assert contact.journal.uncertain(0) == ((5, CONTACT[1]),), "the lift is not confirmed"


async def cut_short(contact: Pass, *then: object) -> None:
    """After the first block contact is left; the robot's words that come then."""
    async with contact.recording() as recorder:
        following = asyncio.ensure_future(contact.follow(recorder))
        contact.robot.reports(5)
        await until(contact, 5)
        contact.touch.leave()
        following.cancel()
        while not contact.robot.left:  # noqa: ASYNC110
            await asyncio.sleep(0)
        for word in then:
            asyncio.get_running_loop().call_soon(contact.robot.words.put_nowait, word)
        raise SafetyStop("force")


async def test_a_robot_that_is_lost_while_contact_is_left_does_not_take_the_place_of_what_ended_it(
    contact: Pass, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streaming, "ASK_S", 1e6)  # the daemon must not wait for further reports
    contact.fake.robot.done = contact.fake.robot.until = 9
    with pytest.raises(SafetyStop, match="force"):
        await cut_short(contact, LinkError("robot: gone"))
    assert "the robot stopped reporting while contact was left: robot: gone" in caplog.text
    assert contact.done() == [5]


async def test_what_the_robot_tells_while_contact_is_left_is_recorded_up_to_its_last_word(contact: Pass) -> None:
    contact.fake.robot.done = contact.fake.robot.until = 9
    with pytest.raises(SafetyStop, match="force"):
        await cut_short(contact, *(ExecutedBlock(seq, float(seq), seq + 1.0) for seq in (6, 7, 8)))
    assert contact.done() == [5, 6, 7, 8]
    assert contact.journal.uncertain(0) == ((5, 10),), "and it stands in the next one"


async def test_a_robot_that_says_nothing_any_more_is_not_waited_for(
    contact: Pass, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streaming, "ASK_S", 0.02)
    contact.fake.robot.acts.hangs.add("progress")
    contact.robot.reports(5)
    contact.robot.fails(SafetyStop("the robot stands"))
    with pytest.raises(SafetyStop, match="the robot stands"):
        await contact.whole()
    assert contact.done() == [5]


async def test_a_lost_journal_is_logged_while_contact_is_left_and_does_not_take_the_place_of_what_ended_it(
    contact: Pass, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(cycle: int, first: int, end: int) -> None:
        raise SafetyStop("journal lost")

    monkeypatch.setattr(contact.journal, "mark_uncertain", lost)
    contact.robot.reports(5)
    contact.robot.fails(LinkError("robot: gone"))
    with pytest.raises(LinkError, match="robot: gone"):
        await contact.whole()
    assert "are not recorded (journal lost): the next start reads them" in caplog.text
    monkeypatch.undo()
    assert contact.journal.passes[0].uncertain is None
    await settle_interrupted_pass(contact.fake.cell, contact.journal)
    assert contact.journal.uncertain(0) != (), "as it says"


async def test_a_disk_that_does_not_keep_up_ends_contact(contact: Pass, monkeypatch: pytest.MonkeyPatch) -> None:
    """Although the robot goes on as if nothing were wrong."""
    monkeypatch.setattr(streaming, "LOOK_S", 0.005)
    monkeypatch.setattr(store, "LATE_S", -1.0)
    contact.robot.reports(5)
    with pytest.raises(SafetyStop, match="a commit takes"):
        await contact.whole()
    assert contact.robot.left


async def test_other_tasks_run_while_many_blocks_are_reported(contact: Pass, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    waits: list[float] = []
    loop = asyncio.get_running_loop()
    plain = loop.call_later
    monkeypatch.setattr(loop, "call_later", lambda seconds, *what: (waits.append(seconds), plain(seconds, *what))[1])

    async def watches() -> None:
        while contact.touch.last_seq < 4 * TURN_BLOCKS - 1:
            seen.append(contact.touch.last_seq)
            await asyncio.sleep(0)

    contact.robot.reports(*range(4 * TURN_BLOCKS))
    contact.robot.fails(SafetyStop("enough"))
    other = asyncio.ensure_future(watches())
    with pytest.raises(SafetyStop):
        await contact.whole()
    await other
    assert set(waits) <= {streaming.LOOK_S}, "no other wait"
    assert {TURN_BLOCKS - 1, 2 * TURN_BLOCKS - 1, 3 * TURN_BLOCKS - 1} <= set(seen)


async def test_an_order_while_the_last_words_are_waited_for_is_reported_afterwards(contact: Pass) -> None:
    """It cuts nothing short: what the tool may have touched is marked first."""
    contact.fake.robot.done = contact.fake.robot.until = 7
    task = asyncio.ensure_future(contact.whole())
    contact.robot.reports(5)
    await until(contact, 5)
    task.cancel()
    for _ in range(5):
        await asyncio.sleep(0)
    task.cancel()
    for _ in range(5):
        await asyncio.sleep(0)
    assert not task.done(), "the robot has executed one more than it has reported"
    contact.robot.reports(6)
    with pytest.raises(asyncio.CancelledError):
        await task
    assert contact.done() == [5, 6]


@pytest.mark.parametrize("gone", [False, True])
async def test_contact_that_is_left_before_the_robot_was_started_has_touched_nothing(contact: Pass, gone: bool) -> None:
    if gone:
        contact.fake.robot.acts.fails["progress"] = LinkError("gone")
    with pytest.raises(RobotLost):
        async with contact.recording():
            raise RobotLost
    assert contact.journal.passes[0].uncertain == (CONTACT[0], CONTACT[0])


class RobotLost(Exception):
    """Any error."""


async def test_a_pass_without_a_block_in_contact_ends_at_once(contact: Pass) -> None:
    contact.robot.stands()
    await contact.whole()
    assert contact.done() == []


async def test_a_robot_that_has_executed_nothing_is_not_waited_for(
    contact: Pass, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(streaming, "ASK_S", 1e6)
    contact.fake.robot.done = contact.fake.robot.until = 0
    task = asyncio.ensure_future(contact.whole())
    while not contact.touch.ran:  # noqa: ASYNC110
        await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert contact.done() == []


async def test_who_follows_hears_of_a_lost_robot_himself(contact: Pass) -> None:
    """A robot that the end of the recording does not reach is included: no block waits, and all would seem done."""
    results: list[BaseException | None] = []

    async def apart() -> None:
        async with contact.recording() as recorder:
            following = asyncio.ensure_future(contact.follow(recorder))
            contact.robot.fails(LinkError("robot: gone"))
            try:
                await asyncio.Event().wait()
            finally:
                contact.touch.leave()
                results.extend(await asyncio.gather(following, return_exceptions=True))

    with pytest.raises(LinkError, match="robot: gone"):
        await apart()
    assert [type(error) for error in results] == [LinkError]


async def test_an_order_while_the_last_words_are_waited_for_does_not_take_the_place_of_an_error(contact: Pass) -> None:
    contact.fake.robot.done = contact.fake.robot.until = 7
    task = asyncio.ensure_future(cut_short(contact))
    await until(contact, 5)
    while not contact.robot.left:  # noqa: ASYNC110
        await asyncio.sleep(0)
    for _ in range(9):
        await asyncio.sleep(0)
    assert not task.done()
    task.cancel()
    await asyncio.sleep(0)
    contact.robot.reports(6)
    with pytest.raises(SafetyStop, match="force"):
        await task
    assert contact.done() == [5, 6]
    assert contact.journal.passes[0].uncertain == (7, 8), "it was marked once all blocks were reported"
