"""Build a closed device from a profile and an address."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from polishd.api import ActuatorTimes, ConfigError, PolishdError, SensorTimes, SpindleTimes
from polishd.config.device_profile import DeviceProfile, ModbusTable, Quantity, Value, write_of
from polishd.config.device_profile_checks import ORDERS
from polishd.drivers.profile_device import codec
from polishd.drivers.profile_device.codec import Values
from polishd.drivers.profile_device.device import ProfileTransport
from polishd.drivers.profile_device.drives import ProfiledActuator, ProfiledForceSensor, ProfiledSpindle
from polishd.drivers.profile_device.links import LineWire, ModbusWire
from polishd.drivers.transport.address import SerialLine, Tcp, line_address
from polishd.drivers.transport.modbus_link import read_frame, write_frame


def usual_line(profile: DeviceProfile) -> SerialLine:
    """Return the profile's serial settings, without a path."""
    return SerialLine(Path(), profile.serial.baud, profile.serial.parity, profile.serial.stop_bits)


def address_of(profile: DeviceProfile, text: str, base_dir: Path) -> SerialLine | Tcp:
    """Parse the address; the profile supplies serial settings that it omits. ConfigError names the address."""
    return line_address(text, base_dir, f"a device on {profile.link}", usual_line(profile))


def wire_of(
    profile: DeviceProfile, address: SerialLine | Tcp, silence_s: float, *, unit: int | None = None, pole_pairs: int = 1
) -> ProfileTransport:
    """Build the link; opens nothing."""
    if profile.modbus:
        return ModbusWire(profile, address, silence_s, unit=unit, pole_pairs=pole_pairs)
    return LineWire(profile, address, silence_s, pole_pairs=pole_pairs)


def actuator(
    profile: DeviceProfile, address: SerialLine | Tcp, times: ActuatorTimes | None = None, *, unit: int | None = None
) -> ProfiledActuator:
    """Build a force actuator; opens nothing."""
    times = times or ActuatorTimes()
    return ProfiledActuator(wire_of(profile, address, times.silence_s, unit=unit), times)


def spindle(
    profile: DeviceProfile,
    address: SerialLine | Tcp,
    times: SpindleTimes | None = None,
    *,
    unit: int | None = None,
    pole_pairs: int = 1,
) -> ProfiledSpindle:
    """Build a spindle; opens nothing."""
    times = times or SpindleTimes()
    return ProfiledSpindle(wire_of(profile, address, times.silence_s, unit=unit, pole_pairs=pole_pairs), times)


def force_sensor(
    profile: DeviceProfile, address: SerialLine | Tcp, times: SensorTimes | None = None, *, unit: int | None = None
) -> ProfiledForceSensor:
    """Build a force sensor; opens nothing."""
    times = times or SensorTimes()
    return ProfiledForceSensor(wire_of(profile, address, times.silence_s, unit=unit), times)


# Effect of a profile: the requests on the link, and the meaning of raw values. Opens nothing.

EXAMPLES = {"force": (12.0, "12 N"), "speed": (1000.0, "1000 rpm"), "time": (1000.0, "1 s")}
ASKS = {"force": "force", "engage": "force", "forward": "speed", "reverse": "speed", "watchdog": "time"}
UNITS = {"force": "N", "set_point": "N", "position": "mm", "speed": "rpm"}


def polls(profile: DeviceProfile) -> list[str]:
    """Requests of one poll of the device."""
    if profile.modbus is None:
        return [ask.send for ask in profile.asks.values() if set(ask.groups) & set(profile.polled)]
    found = codec.blocks(profile.registers, profile.polled, profile.modbus.max_registers)
    return [_hex(read_frame(profile.modbus.unit, one.table, one.address, one.count)) for one in found]


def poll_s(profile: DeviceProfile) -> float:
    """Time of one poll on the serial line, s: requests and answers, without the device's response time."""
    byte_s = usual_line(profile).byte_s
    if profile.modbus is None:
        return byte_s * sum(len(ask) + 2 + 40 for ask in polls(profile))
    found = codec.blocks(profile.registers, profile.polled, profile.modbus.max_registers)
    sizes = [one.count if one.table in {"holding", "input"} else -(-one.count // 16) for one in found]
    return sum(max(7.0 * byte_s, 0.0035) + profile.modbus.pause_s + byte_s * (8 + 5 + 2 * size) for size in sizes)


def orders(profile: DeviceProfile) -> Iterator[tuple[str, str]]:
    """Each command, and the bytes that are sent for an example value."""
    for name in type(profile.commands).model_fields:
        steps = getattr(profile.commands, name)
        if steps and name in ORDERS[profile.kind]:
            asked, words = EXAMPLES[ASKS[name]] if name in ASKS else (0.0, "")
            sent = " | ".join(_sent(profile, step, asked) for step in steps)
            yield f"{name}, {words}" if words else name, sent


def scales(profile: DeviceProfile) -> Iterator[tuple[str, str]]:
    """Each status value, its location, and the size of one step."""
    for name in profile.polled:
        quantity = profile.quantities[name]
        yield name, ", ".join(filter(None, [_place(profile, name), _worth(quantity), _sign(quantity)]))


def read_raw(profile: DeviceProfile, name: str, text: str) -> Values:
    """Decode a raw example: register words (``0x04AE``, or several), or the answer to a request."""
    try:
        if profile.modbus is not None:
            found = _of_words(profile, profile.modbus, name, text)
        else:
            ask = profile.asks[name]
            found = codec.fields_of(profile, ask, text)
            if set(found) >= set(profile.polled):
                found = codec.signed(profile, found)
                found["(state)"] = codec.state_of(profile, found) if profile.states else "none"
    except KeyError:
        known = ", ".join(profile.registers or profile.asks)
        raise ConfigError(
            f"raw example {name!r}: the profile has no such {_thing(profile)}; it has {known}. Name one of them"
        ) from None
    except (PolishdError, ValueError, OverflowError) as error:
        raise ConfigError(f"raw example {name}={text!r}: {error}") from error
    return found


def _of_words(profile: DeviceProfile, table: ModbusTable, name: str, text: str) -> Values:
    register = profile.registers[name]
    words = [int(word, 0) for word in text.replace(",", " ").split()]
    if len(words) != register.size:
        raise ValueError(f"it fills {register.size} registers, not {len(words)}")
    return {name: codec.worth(register, codec.unpack(register, words, table.word_order), 1)}


def said(name: str, value: Value) -> str:
    """Format a value with its unit."""
    return value if isinstance(value, str) else f"{value:.6g} {UNITS.get(name, '')}".strip()


def _sent(profile: DeviceProfile, step: str, asked: float) -> str:
    if profile.modbus is None:
        return step.format(asked=asked, count=1)
    write = write_of(step)
    register = profile.registers[write.register]
    if isinstance(write.value, float):
        words = codec.pack(register, write.value, profile.modbus.word_order)
    elif write.value == "asked":
        words = codec.words_for(register, write.register, asked, profile.modbus.word_order, 1)
    else:
        words = codec.pack(register, 1.0, profile.modbus.word_order)
    many = register.write_many or len(words) > 1
    return _hex(write_frame(profile.modbus.unit, register.table, register.address, words, many=many))


def _place(profile: DeviceProfile, name: str) -> str:
    if profile.modbus is None:
        return "in the answer to " + next(ask.send for ask in profile.asks.values() if name in ask.groups)
    register = profile.registers[name]
    return f"{register.table} {register.address} (0x{register.address:04X}), {register.type}"


def _worth(quantity: Quantity) -> str:
    if quantity.unit == "1":
        return ""
    offset = f" {quantity.offset:+g} {quantity.unit}" if quantity.offset else ""
    return f"1 is {quantity.scale:g} {quantity.unit}{offset}"


def _sign(quantity: Quantity) -> str:
    return f"less than nothing by {quantity.negative.when}" if quantity.negative else ""


def _thing(profile: DeviceProfile) -> str:
    return "register" if profile.modbus else "ask"


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()
