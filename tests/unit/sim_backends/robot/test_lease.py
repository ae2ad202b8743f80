"""The robot controller: who may write and for how long, what is proved of a program, and what may start it."""

from __future__ import annotations

import pytest

from polishd.sim_backends.common import framing as f
from polishd.sim_backends.robot.device import BACKLOG, CHUNK, Client, Lease
from tests.unit.sim_backends.robot.test_controller import LINES, Bench, credits_sent, executed, kinds, last, naks


def lease_of(got: list[tuple[int, bytes]]) -> str:
    return str(last(got, f.WELCOME)["lease"])


def new_client() -> Client:
    return Client(lambda frame: None)


def take(lease: Lease, client: Client, name: str, now_s: float, *, standing: bool = False) -> bool:
    return lease.take(client, name, now_s, standing=standing)


def test_a_lease_lasts_as_long_as_its_writer_sends() -> None:
    lease, writer, other = Lease(1.0), new_client(), new_client()
    assert take(lease, writer, "", 10.0)
    assert not take(lease, other, "", 11.0)
    lease.renew(writer, 11.0)
    lease.renew(other, 11.5)
    assert lease.silent_s(11.5) == 0.5
    assert not take(lease, other, "", 12.0)
    assert take(lease, other, "", 12.01)
    assert lease.writer is other


def test_a_lease_is_named_anew_for_each_writer_and_kept_by_who_comes_back() -> None:
    lease, names = Lease(1.0), []
    for now_s in (0.0, 5.0):
        assert take(lease, new_client(), "", now_s)
        names.append(lease.name)
    assert len(set(names)) == 2
    assert take(lease, new_client(), names[1], 5.0)
    assert lease.name == names[1]
    assert not take(lease, new_client(), names[0], 5.0), "an old one is worth nothing"


def test_at_standstill_the_robot_does_not_wait_for_a_writer_whose_connection_ended() -> None:
    lease, writer = Lease(1.0), new_client()
    take(lease, writer, "", 0.0)
    lease.leave(new_client())
    assert not take(lease, new_client(), "", 0.1, standing=True), "it is still there"
    lease.leave(writer)
    assert not take(lease, new_client(), "", 0.2, standing=False), "it has time to come back"
    assert take(lease, new_client(), "", 0.2, standing=True)


def test_a_half_dead_connection_is_followed_by_its_own_writer_at_once() -> None:
    bench = Bench()
    old, got = bench.client()
    new, welcome = bench.client(lease=lease_of(got))
    assert lease_of(welcome) == lease_of(got)
    got.clear()
    bench.load(old)
    assert naks(got) == [(f.LOAD, "reader")], "it may only read on"
    bench.controller.on_closed(old)
    bench.load(new)
    assert last(welcome, f.ACK)["of"] == f.LOAD


def test_a_writer_that_vanished_leaves_its_lease_after_the_watchdog() -> None:
    bench = Bench()
    bench.client()
    bench.now = 0.9
    assert naks(bench.client()[1]) == [(f.HELLO, "busy")]
    bench.now = 1.1
    assert kinds(bench.client()[1])[0] == f.WELCOME


def test_readers_do_not_keep_a_lease_nor_a_robot_going() -> None:
    bench = Bench()
    writer, _ = bench.loaded()
    reader, _ = bench.client("reader")
    bench.resume(writer)
    bench.until(1.3, reader)
    assert bench.controller.status()["detail"] == "watchdog"
    assert kinds(bench.client()[1])[0] == f.WELCOME


def test_a_running_robot_is_not_handed_to_a_stranger() -> None:
    bench = Bench()
    writer, got = bench.loaded()
    bench.resume(writer)
    bench.until(0.5, writer)
    bench.controller.on_closed(writer)
    _, stranger = bench.client()
    assert naks(stranger) == [(f.HELLO, "busy")]
    _, again = bench.client(lease=lease_of(got))
    assert last(again, f.WELCOME)["status"]["state"] == "running"


def test_a_stranger_who_comes_as_the_watchdog_runs_out_gets_a_robot_that_stops() -> None:
    bench = Bench()
    writer, _ = bench.loaded()
    bench.resume(writer)
    bench.until(0.5, writer)
    bench.now += 1.01  # no tick in between
    stranger, got = bench.client()
    assert kinds(got)[0] == f.WELCOME
    bench.until(bench.now + 0.2, stranger)
    assert bench.controller.status()["detail"] == "watchdog"


@pytest.mark.parametrize("state", ["held", "running", "done"])
def test_a_connection_that_ends_and_comes_back_starts_nothing(state: str) -> None:
    bench = Bench()
    writer, got = bench.loaded()
    bench.resume(writer, until=3 if state == "held" else None)
    bench.until(5.0 if state == "done" else 0.8, writer)
    bench.controller.on_closed(writer)
    bench.until(bench.now + 2.0)
    assert bench.controller.status()["state"] == ("held" if state == "running" else state)
    moved = bench.controller.status()["executed"]
    back, _ = bench.client(lease=lease_of(got))
    bench.blocks(back, 0, LINES)
    bench.until(bench.now + 2.0, back)
    assert bench.controller.status()["executed"] == moved


def test_a_resume_from_before_a_stop_is_stale() -> None:
    bench = Bench()
    writer, got = bench.loaded()
    reader, _ = bench.client("reader")
    stops = last(got, f.ACK)["status"]["stops"]
    bench.say(reader, f.HOLD, {})
    for wrong in ({"stops": stops}, {"stops": None}, {}):
        bench.say(writer, f.RESUME, {"until": None, **wrong})
    assert naks(got) == [(f.RESUME, "stale")] * 3
    assert bench.controller.status()["state"] == "held"
    bench.say(writer, f.PING, {})
    bench.say(writer, f.RESUME, {"until": None, "stops": last(got, f.STATUS)["stops"]})
    assert bench.controller.status()["state"] == "running"


def test_the_watchdog_makes_a_resume_stale_too() -> None:
    bench = Bench()
    writer, got = bench.loaded()
    stops = bench.controller.stops
    bench.resume(writer)
    bench.until(2.0)
    bench.say(writer, f.RESUME, {"until": None, "stops": stops})
    assert naks(got) == [(f.RESUME, "stale")]


def test_blocks_that_are_not_those_announced_are_never_all_accepted() -> None:
    bench = Bench()
    writer, got = bench.client()
    bench.load(writer)
    bench.blocks(writer, 0, [*LINES[:7], b"G1 X8.1 F600", *LINES[8:]])
    assert naks(got) == [(f.BLOCKS, "hash")]
    assert bench.controller.motion.accepted == len(LINES) - 1
    bench.blocks(writer, len(LINES) - 1, LINES[-1:])
    bench.resume(writer)
    assert naks(got)[1:] == [(f.BLOCKS, "hash"), (f.RESUME, "no_program")]
    assert bench.controller.status()["state"] == "held"


def test_the_hash_is_of_the_blocks_however_they_come() -> None:
    bench = Bench()
    writer, got = bench.client()
    bench.load(writer)
    for first, last_ in ((0, 5), (3, 9), (11, 20), (9, 20), (0, 20)):
        bench.blocks(writer, first, LINES[first:last_])
    assert naks(got) == []
    assert bench.controller.motion.accepted == len(LINES)


def test_a_running_robot_goes_on_with_what_it_holds_after_a_refusal_and_is_not_started_again() -> None:
    bench = Bench(window=8)
    writer, got = bench.client()
    bench.load(writer)
    bench.blocks(writer, 0, LINES[:8])
    bench.resume(writer)
    bench.until(0.3, writer)
    accepted = bench.controller.motion.accepted
    bench.blocks(writer, accepted, [b"nonsense"])
    assert naks(got) == [(f.BLOCKS, "syntax")]
    bench.until(3.0, writer)
    status = bench.controller.status()
    assert (status["state"], status["detail"], status["executed"]) == ("held", "underrun", accepted)
    bench.resume(writer)
    assert naks(got)[1:] == [(f.RESUME, "no_program")]


def test_a_lost_accepted_is_sent_again_on_a_ping() -> None:
    bench = Bench()
    writer, got = bench.loaded()
    got.clear()
    bench.say(writer, f.PING, {})
    assert credits_sent(got) == [(len(LINES), 0)]
    assert kinds(got) == [f.ACCEPTED, f.STATUS]


def test_all_clients_learn_at_once_that_the_program_changed() -> None:
    bench = Bench()
    writer, _ = bench.client()
    _, got = bench.client("reader")
    bench.load(writer)
    assert last(got, f.STATUS)["program_sha256"] == "ab"
    bench.say(writer, f.ABORT, {})
    assert last(got, f.STATUS)["program_sha256"] == ""


def test_a_slow_client_gets_records_later_and_delays_no_other() -> None:
    bench = Bench()
    writer, got = bench.loaded()
    bench.resume(writer)
    bench.until(3.0, writer)
    bench.controller.motion.executed *= 3 * CHUNK // len(LINES)
    on_the_way = [0]
    slow_got: list[tuple[int, bytes]] = []
    slow = Client(lambda frame: slow_got.extend(f.Splitter().feed(frame)), lambda: on_the_way[0])
    on_the_way[0] = BACKLOG
    bench.say(slow, f.HELLO, {"protocol": 1, "role": "reader", "client": "slow", "executed_from": 0})
    bench.controller.tick(bench.now)
    assert executed(slow_got) == []
    assert len(executed(got)) == 3 * CHUNK
    on_the_way[0] = 0
    bench.controller.tick(bench.now)
    assert len(executed(slow_got)) == 3 * CHUNK


def test_noise_from_a_reader_requests_no_resend() -> None:
    bench = Bench()
    _, got = bench.loaded(LINES[:5])
    reader, renew = bench.client("reader")
    got.clear()
    renew.clear()
    bench.controller.on_broken(reader)
    assert got == renew == []
