"""Convert register words and numbers in answers to quantities, and back. Pure. ProtocolError for impossible values."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from polishd.api import DeviceIdentity, DeviceRefused, ProtocolError
from polishd.config.device_profile import (
    IDENTITY,
    DeviceProfile,
    LineRequest,
    ModbusTable,
    Quantity,
    RegexGroup,
    Register,
    Value,
    WordOrder,
    factor,
)
from polishd.model.devices import RegisterTable

Values = dict[str, Value]
LEAST_FLOAT = 1e-30
"""Smaller than any measured value. A float with its two words exchanged is often smaller."""
FORMATS = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}


@dataclass(frozen=True, slots=True)
class RegisterBlock:
    """Registers that one request reads."""

    table: RegisterTable
    address: int
    count: int
    names: tuple[str, ...]


def blocks(registers: Mapping[str, Register], names: Sequence[str], most: int) -> tuple[RegisterBlock, ...]:
    """Return the fewest requests that read all these registers.

    A block spans only registers of the profile: devices refuse addresses that they do not have.
    """
    known = {(one.table, one.address + at) for one in registers.values() for at in range(one.size)}
    found: list[RegisterBlock] = []
    for name in sorted(names, key=lambda one: (registers[one].table, registers[one].address)):
        register = registers[name]
        last = found[-1] if found else None
        if last and last.table == register.table:
            between = range(last.address + last.count, register.address)
            count = max(register.address + register.size - last.address, last.count)
            if count <= most and all((last.table, at) in known for at in between):
                found[-1] = RegisterBlock(last.table, last.address, count, (*last.names, name))
                continue
        found.append(RegisterBlock(register.table, register.address, register.size, (name,)))
    return tuple(found)


def values_of(profile: DeviceProfile, block: RegisterBlock, words: Sequence[int], pole_pairs: int = 1) -> Values:
    """Decode the words (or bits) of a block, in N, mm, rpm or ms; see ``signed``."""
    order, found = (profile.modbus or ModbusTable()).word_order, Values()
    for name in block.names:
        register = profile.registers[name]
        at = register.address - block.address
        found[name] = worth(register, unpack(register, words[at : at + register.size], order), pole_pairs)
    return found


def fields_of(profile: DeviceProfile, ask: LineRequest, answer: str, pole_pairs: int = 1) -> Values:
    """Decode the line of an answer, in N, mm, rpm or ms; see ``signed``."""
    match = re.fullmatch(ask.answer, answer)
    if match is None:
        raise ProtocolError(f"{ask.send} was answered by {answer!r}, which is no such answer")
    found = Values()
    for name, text in match.groupdict().items():
        if text is not None:
            group = profile.values.get(name, RegexGroup())
            found[name] = worth(group, _raw(group, ask.send, text), pole_pairs)
    return found


def unpack(register: Register, words: Sequence[int], order: WordOrder) -> Value:
    """Return the raw value of a register's words (or its bit)."""
    if register.type == "bit":
        return float(words[0])
    if register.type == "text":
        return _text(words)
    first_high = words if (register.word_order or order) == "high_first" else list(reversed(words))
    raw = b"".join(one.to_bytes(2, "big") for one in first_high)
    value = float(struct.unpack(FORMATS[register.type], raw)[0])
    if not math.isfinite(value) or 0.0 < abs(value) < LEAST_FLOAT:
        raise ProtocolError(f"a float reads {value:.3g}: its two words are in the other order, or it is another device")
    return value


def pack(register: Register, raw: float, order: WordOrder) -> list[int]:
    """Return the words of a raw value; struct.error if it does not fit."""
    if register.type == "bit":
        return [int(raw != 0.0)]
    data = struct.pack(FORMATS[register.type], raw if register.type == "f32" else round(raw))
    words = [int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2)]
    return words if (register.word_order or order) == "high_first" else words[::-1]


def steps_of(quantity: Quantity, asked: float, pole_pairs: int) -> float:
    """Return the raw value to write for a value in N, mm, rpm or ms."""
    return (asked / factor(quantity.unit, pole_pairs) - quantity.offset) / quantity.scale


def worth(quantity: Quantity, raw: Value, pole_pairs: int) -> Value:
    """Convert a raw value that was read to N, mm, rpm or ms."""
    if isinstance(raw, str):
        return raw
    return (raw * quantity.scale + quantity.offset) * factor(quantity.unit, pole_pairs)


def signed(profile: DeviceProfile, values: Values) -> Values:
    """Return the values with the signs that other values give them, each checked against its possible range."""
    found = dict(values)
    for name, value in values.items():
        negative = profile.quantities[name].negative
        if negative and isinstance(value, float) and negative.holds(values[negative.when]):
            found[name] = -value
    for name, value in found.items():
        bounds = profile.quantities[name].range
        if bounds and isinstance(value, float) and not bounds[0] <= value <= bounds[1]:
            raise ProtocolError(f"{name} reads {value:g}, which cannot be: {bounds[0]:g} to {bounds[1]:g}")
    return found


def words_for(register: Register, name: str, asked: float, order: WordOrder, pole_pairs: int) -> list[int]:
    """Return the words to write for a value in N, mm, rpm or ms; DeviceRefused if the register cannot hold it."""
    raw = steps_of(register, asked, pole_pairs)
    try:
        return pack(register, raw, order)
    except (struct.error, OverflowError, ValueError):
        raise DeviceRefused(f"{asked:g} is {raw:.6g} in register {name!r}, which has no room for it") from None


def _text(words: Sequence[int]) -> str:
    raw = b"".join(one.to_bytes(2, "big") for one in words).rstrip(b"\0 ")
    try:
        return raw.decode("ascii")
    except UnicodeDecodeError:
        raise ProtocolError(f"identity text is not ASCII: {raw!r}") from None


def _raw(group: RegexGroup, request: str, text: str) -> Value:
    if group.type == "text":
        return text
    try:
        value = float(int(text, 16)) if group.type == "hex" else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ProtocolError(f"{request} was answered by {text!r} where a number stands")
    return value


# Meaning of a device's values by its profile. Pure. ProtocolError for a value that the profile does not have.


def state_of(profile: DeviceProfile, values: Values) -> str:
    """Return the state by the first rule that matches."""
    for rule in profile.states:
        if rule.holds(values[rule.when]):
            return rule.state
    said = ", ".join(f"{name} {_plain(values[name])}" for name in dict.fromkeys(rule.when for rule in profile.states))
    raise ProtocolError(f"{said} is no state that profile {profile.name!r} knows; is it another device?")


def fault_of(profile: DeviceProfile, values: Values) -> int:
    """Return the bits or the code of the faults; 0: none."""
    if profile.faults is None:
        return 0
    value = values[profile.faults.value]
    if isinstance(value, str):
        raise ProtocolError(f"{profile.faults.value} reads {value!r} where a number stands; mend the profile")
    return int(value) if profile.faults.mask is None else int(value) & profile.faults.mask


def fault_words(profile: DeviceProfile, fault: int) -> str:
    """Describe the faults."""
    if profile.faults is None or not fault:
        return ""
    known = [text for bit, text in profile.faults.bits.items() if fault & int(bit)]
    known += [text for code, text in profile.faults.codes.items() if fault == int(code)]
    return ", ".join(known) or f"fault {fault}, which the profile does not describe"


def number(values: Values, name: str, default: float) -> float:
    """Return a value that is a number; the default if the device does not report it."""
    value = values.get(name, default)
    if isinstance(value, str):
        raise ProtocolError(f"{name} reads {value!r} where a number stands; mend the profile")
    return value


def identity(profile: DeviceProfile, values: Values) -> DeviceIdentity:
    """Return the identity that the device reports, completed from the profile."""
    said = {name: _plain(values[name]) for name in IDENTITY if name in values}
    boot = said.pop("boot", "")
    return DeviceIdentity(**{**dict(profile.identity), **said}, boot_id=boot)


def _plain(value: Value) -> str:
    return value if isinstance(value, str) else f"{value:.15g}"
