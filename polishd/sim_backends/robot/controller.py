"""The robot controller's mind: roles, program, credit, watchdog. Pure of I/O; wall times are handed in."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from polishd.model.errors import ProgramError
from polishd.model.surface import BoolArray
from polishd.sim_backends.config import Robot
from polishd.sim_backends.robot import frames
from polishd.sim_backends.robot.motion import Motion
from polishd.sim_backends.robot.rnc import Block, Reader

WRITER_ONLY = {frames.LOAD, frames.BLOCKS, frames.RESUME, frames.ABORT}
CHUNK = 2000
"""Blocks in one EXECUTED frame."""

Report = Callable[..., None]


@dataclass(eq=False, slots=True)
class Client:
    """One connection."""

    send: Callable[[bytes], None]
    role: str = ""
    told: int = 0
    """Executed blocks of the program that it was told of."""
    credit: tuple[int, int] = (-1, -1)
    broken: int = 0
    awaits: list[int] = field(default_factory=list)
    """Types (HOLD, ABORT) whose ACK waits for standstill."""


@dataclass(slots=True)
class Controller:
    """What answers on the robot link."""

    config: Robot
    motion: Motion
    identity: dict[str, str]
    reach: Callable[[list[Block]], BoolArray]
    """Which of these blocks end where the robot can be, (n,)."""
    report: Report
    """Tells the witness: (event, at_s=now, **data)."""
    clients: list[Client] = field(default_factory=list)
    writer: Client | None = None
    heard_s: float = 0.0
    """Wall time of the writer's last frame."""
    sha256: str = ""
    _reader: Reader | None = None
    _gap_told: int = -1
    _was: str = "idle"

    def on_frame(self, client: Client, kind: int, payload: bytes, now_s: float) -> None:
        """Act on one intact frame."""
        if client is self.writer:
            self.heard_s = now_s
        if kind == frames.HELLO:
            self._hello(client, payload, now_s)
        elif not client.role:
            self._nak(client, kind, "protocol", "the first frame must be HELLO")
        elif kind in WRITER_ONLY and client.role != "writer":
            self._nak(client, kind, "reader", "readers may only watch, ping and hold")
        elif kind == frames.BLOCKS:
            self._blocks(client, payload, now_s)
        else:
            self._command(client, kind, payload, now_s)

    def on_broken(self, client: Client) -> None:
        """A frame of this client was damaged: ask the writer to send again."""
        if client is self.writer and self.motion.state != "idle":
            client.send(frames.pack(frames.RESEND, struct.pack(">I", self.motion.accepted)))

    def on_closed(self, client: Client) -> None:
        """A connection ended; the controller's state does not."""
        if client in self.clients:
            self.clients.remove(client)
        if client is self.writer:
            self.writer = None

    def tick(self, now_s: float) -> None:
        """Execute up to the present, mind the watchdog, tell everyone."""
        self.motion.advance(now_s)
        if (
            self.motion.state == "running"
            and not self.motion.stopping
            and now_s - self.heard_s > self.config.watchdog_s
        ):
            self.report("watchdog", silent_s=round(now_s - self.heard_s, 3))
            self.motion.hold(now_s, "watchdog")
        self._changes()
        for client in self.clients:
            self._tell(client)

    def status(self) -> dict[str, Any]:
        """The STATUS object."""
        motion = self.motion
        return {
            "state": motion.state,
            "program_sha256": self.sha256,
            "accepted": motion.accepted,
            "executed": len(motion.executed),
            "buffer_s": round(motion.ahead_s, 6),
            "boot_id": self.identity["boot_id"],
            "detail": motion.detail,
            "time_s": round(motion.process_s, 6),
        }

    def send_status(self) -> None:
        """STATUS to everyone."""
        frame = frames.pack_json(frames.STATUS, self.status())
        for client in self.clients:
            client.send(frame)

    def _hello(self, client: Client, payload: bytes, now_s: float) -> None:
        message = frames.unpack_json(payload)
        role = message.get("role") if message else None
        if message is None or message.get("protocol") != 1 or role not in {"writer", "reader"} or client.role:
            self._nak(client, frames.HELLO, "protocol", "HELLO wants protocol 1, a role, and comes once")
            return
        if role == "writer" and self.writer is not None:
            self._nak(client, frames.HELLO, "busy", "another writer is connected")
            return
        client.role = role
        self.clients.append(client)
        if role == "writer":
            self.writer, self.heard_s = client, now_s
        self.motion.advance(now_s)
        start = message.get("executed_from", 0)
        client.told = start if isinstance(start, int) and start >= 0 else 0
        welcome = {"protocol": 1, **self.identity, "watchdog_s": self.config.watchdog_s, "window": self.config.window}
        client.send(frames.pack_json(frames.WELCOME, {**welcome, "status": self.status()}))
        self.report("client", role=role, client=str(message.get("client", "")))
        self._tell(client)

    def _blocks(self, client: Client, payload: bytes, now_s: float) -> None:
        taken = frames.unpack_blocks(payload)
        if taken is None:
            self._nak(client, frames.BLOCKS, "protocol", "malformed BLOCKS")
            return
        if self._reader is None:
            self._nak(client, frames.BLOCKS, "no_program", "LOAD first")
            return
        first, lines = taken
        expected = self.motion.accepted
        if first > expected:
            if self._gap_told != expected:
                self._gap_told = expected
                client.send(frames.pack(frames.RESEND, struct.pack(">I", expected)))
            return
        self.motion.advance(now_s)
        room = min(len(self.motion.executed) + self.config.window, self.motion.path.blocks) - expected
        self._accept(client, lines[expected - first :][: max(room, 0)], now_s)

    def _accept(self, client: Client, lines: list[bytes], now_s: float) -> None:
        reader = self._reader
        if reader is None or not lines:
            return
        read: list[Block] = []
        for k, line in enumerate(lines):
            try:
                block = reader.read(line)
            except ProgramError as error:
                self._refuse(client, "syntax", f"block {self.motion.accepted + k}: {error}")
                break
            outside = self._outside(block)
            if outside:
                self._refuse(client, "limits", f"block {self.motion.accepted + k}: {outside}")
                break
            read.append(block)
        can = self.reach(read)
        if not can.all():
            bad = int(can.argmin())
            del read[bad:]
            self._refuse(client, "limits", f"block {self.motion.accepted + bad}: out of the robot's reach")
        if read:
            self.motion.append(now_s, read)
        self._tell(client)

    def _refuse(self, client: Client, code: str, text: str) -> None:
        """Nothing after a refused block is accepted."""
        self._reader = None
        self._nak(client, frames.BLOCKS, code, text)

    def _outside(self, block: Block) -> str:
        limits = self.config
        ranges = (limits.x_mm, limits.y_mm, limits.z_mm, limits.a_deg)
        for axis, value, (low, high) in zip("XYZA", block.end, ranges, strict=False):
            if not low <= value <= high:
                return f"{axis} {value:g} is outside {low:g} to {high:g}"
        return ""

    def _command(self, client: Client, kind: int, payload: bytes, now_s: float) -> None:
        message = frames.unpack_json(payload)
        if message is None:
            self._nak(client, kind, "protocol", "the payload is not a JSON object")
        elif kind == frames.PING:
            self.motion.advance(now_s)
            self._tell(client)
            client.send(frames.pack_json(frames.STATUS, self.status()))
        elif kind == frames.LOAD:
            self._load(client, message, now_s)
        elif kind == frames.RESUME:
            self._resume(client, message, now_s)
        elif kind in {frames.HOLD, frames.ABORT}:
            self.motion.hold(now_s, "hold" if kind == frames.HOLD else "abort")
            client.awaits.append(kind)
            self._changes()
        else:
            self._nak(client, kind, "protocol", f"unknown type 0x{kind:02x}")

    def _load(self, client: Client, message: dict[str, Any], now_s: float) -> None:
        self.motion.advance(now_s)
        blocks, sha256 = message.get("blocks"), message.get("program_sha256")
        if self.motion.state == "running":
            self._nak(client, frames.LOAD, "running", "hold first")
            return
        if not isinstance(blocks, int) or not isinstance(sha256, str) or not 0 < blocks <= 5_000_000:
            self._nak(client, frames.LOAD, "protocol", "LOAD wants program_sha256 and blocks")
            return
        self.motion.load(blocks)
        self.sha256, self._gap_told = sha256, -1
        self._reader = Reader(self.motion.pose)
        for each in self.clients:
            each.told = 0
        self.report("program_loaded", sha256=sha256, blocks=blocks)
        self._ack(client, frames.LOAD)
        self._tell(client)

    def _resume(self, client: Client, message: dict[str, Any], now_s: float) -> None:
        until = message.get("until")
        if self.motion.state == "idle":
            self._nak(client, frames.RESUME, "no_program", "LOAD first")
            return
        if until is not None and not isinstance(until, int):
            self._nak(client, frames.RESUME, "protocol", "until is a sequence number or null")
            return
        self.motion.resume(now_s, until)
        self._ack(client, frames.RESUME)
        self._changes()

    def _changes(self) -> None:
        """Report starts and stops; give the ACKs that waited for standstill."""
        motion = self.motion
        if motion.state != self._was:
            name = "motion_started" if motion.state == "running" else "motion_stopped"
            if "running" in {motion.state, self._was}:
                self.report(name, motion.changed_s, detail=motion.detail or motion.state, executed=len(motion.executed))
            self._was = motion.state
        if motion.state == "running":
            return
        for client in [client for client in self.clients if client.awaits]:
            self._tell(client)
            for kind in client.awaits:
                if kind == frames.ABORT:
                    motion.forget()
                    self.sha256, self._reader, self._was = "", None, "idle"
                self._ack(client, kind)
            client.awaits.clear()

    def _tell(self, client: Client) -> None:
        """ACCEPTED where it changed, EXECUTED where there is more."""
        executed = self.motion.executed
        accepted = self.motion.accepted
        room = min(len(executed) + self.config.window, self.motion.path.blocks) - accepted
        if client.credit != (accepted, room):
            client.credit = (accepted, room)
            client.send(frames.pack(frames.ACCEPTED, struct.pack(">II", accepted, max(room, 0))))
        while client.told < len(executed):
            part = executed[client.told : client.told + CHUNK]
            client.send(frames.pack_executed(part))
            client.told += len(part)

    def _ack(self, client: Client, kind: int) -> None:
        client.send(frames.pack_json(frames.ACK, {"of": kind, "status": self.status()}))

    def _nak(self, client: Client, kind: int, code: str, text: str) -> None:
        client.send(frames.pack_json(frames.NAK, {"of": kind, "code": code, "text": text}))
