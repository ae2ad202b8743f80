"""Actuator and spindle of a cell, as the simulator has them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from polishd.config.device_profile import DeviceProfile
from polishd.console.rehearsal.draft import SIM_STATE, RehearsalDraft
from polishd.console.rehearsal.part import require_force
from polishd.console.rehearsal.wires import wire
from polishd.drivers.profiled.make import address_of
from polishd.drivers.profiled.shelf import DEVICE_PROFILE_DIR, profile_of
from polishd.drivers.transport.address import SerialLine, SlcanAddress, Tcp

MOST_N = 50.0
TOUCH_MM = 5.0
"""Where the simulated actuator meets the part, half-way of its stroke."""
LANDS_S, LIFTS_S, SPINS_S, USUAL_RPM = 2.0, 4.0, 3.0, 3000
DRIVE_TIME_SHARE = 0.8
"""Share of the longest time that the cell allows which a simulated device takes, where it is slower by itself."""
CIA402_ACTUATOR = {"n_per_permille": 0.05, "mm_per_increment": 0.001, "rest_increments": 0, "balance_n": 2.0}
CIA402_SPINDLE = {"rpm_per_unit": 0.1}
"""What the simulated drive's numbers mean."""


def add_actuator(draft: RehearsalDraft, device: str) -> None:
    """``[actuator]``; ConfigError where it cannot press as the process asks."""
    require_force(draft, MOST_N)
    kinds: dict[str, Callable[[RehearsalDraft, str, dict[str, Any]], Mapping[str, Any]]] = {
        "voice_coil_modbus": _voice_coil_modbus,
        "voice_coil_serial": _voice_coil_serial,
        "cia402_actuator": _cia402_actuator,
        "actuator_profile": _actuator_profile,
    }
    kind = str(draft.config.devices[device].type)
    if kind in kinds:
        times = kinds[kind](draft, device, draft.options(device))
    else:
        draft.put("actuator", "kind", "modbus_rtu", f"stands in for {kind}")
        instead = {"type": "voice_coil_modbus", "address": f"serial:{SIM_STATE}/actuator?baud=115200"}
        draft.replace_device(device, instead, f"there is no simulated {kind!r}")
        draft.plugin("voice_coil")
        times = {}
    _add_times(draft, device, times)


def _add_times(draft: RehearsalDraft, device: str, times: Mapping[str, Any]) -> None:
    """What the simulated one takes, and where it touches."""
    for key, usual_s, allowed in (("land_s", LANDS_S, "landing_s"), ("lift_s", LIFTS_S, "retract_s")):
        if allowed in times:
            takes_s = min(usual_s, DRIVE_TIME_SHARE * float(times[allowed]))
            draft.put("actuator", key, takes_s, f"at most {DRIVE_TIME_SHARE:g} x {device}.{allowed}")
    if "unpowered" in times:
        draft.put("actuator", "unpowered", times["unpowered"], f"{device}.unpowered")
    touch_off = draft.config.touch_off
    given_mm = None if touch_off is None else touch_off.position_mm or float(times.get("stroke_mm", 10.0)) / 2
    if given_mm not in {None, TOUCH_MM}:
        draft.instead("touch_off.position_mm", TOUCH_MM, "the simulated actuator meets the part half-way of its 10 mm")


def _voice_coil_modbus(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    real = wire(draft, device, "actuator", options["address"])
    draft.put("actuator", "kind", "modbus_rtu" if isinstance(real, SerialLine) else "modbus_tcp", f"{device}.address")
    draft.put("actuator", "unit", options["unit"], draft.origin(f"{device}.unit"))
    _add_baud(draft, device, real)
    return options


def _voice_coil_serial(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    address = options["address"]
    if not address.startswith("serial:"):
        draft.notes.append(
            f"{device}.address: the simulated actuator has its lines of text on a serial line, not on TCP"
        )
        address = "serial:none?baud=115200"
    real = wire(draft, device, "actuator", address)
    draft.put("actuator", "kind", "serial", f"{device}.type")
    _add_baud(draft, device, real)
    return options


def _cia402_actuator(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    _add_can(draft, device, "actuator", options)
    _scale(draft, device, options, CIA402_ACTUATOR)
    return options


def _actuator_profile(draft: RehearsalDraft, device: str, options: dict[str, Any]) -> Mapping[str, Any]:
    profile = _add_profile(draft, device, "actuator", options)
    table: Any = profile.actuator
    given = {name: options[name] for name in ("landing_s", "retract_s", "stroke_mm") if options[name] is not None}
    unit = profile.modbus.unit if options["unit"] is None and profile.modbus is not None else options["unit"]
    draft.put("actuator", "unit", unit, f"{device}.unit, or that of its profile")
    return {**table.model_dump(), **given}


def add_spindle(draft: RehearsalDraft, device: str) -> None:
    """``[spindle]``."""
    kind, options = str(draft.config.devices[device].type), draft.options(device)
    if kind in {"spindle_can", "cia402_spindle"}:
        _add_can(draft, device, "spindle", options)
        draft.put("spindle", "drive", "cia402" if kind == "cia402_spindle" else "spindle_can", f"{device}.type")
        _scale(draft, device, options, CIA402_SPINDLE if kind == "cia402_spindle" else {})
    elif kind == "spindle_profile":
        table: Any = _add_profile(draft, device, "spindle", options).spindle
        options = {**table.model_dump(), **{key: value for key, value in options.items() if value is not None}}
        draft.put("spindle", "unit", options.get("unit"), f"{device}.unit")
        draft.put("spindle", "pole_pairs", options["pole_pairs"], draft.origin(f"{device}.pole_pairs"))
    else:
        draft.put("spindle", "kind", "slcan", f"stands in for {kind}")
        instead = {"type": "spindle_can", "address": f"slcan:{SIM_STATE}/spindle?bitrate=500000"}
        draft.replace_device(device, instead, f"there is no simulated {kind!r}")
        draft.plugin("spindle")
        options = {}
    rpm = draft.config.process.rpm
    most_rpm = max(float(options.get("max_rpm", USUAL_RPM)), rpm)
    draft.put("spindle", "max_rpm", math.ceil(most_rpm), f"{device}.max_rpm, or at least process.rpm")
    if "watchdog_s" in options:
        draft.put("spindle", "watchdog_s", options["watchdog_s"], draft.origin(f"{device}.watchdog_s"))
    if "spin_s" in options:
        spin_s = min(SPINS_S, DRIVE_TIME_SHARE * options["spin_s"] * 1000.0 / rpm)
        draft.put("spindle", "spin_s", spin_s, f"process.rpm in at most {DRIVE_TIME_SHARE:g} x {device}.spin_s")


def _add_baud(draft: RehearsalDraft, device: str, real: object) -> None:
    if isinstance(real, SerialLine):
        draft.put("actuator", "baud", real.baud, f"{device}.address")


def _add_can(draft: RehearsalDraft, device: str, port: str, options: Mapping[str, Any]) -> None:
    real = wire(draft, device, port, options["address"])
    draft.put(port, "kind", "slcan" if isinstance(real, SlcanAddress) else "socketcand", f"{device}.address")
    draft.put(port, "node", options["node"], draft.origin(f"{device}.node"))
    if "eds" in options:
        draft.laid[f"{device}.eds"] = str(draft.config.resolve(options["eds"]).absolute())


def _scale(draft: RehearsalDraft, device: str, options: Mapping[str, Any], simulated: Mapping[str, Any]) -> None:
    """The simulated drive counts in units of its own."""
    for key, value in simulated.items():
        if options[key] != value:
            draft.instead(f"{device}.{key}", value, f"is {options[key]:g} at your drive; the simulated one has its own")


def _add_profile(draft: RehearsalDraft, device: str, port: str, options: Mapping[str, Any]) -> DeviceProfile:
    """What it speaks, from a copy of its profile."""
    named = options["profile"]
    profile = profile_of(named, draft.config.base_dir)
    own = named.endswith(".toml")
    path = draft.config.resolve(named) if own else DEVICE_PROFILE_DIR / f"{named}.toml"
    if own:
        draft.laid[f"{device}.profile"] = str(path.absolute())
    real = wire(draft, device, port, options["address"])
    draft.put(port, "kind", "profile_tcp" if isinstance(real, Tcp) else "profile", f"{device}.address")
    draft.put(port, "profile", draft.copy(f"{port}.profile.toml", path), f"a copy of {device}.profile")
    if port == "actuator":
        _add_baud(draft, device, address_of(profile, options["address"], draft.config.base_dir))
    return profile
