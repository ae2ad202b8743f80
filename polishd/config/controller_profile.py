"""Profiles of robot controllers that load files: what their variables are called, and what their values mean.

The shipped ones are ``controller_profiles/*.toml``; what each variable is for: docs/protocols/plc_robot.md.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.fields import ConfigSection, Positive, Text, as_tuple
from polishd.config.toml_loader import TomlDocument, load_toml
from polishd.model.errors import ConfigError

CONTROLLER_PROFILE_DIR = Path(__file__).with_name("controller_profiles")
LEAST_LOOK_MS = 5.0
Kind = Literal["bool", "int16", "uint16", "int32", "uint32", "float", "double", "string"]
Value = bool | int | float | str
Values = Annotated[tuple[int | str, ...], BeforeValidator(as_tuple)]
Milliseconds = Annotated[float, Field(ge=1, le=10000)]


class Variable(ConfigSection):
    """A variable of the controller."""

    address: Text
    """Where it is: a node (`ns=2;s=...`, `nsu=URI;s=...`) for opcua, a symbol (`MAIN.state`) for ads, a register
    (`holding:40`, `input:7`, `coil:3`, `discrete:0`) for modbus."""
    type: Kind
    """What it holds there. A `string` has no place in Modbus."""


class CommandVariable(Variable):
    """One that polishd sets, and takes back."""

    on: bool | int = True
    """What orders. [1]"""
    off: bool | int = False
    """What does not. [1]"""
    takes_back: bool = False
    """The controller takes it back by itself, so polishd does not."""


class Flag(Variable):
    """One that says yes or no."""

    on: bool | int = True
    """What says yes. [1]"""


class ClockVariable(Variable):
    """One that counts time."""

    unit_s: Positive = 1.0
    """Seconds that one more of it stand for."""


class Override(Variable):
    """The feed override."""

    full: Positive = 100.0
    """What it shows where the program's own feeds are run. [1]"""


class LineVariable(Variable):
    """Where in its program the controller is."""

    shows: Literal["executed", "interpreted"]
    """`executed`: the block that moves now. `interpreted`: the block that is read now, ahead of the motion by a number
    that nobody knows; refused."""
    counts: Literal["lines", "n_words"] = "lines"
    """Lines of the file, or the N words that stand in it, which must rise."""
    first: Annotated[int, Field(ge=0, le=1)] = 1
    """The number of the file's first line. [1]"""
    stamped: bool = False
    """Its time stamp (opcua) is the time at which it changed, and not the time at which it was asked for."""


class StateVariable(Variable):
    """What the controller does. A value may stand for several: `paused` where the line is a pause of the file."""

    idle: Values = ()
    """No program is loaded. [1]"""
    ready: Values = ()
    """One is, and waits for its start. [1]"""
    running: Annotated[Values, Field(min_length=1)]
    """It runs. [1]"""
    paused: Values = ()
    """It stands at a pause of the program. [1]"""
    held: Values = ()
    """It was held, by polishd or by somebody else. [1]"""
    done: Values = ()
    """The program ran to its end. [1]"""
    ended: Values = ()
    """It is over, whatever ended it. Without `done` polishd puts a pause before the end, to know. [1]"""
    fault: Values = ()
    """Something is wrong; alarms say what. [1]"""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for needed, either in (("a program that waits", "ready"), ("a pause", "paused")):
            if not getattr(self, either):
                raise ValueError(f"{either}: is missing: {needed} must be told from one that runs; add its values")
        if not (self.done or self.ended):
            raise ValueError("done: is missing: the end of a program must be seen; add done = [...] or ended = [...]")
        return self


class VariablesTable(ConfigSection):
    """The controller's variables, by what they mean."""

    state: StateVariable
    """What it does."""
    line: LineVariable
    """Where in the program it is."""
    start: CommandVariable
    """Starts the program, or goes on with it. Its rising edge counts."""
    hold: CommandVariable | None = None
    """Holds, and lets nothing start while it stands; without it the profile is refused."""
    reset: CommandVariable | None = None
    """Ends what is loaded, and acknowledges alarms."""
    load: CommandVariable | None = None
    """Loads the file. Its rising edge counts; left out: writing `program` does."""
    program: Variable | None = None
    """Gets the file's name before it is loaded."""
    loaded: Variable | None = None
    """The name of the file that is loaded."""
    feed_override: Override | None = None
    """The operator's feed override; without it `feed_hold` is needed. Contact is refused, and left, below
    `robot.least_override`."""
    feed_hold: Flag | None = None
    """Somebody holds the feed at the controller."""
    in_motion: Flag | None = None
    """An axis moves."""
    alarm: Variable | None = None
    """Its number, or its text; 0 and an empty text are none."""
    alarm_text: Variable | None = None
    """What it says, where `alarm` is a number."""
    heartbeat: Variable | None = None
    """polishd counts it up; the controller holds by itself when it stands still."""
    controller_heartbeat: Variable | None = None
    """The controller counts it up; the link counts as lost when it stands still."""
    clock: ClockVariable | None = None
    """The controller's clock, for the times of blocks; left out: this computer's."""
    line_began: ClockVariable | None = None
    """When the block that `line` shows began, on `clock`: the controller's own word is finer than its reports."""
    state_began: ClockVariable | None = None
    """When it came to its state, likewise."""
    session: Variable | None = None
    """Changes at each start of the controller; left out: what the link tells of that, if anything."""


class ProgramTable(ConfigSection):
    """How programs are written for it. Lines that polishd puts into the file stand out of contact."""

    file: Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=24)] = "polishd.nc"
    """Name of the file that is handed over."""
    pause: Text = "M0"
    """Line at which it stands until it is started again."""
    dwell: Text = "G4 P{seconds:.3f}"
    """Line that takes `{seconds}` at rest: it proves which line the controller shows."""
    end: str = "M2"
    """Line behind a program without M2, M30 or a closing `%`; empty: none, as in languages other than G-code."""
    longest_line: Annotated[int, Field(ge=8, le=65535)] = 250
    """Longest line that it reads. [byte]"""

    @model_validator(mode="after")
    def _asks_for_seconds(self) -> Self:
        try:
            lines = {self.dwell.format(seconds=seconds) for seconds in (0.25, 2.5)}
        except (KeyError, IndexError, ValueError):
            lines = set()
        if len(lines) != 2 or any("\n" in line for line in (*lines, self.pause, self.end)):
            raise ValueError('dwell: wants {seconds} where the time stands, as in "G4 P{seconds:.3f}", on one line')
        return self


class ControllerProfile(TomlDocument):
    """A controller."""

    name: Text
    """What it is, for messages."""
    link: Literal["opcua", "ads", "modbus"]
    """How its variables are reached."""
    report_ms: Milliseconds
    """How often it renews its line and state."""
    link_ms: Milliseconds = 20.0
    """Longest from there to polishd."""
    heartbeat_ms: Milliseconds = 200.0
    """How often polishd counts `heartbeat` up."""
    watchdog_s: Annotated[float, Field(gt=0, le=600)] | None = None
    """It holds by itself when `heartbeat` stands still for so long."""
    silence_s: Annotated[float, Field(ge=0.3, le=60)] = 1.5
    """No answer, or no beat, for so long: its link counts as lost."""
    stop_s: Annotated[float, Field(gt=0, le=60)] = 5.0
    """Longest from hold to standstill."""
    pulse_ms: Milliseconds = 100.0
    """How long an order stands, for the controller to see it."""
    load_s: Annotated[float, Field(gt=0, le=600)] = 30.0
    """Longest that loading a file takes."""
    in_motion_wired: bool = False
    """A wire from the controller takes the actuator's force off when motion stops: no link is waited for."""
    modbus_unit: Annotated[int, Field(ge=0, le=255)] = 1
    """Its unit number on Modbus. [1]"""
    order: Literal["big", "little"] = "big"
    """Which word of two comes first in Modbus registers."""
    variables: VariablesTable
    program: ProgramTable = ProgramTable()

    @model_validator(mode="after")
    def _watched(self) -> Self:
        if (self.watchdog_s is None) != (self.variables.heartbeat is None):
            raise ValueError("watchdog_s: goes with [variables.heartbeat], and only with it")
        for name in ("line_began", "state_began"):
            if getattr(self.variables, name) is not None and self.variables.clock is None:
                raise ValueError(f"variables.{name}: is a time on [variables.clock]; add that")
        return self

    @property
    def look_ms(self) -> float:
        """Between two looks of polishd's: twice as often as the variables are renewed."""
        return max(self.report_ms / 2, LEAST_LOOK_MS)

    @property
    def unseen_stop_s(self) -> float:
        """Longest that it stands before polishd knows: renewed, looked at, told. 0 where a wire tells the actuator."""
        return 0.0 if self.in_motion_wired else (self.report_ms + self.look_ms + self.link_ms) / 1e3

    @property
    def block_end_s(self) -> float:
        """Standard deviation of a block's end, where only reports bound it; 0 where the controller tells it."""
        told = self.variables.line_began is not None or self.variables.line.stamped
        return 0.0 if told else self.report_ms / 1e3 / math.sqrt(12.0)

    def refusal(self) -> tuple[str, str] | None:
        """(key, why) this controller must not polish; None where it may."""
        variables = self.variables
        if variables.hold is None:
            return "variables", "there is no way to stop it; add [variables.hold]"
        if variables.feed_hold is None and variables.feed_override is None:
            return "variables", (
                "an operator's feed hold would not be seen, and the tool would dig; add [variables.feed_hold] or "
                "[variables.feed_override]"
            )
        if variables.line.shows == "interpreted":
            return "variables.line.shows", (
                "the line that is read runs ahead of the motion: what was executed would be guessed; name a variable "
                'that shows the block in motion, and shows = "executed"'
            )
        return None

    def require_usable(self) -> None:
        """ConfigError with file, line and key where it must not polish."""
        if refused := self.refusal():
            raise self.error(*refused)


def shipped() -> list[str]:
    """Names of the profiles that come with polishd."""
    return sorted(path.stem for path in CONTROLLER_PROFILE_DIR.glob("*.toml"))


def load_controller_profile(name: str, base_dir: Path) -> ControllerProfile:
    """A shipped profile by its name, or the TOML file that ends in ``.toml``.

    Raises:
        ConfigError: it is not known or cannot be read, or one line per problem: ``FILE:LINE: table.key: ...``.
    """
    if name.endswith(".toml"):
        return ControllerProfile.of(*load_toml(base_dir / Path(name).expanduser()))
    if name not in shipped():
        raise ConfigError(f"profile {name!r} is not known; known are {', '.join(shipped())}, or the path of a .toml")
    return ControllerProfile.of(*load_toml(CONTROLLER_PROFILE_DIR / f"{name}.toml"))
