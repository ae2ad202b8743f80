"""URScript program for the controller: the plan's lines run in a thread that reports its block and is supervised.

The lines themselves are unchanged. A call before each line that moves or waits writes its block to a register, and
waits if the block may not begin yet (docs/protocols/universal_robots.md).
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from polishd.api import DeviceRefused, Plan, ProtocolError
from polishd.drivers.transport.program_tracker import ProgramTracker, time_shares
from polishd.drivers.universal_robots.rtde import RtdeSample, ScriptPhase, UrRegisters, UrRuntimeState

LONGEST_LINE = 4096
NAME = "polishd"
STOP_M_S2 = 2.0
"""Deceleration of a stop: from 100 mm/s within 2.5 mm."""
LIFT_M_S, LIFT_M_S2 = 0.1, 1.0

_BEGIN = re.compile(rb"\s*(?:def\s+(\w+)\s*\(\s*\)|(thread)\b.*|(?:while|if)\b.*)\s*:")
_END = re.compile(rb"\s*end\s*(?:#.*)?")
_CALL = re.compile(rb"\s*(\w+)\s*\(\s*\)\s*(?:#.*)?")
_ACTS = re.compile(rb"\s*(?:movel|movep|movec|movej|sleep)\s*\(")
_DWELLS = re.compile(rb"(\s*sleep\s*\(\s*)([0-9.eE+-]+)(\s*\).*)")
_ARC = re.compile(rb"\s*movec\s*\(")

_HEAD = """def polishd():
  write_output_integer_register({block}, {start})
  write_output_integer_register({phase}, {waits})
  write_output_integer_register({reported}, {token})
  global polishd_over = False
  def polishd_at(seq):
    if read_input_integer_register({token_in}) != {token} or read_input_integer_register({until}) <= seq:
      write_output_integer_register({block}, seq)
      write_output_integer_register({phase}, {waits})
      while read_input_integer_register({token_in}) != {token} or read_input_integer_register({until}) <= seq:
        sync()
      end
    end
    write_output_integer_register({block}, seq)
    write_output_integer_register({phase}, {runs})
  end
  thread polishd_path():
"""
_TAIL = """
    write_output_integer_register({block}, {blocks})
    global polishd_over = True
  end
  rtde_set_watchdog("input_int_register_{beat}", {rate}, "stop")
  polishd_turns = 0
  polishd_thread = run polishd_path()
  while not polishd_over and (read_input_integer_register({token_in}) != {token} or read_input_integer_register({order}) == 0):
    polishd_turns = polishd_turns + 1
    write_output_integer_register({turns}, polishd_turns)
    sync()
  end
  kill polishd_thread
  write_output_integer_register({phase}, {ends})
  polishd_phase = {held}
  polishd_accel = {stop_accel}
  if polishd_over:
    polishd_phase = {done}
  elif read_input_integer_register({order}) == 2:
    polishd_here = get_target_tcp_pose()
    polishd_up = pose_trans(polishd_here, p[0, 0, {up}, 0, 0, 0])
    polishd_way = read_input_integer_register({lift}) * 0.000001
    polishd_accel = {lift_accel}
    polishd_speed = {lift_speed}
    if polishd_speed * polishd_speed > polishd_way * polishd_accel:
      polishd_speed = sqrt(polishd_way * polishd_accel)
    end
    polishd_x = (polishd_up[0] - polishd_here[0]) * polishd_speed
    polishd_y = (polishd_up[1] - polishd_here[1]) * polishd_speed
    polishd_z = (polishd_up[2] - polishd_here[2]) * polishd_speed
    speedl([polishd_x, polishd_y, polishd_z, 0, 0, 0], polishd_accel, polishd_way / polishd_speed)
    polishd_phase = {lifted}
  end
  stopl(polishd_accel)
  write_output_integer_register({phase}, polishd_phase)
end
"""  # noqa: E501 -- one statement of URScript is one line


@dataclass(frozen=True, slots=True)
class Settings:
    """What all programs of a cell share."""

    registers: UrRegisters
    watchdog_s: float
    """The controller stops a program that hears nothing for so long."""
    into_part: bool = True
    """Where the tool frame's z points."""


@dataclass(frozen=True, slots=True)
class ScriptLine:
    """One line of the plan."""

    text: bytes
    acts: bool
    """It moves or waits; the others take no time."""
    frame: bool
    """Whether the line is structure of the file (``def``, ``end``, a call) that is not run."""

    @property
    def dwell_s(self) -> float | None:
        """Waiting time, s; None for a line that does not wait."""
        match = _DWELLS.match(self.text) if self.acts else None
        return float(match[2]) if match else None


def blocks_of(lines: Sequence[bytes]) -> list[ScriptLine]:
    """Classify each line. DeviceRefused for lines whose position cannot be tracked: loops, branches, threads."""
    found: list[ScriptLine] = []
    opened, moving = "", _moving(lines)
    for seq, line in enumerate(lines):
        begin, call = _BEGIN.match(line), _CALL.fullmatch(line)
        if begin is not None and (begin[1] is None or opened):
            raise DeviceRefused(f"block {seq}: loops, branches, threads and nested routines cannot be followed")
        if begin is not None:
            opened = begin[1].decode()
        ends = _END.fullmatch(line) is not None
        dead = bool(opened) and bool(moving) and opened != moving
        calls = call is not None and call[1].decode() == moving and not opened
        frame = begin is not None or ends or calls or dead
        found.append(ScriptLine(line, not frame and _ACTS.match(line) is not None, frame))
        opened = "" if ends else opened
    if not any(block.acts for block in found):
        raise DeviceRefused("no line of the program moves or waits in URScript. Check [program] format.")
    return found


def _moving(lines: Sequence[bytes]) -> str:
    """Return the name of the routine that moves; empty if the lines are in none."""
    opened = ""
    for line in lines:
        begin = _BEGIN.match(line)
        if begin is not None and begin[1] is not None:
            opened = begin[1].decode()
        elif _END.fullmatch(line):
            opened = ""
        elif opened and _ACTS.match(line):
            return opened
    return ""


@dataclass(frozen=True, slots=True)
class UrScript:
    """A script to send, from one of the program's blocks on."""

    token: int
    text: bytes
    block_of: list[int] = field(repr=False)
    """Block of each line of the text, 0-based; -1 for added lines."""

    def names(self, line: int) -> str:
        """Return the name of a 1-based line of the text in the program, for messages."""
        block = self.block_of[line - 1] if 0 < line <= len(self.block_of) else -1
        return f"block {block}" if block >= 0 else f"line {line}, which polishd adds"


def assemble(blocks: Sequence[ScriptLine], start: int, spent_s: float, token: int, settings: Settings) -> UrScript:
    """Build the script for the blocks from ``start`` on, of which the first has waited ``spent_s``.

    Earlier lines that take no time are repeated: they may set a tool or a position that the rest needs.
    DeviceRefused inside an arc: only its end and one of its points are known.
    """
    if 0 < start < len(blocks) and spent_s > 0.0 and _ARC.match(blocks[start].text):
        raise DeviceRefused(f"block {start}: an arc cannot be continued from within")
    words = _words(start, len(blocks), token, settings)
    lines = _HEAD.format(**words).encode().splitlines()
    block_of = [-1] * len(lines)
    for seq, block in enumerate(blocks):
        if block.frame or (block.acts and seq < start):
            continue
        if block.acts:
            lines.append(b"    polishd_at(%d)" % seq)
            block_of.append(-1)
        lines.append(b"    " + _rest(block, spent_s if seq == start else 0.0))
        block_of.append(seq)
    tail = _TAIL.format(**words).encode().splitlines()[1:]
    return UrScript(token, b"\n".join([*lines, *tail, b""]), [*block_of, *[-1] * len(tail)])


def _rest(block: ScriptLine, spent_s: float) -> bytes:
    """Return the line; of a dwell, its rest."""
    match = _DWELLS.match(block.text)
    if match is None or not spent_s:
        return block.text.strip()
    return b"%b%.4f%b" % (match[1].strip(), max(float(match[2]) - spent_s, 0.0), match[3].strip())


def _words(start: int, blocks: int, token: int, settings: Settings) -> dict[str, object]:
    first = settings.registers.first
    inputs = dict(zip(("beat", "token_in", "until", "order", "lift"), range(first, first + 5), strict=True))
    outputs = dict(zip(("reported", "block", "phase", "turns"), range(first, first + 4), strict=True))
    phases = {phase.name.lower(): int(phase) for phase in ScriptPhase}
    return {
        **inputs,
        **outputs,
        **phases,
        "token": token,
        "start": start,
        "blocks": blocks,
        "rate": f"{1.0 / settings.watchdog_s:.6g}",
        "up": -1 if settings.into_part else 1,
        "lift_speed": LIFT_M_S,
        "lift_accel": LIFT_M_S2,
        "stop_accel": STOP_M_S2,
    }


# Progress of the controller in our program. Sans-IO: samples in, records of blocks out.

START_S = 5.0
"""Time that may pass with standstill after a command, on our clock, since earlier samples may arrive late."""
SILENT_S = 0.1
"""Time without running after which a program is gone, whatever its registers report; the same clock."""
LIVE = (ScriptPhase.WAITS, ScriptPhase.RUNS)


class UrProgramTracker(ProgramTracker):
    """Tracker of one program from its load to its end.

    A block ends when a sample names a later one, so each boundary is known to one sample, without gaps. A block counts
    only after two equal samples, so that one damaged number does not count blocks that were not executed.
    """

    def __init__(self, plan: Plan, blocks: int, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__(plan, blocks)
        self.token = 0
        """Token of the script that was sent last."""
        self.live = False
        """Whether that script waits or runs on the controller."""
        self.until = 0
        """Blocks below this one may begin."""
        self._moves = np.zeros(0, dtype=bool)
        self._dwells = np.zeros(0, dtype=bool)
        self._dwell_s = np.zeros(0)
        self._now_s = now_s
        self._ordered_s = 0.0
        self._turned_s = 0.0
        """Time at which the program ran last."""
        self._last: RtdeSample | None = None

    @property
    def spent_s(self) -> float:
        """Process time of the present block so far."""
        return self.clock_s - self.began_s

    @property
    def heard(self) -> bool:
        """Whether the script that was sent last has reported."""
        return self._last is not None

    def sent(self, token: int, blocks: Sequence[ScriptLine]) -> None:
        """Record that a script with that token was sent; it waits before its first block."""
        self.token, self.until, self._last, self.live = token, 0, None, False
        self._dwells = np.array([block.dwell_s is not None for block in blocks], dtype=bool)
        self._moves = np.array([block.acts for block in blocks], dtype=bool) & ~self._dwells
        self._dwell_s = np.array([block.dwell_s or 0.0 for block in blocks])

    def go(self, time_s: float, detail: str = "") -> None:
        """Begin to run, or continue, up to ``until``."""
        super().go(time_s, detail)
        self._ordered_s = self._now_s()

    def drop(self, reason: str) -> None:
        """End the program: it will not be continued."""
        super().drop(reason)
        self.live = False

    def update(self, sample: RtdeSample) -> None:
        """Process a sample. ProtocolError if it is impossible."""
        if not self.token:
            return
        if sample.token != self.token:
            if self.live:
                self._fail("the controller runs another program, or has restarted")
            return
        before, self._last = self._last, sample
        if before is None or sample.turns != before.turns:
            self._turned_s = sample.time_s
        if before is None:
            self.live = True
        else:
            self._book(before, sample)
        if not self.ended:
            self._judge(before or sample, sample)

    def _book(self, before: RtdeSample, sample: RtdeSample) -> None:
        if not before.block <= sample.block <= self.blocks:
            raise ProtocolError(f"the robot reports block {sample.block} of {self.blocks}, after block {before.block}")
        self._advance(before.block)
        if before.phase == ScriptPhase.RUNS or sample.block > before.block:
            self.clock_s += max(sample.time_s - before.time_s, 0.0)

    def _judge(self, before: RtdeSample, sample: RtdeSample) -> None:
        """Set the state, and end the program if it cannot continue."""
        match sample.phase:
            case ScriptPhase.DONE if len(self) == self.blocks:
                self.state, self.live = "done", False
            case ScriptPhase.HELD:
                self.state, self.live = "held", False
            case ScriptPhase.LIFTED:
                self.drop("lifted off the path")
        if sample.phase not in LIVE:
            return
        self.live = True
        if why := sample.obstacle():
            self._fail(why)
        elif sample.runtime in (UrRuntimeState.PAUSING, UrRuntimeState.PAUSED):
            self._paused()
        elif sample.runtime == before.runtime == UrRuntimeState.STOPPED:
            self._fail("the program was stopped at the controller")
        elif sample.time_s - self._turned_s > SILENT_S:
            self._fail("the controller runs another program, or ours hangs")
        elif sample.phase == ScriptPhase.WAITS:
            self._waits(sample)
        else:
            self.state, self.detail = "running", ""

    def _waits(self, sample: RtdeSample) -> None:
        """Handle waiting before a block: as commanded, or because the command has not arrived yet."""
        if sample.block >= self.until:
            self.state, self.detail = "held", ""
            return
        if self._now_s() - self._ordered_s > START_S:
            self._fail(f"it does not begin block {sample.block}")

    def _paused(self) -> None:
        """Handle a pause by another client: the tool may stand still on the part, so the program fails at once."""
        self.detail = "the program was paused at the controller"
        if self.state == "running":
            self._fail(self.detail)

    def _fail(self, why: str) -> None:
        self.state, self.detail, self.live = "fault", why, False

    def _advance(self, to: int) -> None:
        """Record all blocks below ``to`` as executed: dwells get their programmed time, moves the rest, others none."""
        first = len(self)
        if to <= first:
            return
        moves, dwells, asked_s = self._moves[first:to], self._dwells[first:to], self._dwell_s[first:to]
        if not (moves | dwells).any():
            self.stretch(np.zeros(to - first), high_s=self.began_s)
            return
        rest = moves if moves.any() or asked_s.any() else dwells
        self.stretch(time_shares(self.spent_s, asked_s, float(asked_s.sum()), rest))
