"""Device profiles: what a drive or a sensor says and hears on its wire, as data (docs/devices.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from polishd.config.device_tables import (
    ActuatorTable,
    CommandSteps,
    Faults,
    ForceSensorTable,
    IdentityTable,
    LineRequest,
    LinesTable,
    ModbusTable,
    Quantity,
    RegexGroup,
    Register,
    SerialTable,
    SpindleTable,
    StateCondition,
    StateRule,
)
from polishd.config.document import TomlDocument
from polishd.config.values import Text, Texts, as_tuple

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
    orders: CommandSteps = CommandSteps()
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
    def told(self) -> tuple[str, ...]:
        """Values by which the device says who it is."""
        named = [name for name in IDENTITY if name in self.quantities]
        return self.with_signs([*named, *(one.when for one in self.expects)])

    def with_signs(self, names: Sequence[str]) -> tuple[str, ...]:
        """The values, each once, and those that say which of them are less than nothing."""
        signs = [found.when for name in names if (found := self.quantities[name].negative)]
        return tuple(dict.fromkeys([*names, *signs]))
