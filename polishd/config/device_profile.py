"""Device profiles: the protocol of a drive or a sensor as data (docs/how-to/devices.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from string import Formatter
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from polishd.config.fields import ConfigSection, Positive, Range, Text, Texts, as_tuple
from polishd.config.toml_loader import TomlDocument, did_you_mean, join_words
from polishd.model.devices import ActuatorTimes, RegisterTable, SensorTimes, SpindleTimes

# Units of device profiles, and their value in polishd's units.

FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "gf": 9.80665e-3, "lbf": 4.4482216, "ozf": 0.27801385}
LENGTH = {"mm": 1.0, "um": 1e-3, "m": 1e3, "in": 25.4}
SPEED = {"rpm": 1.0, "1/s": 60.0}
FREQUENCY = {"Hz": 60.0}
"""Of the motor's current: with one pole pair 1 Hz is 60 rpm."""
TIME = {"ms": 1.0, "s": 1e3}
PLAIN = {"1": 1.0}
FACTORS = FORCE | LENGTH | SPEED | FREQUENCY | TIME | PLAIN
KINDS = {"force": FORCE, "length": LENGTH, "speed": SPEED | FREQUENCY, "time": TIME}
"""Units by quantity, each with its value in N, mm, rpm or ms."""


def factor(unit: str, pole_pairs: int) -> float:
    """Return the value of one unit in N, mm, rpm or ms."""
    return FACTORS[unit] / (pole_pairs if unit in FREQUENCY else 1)


# The tables of a device profile: one frozen model each. docs/how-to/devices.md describes them.

_ACTUATOR, _SPINDLE, _SENSOR = ActuatorTimes(), SpindleTimes(), SensorTimes()

Unpowered = Literal["lifts", "stays", "presses"]
WordOrder = Literal["high_first", "low_first"]
Value = float | str
Values = Annotated[tuple[Value, ...], BeforeValidator(as_tuple)]
Times = Annotated[float, Field(gt=0.0, le=120.0)]

LEAST = {"u16": 0, "i16": -(1 << 15), "u32": 0, "i32": -(1 << 31), "bit": 0, "f32": -3.4e38}
MOST = {"u16": (1 << 16) - 1, "i16": (1 << 15) - 1, "u32": (1 << 32) - 1, "i32": (1 << 31) - 1, "bit": 1, "f32": 3.4e38}
"""Range of a register's raw values, by its type."""


class StateCondition(ConfigSection):
    """A condition on one value of the device, in N, mm or rpm if it has a unit."""

    when: Text
    """Name of the value: of a register, or of a group of an answer."""
    mask: Annotated[int, Field(ge=1, le=0xFFFFFFFF)] | None = None
    """Only these bits of the value count. [1]"""
    equals: Values = ()
    """The value is one of these numbers (or texts). [1]"""
    unlike: Values = ()
    """The value is none of these. [1]"""
    above: float | None = None
    """The value is greater than this. [1]"""
    below: float | None = None
    """The value is less than this. If several conditions are set, all must hold. [1]"""

    @model_validator(mode="after")
    def _asks_something(self) -> Self:
        if not (self.equals or self.unlike) and self.above is None and self.below is None:
            raise ValueError("when: has no condition; add equals, unlike, above or below")
        return self

    def holds(self, value: Value) -> bool:
        """Return True if the value meets the condition."""
        if isinstance(value, float) and self.mask is not None:
            value = float(int(value) & self.mask)
        fits = (not self.equals or value in self.equals) and value not in self.unlike
        if isinstance(value, str):
            return fits and self.above is None and self.below is None
        return fits and (self.above is None or value > self.above) and (self.below is None or value < self.below)


class StateRule(StateCondition):
    """State of the device by its values. The first rule that holds decides."""

    state: Literal["retracted", "extending", "contact", "retracting", "fault", "stopped", "running", "taring"]
    """State of an actuator, of a spindle (`stopped`, `running`), of a force sensor (`taring`: its readings are not
    valid yet), or `fault` of any device."""


class Quantity(ConfigSection):
    """A transmitted number, and its physical value."""

    unit: Text = "1"
    """Its unit on the link: N, mN, kN, kgf, gf, lbf, ozf; mm, um, m, in; rpm, 1/s, Hz (of the motor's current); ms, s;
    1 for status words and the like."""
    scale: float = 1.0
    """Value of one step of the number in the unit. [1]"""
    offset: float = 0.0
    """Added after scaling, in the unit. [1]"""
    negative: StateCondition | None = None
    """Condition under which an unsigned number is negative."""
    range: Range | None = None
    """Plausible range in N, mm or rpm. A value outside comes from another device, or another word order. [1]"""

    @field_validator("unit")
    @classmethod
    def _known(cls, unit: str) -> str:
        if unit not in FACTORS:
            raise ValueError(f"unit {unit!r} is not known{did_you_mean(unit, FACTORS)} Known: {join_words(FACTORS)}")
        return unit

    @field_validator("scale")
    @classmethod
    def _some(cls, scale: float) -> float:
        if scale == 0.0:
            raise ValueError("scale must not be 0; write the value of one step")
        return scale


class Register(Quantity):
    """A register, or several registers with one value. Addresses count from 0, as on the link."""

    address: Annotated[int, Field(ge=0, le=0xFFFF)]
    """Address on the link, from 0. Many manuals count from 1, or write 40001 for the first holding register. [1]"""
    table: RegisterTable = "holding"
    """Register table. It is read with function 3, 4, 1 or 2, and written with 6 (or 16) or 5 (or 15)."""
    type: Literal["u16", "i16", "u32", "i32", "f32", "bit", "text"] = "u16"
    """Data type: unsigned integer, signed integer, IEEE 754 float, one bit, or ASCII with two characters a word."""
    words: Annotated[int, Field(ge=1, le=64)] = 1
    """Number of registers of a text. [1]"""
    word_order: WordOrder | None = None
    """Word order of this register, if it differs from `modbus.word_order`."""
    write_many: bool = False
    """Written with function 16 (15), also for one word."""

    @property
    def size(self) -> int:
        """Number of registers."""
        return {"u32": 2, "i32": 2, "f32": 2, "text": self.words}.get(self.type, 1)

    @property
    def bits(self) -> bool:
        """One bit each: a coil or a discrete input."""
        return self.table in {"coil", "discrete"}

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.bits != (self.type == "bit"):
            raise ValueError(
                f'type: a {self.table} is {"" if self.bits else "not "}of type "bit"; correct type or table'
            )
        if self.words != 1 and self.type != "text":
            raise ValueError('words: only type "text" has it; remove it')
        return self


class RegexGroup(Quantity):
    """A named group of an answer."""

    type: Literal["number", "hex", "text"] = "number"
    """Data type of its characters."""


class LineRequest(ConfigSection):
    """A request on the line, and its answer."""

    send: Text
    """The request, without its ending."""
    answer: Text
    """Regular expression of the whole answer. Its named groups are values: `(?P<force>[-+]?\\d+\\.\\d+) N`."""

    @field_validator("answer")
    @classmethod
    def _pattern(cls, answer: str) -> str:
        return pattern(answer)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the values in the answer."""
        return tuple(re.compile(self.answer).groupindex)


def pattern(text: str) -> str:
    """Return the text if it is a regular expression; raise ValueError if not."""
    try:
        re.compile(text)
    except re.error as error:
        raise ValueError(f"{text!r} is not a regular expression: {error}; correct it") from error
    return text


class SerialTable(ConfigSection):
    """The serial port. An address in the cell may override it: `serial:PATH?baud=9600&parity=even&stop_bits=1`."""

    baud: Annotated[int, Field(ge=300, le=4_000_000)] = 115_200
    """Baud rate. [bit/s]"""
    parity: Literal["none", "even", "odd"] = "none"
    """Parity of each byte."""
    stop_bits: Literal[1, 2] = 1
    """Stop bits after each byte. [1]"""


class ModbusTable(ConfigSection):
    """The device speaks Modbus: RTU on a serial line, or TCP."""

    unit: Annotated[int, Field(ge=0, le=247)] = 1
    """Its unit number. The cell may override it. [1]"""
    word_order: WordOrder = "high_first"
    """Word order of values of two words."""
    max_registers: Annotated[int, Field(ge=1, le=125)] = 125
    """Largest number of registers in one answer. [1]"""
    pause_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Silence before a request, in addition to the 3.5 characters of the standard."""
    error_replies: dict[str, Text] = Field(default_factory=dict)
    """Meanings of its exception codes, in addition to the standard's: `4 = "a fault is set"`."""


class LinesTable(ConfigSection):
    """The device speaks lines of ASCII text."""

    framing: Literal["plain", "numbered"] = "plain"
    """`numbered`: `$` number `,` text `*` checksum, as in docs/protocols/voice_coil_serial.md."""
    ending: Text = "\r\n"
    """End of a request."""
    answer_ending: Text = "\n"
    """End of an answer. A CR before it is removed."""
    accepted: str = "OK"
    """Regular expression of the answer to a command; `""`: commands have no answer."""
    refused: str = ""
    """Regular expression of a refusal of any request. Its group `why`, if present, is the reason."""

    @field_validator("accepted", "refused")
    @classmethod
    def _pattern(cls, text: str) -> str:
        return pattern(text)


class CommandSteps(ConfigSection):
    """Steps of each command, in order. Modbus: `"register = value"`; lines: the request.

    The value is a number, `asked` (the force in newtons, the speed in rpm without its sign, or the time, converted to
    the register's unit) or `count` (one more each time). In a request it is `{asked:.2f}` or `{count}`.
    """

    force: Texts = ()
    """Actuator: write the set point."""
    engage: Texts = ()
    """Actuator: extend, land and press with the set point. Left out: the set point alone does this."""
    retract: Texts = ()
    """Actuator: force off, then lift, in this order."""
    rest: Texts = ()
    """Actuator: after it is retracted."""
    forward: Texts = ()
    """Spindle: turn at that speed, also when it turns already."""
    reverse: Texts = ()
    """Spindle: turn in the other direction. Left out: it cannot."""
    stop: Texts = ()
    """Spindle: stop."""
    clear: Texts = ()
    """Clear a fault. This is done only for faults of `faults.clears`, when the device is made safe."""
    watchdog: Texts = ()
    """Write the watchdog time of the device. Left out: it is set at the device."""
    heartbeat: Texts = ()
    """Feed that watchdog. Left out: any request does."""
    tare: Texts = ()
    """Force sensor: take the present reading as zero."""


class Faults(ConfigSection):
    """Faults of the device. Any value but 0 is a fault."""

    value: Text
    """Name of the value."""
    mask: Annotated[int, Field(ge=1, le=0xFFFFFFFF)] | None = None
    """Only these bits of the value count. [1]"""
    bits: dict[str, Text] = Field(default_factory=dict)
    """Meaning of each bit, by its value: `4 = "drive"`."""
    codes: dict[str, Text] = Field(default_factory=dict)
    """Meaning of each number, instead of `bits`."""
    clears: Values = ()
    """Faults of the device's watchdog, which `commands.clear` clears when the device is made safe. The operator clears
    all others. [1]"""


class IdentityTable(ConfigSection):
    """Identity of the device, for what it does not report in values `vendor`, `model`, `serial`, `firmware`, `boot`."""

    vendor: Text
    """Name of the manufacturer."""
    model: Text
    """Name of the model."""
    serial: Text = "unknown"
    """Serial number."""
    firmware: Text = "unknown"
    """Firmware version."""


class ActuatorTable(ConfigSection):
    """A force actuator, and its default times, which the cell may override."""

    unpowered: Unpowered
    """Behavior of the tool at a power failure. A profile with `presses` is refused, because it damages the part."""
    max_force_n: Positive
    """Largest set point."""
    watchdog_s: Times = _ACTUATOR.watchdog_s
    """Time without a request after which the device takes the force off and lifts."""
    landing_s: Times = _ACTUATOR.landing_s
    """Longest time from engaging to contact."""
    release_s: Times = _ACTUATOR.release_s
    """Longest time from the command to force off."""
    retract_s: Times = _ACTUATOR.retract_s
    """Longest time from force off until the device reports that the tool is up."""
    stroke_mm: Positive = _ACTUATOR.stroke_mm
    """Stroke over which the tool can follow the part."""

    @field_validator("unpowered")
    @classmethod
    def _lets_go(cls, unpowered: str) -> str:
        if unpowered == "presses":
            raise ValueError(
                "a tool that presses without power makes a pit at each power failure; add a spring, weight or valve "
                'that lifts it, and write "lifts"'
            )
        return unpowered


class SpindleTable(ConfigSection):
    """A spindle, and its default times, which the cell may override."""

    max_rpm: Positive
    """Highest speed."""
    watchdog_s: Times = _SPINDLE.watchdog_s
    """Time without a request after which the device stops."""
    spin_s: Times = _SPINDLE.spin_s
    """Longest time from standstill to any speed, or back."""


class ForceSensorTable(ConfigSection):
    """A force sensor."""

    range_n: Range
    """Measuring range; pressing is positive."""
    delay_s: Annotated[float, Field(ge=0.0, le=5.0)] = _SENSOR.delay_s
    """Longest time from a force to its reading: filter, conversion and link."""
    tare_s: Times = _SENSOR.tare_s
    """Longest time from `commands.tare` until the reading is within `zero_n` of 0."""
    zero_n: Positive = 0.1
    """Largest reading after a tare. Not used if a state `taring` shows the end of the tare."""
    period_s: Annotated[float, Field(ge=0.005, le=1.0)] = 0.05
    """Time between two readings."""


Kind = Literal["actuator", "spindle", "force_sensor"]
TRIED = {
    "manual": "from the manual, not tried on the device",
    "simulator": "tried on a simulated device",
    "device": "tried on the device",
}
IDENTITY = ("vendor", "model", "serial", "firmware", "boot")
"""Values with the identity of the device."""


class DeviceProfile(TomlDocument):
    """One kind of device on one kind of link, with the table of each."""

    title: Text
    """Title for people."""
    manual: Text
    """Source of the profile: the manual, its edition, its pages."""
    tried: Literal["manual", "simulator", "device"]
    """Tests so far: none (`manual`), with a simulated device (`simulator`), or with the device (`device`)."""
    settings: Texts = ()
    """Required settings at the device, for people."""
    actuator: ActuatorTable | None = None
    spindle: SpindleTable | None = None
    force_sensor: ForceSensorTable | None = None
    identity: IdentityTable
    serial: SerialTable = SerialTable()
    modbus: ModbusTable | None = None
    lines: LinesTable | None = None
    registers: dict[str, Register] = Field(default_factory=dict)
    asks: dict[str, LineRequest] = Field(default_factory=dict)
    values: dict[str, RegexGroup] = Field(default_factory=dict)
    commands: CommandSteps = CommandSteps()
    states: Annotated[tuple[StateRule, ...], BeforeValidator(as_tuple)] = ()
    faults: Faults | None = None
    expects: Annotated[tuple[StateCondition, ...], BeforeValidator(as_tuple)] = ()

    @property
    def name(self) -> str:
        """Name of its file without the ending."""
        return self._path.stem

    @property
    def kind(self) -> Kind:
        """Kind of the device."""
        return "actuator" if self.actuator else "spindle" if self.spindle else "force_sensor"

    @property
    def link(self) -> Literal["modbus", "lines"]:
        """Protocol of the device."""
        return "modbus" if self.modbus else "lines"

    @property
    def quantities(self) -> Mapping[str, Quantity]:
        """Quantity of each value, by name. Groups of answers without a table are plain numbers."""
        if self.modbus:
            return self.registers
        return {name: self.values.get(name, RegexGroup()) for ask in self.asks.values() for name in ask.groups}

    @property
    def polled(self) -> tuple[str, ...]:
        """Values of the device's state and readings, with their sign values."""
        known = {
            "actuator": ("force", "set_point", "position"),
            "spindle": ("speed",),
            "force_sensor": ("force", "count"),
        }
        named = [name for name in (*known[self.kind], "beat_echo") if name in self.quantities]
        named += [rule.when for rule in self.states] + ([self.faults.value] if self.faults else [])
        return self.with_signs(named)

    @property
    def identifying(self) -> tuple[str, ...]:
        """Values that identify the device, with their sign values."""
        named = [name for name in IDENTITY if name in self.quantities]
        return self.with_signs([*named, *(one.when for one in self.expects)])

    def with_signs(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the values, each once, and the values that hold their signs."""
        signs = [found.when for name in names if (found := self.quantities[name].negative)]
        return tuple(dict.fromkeys([*names, *signs]))


# The steps of a command: ``"command = 1"`` on Modbus, the request on lines.

_WRITE = re.compile(r"\s*([A-Za-z]\w*)\s*=\s*(asked|count|[-+]?\d+(?:\.\d+)?|0[xX][0-9A-Fa-f]+)\s*")
SLOTS = {"asked": 1.5, "count": 1}
"""Names that a request may have in braces, each with a value to try its format."""


@dataclass(frozen=True, slots=True)
class Write:
    """One write to a register."""

    register: str
    value: float | Literal["asked", "count"]


def write_of(step: str) -> Write:
    """Parse a step on Modbus; raise ValueError with the problem."""
    match = _WRITE.fullmatch(step)
    if match is None:
        raise ValueError(f'{step!r} is not a step; write "register = 1", "register = asked" or "register = count"')
    name, text = match.groups()
    if text in {"asked", "count"}:
        return Write(name, text)  # type: ignore[arg-type]
    return Write(name, float(int(text, 16)) if text[:2].lower() == "0x" else float(text))


def slots_of(step: str) -> set[str]:
    """Return the names in braces of a step on lines; raise ValueError with the problem."""
    try:
        found = {name for _, name, _, _ in Formatter().parse(step) if name is not None}
        if unknown := found - set(SLOTS):
            raise ValueError(f"{{{min(unknown)}}} is unknown; use {{asked}} or {{count}}")
        step.format(**SLOTS).encode("ascii")
    except (ValueError, IndexError, KeyError, AttributeError) as error:
        raise ValueError(f"{step!r} cannot be sent: {error}") from error
    return found
