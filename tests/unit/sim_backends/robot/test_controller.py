"""The robot controller: who may do what, credit, gaps, watchdog."""

from __future__ import annotations

import hashlib
import json
import struct
from typing import Any

import numpy as np
import pytest

from polishd.config.simulator_devices import SimRobotSection
from polishd.sim_backends.common import framing as f
from polishd.sim_backends.robot.device import Client, SimRobotController
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.trajectory import Limits

LIMITS = Limits(accel_mm_s2=1000.0, overhead_s=0.0, corner_deg=30.0, rapid_mm_s=100.0, max_feed_mm_s=100.0, speed=1.0)
LINES = [f"G1 X{k} F600".encode() for k in range(1, 21)]

Frames = list[tuple[int, bytes]]


class Bench:
    """A controller, its log, and what clients were sent."""

    def __init__(self, **config: Any) -> None:
        self.log = []
        motion = SimMotion(LIMITS, (0.0, 0.0, 50.0, 0.0, 0.0))
        self.controller = SimRobotController(
            SimRobotSection(**{"watchdog_s": 1.0, "window": 4096, **config}),
            motion,
            {"boot_id": "b1", "vendor": "v", "model": "m", "serial": "s", "firmware": "f"},
            lambda blocks: np.array([abs(block.end[1]) < 100.0 for block in blocks], dtype=bool),
            lambda name, at_s=None, **data: self.log.append((name, data)),
        )
        self.now = 0.0

    def client(self, role: str = "writer", executed_from: int = 0, lease: str = "") -> tuple[Client, Frames]:
        client = Client(lambda frame: client_frames.extend(f.Splitter().feed(frame)))
        client_frames = []
        hello = {"protocol": 1, "role": role, "client": "t", "executed_from": executed_from, "lease": lease}
        self.say(client, f.HELLO, hello)
        return client, client_frames

    def load(self, client: Client, lines: list[Any] = LINES, **changes: Any) -> None:
        blocks_sha256 = hashlib.sha256(b"".join(line + b"\n" for line in lines)).hexdigest()
        message = {"program_sha256": "ab", "blocks_sha256": blocks_sha256, "blocks": len(lines)}
        self.say(client, f.LOAD, message | changes)

    def resume(self, client: Client, until: int | None = None) -> None:
        self.say(client, f.RESUME, {"until": until, "stops": self.controller.stops})

    def say(self, client: Any, kind: int, message: Any) -> None:
        payload = message if isinstance(message, bytes) else json.dumps(message).encode()
        self.controller.on_frame(client, kind, payload, self.now)

    def blocks(self, client: Any, first: int, lines: list[Any]) -> None:
        kind, payload = next(iter(f.Splitter().feed(f.pack_blocks(first, lines))))
        self.controller.on_frame(client, kind, payload, self.now)

    def loaded(self, lines: list[Any] = LINES, **config: Any) -> tuple[Client, Frames]:
        client, got = self.client()
        self.load(client, lines)
        self.blocks(client, 0, lines)
        return client, got

    def until(self, now: float, client: Any = None, step: float = 0.05) -> None:
        """Let time pass; a client given keeps pinging."""
        while self.now < now:
            self.now += step
            if client is not None:
                self.say(client, f.PING, {})
            self.controller.tick(self.now)


def kinds(got: Frames) -> list[int]:
    return [kind for kind, _ in got]


def last(got: Frames, kind: int) -> dict[str, Any]:
    return json.loads(next(payload for which, payload in reversed(got) if which == kind))


def naks(got: Frames) -> list[tuple[int, str]]:
    return [(m["of"], m["code"]) for m in (json.loads(p) for k, p in got if k == f.NAK)]


def credits_sent(got: Frames) -> list[tuple[int, int]]:
    return [struct.unpack(">IId", payload)[:2] for kind, payload in got if kind == f.ACCEPTED]


def executed(got: Frames) -> list[tuple[int, float, float]]:
    return [block for kind, payload in got if kind == f.EXECUTED for block in f.unpack_executed(payload)]


def test_hello_is_answered_by_welcome_and_credit() -> None:
    _, got = Bench().client()
    assert kinds(got) == [f.WELCOME, f.ACCEPTED]
    welcome = last(got, f.WELCOME)
    assert welcome["protocol"] == 1
    assert welcome["boot_id"] == "b1"
    assert welcome["window"] == 4096
    assert welcome["status"]["state"] == "idle"
    assert credits_sent(got) == [(0, 0)]


def test_nothing_before_hello_and_hello_once() -> None:
    bench = Bench()
    client, got = Bench().client()
    stranger = []
    fresh = Client(lambda frame: stranger.extend(f.Splitter().feed(frame)))
    bench.say(fresh, f.PING, {})
    assert naks(stranger) == [(f.PING, "protocol")]
    bench.say(client, f.HELLO, {"protocol": 1, "role": "writer"})
    assert naks(got) == [(f.HELLO, "protocol")]


def test_one_writer_any_number_of_readers() -> None:
    bench = Bench()
    writer, _ = bench.client()
    _, second = bench.client()
    assert naks(second) == [(f.HELLO, "busy")]
    reader, got = bench.client("reader")
    for kind in (f.LOAD, f.RESUME, f.ABORT):
        bench.say(reader, kind, {})
    bench.blocks(reader, 0, LINES)
    assert naks(got) == [(kind, "reader") for kind in (f.LOAD, f.RESUME, f.ABORT, f.BLOCKS)]
    bench.controller.on_closed(writer)
    _, third = bench.client()
    assert kinds(third)[0] == f.WELCOME


def test_load_send_run_done() -> None:
    bench = Bench()
    client, got = bench.loaded()
    assert last(got, f.ACK)["of"] == f.LOAD
    assert credits_sent(got)[-1] == (20, 0)
    held_s = struct.unpack(">IId", got[-1][1])[2]
    assert held_s == pytest.approx(bench.controller.status()["buffer_s"], abs=1e-6)
    assert held_s == pytest.approx(2.0, rel=0.05), "20 mm at 10 mm/s"
    bench.resume(client)
    bench.until(3.0, client)
    assert bench.controller.status()["state"] == "done"
    assert [seq for seq, _, _ in executed(got)] == list(range(20))
    assert [name for name, _ in bench.log] == ["client", "program_loaded", "motion_started", "motion_stopped"]


def test_repeated_blocks_are_ignored_and_gaps_requested_once() -> None:
    bench = Bench()
    client, got = bench.client()
    bench.load(client)
    bench.blocks(client, 0, LINES[:5])
    bench.blocks(client, 3, LINES[3:8])
    assert bench.controller.motion.accepted == 8
    got.clear()
    bench.blocks(client, 12, LINES[12:])
    bench.blocks(client, 14, LINES[14:])
    assert got == [(f.RESEND, struct.pack(">I", 8))]
    bench.blocks(client, 8, LINES[8:10])
    bench.blocks(client, 12, LINES[12:])
    assert got[-1] == (f.RESEND, struct.pack(">I", 10))


def test_a_damaged_frame_is_requested_again() -> None:
    bench = Bench()
    client, got = bench.loaded(LINES[:5])
    bench.controller.on_broken(client)
    bench.controller.on_broken(client)
    assert got[-1] == (f.RESEND, struct.pack(">I", 5))
    assert kinds(got).count(f.RESEND) == 1


def test_the_window_bounds_what_is_taken_and_moves_with_execution() -> None:
    bench = Bench(window=6)
    client, got = bench.client()
    bench.load(client)
    assert credits_sent(got)[-1] == (0, 6)
    bench.blocks(client, 0, LINES)
    assert credits_sent(got)[-1] == (6, 0)
    bench.resume(client, 4)
    bench.until(2.0, client)
    assert (6, 4) in credits_sent(got)


@pytest.mark.parametrize(
    ("line", "code"),
    [(b"G7 X1", "syntax"), (b"G1 X500 F60", "limits"), (b"G1 A80 F60", "limits"), (b"G1 Y120 F60", "limits")],
)
def test_a_bad_block_is_refused_and_nothing_after_it_is_taken(line: bytes, code: str) -> None:
    bench = Bench()
    client, got = bench.loaded([*LINES[:3], line, *LINES[4:]])
    assert naks(got) == [(f.BLOCKS, code)]
    assert bench.controller.motion.accepted == 3
    bench.blocks(client, 3, LINES[3:])
    assert bench.controller.motion.accepted == 3


def test_the_writers_silence_leads_to_hold() -> None:
    bench = Bench()
    client, _got = bench.loaded()
    bench.resume(client)
    bench.until(0.5, client)
    bench.until(1.45)
    assert bench.controller.status()["state"] == "running"
    bench.until(1.7)
    status = bench.controller.status()
    assert (status["state"], status["detail"]) == ("held", "watchdog")
    assert "watchdog" in [name for name, _ in bench.log]


def test_a_lost_connection_does_not_stop_the_state_and_a_new_one_hears_it_all() -> None:
    bench = Bench()
    client, _ = bench.loaded()
    bench.resume(client)
    bench.until(0.6, client)
    bench.controller.on_closed(client)
    lease = bench.controller.lease.name
    _, got = bench.client(executed_from=2, lease=lease)
    assert last(got, f.WELCOME)["lease"] == lease
    assert [seq for seq, _, _ in executed(got)] == list(range(2, len(bench.controller.motion.executed)))
    assert bench.controller.status()["state"] == "running"


def test_hold_by_a_reader_is_acknowledged_at_standstill() -> None:
    bench = Bench()
    client, _ = bench.loaded()
    reader, got = bench.client("reader")
    bench.resume(client)
    bench.until(0.5, client)
    bench.say(reader, f.HOLD, {})
    assert f.ACK not in kinds(got)
    bench.until(0.6, client)
    assert last(got, f.ACK)["of"] == f.HOLD
    assert last(got, f.ACK)["status"]["state"] == "held"


def test_abort_forgets() -> None:
    bench = Bench()
    client, got = bench.loaded()
    bench.resume(client)
    bench.until(0.5, client)
    bench.say(client, f.ABORT, {})
    bench.until(0.6, client)
    assert last(got, f.ACK)["of"] == f.ABORT
    assert last(got, f.ACK)["status"]["state"] == "idle"
    assert bench.controller.status()["state"] == "idle"
    bench.resume(client)
    assert naks(got) == [(f.RESUME, "no_program")]


def test_load_is_refused_while_running_and_when_it_is_nonsense() -> None:
    bench = Bench()
    client, got = bench.loaded()
    bench.resume(client)
    bench.load(client)
    bench.until(3.0, client)
    for nonsense in ({"program_sha256": 5}, {"blocks_sha256": ""}, {"blocks": 0}, {"blocks": "3"}):
        bench.load(client, **nonsense)
    bench.say(client, f.LOAD, b"nonsense")
    assert naks(got) == [(f.LOAD, "running")] + [(f.LOAD, "protocol")] * 5


def test_unknown_types_are_refused() -> None:
    bench = Bench()
    client, got = bench.client()
    bench.say(client, 0x55, {})
    assert naks(got) == [(0x55, "protocol")]


def test_a_stop_is_reported_although_the_report_of_the_start_takes_time() -> None:
    """Reporting brings the motion to the present; on a busy machine a short retreat is over by then (issue 12.12)."""
    bench = Bench()
    client, _ = bench.loaded([b"G1 X1 F6000"])
    controller, log = bench.controller, bench.log

    def slowly(name: str, at_s: float | None = None, **data: Any) -> None:
        log.append((name, data))
        controller.motion.advance(bench.now + 1.0)

    controller.report = slowly
    bench.resume(client)
    bench.until(0.2)
    reported = [name for name, _ in log if name.startswith("motion")]
    assert (controller.motion.state, reported) == ("done", ["motion_started", "motion_stopped"])
