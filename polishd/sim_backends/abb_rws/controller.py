"""The controller: panel, tasks, motion and their clock. Pure of I/O except for reports; the caller passes wall times.

The program pointer runs ahead of the motion by some moves; at a stop point, and in a wait, it waits for the motion. A
wait that ended between two ticks ends at its own time: the next move begins then.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ProgramError
from polishd.model.surface import FloatArray
from polishd.sim_backends.abb_rws.rapid import Instruction, RapidSource, reading, shown, single
from polishd.sim_backends.abb_rws.tasks import BuiltIn, Function, RapidTask, Steps, StopWatch, Wait
from polishd.sim_backends.common.faults import SpeedOverride
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.program_reader import Pose, SimProgramBlock
from polishd.sim_backends.robot.trajectory import BlockColumns
from polishd.sim_backends.universal_robots.arm import from_wrist, wrist_deg

MOTION_TASK, WATCH_TASK = "T_ROB1", "T_POLISHD"
AHEAD = 8
"""Moves that the program pointer is ahead of the motion at most."""
TRAP_S = (0.002, 0.012)
"""Shortest and longest delay of a trap, controller's time; up to 0.12 s on a real controller."""
OURS = b"! polishd"
"""End of each line that polishd adds to a program."""
MORE_MOVES = 4096
"""Moves of a program beyond those in its text, for its loops."""
MOVES = ("movel", "movej", "triggl", "triggj", "moveabsj")


@dataclass(slots=True)
class ProgramLines:
    """The program's block of each line of a module."""

    block: list[int]

    @classmethod
    def of(cls, text: bytes) -> ProgramLines:
        """Count the lines that polishd did not add."""
        block, count = [], 0
        for line in text.split(b"\n"):
            is_ours = line.rstrip().endswith(OURS)
            block.append(-1 if is_ours else count)
            count += not is_ours
        return cls(block)


class AbbController:
    """Commands of the panel and of RAPID execution."""

    def __init__(
        self,
        config: SimRobotSection,
        motion: SimMotion,
        report: Callable[..., None],
        began_s: float,
        seed: int,
    ) -> None:
        self.config = config
        self.motion = motion
        self._report = report
        self._began_s = began_s
        self._random = random.Random(seed)  # noqa: S311
        self.state, self.mode, self.ratio = "motoron", "AUTO", 100.0
        self.override = SpeedOverride()
        """Faults of the script: an operator's speed ratio, or a standstill that the robot does not report."""
        self.running = False
        self.log: list[tuple[int, str]] = []
        """Event log: (code, text)."""
        shared: dict[str, Any] = {}
        functions = {**_FUNCTIONS, "taskrunrob": lambda *_: self.running}
        self.tasks = {
            MOTION_TASK: RapidTask(MOTION_TASK, {**_COMMON, **self._instructions()}, functions, shared),
            WATCH_TASK: RapidTask(WATCH_TASK, {**_COMMON, **self._watch_instructions()}, functions, shared),
        }
        self._steps: Steps | None = None
        self._wait: Wait | None = None
        self._watch_steps: Steps | None = None
        self._watch_wait: Wait | None = None
        self._stopping = False
        self._move_stopped = False
        self._ends: dict[int, float] = {}
        """Controller's time at which each move or wait ended."""
        self._taken = 0
        self._triggers: dict[int, list[int]] = {}
        self._flew_by = True
        self._now_s = began_s
        self._block_of = np.full(MORE_MOVES, -1.0)
        self.lines: dict[str, ProgramLines] = {}
        self._prepare_motion()

    @property
    def motion_task(self) -> RapidTask:
        """The task that moves the robot."""
        return self.tasks[MOTION_TASK]

    @property
    def move_stopped(self) -> bool:
        """Whether StopMove is in force."""
        return self._move_stopped

    @property
    def is_active(self) -> bool:
        """Whether it moves, or runs a program that may."""
        return self.motion.state == "running" or (self.running and not self._move_stopped)

    def blocks_of(self, moves: FloatArray) -> FloatArray:
        """Return the program's blocks (n,) of moves (n,)."""
        return self._block_of[np.minimum(moves.astype(np.int64), len(self._block_of) - 1)]

    def clock_s(self, wall_s: float) -> float:
        """Return the controller's time."""
        return (wall_s - self._began_s) * self.motion.limits.speed

    def _wall_s(self, clock_s: float) -> float:
        return self._began_s + clock_s / self.motion.limits.speed

    # requests of clients and buttons

    def loading(self, task: str, text: bytes, *, replace: bool) -> Generator[None, None, None]:
        """Load a module, in turns. ProgramError with (message, line) where it cannot be loaded."""
        owner = self.tasks[task]
        if owner is self.motion_task and self.running:
            raise ProgramError("the task runs", 0)
        source: RapidSource = yield from reading(text.decode("latin-1"))
        if source.name.lower() in owner.modules and not replace:
            raise ProgramError(f"module {source.name} is loaded already", 0)
        owner.load(source)
        self.lines[source.name.lower()] = ProgramLines.of(text)
        if owner is self.motion_task:
            self._steps = None
        else:
            self._watch_steps, self._watch_wait = owner.main(), None

    def reset_pointer(self) -> None:
        """Set the program pointer to main. ProgramError if there is none, or while it runs."""
        if self.running:
            raise ProgramError("the program runs", 0)
        if self.motion_task.routine("main") is None:
            raise ProgramError("the task has no main", 0)
        self._steps, self._wait = None, None
        self._prepare_motion()

    def start(self) -> str:
        """Start or continue; return why not."""
        if self.mode != "AUTO":
            return "the controller is in manual mode"
        if self.state != "motoron":
            return f"the controller's state is {self.state}"
        if self.running:
            return "the program runs already"
        task = self.motion_task
        if self._steps is None:
            if task.routine("main") is None:
                return "the task has no main"
            self._prepare_motion()
            self._steps = task.main()
            task.time_s = self.clock_s(self._now_s)
        self.running, self._stopping = True, False
        if self._taken < self.motion.accepted and not self._move_stopped:
            self.motion.resume(self._now_s, None)
        return ""

    def stop(self, why: str = "stop") -> None:
        """Stop on the path: the program is stopped when the robot stands."""
        if self.running:
            self._stopping = True
            self.motion.hold(self._now_s, why)

    def press(self, button: str, now_s: float) -> None:
        """Press ``emergency stop`` or turn the key to ``manual``; once more: back to automatic with motors on."""
        self.tick(now_s)
        if button == "emergency stop":
            self.state = "motoron" if self.state == "emergencystop" else "emergencystop"
        else:
            self.mode = "AUTO" if self.mode == "MANR" else "MANR"
        self.note(10013, button)
        self.stop(button)

    def note(self, code: int, text: str) -> None:
        """Write to the event log."""
        self.log.append((code, text))
        self._report("controller_event", code=code, text=text)

    # the controller's cycle

    def tick(self, now_s: float) -> None:
        """Run up to the present."""
        self._now_s = now_s
        pace = self.override.actual(now_s) * self.ratio / 100.0
        if pace != self.motion.pace:
            self.motion.set_pace(now_s, pace)
        self._run_watch()
        self._run_motion()
        if self._stopping and self.motion.state != "running":
            self.running = self._stopping = False

    @property
    def reported_ratio(self) -> float:
        """Speed ratio that the panel reports, %."""
        return self.ratio * self.override.reported(self._now_s)

    def _run_watch(self) -> None:
        task = self.tasks[WATCH_TASK]
        task.time_s = self.clock_s(self._now_s)
        if self._watch_steps is None or (self._watch_wait is not None and self._watch_wait() is None):
            return
        try:
            self._watch_wait = next(self._watch_steps, None)
        except ProgramError as error:
            self._watch_steps = None
            self.note(40000, f"{WATCH_TASK} line {task.line}: {error.args[0]}")

    def _run_motion(self) -> None:
        task = self.motion_task
        while True:
            self.motion.advance(self._now_s)
            self._take_executed()
            if not self.running or self._stopping or self._steps is None:
                return
            at_s = task.time_s if self._wait is None else self._wait()
            if at_s is None:
                return
            task.time_s = max(at_s, task.time_s)
            try:
                self._wait = next(self._steps)
            except StopIteration:
                self._end(10002, "")
            except ProgramError as error:
                self._end(40000, f"{MOTION_TASK} line {error.args[1] or task.line}: {error.args[0]}")
            except (TypeError, ValueError, LookupError) as error:
                self._end(40000, f"{MOTION_TASK} line {task.line}: {error}")

    def _end(self, code: int, problem: str) -> None:
        self._steps, self._wait = None, None
        if problem:
            self.note(code, problem)
        self.stop("error" if problem else "end")

    def _take_executed(self) -> None:
        """Note when moves ended, and run the traps of their triggers, which a stopping program drops."""
        task, executed = self.motion_task, self.motion.executed
        while self._taken < len(executed):
            move, _, end_s = executed[self._taken]
            self._taken += 1
            self._ends[move] = self.clock_s(float(self.motion.wall_at(np.array(end_s))))
            for interrupt in self._triggers.pop(move, ()):
                if self._stopping or not self.running:
                    continue
                kept_s, task.time_s = task.time_s, self._ends[move] + self._random.uniform(*TRAP_S)
                try:
                    task.trap(interrupt)
                except ProgramError as error:
                    self._end(40000, f"{MOTION_TASK} line {error.args[1] or task.line}: {error.args[0]}")
                task.time_s = kept_s

    def _prepare_motion(self) -> None:
        """Drop all motion that is planned."""
        moves = sum(len(lines.block) for lines in self.lines.values()) + MORE_MOVES
        self.motion.load(BlockColumns(moves, self.motion.pose, self.motion.limits))
        self._block_of = np.full(moves, -1.0)
        self._ends, self._taken, self._triggers, self._flew_by = {}, 0, {}, True

    def _queue(self, block: SimProgramBlock, *, flies_by: bool) -> int:
        """Append a move or a wait at the task's time; return its number."""
        motion, task = self.motion, self.motion_task
        number = motion.accepted
        if number >= motion.path.blocks:
            raise ProgramError(f"the simulated controller runs at most {motion.path.blocks} moves a start", task.line)
        lines = self.lines.get("polishd_part") or next(iter(self.lines.values()), ProgramLines([]))
        self._block_of[number] = lines.block[task.line - 1] if task.line <= len(lines.block) else -1.0
        motion.append(self._now_s, [block])
        if not self._flew_by:
            motion.path.entry[number] = 0.0
        self._flew_by = flies_by
        if motion.state != "running" and not self._move_stopped and not self._stopping:
            motion.resume(min(self._wall_s(task.time_s), self._now_s), None)
        return number

    def _ended(self, number: int) -> Wait:
        return lambda: self._ends.get(number)

    def _stands(self) -> Wait:
        """Wait until all moves are over."""
        last = self.motion.accepted - 1
        return self._ended(last) if last >= 0 else lambda: self.motion_task.time_s

    # the instructions that move, wait and stop

    def _instructions(self) -> dict[str, BuiltIn]:
        return {
            **dict.fromkeys(MOVES, self._move),
            "waittime": self._wait_time,
            "waitrob": lambda *_: self._wait_for(self._stands()),
            "stop": lambda task, _: self._stop_here(task),
            "stopmove": lambda *_: self._stop_move(),
            "startmove": lambda *_: self._start_move(),
        }

    def _watch_instructions(self) -> dict[str, BuiltIn]:
        def wait(task: RapidTask, statement: Instruction) -> Steps:
            due_s = task.time_s + float(task.of(statement.arguments[-1]))
            return self._wait_for(lambda: due_s if self.clock_s(self._now_s) >= due_s else None)

        stops: dict[str, BuiltIn] = {
            "stopmove": lambda *_: self._stop_move(),
            "startmove": lambda *_: self._start_move(),
        }
        return {"waittime": wait, **stops}

    def _wait_for(self, wait: Wait) -> Steps:
        yield wait

    def _wait_time(self, task: RapidTask, statement: Instruction) -> Steps:
        r"""Wait behind the moves: \InPos or not, the robot stands."""
        seconds = float(task.of(statement.arguments[-1]))
        if seconds < 0.0:
            raise ProgramError("a wait has 0 s or more", task.line)
        yield self._ended(self._queue(SimProgramBlock("dwell", self._last_pose(), seconds), flies_by=True))

    def _stop_here(self, task: RapidTask) -> Steps:
        yield self._stands()
        self.running = False
        yield lambda: self.clock_s(self._now_s) if self.running else None
        task.time_s = self.clock_s(self._now_s)

    def _stop_move(self) -> None:
        if not self._move_stopped:
            self._move_stopped = True
            self._report("watchdog")
            self.motion.hold(self._now_s, "StopMove")

    def _start_move(self) -> None:
        self._move_stopped = False
        if self.running and self._taken < self.motion.accepted:
            self.motion.resume(self._now_s, None)

    def _move(self, task: RapidTask, statement: Instruction) -> Steps:
        name, arguments, switches = statement.name, statement.arguments, statement.switches
        has_triggers = name.startswith("trigg")
        if len(arguments) < 4 + has_triggers:
            raise ProgramError(f"{name} has too few arguments", task.line)
        values = [task.of(argument) for argument in arguments[:-1]]  # a controller has the tools of its shop
        zone = values[-1]
        interrupts = [value[1] for value in values[2:-1]] if has_triggers else []
        end = self._home() if name == "moveabsj" else self._pose(task, values[0])
        speed = float(task.of(switches["v"])) if "v" in switches else float(values[1][0])
        if "t" in switches:
            block = SimProgramBlock("move", end, max(float(task.of(switches["t"])), 1e-3), inverse=True)
        else:
            block = SimProgramBlock("move", end, speed)
        number = self._queue(block, flies_by=not zone[0])
        if interrupts:
            self._triggers[number] = interrupts
        yield self._ended(number if zone[0] else number - AHEAD) if zone[0] or number >= AHEAD else self._at_once(task)

    @staticmethod
    def _at_once(task: RapidTask) -> Wait:
        at_s = task.time_s
        return lambda: at_s

    def _last_pose(self) -> Pose:
        x, y, z, a, c = (float(value) for value in self.motion.path.pose[self.motion.accepted])
        return x, y, z, a, c

    def _home(self) -> Pose:
        """Joint angles have no place in the plant: such a move goes home."""
        return self.config.home

    def _pose(self, task: RapidTask, target: Any) -> Pose:
        """Return the plant's pose of a robtarget; ProgramError where it is out of range."""
        try:
            (x, y, z), (w, i, j, k) = target[0], target[1]
            a, c = wrist_deg((w, i, j, k))
        except (TypeError, ValueError, LookupError):
            raise ProgramError("the target is no robtarget", task.line) from None
        before = self._last_pose()[4]
        c = before if abs(a) < 1e-6 else c + 360.0 * round((before - c) / 360.0)
        ranges = (self.config.x_mm, self.config.y_mm, self.config.z_mm, self.config.a_deg)
        for axis, value, (low, high) in zip("XYZA", (x, y, z, a), ranges, strict=True):
            if not low <= value <= high:
                raise ProgramError(
                    f"position outside reach: {axis} {value:g} is outside {low:g} to {high:g}", task.line
                )
        return x, y, z, a, c

    def robtarget(self) -> tuple[tuple[float, float, float], tuple[float, ...]]:
        """Return position, mm, and orientation of the tool."""
        x, y, z, a, c = self.motion.pose
        return (x, y, z), from_wrist(a, c)

    # data

    def read(self, task: str, name: str) -> str | None:
        """Return a variable as RAPID writes it; None if there is none."""
        owner = self.tasks.get(task)
        cell = owner.data.get(name.lower()) if owner is not None else None
        return None if cell is None or isinstance(cell.value, StopWatch) else shown(cell.value)

    def write(self, task: str, name: str, text: str) -> str:
        """Write a variable; return why not."""
        owner = self.tasks.get(task)
        cell = owner.data.get(name.lower()) if owner is not None else None
        if owner is None or cell is None:
            return "the variable does not exist"
        if cell.storage == "const":
            return "the variable is constant"
        try:
            value = _parsed(owner, text)
        except ProgramError as error:
            return str(error.args[0])
        if type(value) is not type(cell.value):
            return f"{text} is no value of its type"
        cell.value = single(value)
        return ""


def _parsed(task: RapidTask, text: str) -> Any:
    """Return the value of a text."""
    source = _whole(reading(f"MODULE m\nVAR any v:={text};\nENDMODULE"))
    return task.of(source.declarations[0].value)


def _whole(steps: Generator[None, None, RapidSource]) -> RapidSource:
    while True:
        try:
            next(steps)
        except StopIteration as end:
            source: RapidSource = end.value
            return source


# Instructions and functions that every task has.


def _watch_of(task: RapidTask, reference: Any) -> StopWatch:
    value = task.cell_of(reference).value
    if not isinstance(value, StopWatch):
        raise ProgramError("the argument is no clock", task.line)
    return value


def _clock_reset(task: RapidTask, statement: Instruction) -> None:
    watch = _watch_of(task, statement.arguments[0])
    watch.passed_s, watch.since_s = 0.0, None


def _clock_start(task: RapidTask, statement: Instruction) -> None:
    watch = _watch_of(task, statement.arguments[0])
    watch.since_s = task.time_s if watch.since_s is None else watch.since_s


def _clock_stop(task: RapidTask, statement: Instruction) -> None:
    watch = _watch_of(task, statement.arguments[0])
    watch.passed_s, watch.since_s = watch.read(task.time_s), None


def _delete_interrupt(task: RapidTask, statement: Instruction) -> None:
    task.traps.pop(task.cell_of(statement.arguments[0]).value or 0, None)


def _connect(task: RapidTask, statement: Instruction) -> None:
    number = next(at for at in range(1, len(task.traps) + 2) if at not in task.traps)
    task.traps[number] = task.of(statement.arguments[1])
    task.cell_of(statement.arguments[0]).value = number


def _trigger(task: RapidTask, statement: Instruction) -> None:
    data, distance, interrupt = statement.arguments
    if task.of(distance) != 0.0:
        raise ProgramError("a trigger away from the point is not simulated", task.line)
    task.cell_of(data).value = ["int", task.cell_of(interrupt).value]


def _increment(task: RapidTask, statement: Instruction) -> None:
    cell = task.cell_of(statement.arguments[0])
    cell.value = single(cell.value + 1.0)


def _nothing(_task: RapidTask, _statement: Instruction) -> None:
    """Settings and outputs that the plant does not have."""


_SETTINGS = (
    "tpwrite", "tperase", "confl", "confj", "singarea", "accset", "velset", "setdo", "setao", "setgo", "set", "reset",
    "gripload",
)  # fmt: skip
_COMMON: Mapping[str, BuiltIn] = {
    "clkreset": _clock_reset,
    "clkstart": _clock_start,
    "clkstop": _clock_stop,
    "connect": _connect,
    "idelete": _delete_interrupt,
    "triggint": _trigger,
    "incr": _increment,
    **dict.fromkeys(_SETTINGS, _nothing),
}


def _offs(_task: RapidTask, values: Sequence[Any]) -> Any:
    (x, y, z), *rest = values[0]
    return [[x + values[1], y + values[2], z + values[3]], *rest]


_FUNCTIONS: Mapping[str, Function] = {
    "offs": _offs,
    "abs": lambda _, values: abs(values[0]),
    "round": lambda _, values: float(round(values[0])),
    "clkread": lambda task, values: values[0].read(task.time_s),
}


def module_names(tasks: Mapping[str, RapidTask], task: str) -> Iterator[str]:
    """Return the modules of a task."""
    yield from (source.name for source in tasks[task].modules.values())
