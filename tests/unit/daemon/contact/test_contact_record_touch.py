"""What samples and orders say of each block: touched, not touched, or not known, with its force and its speed."""

from __future__ import annotations

import pytest

from polishd.daemon.contact.contact_record import REPORT_S, ContactRecord
from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock, ForceSample, SensedForce, SpeedSample

LATE_S = 1.5


class Contact:
    """A contact that lands at 0 s; blocks and samples by the time at which they come."""

    def __init__(self) -> None:
        self.records: list[BlockRecord] = []
        self.touch = ContactRecord(self.records.extend, LATE_S)
        self.force(0.0)
        self.touch.begin(0.02)

    def force(self, at_s: float, force_n: float = 12.0, *, on: bool = True) -> None:
        self.touch.force(ForceSample(at_s, force_n, 12.0, on, not on))

    def speed(self, at_s: float, rpm: float = 1000.0) -> None:
        self.touch.speed(SpeedSample(at_s, rpm, 1000.0))

    def block(self, seq: int, at_s: float) -> None:
        self.touch.add_block(ExecutedBlock(seq, float(seq), seq + 1.0), at_s)

    @property
    def touched(self) -> dict[int, bool | None]:
        return {record.block.seq: record.touched for record in self.records}


@pytest.fixture
def contact() -> Contact:
    return Contact()


def test_a_block_between_samples_in_contact_touched(contact: Contact) -> None:
    contact.block(0, 0.1)
    contact.force(0.15)
    assert contact.records == [], "this one may have been read before the block ended"
    assert not contact.touch.known.is_set()
    contact.block(1, 0.2)
    contact.force(0.2)
    assert contact.touched == {0: True}
    contact.force(0.25)
    assert contact.touched == {0: True, 1: True}
    assert contact.touch.known.is_set()


def test_contact_that_is_lost_after_a_block_leaves_it_unknown(contact: Contact) -> None:
    contact.force(0.05)
    contact.block(0, 0.1)
    contact.force(0.15, 0.0, on=False)
    contact.force(0.2, 0.0, on=False)
    assert contact.touched == {0: None}


def test_a_sample_that_lay_on_the_wire_while_the_daemon_stood_still_tells_of_no_block_after_it(
    contact: Contact,
) -> None:
    """Read before the daemon was stopped, taken when it went on; meanwhile the actuator's watchdog has lifted."""
    for seq in range(5):
        contact.block(seq, 3.0)
    contact.force(3.0)
    contact.force(3.05, 0.0, on=False)
    assert set(contact.touched.values()) == {None}


def test_contact_that_comes_back_counts_once_no_word_can_be_older(contact: Contact) -> None:
    contact.block(0, 1.0)
    contact.force(1.05, 0.0, on=False)
    contact.force(1.1)
    for seq, at_s in enumerate((1.2, 2.5, 2.7, 2.9), start=1):
        contact.block(seq, at_s)
        contact.force(at_s + 0.05)
        contact.force(at_s + 0.1)
    # the block of 2.9 began after the word of 2.7, which may be 1.5 s late: contact had come back by then
    assert contact.touched == {0: None, 1: None, 2: None, 3: None, 4: True}


def test_force_and_speed_are_means_of_the_samples_around(contact: Contact) -> None:
    contact.force(1.0, 10.0)
    contact.speed(1.0, 990.0)
    contact.block(0, 1.0)
    for at_s, force_n in ((1.05, 10.0), (1.1, 11.0), (1.2, 13.0), (1.3, 15.0)):
        contact.force(at_s, force_n)
    contact.speed(1.25, 1010.0)
    contact.block(1, 1.3)
    contact.force(1.35, 16.0)
    contact.force(1.4, 17.0)
    first, second = contact.records
    assert (first.force_n, first.rpm, first.told_s) == (pytest.approx((12.0 + 10.0) / 2), 990.0, 1.0)
    assert second.force_n == pytest.approx((10.0 + 10.0 + 11.0 + 13.0 + 15.0) / 5)
    assert second.rpm == pytest.approx(1000.0)


def test_blocks_of_one_word_share_its_time(contact: Contact) -> None:
    """One report has many blocks: each lies between this report and the one before."""
    contact.block(0, 1.0)
    contact.force(1.0, 8.0)
    contact.block(1, 2.0)
    contact.block(2, 2.0 + REPORT_S / 2)
    contact.force(2.0 + REPORT_S / 2, 16.0)
    contact.block(3, 2.0 + REPORT_S)  # of the same report, and after the sample
    contact.force(2.1, 16.0)
    assert contact.touched == {0: True, 1: True, 2: True}
    contact.force(2.2, 16.0)
    _, *others = contact.records
    assert [record.told_s for record in others] == [2.0, 2.0, 2.0]
    assert others[0].force_n == others[1].force_n == others[2].force_n == pytest.approx(12.0)


def test_the_independent_sensor_has_a_mean_of_its_own(contact: Contact) -> None:
    contact.touch.sensed(SensedForce(0.5, 11.0))
    contact.block(0, 1.0)
    contact.force(1.05)
    contact.touch.sensed(SensedForce(1.0, 12.0))
    contact.force(1.1)
    contact.block(1, 2.0)
    contact.force(2.05)
    contact.force(2.1)
    first, second = contact.records
    assert (first.force_n, first.sensor_force_n) == (12.0, 11.5)
    assert second.sensor_force_n == 12.0, "the latest one: a sensor may be slower than the robot's reports"


def test_no_sample_is_no_knowledge() -> None:
    records: list[BlockRecord] = []
    touch = ContactRecord(records.extend, LATE_S)
    touch.begin(0.0)
    touch.add_block(ExecutedBlock(0, 0.0, 1.0), 1.0)
    touch.leave()
    touch.flush()
    assert records == [BlockRecord(ExecutedBlock(0, 0.0, 1.0), None, None, None, 1.0)]


# leaving


def test_an_actuator_that_dies_leaves_what_no_later_sample_tells_of_unknown(contact: Contact) -> None:
    """It lost its power after 3.0 s, and the link reports it before the next sample is due."""
    contact.block(0, 2.9)
    contact.force(2.95)
    contact.block(1, 2.99)
    contact.force(3.0)
    contact.block(2, 3.01)
    contact.block(3, 3.04)
    contact.touch.leave()
    assert contact.touched == {0: True}, "a journal that is lost keeps no tool on the part"
    contact.touch.flush()
    contact.touch.flush()
    assert contact.touched == {0: True, 1: None, 2: None, 3: None}
    assert [record.force_n for record in contact.records] == [12.0] * 4


def test_from_the_command_until_the_lift_contact_is_unknown_then_it_is_off(contact: Contact) -> None:
    contact.force(3.0)
    contact.touch.leave()
    contact.force(3.05, 0.1)  # no information: the tool rests on the part for half of its lift
    for seq, at_s in enumerate((3.1, 4.0, 5.0, 6.0, 6.6, 8.0)):
        if at_s == 5.0:
            contact.touch.off(4.5)
            contact.touch.off(9.0)  # by its watchdog it would have been off then
        contact.block(seq, at_s)
    # the word of 6.0 may be 1.5 s late: what follows it is the first that began after the lift for sure
    assert contact.touched == {0: None, 1: None, 2: None, 3: None, 4: False, 5: False}
    assert [record.force_n for record in contact.records] == [None] * 6


def test_a_robot_that_takes_the_tool_off_moves_while_it_presses() -> None:
    touch = ContactRecord(lambda records: None, LATE_S)
    touch.leave()
    assert not touch.taken_off, "nothing moves"
    touch.lifts(3.0)
    assert touch.taken_off
    touch.off(3.5)
    assert touch.taken_off, "it pressed while the robot lifted"
    touch.off(2.9)
    assert not touch.taken_off, "the actuator had let go before"
    assert not touch.ran


def test_what_follows_the_last_word(contact: Contact) -> None:
    assert contact.touch.ran
    contact.block(0, 3.0)
    contact.touch.leave()
    assert not contact.touch.up
    contact.touch.off(2.0)
    assert not contact.touch.up, "the robot's word may be late"
    contact.touch.off(1.5)
    assert contact.touch.up
    assert (contact.touch.last_seq, contact.touch.reported_s) == (0, 3.0)
