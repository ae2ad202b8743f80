"""Loader, force sensor and monitor of a cell, as the simulator has them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from polishd.config.signals import BoundsSection, SignalSection
from polishd.console.rehearsal.draft import SIM_STATE, RehearsalDraft
from polishd.console.rehearsal.wires import wire
from polishd.drivers.transport.address import SerialLine

LOADS_S, UNLOADS_S, FILTER_S, RANGE_N = 30.0, 20.0, 0.03, 60.0
LOADER_TIME_SHARE = 0.4
"""Share of the longest change that loading, or unloading, takes where the simulated loader is slower by itself."""
ROOM = 0.1
"""How far a signal is inside a bound, relative to it."""
_NO_NAME = re.compile(r"[^A-Za-z0-9._-]")


def add_loader(draft: RehearsalDraft, device: str) -> None:
    """``[loader]``."""
    options = _line(draft, device, "loader", "loader_line", "loader")
    change_s = float(options.get("change_s", 120.0))
    for key, usual_s in (("load_s", LOADS_S), ("unload_s", UNLOADS_S)):
        draft.put(
            "loader",
            key,
            min(usual_s, LOADER_TIME_SHARE * change_s),
            f"at most {LOADER_TIME_SHARE:g} x {device}.change_s",
        )


def add_force_sensor(draft: RehearsalDraft, device: str) -> None:
    """``[force_sensor]``."""
    options = _line(draft, device, "force_sensor", "force_sensor_line", "force_sensor")
    latency_s = min(FILTER_S, float(options.get("delay_s", 0.1)) / 2)
    draft.put("force_sensor", "latency_s", latency_s, f"at most half of {device}.delay_s")
    most_n = max(RANGE_N, 3.0 * draft.config.process.force_n)
    draft.put("force_sensor", "range_n", most_n, "at least three times process.force_n")


def add_monitors(draft: RehearsalDraft, devices: Sequence[str]) -> None:
    """``[monitor]``: one box tells what all of the cell's monitors do, each signal well inside its bounds."""
    first, *others = devices
    _line(draft, first, "monitor", "monitor_line", "monitors")
    address = draft.laid.get(f"{first}.address") or draft.laid[first]["address"]
    for device in others:
        if draft.config.devices[device].type == "monitor_line":
            draft.laid[f"{device}.address"] = address
        else:
            why = f"there is no simulated {draft.config.devices[device].type!r}"
            draft.replace_device(device, {"type": "monitor_line", "address": address}, why)
    if others:
        draft.notes.append(f"{', '.join(devices)}: one simulated monitor tells the signals of all, at one address")
    for name, signal in draft.config.signals.items():
        told = signal.signal or name
        if _NO_NAME.search(told):
            told = _NO_NAME.sub("_", told)
            draft.instead(
                f"signals.{name}.signal", told, "a name on the simulated monitor's wire has no such characters"
            )
        draft.put(f"monitor.signals.{told}", "value", inside(signal), f"inside the bounds of signals.{name}")


def inside(signal: SignalSection) -> float | bool:
    """A value that is as it should be before contact and in contact."""
    asked: list[BoundsSection] = [one for one in (signal.before, signal.in_contact) if one is not None]
    states = [one.state for one in asked if one.state is not None]
    if states:
        return states[0]
    low = max((one.min for one in asked if one.min is not None), default=None)
    high = min((one.max for one in asked if one.max is not None), default=None)
    if low is not None and high is not None:
        return (low + high) / 2.0
    if low is not None:
        return low + (ROOM * abs(low) or 1.0)
    return (high or 0.0) - (ROOM * abs(high or 0.0) or 1.0)


def _line(draft: RehearsalDraft, device: str, port: str, line_type: str, plugin: str) -> dict[str, Any]:
    """A small device on a line: its own type, or that which stands in for another; its options."""
    kind = str(draft.config.devices[device].type)
    if kind != line_type:
        draft.put(port, "kind", "serial", f"stands in for {kind}")
        instead = {"type": line_type, "address": f"serial:{SIM_STATE}/{port}?baud=115200"}
        draft.replace_device(device, instead, f"there is no simulated {kind!r}")
        draft.plugin(plugin)
        return {}
    options = draft.options(device)
    real = wire(draft, device, port, options["address"])
    draft.put(port, "kind", "serial" if isinstance(real, SerialLine) else "tcp", f"{device}.address")
    if isinstance(real, SerialLine):
        draft.put(port, "baud", real.baud, f"{device}.address")
    return options
