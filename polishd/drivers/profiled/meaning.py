"""What a device's values mean, by its profile. Pure. Raises ProtocolError on what the profile does not have."""

from __future__ import annotations

from polishd.api import DeviceIdentity, ProtocolError
from polishd.config.device_profile import IDENTITY, DeviceProfile
from polishd.config.device_tables import Value
from polishd.drivers.profiled.codec import Values


def state_of(profile: DeviceProfile, values: Values) -> str:
    """The state, by the first rule that holds."""
    for rule in profile.states:
        if rule.holds(values[rule.when]):
            return rule.state
    said = ", ".join(f"{name} {_plain(values[name])}" for name in dict.fromkeys(rule.when for rule in profile.states))
    raise ProtocolError(f"{said} is no state that profile {profile.name!r} knows; is it another device?")


def fault_of(profile: DeviceProfile, values: Values) -> int:
    """Bits or code of the faults; 0: none."""
    if profile.faults is None:
        return 0
    value = values[profile.faults.value]
    if isinstance(value, str):
        raise ProtocolError(f"{profile.faults.value} reads {value!r} where a number stands; mend the profile")
    return int(value) if profile.faults.mask is None else int(value) & profile.faults.mask


def fault_words(profile: DeviceProfile, fault: int) -> str:
    """The faults in words."""
    if profile.faults is None or not fault:
        return ""
    known = [text for bit, text in profile.faults.bits.items() if fault & int(bit)]
    known += [text for code, text in profile.faults.codes.items() if fault == int(code)]
    return ", ".join(known) or f"fault {fault}, of which the profile does not say what it is"


def number(values: Values, name: str, default: float) -> float:
    """A value that is a number; the default where the device does not give it."""
    value = values.get(name, default)
    if isinstance(value, str):
        raise ProtocolError(f"{name} reads {value!r} where a number stands; mend the profile")
    return value


def identity(profile: DeviceProfile, values: Values) -> DeviceIdentity:
    """What the device says of itself, and for the rest what the profile does."""
    said = {name: _plain(values[name]) for name in IDENTITY if name in values}
    boot = said.pop("boot", "")
    return DeviceIdentity(**{**dict(profile.identity), **said}, boot_id=boot)


def _plain(value: Value) -> str:
    return value if isinstance(value, str) else f"{value:.15g}"
