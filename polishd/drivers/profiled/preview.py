"""What a profile makes of a device: the requests as they go over the wire, and how raw values read. Opens nothing."""

from __future__ import annotations

from collections.abc import Iterator

from polishd.api import ConfigError, PolishdError
from polishd.config.device_checks import ORDERS
from polishd.config.device_profile import DeviceProfile
from polishd.config.device_steps import write_of
from polishd.config.device_tables import ModbusTable, Quantity, Value
from polishd.drivers.profiled import codec, meaning
from polishd.drivers.profiled.codec import Values
from polishd.drivers.profiled.make import usual_line
from polishd.drivers.profiled.modbus_link import read_frame, write_frame

EXAMPLES = {"force": (12.0, "12 N"), "speed": (1000.0, "1000 rpm"), "time": (1000.0, "1 s")}
ASKS = {"force": "force", "engage": "force", "forward": "speed", "reverse": "speed", "watchdog": "time"}
UNITS = {"force": "N", "set_point": "N", "position": "mm", "speed": "rpm"}


def polls(profile: DeviceProfile) -> list[str]:
    """The requests of one look at the device."""
    if profile.modbus is None:
        return [ask.send for ask in profile.asks.values() if set(ask.groups) & set(profile.polled)]
    found = codec.blocks(profile.registers, profile.polled, profile.modbus.most)
    return [_hex(read_frame(profile.modbus.unit, one.table, one.address, one.count)) for one in found]


def poll_s(profile: DeviceProfile) -> float:
    """Seconds that one look takes on its serial line, requests and answers, without the device's own time."""
    byte_s = usual_line(profile).byte_s
    if profile.modbus is None:
        return byte_s * sum(len(ask) + 2 + 40 for ask in polls(profile))
    found = codec.blocks(profile.registers, profile.polled, profile.modbus.most)
    sizes = [one.count if one.table in {"holding", "input"} else -(-one.count // 16) for one in found]
    return sum(max(7.0 * byte_s, 0.0035) + profile.modbus.pause_s + byte_s * (8 + 5 + 2 * size) for size in sizes)


def orders(profile: DeviceProfile) -> Iterator[tuple[str, str]]:
    """Each order, and what is sent for an example of what may be asked."""
    for name in type(profile.orders).model_fields:
        steps = getattr(profile.orders, name)
        if steps and name in ORDERS[profile.kind]:
            asked, words = EXAMPLES[ASKS[name]] if name in ASKS else (0.0, "")
            sent = " | ".join(_sent(profile, step, asked) for step in steps)
            yield f"{name}, {words}" if words else name, sent


def scales(profile: DeviceProfile) -> Iterator[tuple[str, str]]:
    """Each value that tells how it is, where it stands, and what one step of it is worth."""
    for name in profile.polled:
        quantity = profile.quantities[name]
        yield name, ", ".join(filter(None, [_place(profile, name), _worth(quantity), _sign(quantity)]))


def read_raw(profile: DeviceProfile, name: str, text: str) -> Values:
    """What a raw example reads: words of a register (``0x04AE``, or several), or the answer to an ask."""
    try:
        if profile.modbus is not None:
            found = _of_words(profile, profile.modbus, name, text)
        else:
            ask = profile.asks[name]
            found = codec.fields_of(profile, ask, text)
            if set(found) >= set(profile.polled):
                found = codec.signed(profile, found)
                found["(state)"] = meaning.state_of(profile, found) if profile.states else "none"
    except KeyError:
        known = ", ".join(profile.registers or profile.asks)
        raise ConfigError(f"raw example {name!r}: the profile has no such {_thing(profile)}; it has {known}") from None
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
    """A value with its unit."""
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
