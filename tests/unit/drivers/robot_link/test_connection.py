"""The session without a wire: credit, go-back-N, records, restarts."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from polishd.api import ExecutedBlock, LinkError, Segment
from polishd.drivers.robot_link.driver import MAX_BLOCKS, MAX_BYTES, ExecutionRecord, RobotLinkSession
from polishd.drivers.robot_link.protocol import Ack, Nak
from tests.fakes import robot as wire


def status(**changes: Any) -> dict[str, Any]:
    base = {"state": "held", "program_sha256": "sha", "accepted": 0, "executed": 0, "buffer_s": 0.0, "boot_id": "b1"}
    base["stops"] = 0
    return base | changes


def welcome(**changes: Any) -> bytes:
    identity = {"vendor": "V", "model": "M", "serial": "S", "firmware": "F", "boot_id": "b1"}
    content = identity | {"protocol": 1, "watchdog_s": 1.0, "window": 8, "status": status(**changes)}
    return wire.frame(wire.WELCOME, content)


def accepted(next_seq: int, credit: int, buffer_s: float = 0.0) -> bytes:
    return wire.frame(wire.ACCEPTED, struct.pack(">IId", next_seq, credit, buffer_s))


def executed(*seqs: int) -> bytes:
    records = b"".join(struct.pack(">Idd", seq, float(seq), seq + 0.5) for seq in seqs)
    return wire.frame(wire.EXECUTED, struct.pack(">H", len(seqs)) + records)


def resend(seq: int) -> bytes:
    return wire.frame(wire.RESEND, struct.pack(">I", seq))


def loaded(window: int = 8) -> RobotLinkSession:
    session = RobotLinkSession(ExecutionRecord())
    session.receive(welcome(program_sha256="", state="idle") + accepted(0, window))
    session.receive(wire.frame(wire.ACK, {"of": wire.LOAD, "status": status()}))
    session.answers.clear()
    return session


def segments(count: int, first: int = 0) -> list[Segment]:
    return [Segment(seq, b"G1 X%d" % seq) for seq in range(first, first + count)]


def sent(frame: bytes) -> tuple[int, int]:
    """First sequence number and count of a BLOCKS frame."""
    first, count = struct.unpack_from(">IH", frame, 8)
    return first, count


def test_nothing_counts_before_the_welcome() -> None:
    session = RobotLinkSession(ExecutionRecord())
    assert session.receive(accepted(5, 5) + executed(0) + wire.frame(wire.STATUS, status())) == 3
    assert session.progress is None
    assert session.credit.limit == 0
    with pytest.raises(LinkError):
        session.present()


def test_unknown_frames_are_ignored() -> None:
    session = loaded()
    assert session.receive(wire.frame(0x99, {})) == 1
    assert session.answers == []


def test_blocks_go_out_as_credit_allows() -> None:
    session, blocks = loaded(8), segments(20)
    assert sent(session.next_blocks(blocks)) == (0, 8)
    assert session.next_blocks(blocks) == b""
    session.receive(accepted(8, 3))
    assert sent(session.next_blocks(blocks)) == (8, 3)
    session.receive(accepted(11, 100))
    assert sent(session.next_blocks(blocks)) == (11, 9)
    assert session.next_blocks(blocks) == b""


def test_frames_of_blocks_are_small() -> None:
    session = loaded()
    session.receive(accepted(0, 10_000))
    assert sent(session.next_blocks(segments(1000))) == (0, MAX_BLOCKS)
    long = [Segment(MAX_BLOCKS + at, bytes(60_000)) for at in range(10)]
    assert sent(session.next_blocks(long)) == (MAX_BLOCKS, MAX_BYTES // 60_000)


def test_resend_goes_back_but_not_behind_what_is_held() -> None:
    session, blocks = loaded(8), segments(8)
    session.next_blocks(blocks)
    session.receive(accepted(3, 5) + resend(5))
    assert sent(session.next_blocks(blocks)) == (5, 3)
    session.receive(resend(1))
    assert sent(session.next_blocks(blocks)) == (3, 5)
    session.receive(accepted(8, 8) + resend(5))
    assert session.next_blocks(blocks) == b""


def test_an_old_accepted_takes_nothing_back() -> None:
    session, blocks = loaded(8), segments(8)
    session.next_blocks(blocks)
    session.receive(accepted(6, 2) + accepted(4, 4))
    assert session.credit.accepted == 6


def test_a_lost_accepted_is_made_good_by_status() -> None:
    session, blocks = loaded(8), segments(8)
    session.next_blocks(blocks)
    session.receive(wire.frame(wire.STATUS, status(accepted=8)))
    assert session.credit.accepted == 8


def test_present_is_what_was_said_last() -> None:
    session = loaded(8)
    session.receive(accepted(5, 3, 1.25) + executed(0, 1))
    present = session.present()
    assert (present.accepted, present.executed, present.buffer_s) == (5, 2, 1.25)
    session.receive(accepted(4, 4, 1.0))
    assert session.present().buffer_s == 1.25, "an old word"


def test_a_program_that_is_gone_takes_record_and_credit_with_it() -> None:
    session = loaded(8)
    session.receive(accepted(5, 3) + executed(0, 1))
    credit, record = session.credit, session.record
    session.receive(wire.frame(wire.STATUS, status(program_sha256="", state="idle", stops=4)))
    assert session.credit is not credit
    assert session.record is not record
    assert (session.credit.limit, len(session.record), session.present().stops) == (0, 0, 4)
    assert len(record) == 2


def test_load_starts_from_nothing() -> None:
    session = loaded(8)
    session.receive(accepted(8, 8) + executed(0, 1, 2))
    old = session.record
    session.receive(wire.frame(wire.ACK, {"of": wire.LOAD, "status": status(program_sha256="new")}))
    assert session.record is not old
    assert (len(old), len(session.record), session.record.program_sha256) == (3, 0, "new")
    assert (session.credit.accepted, session.credit.limit) == (0, 8)


def test_records_are_kept_over_a_reconnect() -> None:
    first = loaded()
    first.receive(executed(0, 1))
    second = RobotLinkSession(first.record)
    assert second.executed_from == 2
    second.receive(welcome(executed=4, accepted=5) + executed(2, 3))
    assert second.record is first.record
    assert second.follows
    assert [second.record[seq].seq for seq in range(4)] == [0, 1, 2, 3]


@pytest.mark.parametrize("change", [{"program_sha256": "other"}, {"boot_id": "b1", "executed": 1}])
def test_another_programs_records_are_not_mixed(change: dict[str, Any]) -> None:
    first = loaded()
    first.receive(executed(0, 1, 2))
    second = RobotLinkSession(first.record)
    second.receive(welcome(**change) + executed(3))
    assert not second.follows
    assert second.record is not first.record
    assert len(second.record) == 0
    assert len(first.record) == 3


def test_lost_records_end_the_link() -> None:
    session = loaded()
    with pytest.raises(LinkError, match="lost on the link"):
        session.receive(executed(0, 2))
    assert session.record[0] == ExecutedBlock(0, 0.0, 0.5)


def test_a_restart_ends_the_link() -> None:
    session = loaded()
    with pytest.raises(LinkError, match="has restarted"):
        session.receive(wire.frame(wire.STATUS, status(boot_id="b2")))


def test_who_does_not_follow_asks_for_no_records() -> None:
    session = RobotLinkSession(None)
    assert session.executed_from == 0xFFFF_FFFF
    session.receive(welcome(executed=9, accepted=9) + executed(7, 8))
    assert len(session.record) == 0


def test_answers_wait_in_order() -> None:
    session = loaded()
    session.receive(wire.frame(wire.ACK, {"of": wire.HOLD, "status": status(state="done")}))
    session.receive(wire.frame(wire.NAK, {"of": wire.RESUME, "code": "no_program", "text": "none"}))
    ack, nak = session.answers
    assert isinstance(ack, Ack)
    assert isinstance(nak, Nak)
    assert session.progress is not None
    assert session.progress.state == "done"
    assert nak.code == "no_program"
