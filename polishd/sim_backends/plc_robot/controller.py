"""The controller: variables in, motion, variables out. Pure of I/O except for the file; the caller passes wall times.

It reads a file by its ending: .JBI is INFORM, .pgx is VAL3, any other is RNC blocks. On the load command it reads the
file, a part in each cycle: the cycle time does not depend on the program's length. It updates its outputs once every
report, and stops when no client counts the heartbeat up. An operator at the controller may hold the feed; motion
continues when the operator releases it.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ProgramError
from polishd.model.surface import FloatArray
from polishd.sim_backends.plc_robot.inform import InformReader
from polishd.sim_backends.plc_robot.language import LanguageReader
from polishd.sim_backends.plc_robot.val3 import Val3Reader
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.program_reader import Intake, Reach
from polishd.sim_backends.robot.trajectory import BlockColumns as Blocks

# A program file in the controller, and which of its lines belong to the program.

OURS = b"(polishd)"
"""End of each line of G-code that polishd inserts."""
LANGUAGES: dict[str, type[LanguageReader]] = {".jbi": InformReader, ".pgx": Val3Reader}
"""By the ending of the file."""


@dataclass(frozen=True, slots=True)
class PlcProgram:
    """A file, and the facts about it that the plant needs."""

    lines: tuple[bytes, ...]
    sha256: str
    """Of the program without the inserted lines."""
    blocks: int
    inserted: FloatArray
    """(m,) 0-based lines that were inserted."""

    @classmethod
    def of(cls, text: bytes, language: type[LanguageReader] | None = None) -> PlcProgram:
        """Parse the text."""
        lines = text.removesuffix(b"\n").removesuffix(b"\r").split(b"\n")
        if language is None:
            inserted = [at for at, line in enumerate(lines) if line.endswith(OURS)]
        else:
            inserted = language.inserted(lines)
        added = set(inserted)
        own = [line for at, line in enumerate(lines) if at not in added] if inserted else lines
        return cls(tuple(lines), hashlib.sha256(b"\n".join(own)).hexdigest(), len(own), np.array(inserted, dtype=float))

    def blocks_of(self, lines: FloatArray) -> FloatArray:
        """Return 0-based blocks of the program (n,) of 0-based lines (n,)."""
        blocks = lines - np.searchsorted(self.inserted, lines)
        return np.asarray(np.minimum(blocks, max(self.blocks - 1, 0)), dtype=np.float64)


def sha256_of(lines: Sequence[bytes]) -> str:
    """Hash the lines as the intake does."""
    return hashlib.sha256(b"".join(line + b"\n" for line in lines)).hexdigest()


IDLE, READY, RUNNING, PAUSED, HELD, DONE, FAULT = range(7)
Value = bool | int | float | str
INPUTS: dict[str, Value] = {
    "start": False, "hold": False, "reset": False, "load": False, "program": "", "heartbeat": 0,
}  # fmt: skip
BAD_PROGRAM, NO_PROGRAM, EMERGENCY_STOP = 1, 2, 99
LINES_A_CYCLE = 500
"""Lines of a program that a load reads in a cycle."""


@dataclass(slots=True)
class Loading:
    """A program that is being loaded."""

    name: str
    program: PlcProgram
    intake: Intake
    blocks: Blocks
    reader: LanguageReader | None
    """None: RNC blocks."""
    longest_turn_s: float = 0.0
    """Time between two cycles, from the command on."""


@dataclass(slots=True)
class Plc:
    """Values that the servers show."""

    config: SimRobotSection
    motion: SimMotion
    folder: Path
    reach: Reach
    report: Callable[..., None]
    """Write to the event log: (event, at_s=now, **data)."""
    boot_id: str
    inputs: dict[str, Value] = field(default_factory=lambda: dict(INPUTS))
    shown: dict[str, Value] = field(default_factory=dict)
    """Return the values that the controller reports, as of its last report."""
    feed_held: bool = False
    manual: bool = False
    """The key is at manual: no program starts."""
    goes_on: bool = True
    """A program continues when the feed is released, without a start."""
    program: PlcProgram | None = None
    _reader: LanguageReader | None = None
    """Of the loaded program, if it is not of RNC blocks."""
    _before: dict[str, Value] = field(default_factory=lambda: dict(INPUTS))
    _alarm: tuple[int, str] = (0, "")
    _loaded: str = ""
    _was: str = "idle"
    _heartbeat_s: float = 0.0
    _next_s: float = 0.0
    _beats: int = 0
    _goes_on: bool = False
    """The feed was held while it ran."""
    _loading: Loading | None = None
    _ticked_s: float | None = None

    def tick(self, now_s: float) -> None:
        """Run one cycle of the controller's program."""
        self.motion.advance(now_s)
        turn_s = 0.0 if self._ticked_s is None else now_s - self._ticked_s
        self._ticked_s = now_s
        inputs, before = dict(self.inputs), self._before
        self._before = inputs
        if inputs["heartbeat"] != before["heartbeat"]:
            self._heartbeat_s = now_s
        if self._rises("reset", before):
            self._reset(now_s)
        if self._loading is not None:
            self._go_on_loading(self._loading, turn_s)
        if self._rises("load", before):
            self._load(str(inputs["program"]))
        if inputs["hold"] and self.motion.state == "running":
            self.motion.hold(now_s, "hold")
        elif self._rises("start", before) and not inputs["hold"]:
            self._start(now_s)
        if self.motion.state == "running" and now_s - self._heartbeat_s > self.config.watchdog_s:
            if not self.motion.stopping:
                self.report("watchdog", silent_s=round(now_s - self._heartbeat_s, 3))
            self.motion.hold(now_s, "watchdog")
        self._changes()
        if now_s >= self._next_s:
            self._next_s = max(self._next_s + self.config.report_ms / 1e3, now_s)
            self._show(now_s)

    def press(self, button: str, now_s: float) -> None:
        """Press ``emergency stop`` or ``feed hold``, or turn the key to ``manual``; again: release, or turn it back."""
        self.motion.advance(now_s)
        if button == "emergency stop":
            self._alarm, self._loading = (EMERGENCY_STOP, button), None
            self.motion.hold(now_s, button)
        elif button == "manual":
            self.manual = not self.manual
            if self.manual:
                self.motion.hold(now_s, button)
        else:
            self.feed_held = not self.feed_held
            if self.feed_held:
                self._goes_on = self.motion.state == "running"
                self.motion.hold(now_s, button)
            elif self.goes_on and self._goes_on and self.motion.state == "held":
                self.motion.resume(now_s, None)
        self._changes()

    @property
    def alarm(self) -> int:
        """Number of the alarm at present."""
        return self._alarm[0]

    @property
    def is_emergency_stopped(self) -> bool:
        """The emergency stop is pressed."""
        return self._alarm[0] == EMERGENCY_STOP

    def is_silent(self, now_s: float) -> bool:
        """The watchdog has stopped the program, and still receives no heartbeat."""
        return self.motion.detail == "watchdog" and now_s - self._heartbeat_s > self.config.watchdog_s

    def start(self, now_s: float) -> None:
        """Start the selected job, or continue it; one that ran to its end begins again."""
        if self.motion.state == "done":
            self.motion.load(self.motion.path)
        self._start(now_s)

    def hold(self, now_s: float, *, on: bool) -> None:
        """Hold at once, however soon it is released again, or release."""
        self.inputs["hold"] = on
        if on and self.motion.state == "running":
            self.motion.hold(now_s, "hold")

    def select(self, name: str) -> bool:
        """Load a file, to begin at its top. False if there is none."""
        self._load(name)
        found = self._alarm[0] != NO_PROGRAM
        if not found:
            self._drop_alarm()
        return found

    def cancel_alarm(self) -> None:
        """Acknowledge an alarm; the program stays."""
        if not self.is_emergency_stopped:
            self._drop_alarm()

    def moves_to(self, number: int) -> int:
        """Return how many moves the program has up to the line that is shown by this number."""
        if self.program is None or self._reader is None:
            return 0
        lines = self.program.lines[: bisect_right(self._reader.numbers, number)]
        return sum(line.startswith(b"MOV") for line in lines)

    def blocks_of(self, lines: FloatArray) -> FloatArray:
        """Return the program's blocks (n,) of lines of the file (n,)."""
        return lines if self.program is None else self.program.blocks_of(lines)

    def _rises(self, name: str, before: dict[str, Value]) -> bool:
        return bool(self.inputs[name]) and not before[name]

    def _reset(self, now_s: float) -> None:
        self.motion.hold(now_s, "reset")
        if self.motion.state != "running" and self._alarm[0] != EMERGENCY_STOP:
            self._alarm = (0, "")
            self._unload()

    def _drop_alarm(self) -> None:
        self._alarm = (0, "")

    def _unload(self) -> None:
        """Drop the program, and any load under way."""
        self.motion.forget()
        self._was, self._loaded, self.program, self._loading = "idle", "", None, None

    def _load(self, name: str) -> None:
        """Load on command: drop the old program, and read the file from the next cycle on."""
        if self.motion.state == "running" or self._alarm[0]:
            return
        self._unload()
        path = self.folder / Path(name).name
        language = LANGUAGES.get(path.suffix.lower())
        try:
            program = PlcProgram.of(path.read_bytes(), language)
        except OSError as error:
            self._alarm = (NO_PROGRAM, f"{name}: {error.strerror}")
            return
        lines = list(program.lines)
        pose = self.motion.pose
        reader = language(pose, path.stem) if language is not None else None
        intake = Intake(self.config, self.reach, len(lines), sha256_of(lines), pose, reader=reader)
        self._loading = Loading(name, program, intake, Blocks(len(lines), pose, self.motion.limits), reader)

    def _go_on_loading(self, loading: Loading, turn_s: float) -> None:
        """Read a cycle's part of the program; with its last line it is loaded."""
        program, intake, blocks = loading.program, loading.intake, loading.blocks
        loading.longest_turn_s = max(loading.longest_turn_s, turn_s)
        first = blocks.accepted
        taken = intake.take(first, list(program.lines[first : first + LINES_A_CYCLE]))
        if refusal := intake.refusal():
            self._alarm, self._loading = (BAD_PROGRAM, refusal[1]), None
            return
        blocks.append(taken)
        if blocks.accepted < blocks.blocks:
            return
        self._loading = None
        if loading.reader is not None:
            try:
                loading.reader.finish()
            except ProgramError as error:
                self._alarm = (BAD_PROGRAM, str(error))
                return
        self.motion.load(blocks)
        self.program, self._loaded, self._reader = program, loading.name, loading.reader
        longest_turn_s = round(loading.longest_turn_s, 4)
        self.report("program_loaded", sha256=program.sha256, blocks=program.blocks, longest_turn_s=longest_turn_s)

    def _start(self, now_s: float) -> None:
        if self._alarm[0] or self.feed_held or self.manual or self.program is None or self.motion.state != "held":
            return
        self._heartbeat_s = now_s
        self.motion.resume(now_s, None)

    def _changes(self) -> None:
        """Report starts and stops."""
        motion = self.motion
        while (state := motion.state) != (was := self._was):
            self._was = state
            name = "motion_started" if state == "running" else "motion_stopped"
            if "running" in {state, was}:
                self.report(name, motion.changed_s, detail=motion.detail or state, executed=len(motion.executed))

    def _show(self, now_s: float) -> None:
        line, began_s = self._line(now_s)
        self._beats = (self._beats + 1) & 0xFFFFFFFF
        self.shown = {
            "state": self._state(),
            "line": line,
            "line_began": began_s * self.motion.limits.speed,
            "state_began": self.motion.changed_s * self.motion.limits.speed,
            "clock": now_s * self.motion.limits.speed,
            "loaded": self._loaded,
            "feed_override": 100.0 * self.motion.reported_pace,
            "feed_hold": self.feed_held,
            "in_motion": self.motion.state == "running",
            "alarm": self._alarm[0],
            "alarm_text": self._alarm[1],
            "controller_heartbeat": self._beats,
            "session": self.boot_id,
        }

    def _state(self) -> int:
        motion = self.motion
        if self._alarm[0]:
            return FAULT
        if motion.state == "held":
            if motion.detail == "loaded":
                return READY
            return PAUSED if motion.detail == "pause" else HELD
        return {"idle": IDLE, "running": RUNNING, "done": DONE}[motion.state]

    def _line(self, now_s: float) -> tuple[int, float]:
        """1-based line under way, or of the pause at which it stands, and the wall time at which that began.

        In a robot's language: the number that its reader counts.
        """
        motion, executed = self.motion, self.motion.executed
        stands_s = now_s if motion.state == "running" else motion.changed_s
        done = len(executed)

        def wall(process_s: float) -> float:
            return stands_s - (motion.process_s - process_s) / motion.limits.speed

        at_pause = self._state() == PAUSED and bool(executed)
        began_s = wall(executed[-1][1 if at_pause else 2]) if executed else motion.changed_s
        ahead = self.config.read_ahead_lines if motion.state == "running" else 0
        line = done if at_pause else min(done + 1 + ahead, max(motion.path.blocks, 1))
        reader = self._reader
        if self.program is None or reader is None:
            return line, began_s
        first = reader.begins_at(line - 1)
        return reader.numbers[line - 1], wall(executed[first][1]) if first < done else began_s
