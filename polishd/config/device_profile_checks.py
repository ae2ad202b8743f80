"""Consistency checks of a device profile; each fault names its key."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from polishd.config.device_profile import KINDS, LEAST, MOST, DeviceProfile, Faults, slots_of, write_of
from polishd.config.toml_loader import Location, did_you_mean, join_words, loads_toml
from polishd.model.errors import ConfigError
from polishd.util.files import named_path, toml_text

Fault = tuple[Location, str]

DEVICES = ("actuator", "spindle", "force_sensor")
LINKS = ("modbus", "lines")
NEEDS = {
    "actuator": (("force",), ("force", "retract"), ("retracted", "contact")),
    "spindle": (("speed",), ("forward", "stop"), ("stopped", "running")),
    "force_sensor": (("force",), ("tare",), ()),
}
"""Required values, commands and states, by kind."""
ORDERS = {
    "actuator": {"force", "engage", "retract", "rest", "clear", "watchdog", "heartbeat"},
    "spindle": {"forward", "reverse", "stop", "clear", "watchdog", "heartbeat"},
    "force_sensor": {"tare", "clear"},
}
STATES = {
    "actuator": {"retracted", "extending", "contact", "retracting", "fault"},
    "spindle": {"stopped", "running", "fault"},
    "force_sensor": {"fault", "taring"},
}
MEASURES = {"force": "force", "position": "length", "speed": "speed"}
"""Quantity of each value that polishd knows by name."""
ASKED = {"force": "force", "engage": "force", "forward": "speed", "reverse": "speed", "watchdog": "time"}
"""Quantity of ``asked`` in each command."""


def faults_of(profile: DeviceProfile) -> list[Fault]:
    """Return key and problem of each fault, in the best order to correct them."""
    shape = list(_shape(profile))
    return shape or [
        *_needs(profile),
        *_foreign(profile),
        *_units(profile),
        *_sizes(profile),
        *_orders(profile),
        *_names(profile),
    ]


def _shape(profile: DeviceProfile) -> Iterator[Fault]:
    for names in (DEVICES, LINKS):
        given = [name for name in names if getattr(profile, name) is not None]
        if len(given) != 1:
            has = f"has {' and '.join(f'[{name}]' for name in given)}" if given else "has none of them"
            tables = ", ".join(f"[{name}]" for name in names)
            yield (given[-1] if given else names[0],), f"a profile has one of {tables}; this one {has}"
    for name in ("asks", "values") if profile.modbus else ("registers",):
        if getattr(profile, name):
            yield (name,), f"needs [{'lines' if profile.modbus else 'modbus'}]; remove it"
    own = "registers" if profile.modbus else "asks"
    if not getattr(profile, own):
        yield (own,), f"is missing; add [{own}.NAME] for each value of the device"


def _needs(profile: DeviceProfile) -> Iterator[Fault]:
    values, orders, states = NEEDS[profile.kind]
    for name in values:
        if name not in profile.quantities:
            what = f"[registers.{name}]" if profile.modbus else f"an answer with a group (?P<{name}>...)"
            where = "registers" if profile.modbus else "asks"
            yield (where,), f"every {_kind(profile)} needs a value {name!r}; add {what}"
    for name in orders:
        if not getattr(profile.commands, name):
            yield ("commands", name), f"is missing, and every {_kind(profile)} needs it; add it: {name} = [...]"
    for state in states:
        if state not in {rule.state for rule in profile.states}:
            yield ("states",), f'there is no rule for "{state}"; add [[states]] with state = "{state}"'


def _foreign(profile: DeviceProfile) -> Iterator[Fault]:
    """Yield commands and states of another kind of device."""
    orders, states = ORDERS[profile.kind], STATES[profile.kind]
    for name in type(profile.commands).model_fields:
        if getattr(profile.commands, name) and name not in orders:
            yield ("commands", name), f"is not a command of this {_kind(profile)}; known: {join_words(orders)}"
    for at, rule in enumerate(profile.states):
        if rule.state not in states:
            problem = f'"{rule.state}" is not a state of this {_kind(profile)}; known: {join_words(states)}'
            yield ("states", at, "state"), problem


def _units(profile: DeviceProfile) -> Iterator[Fault]:
    table = "registers" if profile.modbus else "values"
    meant = MEASURES | {"set_point": "speed" if profile.spindle else "force"}
    for name, quantity in profile.quantities.items():
        if name in meant and quantity.unit not in KINDS[meant[name]]:
            fitting = join_words(KINDS[meant[name]])
            yield (table, name, "unit"), f"{quantity.unit!r} is not a unit of {meant[name]}; use one of {fitting}"


def _sizes(profile: DeviceProfile) -> Iterator[Fault]:
    for name, register in profile.registers.items():
        if profile.modbus and register.size > profile.modbus.max_registers:
            most = profile.modbus.max_registers
            yield (
                ("registers", name),
                f"has {register.size} registers, and modbus.max_registers is {most}; correct one of the two",
            )
        if register.address + register.size > 0x10000:
            yield ("registers", name, "address"), f"{register.size} registers from there end beyond 65535; correct it"


def _orders(profile: DeviceProfile) -> Iterator[Fault]:
    for order in sorted(ORDERS[profile.kind]):
        for step in getattr(profile.commands, order):
            try:
                yield from _step(profile, order, step)
            except ValueError as error:
                yield ("commands", order), str(error)


def _step(profile: DeviceProfile, order: str, step: str) -> Iterator[Fault]:
    key = ("commands", order)
    if not profile.modbus:
        if "asked" in slots_of(step) and order not in ASKED:
            yield key, "this command has no value; remove {asked}"
        return
    write = write_of(step)
    register = profile.registers.get(write.register)
    if register is None:
        near = did_you_mean(write.register, profile.registers)
        yield key, f"there is no [registers.{write.register}]{near} Known: {join_words(profile.registers)}"
    elif register.table in {"input", "discrete"} or register.type == "text":
        yield key, f"{write.register!r} cannot be written: it is a {register.table} register of type {register.type}"
    elif isinstance(write.value, float):
        if not LEAST[register.type] <= write.value <= MOST[register.type]:
            yield (
                key,
                f"{write.value:g} does not fit {write.register!r} of type {register.type}; correct one of the two",
            )
    elif write.value == "asked":
        if order not in ASKED:
            yield key, "this command has no value; write a number"
        elif register.unit not in KINDS[ASKED[order]]:
            fitting = join_words(KINDS[ASKED[order]])
            problem = f"commands.{order} writes a {ASKED[order]} there, and {register.unit!r} is not a unit of it"
            yield ("registers", write.register, "unit"), f"{problem}; use one of {fitting}"


def _names(profile: DeviceProfile) -> Iterator[Fault]:
    known = profile.quantities
    used: list[tuple[Location, str]] = [(("states", at, "when"), rule.when) for at, rule in enumerate(profile.states)]
    used += [(("expects", at, "when"), rule.when) for at, rule in enumerate(profile.expects)]
    used += [(("faults", "value"), profile.faults.value)] if profile.faults else []
    table = "registers" if profile.modbus else "values"
    used += [((table, name, "negative"), q.negative.when) for name, q in known.items() if q.negative]
    for key, name in used:
        if name not in known:
            yield key, f"there is no value {name!r}{did_you_mean(name, known)} Known: {join_words(known)}"
    for name in profile.values:
        if name not in known:
            yield ("values", name), f"no answer has a group {name!r}; add it to an answer of [asks], or remove this"
    if profile.faults:
        yield from _fault_numbers(profile, profile.faults)


def _fault_numbers(profile: DeviceProfile, faults: Faults) -> Iterator[Fault]:
    for table in ("bits", "codes"):
        for number in getattr(faults, table):
            if not number.isdecimal():
                yield ("faults", table, number), f"{number!r} is not a number; write the value of the bit, or the code"
    if faults.clears and not profile.commands.clear and not profile.actuator:
        yield ("faults", "clears"), "needs the command that clears a fault; add it: commands.clear = [...]"


def _kind(profile: DeviceProfile) -> str:
    return profile.kind.replace("_", " ")


# Read and check a device profile's file.


def load_device_profile(path: Path) -> DeviceProfile:
    """Read a profile; ConfigError with one line per problem: ``FILE:LINE: table.key: what is wrong; what to do``."""
    return device_profile_of(toml_text(path), path)


def device_profile_of(text: str, path: Path) -> DeviceProfile:
    """Read the text of a profile's file, as ``load_device_profile``."""
    profile = DeviceProfile.of(*loads_toml(text, path))
    if found := faults_of(profile):
        raise ConfigError("\n".join(profile.source.error(key, problem) for key, problem in found))
    return profile


# Profiles: polishd's by name, the user's by file.

DEVICE_PROFILE_DIR = Path(__file__).with_name("device_profiles")


def shipped() -> list[str]:
    """Names of polishd's profiles, sorted."""
    return sorted(path.stem for path in DEVICE_PROFILE_DIR.glob("*.toml"))


def profile_of(name: str, base_dir: Path) -> DeviceProfile:
    """Read the profile of that name, or a ``.toml`` file relative to ``base_dir``; ConfigError names file and key."""
    if name.endswith(".toml"):
        return load_device_profile(named_path(base_dir, name))
    known = shipped()
    if name not in known:
        hint = f"{did_you_mean(name, known)} polishd has {join_words(known)}. Use one, or your own NAME.toml"
        raise ConfigError(f"profile {name!r} is not known{hint}")
    return load_device_profile(DEVICE_PROFILE_DIR / f"{name}.toml")
