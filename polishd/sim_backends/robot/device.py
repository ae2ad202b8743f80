"""Simulated robot controller on polishd's robot link: roles, program, credit and watchdog, and its process.

The controller is pure of I/O: the caller passes wall times.
"""

from __future__ import annotations

import asyncio
import signal
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from polishd.config.simulator_devices import SimRobotSection
from polishd.config.simulator_faults import MOTION
from polishd.sim_backends.common import framing
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.robot.motion import SimMotion, SimRobotBody
from polishd.sim_backends.robot.program_reader import Intake, Reach

# Clients of the robot controller, and which of them may write.

CHUNK = 2000
"""Blocks in one EXECUTED frame."""
BACKLOG = 1 << 19
"""Bytes on their way to a client beyond which records wait for the next tick."""


@dataclass(eq=False, slots=True)
class Client:
    """One connection."""

    send: Callable[[bytes], None]
    backlog: Callable[[], int] = lambda: 0
    """Bytes that it has not read yet."""
    role: str = ""
    reported: int = 0
    """Executed blocks of the program that were reported to it."""
    credit: tuple[int, int] = (-1, -1)
    awaits: list[int] = field(default_factory=list)
    """Types (HOLD, ABORT) whose ACK waits for standstill."""

    def ack(self, kind: int, status: dict[str, Any]) -> None:
        """Confirm it."""
        self.send(framing.pack_json(framing.ACK, {"of": kind, "status": status}))

    def report(self, credit: tuple[int, int], ahead_s: float, executed: Sequence[tuple[int, float, float]]) -> None:
        """Send ACCEPTED where ``credit`` changed, and EXECUTED where there is more and the client reads it."""
        if self.credit != credit:
            self.credit = credit
            self.send(framing.pack(framing.ACCEPTED, struct.pack(">IId", *credit, ahead_s)))
        while self.reported < len(executed) and self.backlog() < BACKLOG:
            part = executed[self.reported : self.reported + CHUNK]
            self.send(framing.pack_executed(part))
            self.reported += len(part)

    def nak(self, kind: int, code: str, text: str) -> None:
        """Refuse it."""
        self.send(framing.pack_json(framing.NAK, {"of": kind, "code": code, "text": text}))


@dataclass(slots=True)
class Lease:
    """The right to write. Each frame of its writer renews it; it lapses after its time without a frame."""

    lasts_s: float
    name: str = ""
    """The last lease given."""
    writer: Client | None = None
    """None while its holder is away."""
    _frame_s: float = float("-inf")
    _count: int = 0

    def take(self, client: Client, name: str, now_s: float, *, standing: bool) -> bool:
        """True if this connection may write from now on; the former writer may only read then.

        At standstill the robot does not wait for a writer whose connection has ended.
        """
        taken = self.silent_s(now_s) <= self.lasts_s and not (standing and self.writer is None)
        if not self.name or name != self.name:
            if taken:
                return False
            self._count += 1
            self.name = f"lease-{self._count}"
        if self.writer is not None:
            self.writer.role = "reader"
        self.writer, self._frame_s = client, now_s
        return True

    def renew(self, client: Client, now_s: float) -> None:
        """Take a sound frame of this connection."""
        if client is self.writer:
            self._frame_s = now_s

    def silent_s(self, now_s: float) -> float:
        """Time without a frame of the writer."""
        return now_s - self._frame_s

    def leave(self, client: Client) -> None:
        """End a connection."""
        if client is self.writer:
            self.writer = None


WRITER_ONLY = {framing.LOAD, framing.BLOCKS, framing.RESUME, framing.ABORT, framing.LIFT}
MAX_BLOCKS = 5_000_000
LONGEST_LIFT_MM = 500.0
Report = Callable[..., None]


@dataclass(slots=True)
class SimRobotController:
    """The robot's end of the robot link."""

    config: SimRobotSection
    motion: SimMotion
    identity: dict[str, str]
    reach: Reach
    report: Report
    """Write to the event log: (event, at_s=now, **data)."""
    clients: list[Client] = field(default_factory=list)
    lease: Lease = field(init=False)
    sha256: str = ""
    stops: int = 0
    """HOLD, ABORT, LIFT and watchdog stops, counted since the start: a RESUME with an older count is stale."""
    estop: bool = False
    """The emergency stop is pressed: no motion until the controller is started again."""
    _intake: Intake | None = None
    _was: str = "idle"

    def __post_init__(self) -> None:
        """Start without a writer."""
        self.lease = Lease(self.config.watchdog_s)

    def on_frame(self, client: Client, kind: int, payload: bytes, now_s: float) -> None:
        """Act on one intact frame."""
        self.lease.renew(client, now_s)
        if kind == framing.HELLO:
            self._hello(client, payload, now_s)
        elif not client.role:
            client.nak(kind, "protocol", "the first frame must be HELLO")
        elif kind in WRITER_ONLY and client is not self.lease.writer:
            client.nak(kind, "reader", "a client without the lease may only watch, ping and hold")
        elif kind == framing.BLOCKS:
            self._blocks(client, payload, now_s)
        else:
            self._command(client, kind, payload, now_s)

    def on_broken(self, client: Client) -> None:
        """A frame of this client was damaged: request it from the writer again."""
        if client is self.lease.writer and self._intake is not None:
            self._request_resend(client, self._intake)

    def on_closed(self, client: Client) -> None:
        """End a connection; the controller's state remains."""
        if client in self.clients:
            self.clients.remove(client)
        self.lease.leave(client)

    def tick(self, now_s: float) -> None:
        """Execute up to the present, check the watchdog, report to every client."""
        self.motion.advance(now_s)
        self._watch(now_s)
        self._changes()
        for client in self.clients:
            self._report_progress(client)

    def status(self) -> dict[str, Any]:
        """Return the STATUS object."""
        motion = self.motion
        return {
            "state": "fault" if self.estop else motion.state,
            "program_sha256": self.sha256,
            "accepted": motion.accepted,
            "executed": len(motion.executed),
            "buffer_s": round(motion.ahead_s, 6),
            "boot_id": self.identity["boot_id"],
            "stops": self.stops,
            "detail": "emergency stop" if self.estop else motion.detail,
            "time_s": round(motion.process_s, 6),
            "override": round(motion.reported_pace, 4),
        }

    def send_status(self) -> None:
        """Send STATUS to every client."""
        frame = framing.pack_json(framing.STATUS, self.status())
        for client in self.clients:
            client.send(frame)

    def _hello(self, client: Client, payload: bytes, now_s: float) -> None:
        message = framing.unpack_json(payload)
        role = message.get("role") if message else None
        if message is None or message.get("protocol") != 1 or role not in {"writer", "reader"} or client.role:
            client.nak(framing.HELLO, "protocol", "HELLO needs protocol 1 and a role, and is sent once")
            return
        self.motion.advance(now_s)
        self._watch(now_s)  # a running program is not handed to a new writer
        name, standing = str(message.get("lease", "")), self.motion.state != "running"
        if role == "writer" and not self.lease.take(client, name, now_s, standing=standing):
            client.nak(framing.HELLO, "busy", "another writer has the lease")
            return
        client.role = role
        self.clients.append(client)
        start = message.get("executed_from", 0)
        client.reported = start if isinstance(start, int) and start >= 0 else 0
        welcome = {"protocol": 1, **self.identity, "watchdog_s": self.config.watchdog_s, "window": self.config.window}
        lease = self.lease.name if role == "writer" else ""
        client.send(framing.pack_json(framing.WELCOME, {**welcome, "lease": lease, "status": self.status()}))
        self.report("client", role=role, client=str(message.get("client", "")))
        self._report_progress(client)

    def _watch(self, now_s: float) -> None:
        """Stop the program after the watchdog time."""
        silent_s = self.lease.silent_s(now_s)
        if self.motion.state == "running" and not self.motion.stopping and silent_s > self.config.watchdog_s:
            self.report("watchdog", silent_s=round(silent_s, 3))
            self._stop(now_s, "watchdog")

    def press(self, button: str, now_s: float) -> None:
        """``emergency stop`` or ``pause at the pendant``: stop without a command of the link."""
        self.estop = self.estop or button == "emergency stop"
        self._stop(now_s, button)
        self._changes()

    def _stop(self, now_s: float, why: str) -> None:
        self.stops += 1
        self.motion.hold(now_s, why)

    def _blocks(self, client: Client, payload: bytes, now_s: float) -> None:
        taken = framing.unpack_blocks(payload)
        intake = self._intake
        if taken is None:
            client.nak(framing.BLOCKS, "protocol", "malformed BLOCKS")
            return
        if intake is None:
            client.nak(framing.BLOCKS, "no_program", "LOAD first")
            return
        if refusal := intake.refusal():
            client.nak(framing.BLOCKS, *refusal)
            return
        first, lines = taken
        self.motion.advance(now_s)
        expected = self.motion.accepted
        if first > expected:
            self._request_resend(client, intake)
            return
        new = lines[expected - first :][: self._room()]
        if not new:
            return
        if blocks := intake.take(expected, new):
            self.motion.append(now_s, blocks)
        if refusal := intake.refusal():
            client.nak(framing.BLOCKS, *refusal)
        self._report_progress(client)

    def _request_resend(self, client: Client, intake: Intake) -> None:
        """Send RESEND, once for each gap: the frames behind a gap on the link are not new gaps."""
        expected = self.motion.accepted
        if intake.asked_from != expected:
            intake.asked_from = expected
            client.send(framing.pack(framing.RESEND, struct.pack(">I", expected)))

    def _room(self) -> int:
        """Return the number of blocks that may be sent."""
        motion = self.motion
        return max(min(len(motion.executed) + self.config.window, motion.path.blocks) - motion.accepted, 0)

    def _command(self, client: Client, kind: int, payload: bytes, now_s: float) -> None:
        message = framing.unpack_json(payload)
        if message is None:
            client.nak(kind, "protocol", "the payload is not a JSON object")
        elif kind == framing.PING:
            self.motion.advance(now_s)
            client.credit = (-1, -1)  # makes up for a lost ACCEPTED
            self._report_progress(client)
            client.send(framing.pack_json(framing.STATUS, self.status()))
        elif kind == framing.LOAD:
            self._load(client, message, now_s)
        elif kind == framing.RESUME:
            self._resume(client, message, now_s)
        elif kind in {framing.HOLD, framing.ABORT}:
            self._stop(now_s, "hold" if kind == framing.HOLD else "abort")
            client.awaits.append(kind)
            self._changes()
        elif kind == framing.LIFT:
            self._lift(client, message, now_s)
        else:
            client.nak(kind, "protocol", f"unknown type 0x{kind:02x}")

    def _lift(self, client: Client, message: dict[str, Any], now_s: float) -> None:
        distance_mm = message.get("distance_mm")
        if not isinstance(distance_mm, int | float) or not 0.0 < distance_mm <= LONGEST_LIFT_MM:
            client.nak(framing.LIFT, "protocol", f"LIFT needs distance_mm, at most {LONGEST_LIFT_MM:g}")
            return
        if self.estop:
            client.nak(framing.LIFT, "fault", "emergency stop")
            return
        self.stops += 1
        self.motion.lift(now_s, float(distance_mm))
        client.awaits.append(framing.LIFT)
        self._changes()

    def _load(self, client: Client, message: dict[str, Any], now_s: float) -> None:
        self.motion.advance(now_s)
        blocks, hashes = message.get("blocks"), [message.get(key) for key in ("program_sha256", "blocks_sha256")]
        name, hashed = (value if isinstance(value, str) else "" for value in hashes)
        if self.motion.state == "running":
            client.nak(framing.LOAD, "running", "hold first")
            return
        if not name or not hashed or not isinstance(blocks, int) or not 0 < blocks <= MAX_BLOCKS:
            client.nak(framing.LOAD, "protocol", "LOAD needs program_sha256, blocks_sha256 and blocks")
            return
        self.motion.load(blocks)
        self.sha256 = name
        self._intake = Intake(self.config, self.reach, blocks, hashed, self.motion.pose)
        for each in self.clients:
            each.reported = 0
        self.report("program_loaded", sha256=self.sha256, blocks=blocks)
        client.ack(framing.LOAD, self.status())
        self.send_status()
        self._report_progress(client)

    def _resume(self, client: Client, message: dict[str, Any], now_s: float) -> None:
        until, intake = message.get("until"), self._intake
        refusal = intake.refusal() if intake is not None else ("", "LOAD first")
        if self.estop:
            refusal = ("fault", "emergency stop")
        if refusal is not None:
            client.nak(framing.RESUME, "no_program", refusal[1])
        elif self.motion.lifted:
            client.nak(framing.RESUME, "no_program", "the tool was lifted off the path: LOAD again")
        elif until is not None and not isinstance(until, int):
            client.nak(framing.RESUME, "protocol", "until is a sequence number or null")
        elif message.get("stops") != self.stops:
            client.nak(
                framing.RESUME, "stale", f"{self.stops} stops, not {message.get('stops')}: read the status again"
            )
        else:
            self.motion.resume(now_s, until)
            client.ack(framing.RESUME, self.status())
            self._changes()

    def _changes(self) -> None:
        """Report starts and stops; send the ACKs that waited for standstill."""
        motion = self.motion
        while (state := motion.state) != (was := self._was):
            # before the report, which advances the motion to the present: it may have continued since
            self._was = state
            name = "motion_started" if state == "running" else "motion_stopped"
            if "running" in {state, was}:
                self.report(name, motion.changed_s, detail=motion.detail or state, executed=len(motion.executed))
        if motion.state == "running":
            return
        for client in [client for client in self.clients if client.awaits]:
            self._report_progress(client)
            for kind in client.awaits:
                if kind == framing.ABORT:
                    motion.forget()
                    self.sha256, self._intake, self._was = "", None, "idle"
                    self.send_status()
                client.ack(kind, self.status())
            client.awaits.clear()

    def _report_progress(self, client: Client) -> None:
        motion = self.motion
        client.report((motion.accepted, self._room()), motion.ahead_s, motion.executed)


# The process: the link's TCP side, the clock, and reports to the plant.

TICK_S = 0.01
STATUS_S = 0.05


class RobotServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime) -> None:
        identity = {
            "vendor": "polishd",
            "model": "simulated 3UPS-UP",
            "serial": "SIM-R1",
            "firmware": "1.0",
            "boot_id": runtime.boot_id,
        }
        machine = SimRobotBody(runtime)
        self._machine = machine
        robot = runtime.start.config.robot
        self.controller = SimRobotController(robot, machine.motion, identity, machine.reach, machine.event)

    async def run(self) -> None:
        """Tick until cancelled."""
        next_status = time.monotonic()
        while True:
            now = time.monotonic()
            self._machine.set_pace(now)
            self.controller.tick(now)
            self._machine.report()
            if now >= next_status:
                next_status = max(next_status + STATUS_S, now)
                self.controller.send_status()
            await asyncio.sleep(TICK_S)

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client's bytes: it acts on each whole frame. A connection alone moves nothing."""
        client, splitter, broken = Client(outlet.send, outlet.backlog), framing.Splitter(), 0
        outlet.on_closed = lambda: self.controller.on_closed(client)

        def feed(data: bytes) -> None:
            nonlocal broken
            for kind, payload in splitter.feed(data):
                self.controller.on_frame(client, kind, payload, time.monotonic())
            if splitter.broken > broken:
                broken = splitter.broken
                self.controller.on_broken(client)
            self._machine.report()

        return feed


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    server = RobotServer(runtime)
    config = runtime.start.config.robot
    wire = SimWire(runtime, server.connected)
    address = await wire.open_tcp(config.port)
    runtime.button(signal.SIGUSR1, lambda: server.controller.press("emergency stop", time.monotonic()), "estop")
    runtime.button(signal.SIGUSR2, lambda: server.controller.press("pause at the pendant", time.monotonic()))
    wire.ready(f"tcp://{address}")
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="robot_link",
        device="robot",
        section=SimRobotSection,
        links={"link": {"": "robot_link"}},
        main=main,
        faults=(*MOTION, "estop"),
    )
]
