"""What samples and orders say of blocks, at the very edges of time; and that hours of them are not kept."""

from __future__ import annotations

from polishd.daemon.contact.contact_record import REPORT_S, ContactRecord
from tests.unit.daemon.contact.test_contact_record_touch import LATE_S, Contact


def test_a_sample_of_the_moment_in_which_the_robot_is_started_counts() -> None:
    contact = Contact()
    contact.touch = ContactRecord(contact.records.extend, LATE_S)
    contact.force(0.5)
    contact.touch.begin(0.5)
    contact.block(0, 0.6)
    contact.force(0.7)
    contact.force(0.8)
    assert contact.touched == {0: True}


def test_the_mean_of_a_block_begins_with_the_last_sample_before_it() -> None:
    contact = Contact()
    contact.block(0, 1.0)
    contact.force(1.0, 20.0)
    contact.block(1, 2.0)
    contact.touch.leave()
    contact.touch.flush()
    assert [record.force_n for record in contact.records] == [16.0, 20.0]


def test_samples_that_no_block_needs_any_more_are_not_kept() -> None:
    contact = Contact()
    for k in range(1, 400):
        contact.force(k / 20)
        contact.speed(k / 20)
        if k % 10 == 0:
            contact.block(k, k / 20)
    assert len(contact.touch._force) <= 12
    assert len(contact.touch._rpm) <= 12


def test_a_block_exactly_a_lump_later_is_of_the_same_word() -> None:
    contact = Contact()
    contact.block(0, 1.0)
    contact.block(1, 1.0 + REPORT_S)
    contact.block(2, 1.0 + 2 * REPORT_S)
    contact.force(1.1)
    contact.force(1.2)
    assert [record.told_s for record in contact.records] == [1.0, 1.0, 1.0 + 2 * REPORT_S]


def test_what_runs_from_the_moment_on_in_which_the_tool_is_off_is_not_touched() -> None:
    contact = Contact()
    contact.block(0, 3.0)
    contact.touch.leave()
    contact.touch.off(4.5)
    contact.block(1, 6.0)
    contact.block(2, 6.1)
    assert contact.touch.up, "the word of 6.1 can be late by so much that it began at 4.6"
    contact.touch.flush()
    assert contact.touched == {0: None, 1: None, 2: False}


def test_a_robot_that_lifts_in_the_moment_in_which_the_tool_is_off_moves_nothing_on_the_part() -> None:
    contact = Contact()
    contact.touch.lifts(3.0)
    contact.touch.off(3.0)
    assert not contact.touch.taken_off
