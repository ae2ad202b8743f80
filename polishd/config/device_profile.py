"""Device profiles: what a drive or a sensor says and hears on its wire, as data (docs/devices.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from string import Formatter
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, WithJsonSchema, field_validator, model_validator

from polishd.config.fields import ConfigSection, Positive, Range, Text, Texts, as_tuple
from polishd.config.toml_loader import TomlDocument, did_you_mean, join_words
from polishd.model.devices import ActuatorTimes, RegisterTable, SensorTimes, SpindleTimes

# Units that a device profile may write, and what they are in polishd's own.

FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "gf": 9.80665e-3, "lbf": 4.4482216, "ozf": 0.27801385}
LENGTH = {"mm": 1.0, "um": 1e-3, "m": 1e3, "in": 25.4}
SPEED = {"rpm": 1.0, "1/s": 60.0}
FREQUENCY = {"Hz": 60.0}
"""Of the current in the motor: rpm are 60 times as many for one pair of poles."""
TIME = {"ms": 1.0, "s": 1e3}
PLAIN = {"1": 1.0}
FACTORS = FORCE | LENGTH | SPEED | FREQUENCY | TIME | PLAIN
KINDS = {"force": FORCE, "length": LENGTH, "speed": SPEED | FREQUENCY, "time": TIME}
"""By what is measured: the units that fit, each with its worth in N, mm, rpm or ms."""


def factor(unit: str, pole_pairs: int) -> float:
    """Worth of one of that unit in N, mm, rpm or ms."""
    return FACTORS[unit] / (pole_pairs if unit in FREQUENCY else 1)


# The tables of a device profile: one frozen model each. What they mean: docs/devices.md.

_ACTUATOR, _SPINDLE, _SENSOR = ActuatorTimes(), SpindleTimes(), SensorTimes()

Unpowered = Literal["lifts", "stays", "presses"]
WordOrder = Literal["high_first", "low_first"]
Value = float | str
Values = Annotated[tuple[Annotated[Value, WithJsonSchema({"type": "number"})], ...], BeforeValidator(as_tuple)]
Times = Annotated[float, Field(gt=0.0, le=120.0)]

LEAST = {"u16": 0, "i16": -(1 << 15), "u32": 0, "i32": -(1 << 31), "bit": 0, "f32": -3.4e38}
MOST = {"u16": (1 << 16) - 1, "i16": (1 << 15) - 1, "u32": (1 << 32) - 1, "i32": (1 << 31) - 1, "bit": 1, "f32": 3.4e38}
"""Of the raw values of a register, by its type."""


class StateCondition(ConfigSection):
    """A condition on one value that the device gives, in N, mm or rpm where it has a unit."""

    when: Text
    """Name of the value: a register's, or a group's of an answer."""
    mask: Annotated[int, Field(ge=1, le=0xFFFFFFFF)] | None = None
    """Only these bits of it count. [1]"""
    equals: Values = ()
    """It is one of these numbers (or texts), ... [1]"""
    unlike: Values = ()
    """... or none of these, ... [1]"""
    above: float | None = None
    """... or greater than this, ... [1]"""
    below: float | None = None
    """... or less than this. Of several conditions all must hold. [1]"""

    @model_validator(mode="after")
    def _asks_something(self) -> Self:
        if not (self.equals or self.unlike) and self.above is None and self.below is None:
            raise ValueError("when: asks nothing; add equals, unlike, above or below")
        return self

    def holds(self, value: Value) -> bool:
        """Whether it is so of that value."""
        if isinstance(value, float) and self.mask is not None:
            value = float(int(value) & self.mask)
        fits = (not self.equals or value in self.equals) and value not in self.unlike
        if isinstance(value, str):
            return fits and self.above is None and self.below is None
        return fits and (self.above is None or value > self.above) and (self.below is None or value < self.below)


class StateRule(StateCondition):
    """What the device's words for its state mean. The first rule that holds decides."""

    state: Literal["retracted", "extending", "contact", "retracting", "fault", "stopped", "running", "taring"]
    """Of an actuator, of a spindle (`stopped`, `running`), of a force sensor (`taring`: its readings mean nothing
    yet), or `fault` of any."""


class Quantity(ConfigSection):
    """A number on the wire, and what it is worth."""

    unit: Text = "1"
    """Its unit on the wire: N, mN, kN, kgf, gf, lbf, ozf; mm, um, m, in; rpm, 1/s, Hz (of the motor's current); ms, s;
    1 for words of state and the like."""
    scale: float = 1.0
    """One step of the number is so many of the unit. [1]"""
    offset: float = 0.0
    """In the unit; added after scaling. [1]"""
    negative: StateCondition | None = None
    """When the number, which has no sign of its own, means less than nothing."""
    range: Range | None = None
    """What can be true, in N, mm or rpm; anything else is another device, or another word order. [1]"""

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
            raise ValueError("scale must not be 0: no number could be read")
        return scale


class Register(Quantity):
    """A register, or several that hold one value. Addresses count from 0, as on the wire."""

    address: Annotated[int, Field(ge=0, le=0xFFFF)]
    """As on the wire, from 0: many manuals count from 1, or write 40001 for the first holding register. [1]"""
    table: RegisterTable = "holding"
    """Read with function 3, 4, 1 or 2; written with 6 (or 16) or 5 (or 15)."""
    type: Literal["u16", "i16", "u32", "i32", "f32", "bit", "text"] = "u16"
    """What the words are: whole, whole with a sign, a float of IEEE 754, one bit, or ASCII, two characters a word."""
    words: Annotated[int, Field(ge=1, le=64)] = 1
    """Of a text: how many registers it fills. [1]"""
    word_order: WordOrder | None = None
    """Of this one, where it is not as `modbus.word_order`."""
    write_many: bool = False
    """Written with function 16 (15), also where one word would do."""

    @property
    def size(self) -> int:
        """Registers that it fills."""
        return {"u32": 2, "i32": 2, "f32": 2, "text": self.words}.get(self.type, 1)

    @property
    def bits(self) -> bool:
        """One bit each: a coil or a discrete input."""
        return self.table in {"coil", "discrete"}

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.bits != (self.type == "bit"):
            raise ValueError(f'type: a {self.table} is {"" if self.bits else "not "}of type "bit"; mend one of the two')
        if self.words != 1 and self.type != "text":
            raise ValueError("words: only a text has them")
        return self


class RegexGroup(Quantity):
    """A named group of an answer."""

    type: Literal["number", "hex", "text"] = "number"
    """What its characters are."""


class LineRequest(ConfigSection):
    """A request on the line, and its answer."""

    send: Text
    """The request, without its ending."""
    answer: Text
    """A regular expression that the whole answer fits; its named groups are values: `(?P<force>[-+]?\\d+\\.\\d+) N`."""

    @field_validator("answer")
    @classmethod
    def _pattern(cls, answer: str) -> str:
        return pattern(answer)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the values that the answer has."""
        return tuple(re.compile(self.answer).groupindex)


def pattern(text: str) -> str:
    """The text, if it is a regular expression."""
    try:
        re.compile(text)
    except re.error as error:
        raise ValueError(f"{text!r} is no regular expression: {error}; mend it") from error
    return text


class SerialTable(ConfigSection):
    """The serial line; an address in the cell may say otherwise: `serial:PATH?baud=9600&parity=even&stop_bits=1`."""

    baud: Annotated[int, Field(ge=300, le=4_000_000)] = 115_200
    """Its pace. [bit/s]"""
    parity: Literal["none", "even", "odd"] = "none"
    """Of each byte."""
    stop_bits: Literal[1, 2] = 1
    """After each byte. [1]"""


class ModbusTable(ConfigSection):
    """The device speaks Modbus: RTU on a serial line, or TCP."""

    unit: Annotated[int, Field(ge=0, le=247)] = 1
    """Its unit number; the cell may say otherwise. [1]"""
    word_order: WordOrder = "high_first"
    """Of values of two words."""
    max_registers: Annotated[int, Field(ge=1, le=125)] = 125
    """Most registers that it gives in one answer. [1]"""
    pause_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Silence that it needs before a request, beyond the three and a half bytes of the standard."""
    error_replies: dict[str, Text] = Field(default_factory=dict)
    """What its exception codes mean, where the standard says too little: `4 = "a fault is set"`."""


class LinesTable(ConfigSection):
    """The device speaks lines of ASCII text."""

    framing: Literal["plain", "numbered"] = "plain"
    """`numbered`: `$` number `,` text `*` checksum, as docs/protocols/voice_coil_serial.md has it."""
    ending: Text = "\r\n"
    """What ends a request."""
    answer_ending: Text = "\n"
    """What ends an answer; a CR before it is dropped."""
    accepted: str = "OK"
    """A regular expression that the answer to an order fits; `""`: orders are not answered."""
    refused: str = ""
    """A regular expression that a refusal fits, whatever was asked; its group `why`, if it has one, says why."""

    @field_validator("accepted", "refused")
    @classmethod
    def _pattern(cls, text: str) -> str:
        return pattern(text)


class CommandSteps(ConfigSection):
    """What is written, in this order. On Modbus `"register = value"`; on lines the request itself.

    The value is a number, `asked` (the force in newtons, the speed in rpm without its sign, the time, each turned into
    the register's unit) or `count` (one more each time). In a request it is `{asked:.2f}` or `{count}`.
    """

    force: Texts = ()
    """Of an actuator: the set point."""
    engage: Texts = ()
    """To extend, land and press with the set point; left out where the set point alone does it."""
    retract: Texts = ()
    """Force off, then lift: in that order, where these are two."""
    rest: Texts = ()
    """Once it is retracted."""
    forward: Texts = ()
    """Of a spindle: turn that fast, also when it turns already."""
    reverse: Texts = ()
    """The other way; left out: it cannot."""
    stop: Texts = ()
    """Stop turning."""
    clear: Texts = ()
    """Take back a fault; done for those of `faults.clears` only, when the device is made safe."""
    watchdog: Texts = ()
    """Tell the device how long it may hear nothing; left out: it is set at the device."""
    heartbeat: Texts = ()
    """Feed that watchdog; left out: any request does."""
    tare: Texts = ()
    """Of a force sensor: what it reads now is no force."""


class Faults(ConfigSection):
    """What the device says of its faults. Anything but 0 is one."""

    value: Text
    """Name of the value."""
    mask: Annotated[int, Field(ge=1, le=0xFFFFFFFF)] | None = None
    """Only these bits of it count. [1]"""
    bits: dict[str, Text] = Field(default_factory=dict)
    """What each bit means, by its worth: `4 = "drive"`."""
    codes: dict[str, Text] = Field(default_factory=dict)
    """Or what each number means."""
    clears: Values = ()
    """Those of the device's own watchdog: made safe, it is told `commands.clear`; all others are a person's. [1]"""


class IdentityTable(ConfigSection):
    """Who it is, where it does not say so itself in values `vendor`, `model`, `serial`, `firmware`, `boot`."""

    vendor: Text
    """Who makes it."""
    model: Text
    """What it is."""
    serial: Text = "not told"
    """Its number."""
    firmware: Text = "not told"
    """Its firmware."""


class ActuatorTable(ConfigSection):
    """A force actuator, and its times where the cell says no others."""

    unpowered: Unpowered
    """What the tool does when its power goes; with `presses` no part is safe, and the profile is refused."""
    max_force_n: Positive
    """More is never asked."""
    watchdog_s: Times = _ACTUATOR.watchdog_s
    """So long without a word it takes the force off and lifts, by itself."""
    landing_s: Times = _ACTUATOR.landing_s
    """Longest from engaging to contact."""
    release_s: Times = _ACTUATOR.release_s
    """Longest from the order to force off."""
    retract_s: Times = _ACTUATOR.retract_s
    """Longest from force off until it tells that the tool is up."""
    stroke_mm: Positive = _ACTUATOR.stroke_mm
    """How far the tool can follow the part."""

    @field_validator("unpowered")
    @classmethod
    def _lets_go(cls, unpowered: str) -> str:
        if unpowered == "presses":
            raise ValueError(
                "a tool that presses without power digs into the part at each power cut; add a spring, a weight or a "
                'valve that lifts it, and write "lifts"'
            )
        return unpowered


class SpindleTable(ConfigSection):
    """A spindle, and its times where the cell says no others."""

    max_rpm: Positive
    """Faster is never asked."""
    watchdog_s: Times = _SPINDLE.watchdog_s
    """So long without a word it stops by itself."""
    spin_s: Times = _SPINDLE.spin_s
    """Longest from standstill to any speed, or back."""


class ForceSensorTable(ConfigSection):
    """A force sensor."""

    range_n: Range
    """What it can measure; pressing is positive."""
    delay_s: Annotated[float, Field(ge=0.0, le=5.0)] = _SENSOR.delay_s
    """Longest from a force that acts to its reading: filter, conversion and link."""
    tare_s: Times = _SENSOR.tare_s
    """Longest from `commands.tare` until what it read then is 0, ..."""
    zero_n: Positive = 0.1
    """... or not more than this. Not used where a state `taring` says when the tare ends."""
    period_s: Annotated[float, Field(ge=0.005, le=1.0)] = 0.05
    """Time between two readings."""


Kind = Literal["actuator", "spindle", "force_sensor"]
TRIED = {
    "manual": "from the manual, not tried on the device",
    "simulator": "tried on a simulated device",
    "device": "tried on the device",
}
IDENTITY = ("vendor", "model", "serial", "firmware", "boot")
"""Values by which the device says who it is."""


class DeviceProfile(TomlDocument):
    """One kind of device on one kind of link: one of each has its table."""

    title: Text
    """What it is, for people."""
    manual: Text
    """Where all of this stands: the manual, its edition, its pages."""
    tried: Literal["manual", "simulator", "device"]
    """Whether somebody has seen it work: not at all (`manual`), on a simulated device, or on the device itself."""
    settings: Texts = ()
    """What must be set at the device itself, for people."""
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
        """Of its file."""
        return self._path.stem

    @property
    def kind(self) -> Kind:
        """Which device it is."""
        return "actuator" if self.actuator else "spindle" if self.spindle else "force_sensor"

    @property
    def link(self) -> Literal["modbus", "lines"]:
        """What it speaks."""
        return "modbus" if self.modbus else "lines"

    @property
    def quantities(self) -> Mapping[str, Quantity]:
        """What each value is worth, by name. Groups of answers without a table of their own are plain numbers."""
        if self.modbus:
            return self.registers
        return {name: self.values.get(name, RegexGroup()) for ask in self.asks.values() for name in ask.groups}

    @property
    def polled(self) -> tuple[str, ...]:
        """Values that tell how the device is, and what they lean on."""
        said = {
            "actuator": ("force", "set_point", "position"),
            "spindle": ("speed",),
            "force_sensor": ("force", "count"),
        }
        named = [name for name in (*said[self.kind], "beat_echo") if name in self.quantities]
        named += [rule.when for rule in self.states] + ([self.faults.value] if self.faults else [])
        return self.with_signs(named)

    @property
    def identity_values(self) -> tuple[str, ...]:
        """Values by which the device says who it is."""
        named = [name for name in IDENTITY if name in self.quantities]
        return self.with_signs([*named, *(one.when for one in self.expects)])

    def with_signs(self, names: Sequence[str]) -> tuple[str, ...]:
        """The values, each once, and those that say which of them are less than nothing."""
        signs = [found.when for name in names if (found := self.quantities[name].negative)]
        return tuple(dict.fromkeys([*names, *signs]))


# The steps of an order: ``"command = 1"`` on Modbus, the request itself on lines.

_WRITE = re.compile(r"\s*([A-Za-z]\w*)\s*=\s*(asked|count|[-+]?\d+(?:\.\d+)?|0[xX][0-9A-Fa-f]+)\s*")
SLOTS = {"asked": 1.5, "count": 1}
"""What a request may have in braces, with a value to try its format with."""


@dataclass(frozen=True, slots=True)
class Write:
    """One write to a register."""

    register: str
    value: float | Literal["asked", "count"]


def write_of(step: str) -> Write:
    """A step on Modbus. ValueError says what is wrong with it."""
    match = _WRITE.fullmatch(step)
    if match is None:
        raise ValueError(f'{step!r} is no write; write "register = 1", "register = asked" or "register = count"')
    name, text = match.groups()
    if text in {"asked", "count"}:
        return Write(name, text)  # type: ignore[arg-type]
    return Write(name, float(int(text, 16)) if text[:2].lower() == "0x" else float(text))


def slots_of(step: str) -> set[str]:
    """What stands in braces in a step on lines. ValueError says what is wrong with it."""
    try:
        found = {name for _, name, _, _ in Formatter().parse(step) if name is not None}
        if unknown := found - set(SLOTS):
            raise ValueError(f"{{{min(unknown)}}} is none of {{asked}}, {{count}}")
        step.format(**SLOTS).encode("ascii")
    except (ValueError, IndexError, KeyError, AttributeError) as error:
        raise ValueError(f"{step!r} cannot be sent: {error}") from error
    return found
