"""Profiles of robot controllers that load files: names of their variables, and meanings of their values.

The shipped ones are ``controller_profiles/*.toml``. docs/protocols/plc_robot.md describes each variable.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.fields import ConfigSection, Positive, Text, as_tuple
from polishd.config.toml_loader import TomlDocument, load_toml
from polishd.model.errors import ConfigError
from polishd.util.files import named_path

CONTROLLER_PROFILE_DIR = Path(__file__).with_name("controller_profiles")
LEAST_LOOK_MS = 5.0
Kind = Literal["bool", "int16", "uint16", "int32", "uint32", "float", "double", "string"]
Value = bool | int | float | str
Values = Annotated[tuple[int | str, ...], BeforeValidator(as_tuple)]
Milliseconds = Annotated[float, Field(ge=1, le=10000)]


class Variable(ConfigSection):
    """A variable of the controller."""

    address: Text
    """Its address: a node (`ns=2;s=...`, `nsu=URI;s=...`) for opcua, a symbol (`MAIN.state`) for ads, a register
    (`holding:40`, `input:7`, `coil:3`, `discrete:0`) for modbus, a variable (`D010`) or a value of the status
    (`job.line`) for hses."""
    type: Kind
    """Its data type. Modbus has no `string`."""


class CommandVariable(Variable):
    """A variable that polishd sets and resets."""

    on: bool | int = True
    """Value of the command. [1]"""
    off: bool | int = False
    """Value without a command. [1]"""
    takes_back: bool = False
    """The controller resets it, so polishd does not."""


class Flag(Variable):
    """A variable that is true or false."""

    on: bool | int = True
    """Value for true. [1]"""


class ClockVariable(Variable):
    """A variable that counts time."""

    unit_s: Positive = 1.0
    """Seconds per count."""


class Override(Variable):
    """The feed override."""

    full: Positive = 100.0
    """Its value at the programmed feeds. [1]"""


class LineVariable(Variable):
    """The controller's position in its program."""

    shows: Literal["executed", "interpreted"]
    """`executed`: the block that moves now. `interpreted`: the block that is read now, an unknown number of blocks
    ahead of the motion; such a profile is refused."""
    counts: Literal["lines", "n_words", "statements"] = "lines"
    """Lines of the file, the N words in it, which must increase, or the statements that begin as in `counted`."""
    first: Annotated[int, Field(ge=0, le=1)] = 1
    """The number of the file's first line, or of its first statement. [1]"""
    starts_at: str = ""
    """Of `lines`: text of the line that is the first one, such as NOP; the lines above it are not counted. Empty: the
    file's first line."""
    counted: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    """Of `statements`: beginnings of the lines that count, without leading blanks."""
    stamped: bool = False
    """Its time stamp (opcua) is the time of the change, not the time of the read request."""

    @model_validator(mode="after")
    def _countable(self) -> Self:
        if (self.counts == "statements") != bool(self.counted):
            raise ValueError('counted: goes with counts = "statements"; set both, or neither')
        if not all(self.counted):
            raise ValueError("counted: an empty text begins every line; name the statements")
        if self.starts_at and self.counts != "lines":
            raise ValueError('starts_at: goes with counts = "lines"; remove it')
        return self


class StateVariable(Variable):
    """State of the controller. A value may belong to several states: `paused` if the line is a pause of the file."""

    idle: Values = ()
    """No program is loaded. [1]"""
    ready: Values = ()
    """A program is loaded and waits for its start. [1]"""
    running: Annotated[Values, Field(min_length=1)]
    """The program runs. [1]"""
    paused: Values = ()
    """The program stopped at a pause in it. [1]"""
    held: Values = ()
    """The program was held, by polishd or at the controller. [1]"""
    done: Values = ()
    """The program ran to its end. [1]"""
    ended: Values = ()
    """The program ended, for any reason. Without `done` polishd adds a pause before the end, to detect it. [1]"""
    fault: Values = ()
    """The controller has a fault; see its alarms. [1]"""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for name in ("ready", "paused"):
            if not getattr(self, name):
                raise ValueError(f"{name}: is missing; add the values that distinguish it from running")
        if not (self.done or self.ended):
            raise ValueError(
                "done: is missing: the end of a program must be visible; add done = [...] or ended = [...]"
            )
        return self


class VariablesTable(ConfigSection):
    """The controller's variables, by meaning."""

    state: StateVariable
    """State of the controller."""
    line: LineVariable
    """Position in the program."""
    start: CommandVariable
    """Starts or continues the program. The rising edge counts."""
    hold: CommandVariable | None = None
    """Holds the program, and prevents any start while it is on. Without it the profile is refused."""
    reset: CommandVariable | None = None
    """Ends the loaded program, and acknowledges alarms."""
    load: CommandVariable | None = None
    """Loads the file. The rising edge counts. Left out: writing `program` loads it."""
    program: Variable | None = None
    """Name of the file to load."""
    loaded: Variable | None = None
    """Name of the loaded file."""
    feed_override: Override | None = None
    """The operator's feed override; without it `feed_hold` is needed. Below `robot.least_override` the daemon refuses
    or leaves contact."""
    feed_hold: Flag | None = None
    """The operator holds the feed at the controller."""
    in_motion: Flag | None = None
    """An axis moves."""
    alarm: Variable | None = None
    """Number or text of the alarm; 0 or an empty text: no alarm."""
    alarm_text: Variable | None = None
    """Text of the alarm, if `alarm` is a number."""
    heartbeat: Variable | None = None
    """polishd increments it; the controller holds if it stops."""
    controller_heartbeat: Variable | None = None
    """The controller increments it; the link counts as lost if it stops."""
    clock: ClockVariable | None = None
    """The controller's clock, for the times of blocks. Left out: this computer's clock."""
    line_began: ClockVariable | None = None
    """Start time on `clock` of the block that `line` shows. It is more precise than the time of the report."""
    state_began: ClockVariable | None = None
    """Start time on `clock` of the present state."""
    session: Variable | None = None
    """Changes at each start of the controller. Left out: the link's own session, if it has one."""


class ProgramTable(ConfigSection):
    """Format of programs for the controller. polishd adds lines to the file only out of contact."""

    language: str = ""
    """Of lines that call programs of the controller, which no dialect knows: the only `program.format` that goes with
    them. Empty: the cell's dialect must read them as a dwell and a stop."""
    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=24)] = "polishd.nc"
    """Name of the delivered file."""
    renames: bool = True
    """By ftp: deliver under another name, compare the size, rename. False: the controller takes files of its programs
    only, and loads each as it arrives."""
    pause: Text = "M0"
    """Line that stops the program until the next start."""
    dwell: Text = "G4 P{seconds:.3f}"
    """Line that waits `{seconds}` at rest. It shows which line the controller reports."""
    dwell_step_s: Positive = 0.001
    """Step of the time in `dwell`, which is a multiple of it."""
    end: str = "M2"
    """Line after a program without M2, M30 or a closing `%`. Empty: none, as in languages other than G-code."""
    last: str = ""
    """Last line of every program in a language other than G-code, such as END. Without `done` polishd adds a pause
    before it. Empty: the end is seen by `done`."""
    line_end: Literal["lf", "crlf"] = "lf"
    """End of the file's lines."""
    longest_line: Annotated[int, Field(ge=8, le=65535)] = 250
    """Longest line that the controller reads. [byte]"""

    @model_validator(mode="after")
    def _asks_for_seconds(self) -> Self:
        try:
            lines = {self.dwell.format(seconds=seconds) for seconds in (0.25, 2.5)}
        except (KeyError, IndexError, ValueError):
            lines = set()
        if len(lines) != 2 or any("\n" in line for line in (*lines, self.pause, self.end)):
            raise ValueError('dwell: must have {seconds} for the time, as in "G4 P{seconds:.3f}", on one line')
        return self


class ControllerProfile(TomlDocument):
    """A robot controller."""

    name: Text
    """Name of the controller, for messages."""
    link: Literal["opcua", "ads", "modbus", "hses"]
    """Protocol of its variables."""
    report_ms: Milliseconds
    """Period at which it updates its line and state."""
    link_ms: Milliseconds = 20.0
    """Longest delay of the link to polishd."""
    heartbeat_ms: Milliseconds = 200.0
    """Period at which polishd increments `heartbeat`."""
    watchdog_s: Annotated[float, Field(gt=0, le=600)] | None = None
    """Time without a new `heartbeat` after which the controller holds."""
    silence_s: Annotated[float, Field(ge=0.3, le=60)] = 1.5
    """Time without an answer or a new `controller_heartbeat` after which its link counts as lost."""
    stop_s: Annotated[float, Field(gt=0, le=60)] = 5.0
    """Longest time from hold to standstill."""
    pulse_ms: Milliseconds = 100.0
    """Length of a command pulse that the controller can see."""
    load_s: Annotated[float, Field(gt=0, le=600)] = 30.0
    """Longest time to load a file."""
    in_motion_wired: bool = False
    """A wire from the controller takes the actuator's force off when motion stops, without a link's delay."""
    modbus_unit: Annotated[int, Field(ge=0, le=255)] = 1
    """Its unit number on Modbus. [1]"""
    order: Literal["big", "little"] = "big"
    """Order of the words of a value in Modbus registers."""
    variables: VariablesTable
    program: ProgramTable = ProgramTable()

    @model_validator(mode="after")
    def _watched(self) -> Self:
        if not (self.program.end or self.program.last or self.variables.state.done):
            raise ValueError(
                "program.end: is empty, so the end of a program must be visible; add done = [...] to "
                "[variables.state], or program.last"
            )
        if (self.watchdog_s is None) != (self.variables.heartbeat is None):
            raise ValueError("watchdog_s: set it together with [variables.heartbeat], or leave out both")
        for name in ("line_began", "state_began"):
            if getattr(self.variables, name) is not None and self.variables.clock is None:
                raise ValueError(f"variables.{name}: is a time on [variables.clock]; add that section")
        return self

    @property
    def look_ms(self) -> float:
        """Poll period: half of the period at which the variables are updated."""
        return max(self.report_ms / 2, LEAST_LOOK_MS)

    @property
    def unseen_stop_s(self) -> float:
        """Longest time from a stop to its detection: update, poll and link. 0 if a wire stops the actuator's force."""
        return 0.0 if self.in_motion_wired else (self.report_ms + self.look_ms + self.link_ms) / 1e3

    @property
    def block_end_s(self) -> float:
        """Standard deviation of a block's end time, if only reports bound it; 0 if the controller gives the time."""
        is_timed = self.variables.line_began is not None or self.variables.line.stamped
        return 0.0 if is_timed else self.report_ms / 1e3 / math.sqrt(12.0)

    def refusal(self) -> tuple[str, str] | None:
        """Return (key, reason) why this controller must not polish, or None."""
        variables = self.variables
        if variables.hold is None:
            return "variables", "polishd could not stop it; add [variables.hold]"
        if variables.feed_hold is None and variables.feed_override is None:
            return "variables", (
                "polishd could not see an operator's feed hold, and the tool would make a pit; add "
                "[variables.feed_hold] or [variables.feed_override]"
            )
        if variables.line.shows == "interpreted":
            return "variables.line.shows", (
                "the interpreted line is ahead of the motion, so the executed block is unknown; name a variable that "
                'shows the block in motion, and set shows = "executed"'
            )
        return None

    def require_usable(self) -> None:
        """Raise ConfigError with file, line and key if the controller must not polish."""
        if refused := self.refusal():
            raise self.error(*refused)


def shipped() -> list[str]:
    """Return the names of the shipped profiles."""
    return sorted(path.stem for path in CONTROLLER_PROFILE_DIR.glob("*.toml"))


def load_controller_profile(name: str, base_dir: Path) -> ControllerProfile:
    """Load a shipped profile by its name, or a file whose name ends in ``.toml``.

    Raises:
        ConfigError: the profile is unknown or cannot be read, or one line per problem: ``FILE:LINE: table.key: ...``.
    """
    if name.endswith(".toml"):
        return ControllerProfile.of(*load_toml(named_path(base_dir, name)))
    if name not in shipped():
        raise ConfigError(
            f"profile {name!r} is not known; known are {', '.join(shipped())}, or the path of a .toml. Use one of them"
        )
    return ControllerProfile.of(*load_toml(CONTROLLER_PROFILE_DIR / f"{name}.toml"))
