"""The controller: interpreters, advance run, planner, modes and variables. Pure of I/O; the caller passes times.

A program's statements run ahead of the motion by ``$ADVANCE`` moves, up to a WAIT. A line is a trapezoid of speed from
rest to rest; with C_DIS the next one begins while it decelerates, within ``$APO.CDIS`` of its end, and is added to it.
Frames ($BASE, $TOOL) are not simulated: poses are those of the part, as the plant has them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ProgramError
from polishd.sim_backends.common.faults import SpeedOverride
from polishd.sim_backends.kuka_kvp.krl import (
    KrlAssign,
    KrlBranch,
    KrlCall,
    KrlLeave,
    KrlModule,
    KrlMove,
    KrlStatement,
    KrlTarget,
    KrlTrigger,
    KrlValue,
    KrlWait,
    int32,
    reading_krl,
)
from polishd.sim_backends.universal_robots.arm import (
    LinearMove,
    Quaternion,
    ToolPose,
    Triple,
    after,
    angle,
    between,
    from_wrist,
    wrist_deg,
)

# Orientations of KRL: A about Z, B about the new Y, C about the new X.


def from_abc(a_deg: float, b_deg: float, c_deg: float) -> Quaternion:
    """Return the quaternion of A, B and C, deg."""
    a, b, c = (math.radians(part) / 2.0 for part in (a_deg, b_deg, c_deg))
    about_z, about_y = (math.cos(a), 0.0, 0.0, math.sin(a)), (math.cos(b), 0.0, math.sin(b), 0.0)
    return after(after(about_z, about_y), (math.cos(c), math.sin(c), 0.0, 0.0))


def to_abc(quaternion: Quaternion) -> Triple:
    """Return A, B and C of a quaternion, deg."""
    w, x, y, z = quaternion
    a = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    b = math.asin(max(-1.0, min(2.0 * (w * y - z * x), 1.0)))
    c = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return math.degrees(a), math.degrees(b), math.degrees(c)


# The path: lines from rest to rest, of which several may be under way.


@dataclass(slots=True)
class KukaMotion:
    """A motion that the advance run has queued."""

    end: ToolPose
    speed_mm_s: float
    accel_mm_s2: float
    blend_mm: float = 0.0
    """It may be left at this distance before its end; 0: exact stop."""
    at_start: list[Callable[[], None]] = field(default_factory=list)
    """Triggers."""
    at_end: list[Callable[[], None]] = field(default_factory=list)


@dataclass(slots=True)
class KukaPath:
    """Queued motions, and the lines that are under way."""

    pose: ToolPose
    overhead_s: float
    queue: deque[KukaMotion] = field(default_factory=deque)
    speed_mm_s: float = 0.0
    _lines: list[LinearMove] = field(default_factory=list)
    _newest: KukaMotion | None = None
    _owed_s: float | None = None
    """Rest of the overhead before the next motion; None: it has not begun."""

    @property
    def at_rest(self) -> bool:
        """Nothing is queued or under way."""
        return not self.queue and not self._lines

    def stands_at(self, pose: ToolPose) -> bool:
        """A motion to that pose would be none."""
        near = math.dist(self.pose.xyz_mm, pose.xyz_mm) < SAME and angle(self.pose.turn, pose.turn) < SAME
        return self.at_rest and near

    def clear(self) -> None:
        """Drop all motions where the tool stands."""
        self.queue.clear()
        self._lines, self._newest, self._owed_s, self.speed_mm_s = [], None, None, 0.0

    def stand(self) -> None:
        """Stand for one frame."""
        self.speed_mm_s = 0.0

    def step(self, dt_s: float, pace: float) -> None:
        """Move for one frame; ``pace`` is the share of the planned speed."""
        before, step_s = self.pose.xyz_mm, dt_s * pace
        for line in self._lines:
            line.done_s += step_s
        stood = not self._lines
        while self._newest is not None and (late_s := self._late_s()) >= 0.0:
            self._next(min(late_s, step_s), self._newest)
        if stood and self.queue and step_s > 0.0:
            self._begin(step_s)
        self._place()
        newest = self._lines[-1] if self._newest is not None else None
        self._lines = [line for line in self._lines if line is newest or line.done_s < line.takes_s]
        self.speed_mm_s = math.dist(before, self.pose.xyz_mm) / dt_s

    def _leave_s(self, line: LinearMove) -> float:
        """Time in a line at which the next motion may begin."""
        motion = self._newest
        if motion is None or not motion.blend_mm or not self.queue:
            return line.takes_s
        # not before it decelerates, not beyond the approximation distance, not before its half
        top_mm_s = min(motion.speed_mm_s, math.sqrt(motion.accel_mm_s2 * max(line.length_mm, 1e-9)))
        before_s = min(top_mm_s / motion.accel_mm_s2, math.sqrt(2.0 * motion.blend_mm / motion.accel_mm_s2))
        return max(line.takes_s - before_s, line.takes_s / 2.0)

    def _late_s(self) -> float:
        """Time for which the newest motion is over; below 0 while it is under way."""
        return self._lines[-1].done_s - self._leave_s(self._lines[-1])

    def _next(self, late_s: float, left: KukaMotion) -> None:
        """End the newest motion, which is over for ``late_s``; begin the next one where they blend."""
        for fire in left.at_end:
            fire()
        self._newest, self._owed_s = None, None
        if self.queue and left.blend_mm:
            self._start(late_s)
        elif self.queue:
            self._owed_s = self.overhead_s - late_s

    def _begin(self, step_s: float) -> None:
        """Begin from rest, after the overhead."""
        owed_s = (self.overhead_s if self._owed_s is None else self._owed_s) - step_s
        self._owed_s = owed_s
        if owed_s <= 0.0:
            self._owed_s = None
            self._start(-owed_s)

    def _start(self, late_s: float) -> None:
        motion = self.queue.popleft()
        begin = self._lines[-1].end if self._lines else self.pose
        line = LinearMove(begin, motion.end, motion.accel_mm_s2, motion.speed_mm_s)
        line.done_s = late_s
        self._lines.append(line)
        self._newest = motion
        for fire in motion.at_start:
            fire()

    def _place(self) -> None:
        if not self._lines:
            return
        newest = self._lines[-1]
        at = list(_lerp(newest.begin.xyz_mm, newest.end.xyz_mm, newest.share()))
        for line in self._lines[:-1]:
            rest = 1.0 - line.share()
            for axis in range(3):
                at[axis] -= (line.end.xyz_mm[axis] - line.begin.xyz_mm[axis]) * rest
        turn = between(newest.begin.turn, newest.end.turn, newest.share())
        self.pose = ToolPose((at[0], at[1], at[2]), turn)


def _lerp(a: Triple, b: Triple, share: float) -> Triple:
    return a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share


# The controller.

Frames = Generator[None, None, str]
"""Yields at the end of each frame that it uses; returns ``exit`` or ``return`` where a statement leaves its body."""
RAMP_S = 0.1
"""Time in which a stop reduces the pace from full to zero."""
LATE_S = 30.0
"""A process that was delayed catches up with at most this time."""
PASSES = 100
"""Passes through the body of a WHILE in one cycle; of a LOOP there is one."""
STILL_MM_S = 1e-6
SAME = 1e-6
"""Distance, mm, and angle, rad, of two poses that are the same."""
FREE, RESET, ACTIVE, STOP, END = "#P_FREE", "#P_RESET", "#P_ACTIVE", "#P_STOP", "#P_END"
AUTOMATIC, EXTERNAL, MANUAL = "#AUT", "#EX", "#T1"
SYSTEM: dict[str, KrlValue] = {
    "$ADVANCE": 3,
    "$VEL": {"CP": 2.0, "ORI1": 200.0, "ORI2": 200.0},
    "$ACC": {"CP": 2.3, "ORI1": 100.0, "ORI2": 100.0},
    "$APO": {"CDIS": 0.0, "CPTP": 0, "CVEL": 0, "CORI": 0.0},
    "$BASE": {}, "$TOOL": {}, "$LOAD": {}, "$ORI_TYPE": "#VAR", "$CIRC_TYPE": "#BASE", "$IPO_MODE": "#BASE",
    "$NULLFRAME": {"X": 0.0, "Y": 0.0, "Z": 0.0, "A": 0.0, "B": 0.0, "C": 0.0},
    "$BWDSTART": False, "$CMD": 0, "$H_POS": {},
    "$ROBNAME[]": "polishd", "$TRAFONAME[]": "#KR10R1100SIXX_SIM", "$KR_SERIALNO": 970001,
    "$RCV_INFO[]": "KS V8.3.21 (simulated)", "$PRO_STATE0": ACTIVE,
    **{name: {} for name in ("FDAT_ACT", "PDAT_ACT", "LDAT_ACT", "FHOME", "PDEFAULT", "LDEFAULT")},
    **{f"{kind}_DATA[{number}]": {} for kind in ("TOOL", "BASE") for number in range(1, 33)},
}  # fmt: skip
"""Variables of the system and of its $CONFIG.DAT that only hold a value."""


@dataclass(slots=True)
class KukaController:
    """One machine, frame by frame on its own clock."""

    config: SimRobotSection
    path: KukaPath
    frame_s: float
    accel_mm_s2: float
    speed: float
    """Seconds of the controller in one wall second."""
    began_s: float
    """Wall time at which its clock was 0."""
    complain: Callable[[int, str], None] = lambda _line, _text: None
    """Report an error of a running program: line, message."""
    time_s: float = 0.0
    mode: str = AUTOMATIC
    state: str = FREE
    """``$PRO_STATE1``."""
    name: str = ""
    drives_on: bool = True
    stop_message: bool = False
    program_override: int = 100
    override: SpeedOverride = field(default_factory=SpeedOverride)
    """Faults of the script: an operator's override, or a standstill that the robot does not report."""
    values: dict[str, KrlValue] = field(default_factory=lambda: {**SYSTEM})
    rows: list[list[float]] = field(default_factory=list)
    """Motion since the rows were last taken, see ``bus.ROW``."""
    shares: list[tuple[float, float]] = field(default_factory=list)
    """(wall time, planned motion within a second of motion from then on) since the pairs were last taken; ..."""
    share: float = 1.0
    """... and the last value."""
    waits: bool = False
    """A WAIT SEC is under way."""
    _wait_ends_s: float = 0.0
    """When it is over as programmed: a tool that stands until then removes what is planned."""
    _acts: bool = False
    """Motions and waits follow each other: none of its program's stops has come yet."""
    _pace: float = 1.0
    _module: KrlModule | None = None
    _hidden: dict[str, KrlValue | None] = field(default_factory=dict)
    """Variables of the selected module, each with the value of the global one that it hides; None: it hides none."""
    _program: Frames | None = None
    _submit: Frames | None = None
    _triggers: list[KrlTrigger] = field(default_factory=list)
    _timers: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    """Value, ms, and since when it runs."""
    _routines: dict[str, list[KrlStatement]] = field(default_factory=dict)
    """Of the submit interpreter and its modules: any program may call them."""
    _line: int = 0

    # Commands of the proxy and of the operator: each returns False where it is refused.

    def boot(self, *modules: KrlModule) -> None:
        """Load the modules of the submit interpreter and run its SPS."""
        for module in modules:
            self._routines |= module.routines
            self.values |= module.data
        self._submit = self._body(self._routines["SPS"])
        self._run(self._submit)

    def selecting(self, name: str, text: str, data: str = "") -> Iterator[None]:
        """Select a module, some lines of its text and of its data list in each turn.

        ProgramError where one cannot be read, and for a variable that is not declared.
        """
        module = yield from reading_krl(text)
        listed = yield from reading_krl(data)
        if name.upper() not in module.routines:
            raise ProgramError(f"the module has no routine {name}", 1)
        if data and listed.list_of != name.upper():
            raise ProgramError(f"the data list is that of {listed.list_of or 'no module'}", 1)
        self._forget()
        own = module.data | listed.data
        declared = {key.partition("[")[0] for key in (*self.values, *own)}
        for used, line in module.used.items():
            if used not in declared and not used.startswith("$"):
                raise ProgramError(f"{used} is not declared", line)
        self._hidden = {key: self.values.get(key) for key in own}
        self.values |= own
        self._module, self.name, self.state, self._program = module, name.upper(), RESET, None
        self.path.clear()

    def _forget(self) -> None:
        """Remove the variables of the module that was selected."""
        for key, value in self._hidden.items():
            self.values.pop(key, None)
            if value is not None:
                self.values[key] = value
        self._hidden = {}

    def start(self) -> bool:
        """Press the start key."""
        able = self.mode in (AUTOMATIC, EXTERNAL) and self.drives_on and not self.stop_message
        if not able or self._module is None or self.state not in (RESET, STOP):
            return False
        if self._program is None:
            self._triggers, self._acts, self._program = [], False, self._main(self._module.routines[self.name])
        self.state = ACTIVE
        return True

    def stop(self) -> bool:
        """Press the stop key: the robot brakes on its path."""
        if self.state == ACTIVE:
            self.state = STOP
            return True
        return False

    def cancel(self) -> bool:
        """Deselect the program; refused while it runs or the robot still brakes."""
        if self.state in (ACTIVE, FREE) or self.moves:
            return False
        self._forget()
        self.state, self.name, self._module, self._program, self.waits = FREE, "", None, None, False
        self.path.clear()
        return True

    def reset(self) -> bool:
        """Set the program back to its first line."""
        if self.state not in (STOP, END) or self.moves:
            return False
        self.state, self._program, self.waits = RESET, None, False
        self.path.clear()
        return True

    def emergency_stop(self) -> None:
        """Press the emergency stop: drives off, a stop message, the program stands."""
        self.drives_on, self.stop_message = False, True
        self.stop()

    def turn_to_manual(self) -> None:
        """Turn the key to T1: the program stops, and the drives are off without the enabling switch."""
        self.mode, self.drives_on = MANUAL, False
        self.stop()

    def turn_to_automatic(self) -> None:
        """Turn the key back, release the emergency stop, confirm the message, switch the drives on."""
        self.mode, self.drives_on, self.stop_message = AUTOMATIC, True, False

    # Variables.

    def read(self, name: str) -> KrlValue:
        """Return a value by its name in upper case. ProgramError for an unknown one."""
        if name in self.values:
            return self.values[name]
        if name.startswith("$TIMER["):
            value_ms, since_s = self._timers.get(name, (0.0, None))
            return int32(int(value_ms + (0.0 if since_s is None else (self.time_s - since_s) * 1e3)))
        if (shows := _SHOWN.get(name)) is not None:
            return shows(self)
        raise ProgramError(f"{name} is not declared", self._line)

    def write(self, name: str, value: KrlValue) -> None:
        """Set a variable. ProgramError for an unknown one, and for a value of another type."""
        if name.startswith("$TIMER["):
            runs = self._timers.get(name, (0.0, None))[1] is not None
            self._timers[name] = (float(value), self.time_s if runs else None)
        elif name.startswith("$TIMER_STOP["):
            timer = name.replace("_STOP", "")
            self._timers[timer] = (float(self.read(timer)), None if value else self.time_s)
        elif name == "$OV_PRO":
            if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= 100:
                raise ProgramError(f"$OV_PRO takes 0 to 100, not {value!r}", self._line)
            self.program_override = value
        elif name.startswith(("$VEL_AXIS[", "$ACC_AXIS[")):
            self.values[name] = value
        elif name not in self.values:
            raise ProgramError(f"{name} is not declared", self._line)
        else:
            self.values[name] = _converted(name, self.values[name], value, self._line)

    # Time.

    def due(self, wall_s: float) -> range:
        """Return one turn for each frame up to the present."""
        behind_s = (wall_s - self.began_s) * self.speed - self.time_s
        if behind_s > LATE_S * self.speed:
            self.began_s += behind_s / self.speed - LATE_S
            behind_s = LATE_S * self.speed
        return range(int(behind_s / self.frame_s))

    def wall_s(self) -> float:
        """Wall time of its clock."""
        return self.began_s + self.time_s / self.speed

    @property
    def moves(self) -> bool:
        """True with a speed."""
        return self.path.speed_mm_s >= STILL_MM_S

    @property
    def active(self) -> bool:
        """True while it moves, and from a program's motion or WAIT SEC to its next WAIT FOR or its end."""
        return self.moves or (self.state == ACTIVE and self._acts)

    def frame(self) -> None:
        """Run one interpolation cycle."""
        if self._submit is not None:
            self._run(self._submit)
        step = self.frame_s / RAMP_S
        self._pace = min(self._pace + step, 1.0) if self.state == ACTIVE else max(self._pace - step, 0.0)
        stands = self.override.stands
        if self.state == ACTIVE and self._program is not None and not (stands and self.waits):
            self._run(self._program)
        planned = self.program_override / 100.0 * self.override.actual(self.wall_s())
        in_wait = self.waits and self.time_s < self._wait_ends_s
        share = 1.0 if in_wait else 0.0 if stands else 1.0 if self.waits or self.path.at_rest else planned
        if share != (self.shares[-1][1] if self.shares else self.share):
            self.shares.append((self.wall_s(), share))
        if stands or self.state == END or self.path.at_rest:
            self.path.stand()
        else:
            self.path.step(self.frame_s, planned * self._pace)
        if self.moves and self._outside() and not self.stop_message:
            self.stop_message = True
            self.stop()
        if self.active:
            begin_s = self.wall_s()
            x, y, z = self.path.pose.xyz_mm
            block = float(self.values.get("POLISHD_BLOCK", -1))
            end_s = begin_s + self.frame_s / self.speed
            self.rows.append([block, begin_s, end_s, self.frame_s, x, y, z, *wrist_deg(self.path.pose.turn)])
        self.time_s += self.frame_s

    def _outside(self) -> bool:
        ranges = (self.config.x_mm, self.config.y_mm, self.config.z_mm)
        return any(not low <= at <= high for at, (low, high) in zip(self.path.pose.xyz_mm, ranges, strict=True))

    def _run(self, program: Frames) -> None:
        try:
            next(program)
        except StopIteration:
            if program is self._program:
                self.state, self._program = END, None
        except (ProgramError, TypeError, ValueError, KeyError, ZeroDivisionError) as error:
            self.complain(self._line, str(error.args[0]) if isinstance(error, ProgramError) else f"{error!r}")
            self.stop_message = True
            if program is self._submit:
                self._submit, self.values["$PRO_STATE0"] = None, STOP
            else:
                self.stop()

    # Statements.

    def _main(self, body: Sequence[KrlStatement]) -> Frames:
        """A program ends when its last motion has ended."""
        yield from self._body(body)
        while not self.path.at_rest:
            yield
        return ""

    def _body(self, body: Sequence[KrlStatement]) -> Frames:
        for statement in body:
            self._line = statement.line
            match statement:
                case KrlAssign():
                    self._assign(statement.target, statement.value(self.read))
                case KrlTrigger():
                    self._triggers.append(statement)
                case KrlMove():
                    yield from self._move(statement)
                case KrlWait():
                    yield from self._wait(statement)
                case KrlBranch():
                    if left := (yield from self._branch(statement)):
                        return left
                case KrlCall():
                    yield from self._call(statement)
                case KrlLeave():
                    return "return" if statement.returns else "exit"
        return ""

    def _branch(self, statement: KrlBranch) -> Frames:
        passes = 0
        while statement.condition is None or statement.condition(self.read):
            if left := (yield from self._body(statement.body)):
                return "" if statement.repeats and left == "exit" else left
            if not statement.repeats:
                return ""
            passes += 1
            if statement.condition is None or passes % PASSES == 0:
                yield
        return (yield from self._body(statement.otherwise))

    def _call(self, statement: KrlCall) -> Generator[None, None, None]:
        if statement.name == "CWRITE" and statement.argument is not None:
            if statement.argument(self.read) != "STOP 1":
                raise ProgramError("this controller's CWRITE knows STOP 1 only", statement.line)
            self.stop()
            return
        own = self._module.routines if self._module is not None else {}
        routine = own.get(statement.name) or self._routines.get(statement.name)
        if routine is None:
            raise ProgramError(f"{statement.name} is not known", statement.line)
        yield from self._body(routine)

    def _move(self, statement: KrlMove) -> Generator[None, None, None]:
        while len(self.path.queue) >= max(int(self.values["$ADVANCE"]), 1):
            yield
        self._line = statement.line
        target = statement.target(self.read)
        if not isinstance(target, dict) or not {*"XYZABC"} <= target.keys():
            raise ProgramError(
                "this controller moves to poses {X .., Y .., Z .., A .., B .., C ..} only", statement.line
            )
        x, y, z, *turn = (float(target[axis]) for axis in "XYZABC")
        speed = float(self.values["$VEL"]["CP"]) * 1e3 if statement.is_linear else self.config.rapid_mm_s
        accel = min(float(self.values["$ACC"]["CP"]) * 1e3, self.accel_mm_s2)
        if speed <= 0.0 or accel <= 0.0:
            raise ProgramError("$VEL.CP and $ACC.CP must be above 0", statement.line)
        blend_mm = float(self.values["$APO"]["CDIS"]) if statement.approximates else 0.0
        triggers, self._triggers = self._triggers, []
        end = ToolPose((x, y, z), from_abc(turn[0], turn[1], turn[2]))
        if self.path.stands_at(end):
            for one in triggers:
                self._assign(one.target, one.value(self.read))
            return
        self._acts = True
        fires = [(one.at_end, lambda one=one: self._assign(one.target, one.value(self.read))) for one in triggers]
        self.path.queue.append(
            KukaMotion(
                end,
                min(speed, self.config.max_feed_mm_s),
                accel,
                blend_mm,
                [fire for at_end, fire in fires if not at_end],
                [fire for at_end, fire in fires if at_end],
            )
        )

    def _wait(self, statement: KrlWait) -> Generator[None, None, None]:
        """A wait stops the advance run: all motions before it end first, without blending."""
        while not self.path.at_rest:
            yield
        if statement.is_condition:
            while not statement.value(self.read):
                self._acts = False
                yield
            return
        seconds = float(statement.value(self.read))
        if seconds <= 0.0:
            return
        self.waits = self._acts = True
        frames = math.ceil((seconds + self.path.overhead_s) / self.frame_s - 1e-9)
        self._wait_ends_s = self.time_s + frames * self.frame_s
        for _ in range(frames):
            yield
        self.waits = False

    def _assign(self, target: KrlTarget, value: KrlValue) -> None:
        name = target.name if target.index is None else f"{target.name}[{target.index(self.read)}]"
        if not target.component:
            self.write(name, value)
            return
        whole = dict(self.read(name))
        if target.component not in whole:
            raise ProgramError(f"{name} has no component {target.component}", self._line)
        self.values[name] = whole | {target.component: value}


def _position(machine: KukaController) -> dict[str, float]:
    pose = machine.path.pose
    return dict(zip("XYZABC", (*pose.xyz_mm, *to_abc(pose.turn)), strict=True))


def _date(_machine: KukaController) -> dict[str, int]:
    now = datetime.now(tz=UTC)
    parts = (now.second, now.minute, now.hour, now.day, now.month, now.year)
    return dict(zip(("SEC", "MIN", "HOUR", "DAY", "MONTH", "YEAR"), parts, strict=True))


_SHOWN: dict[str, Callable[[KukaController], KrlValue]] = {
    "$PRO_STATE1": lambda machine: machine.state,
    "$PRO_STATE": lambda machine: machine.state,
    "$PRO_NAME1[]": lambda machine: machine.name,
    "$PRO_NAME[]": lambda machine: machine.name,
    "$MODE_OP": lambda machine: machine.mode,
    "$OV_PRO": lambda machine: round(machine.program_override * machine.override.reported(machine.wall_s())),
    "$PERI_RDY": lambda machine: machine.drives_on,
    "$STOPMESS": lambda machine: machine.stop_message,
    "$ROB_STOPPED": lambda machine: not machine.moves,
    "$POS_ACT": _position,
    "$AXIS_ACT": _position,
    "$DATE": _date,
}
"""System variables that show a state of the machine."""


def _converted(name: str, old: KrlValue, value: KrlValue, line: int) -> KrlValue:
    """Return the value in the type of the variable."""
    if isinstance(old, bool) or isinstance(value, bool):
        fits = isinstance(old, bool) and isinstance(value, bool)
    elif isinstance(old, int) and isinstance(value, float):
        return round(value)
    elif isinstance(old, float) and isinstance(value, int):
        return float(value)
    else:
        fits = isinstance(value, type(old))
    if not fits:
        raise ProgramError(f"{name} takes no {value!r}", line)
    return old | value if isinstance(old, dict) else value


def kuka_path(config_pose: Sequence[float], overhead_s: float) -> KukaPath:
    """Return a path that stands at X Y Z A C of the plant."""
    x, y, z, a, c = config_pose
    return KukaPath(ToolPose((x, y, z), from_wrist(a, c)), overhead_s)
