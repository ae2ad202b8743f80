"""Which links a simulated cell has, which protocol each speaks, and which faults make no sense there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from polishd.config.simulator import MOTION, STATES, FaultSection, SimConfig
from polishd.model.errors import ConfigError
from polishd.sim_backends.faults.protocols import PROTOCOLS
from polishd.sim_backends.profiled.sheet import SimDeviceProfile

CAN_SUFFER: Mapping[str, tuple[str, ...]] = {
    "robot": MOTION,
    "actuator": ("freeze", "drift", "stick", "spike", "press", "lie"),
    "force_sensor": ("freeze", "drift", "saturate", "halt", "spike", "lie"),
    "spindle": ("reverse",),
}
"""The states that a device can be in: what is measured, or moved, goes wrong."""
ROBOTS = {"link": "robot_link", "opcua": "opcua", "ads": "ads", "modbus": "modbus_tcp"}
UNIVERSAL_ROBOTS = {"rtde": "rtde", "dashboard": "dashboard", "primary": "primary"}


def protocols(config: SimConfig, device: str) -> Mapping[str, str]:
    """The device's links, with the name of the protocol of each; empty: it has none of the simulator's own.

    The one link of a device that has but one is called ``""``. ConfigError where a profile cannot be read.
    """
    if device == "robot":
        kind = config.robot.kind
        return UNIVERSAL_ROBOTS if kind == "universal_robots" else {"": ROBOTS[kind]} if kind in ROBOTS else {}
    if device in {"actuator", "spindle"}:
        section = config.actuator if device == "actuator" else config.spindle
        if section.kind in {"profile", "profile_tcp"}:
            return {"": _profiled(config, section.profile, tcp=section.kind == "profile_tcp")}
        return {"": "numbered lines" if section.kind == "serial" else section.kind}
    return {"": "numbered lines"}


def _profiled(config: SimConfig, profile: str, *, tcp: bool) -> str:
    raw = SimDeviceProfile.read(config.resolve(profile)).raw
    if "lines" in raw:
        return "numbered lines" if raw["lines"].get("framing") == "numbered" else "lines"
    return "modbus_tcp" if tcp else "modbus_rtu"


def require_possible(config: SimConfig) -> None:
    """ConfigError, a line each, about faults that the device or the link of their section cannot have."""
    lines = [
        config.source.error(("fault", number, key), problem)
        for number, fault in enumerate(config.fault)
        for key, problem in _problems(config, fault)
    ]
    if lines:
        raise ConfigError("\n".join(lines))


def _problems(config: SimConfig, fault: FaultSection) -> Iterator[tuple[str, str]]:
    """(key, what is wrong with it)."""
    if getattr(config, fault.device) is None:
        yield "device", f"there is no {fault.device} in this cell; add [{fault.device}], or remove the fault"
        return
    if fault.what in STATES:
        can = CAN_SUFFER.get(fault.device, ())
        if fault.what not in can:
            yield "what", f"the {fault.device} cannot {fault.what}; it can {', '.join(can) or 'do none of that kind'}"
        if not fault.reported and config.robot.kind == "linuxcnc":
            yield "reported", "a real LinuxCNC reports its feed override; leave it out, or use stand"
        return
    links = protocols(config, fault.device)
    if not links:
        yield "device", "a LinuxCNC is no simulator: its wire is its own; cut it from outside, or use another kind"
    elif fault.link and fault.link not in links:
        yield "link", f"this {fault.device} has no links with names; leave it out"
    elif fault.what in {"wrong_unit", "exception"}:
        meant = [name for link, name in links.items() if fault.link in {"", link}]
        if not any(getattr(PROTOCOLS[name], fault.what) for name in meant):
            yield "what", f"{' and '.join(meant)} has no {fault.what.replace('_', ' ')}; use garble or drop"
