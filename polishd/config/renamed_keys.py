"""Config keys renamed before release 1.0. A file with an old key is refused with an error that names the new key."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any

# Patterns of dotted keys, without the index in a list of tables; the first that fits counts.
RENAMED_KEYS = {
    "between": "part_handling",
    "part_handling.*.person": "operator",
    "part_handling.*.within_s": "timeout_s",
    "part_handling.settle.maps": "max_maps",
    "touch_off.most_off_mm": "max_offset_mm",
    "touch_off.places_mm": "points_mm",
    "process.learns": "process.estimates",
    "dwell.choose": "dwell.objective",
    "dwell.within_s": "dwell.cpu_limit_s",
    "solve.within_s": "solve.cpu_limit_s",
    "signals.*.leads_to": "action",
    "signals.*.on_order": "on_start",
    "signals.*.grace_s": "alarm_delay_s",
    "force_sensor*.band_n": "max_difference_n",
    "force_sensor*.grace_s": "alarm_delay_s",
    "limits.force_grace_s": "limits.force_alarm_delay_s",
    "limits.pit_nm": "limits.max_stall_removal_nm",
    "limits.least_gain": "limits.min_improvement",
    "part.rim": "part.free_edge (true or false)",
    "part.nominal": "part.form",
    "instrument.spike_mads": "instrument.spike_threshold_mad",
    "program.covers": "program.coverage",
    "job.accept": "job.accept_by",
    "job.lookahead_s": "job.stream_ahead_s",
    "memory": "estimates",
    "estimates.remember": "estimates.use_previous",
    "shop.ahead": "shop.max_assigned",
    "metrology*.claimed": "claimed_dir",
    "metrology*.refused": "refused_dir",
    "metrology*.accept_unnamed": "accept_without_part_id",
    "notify.*.repeat_s": "remind_after_s",
    "notify.*.within_s": "timeout_s",
    # the simulator's file
    "truth": "hidden_truth",
    "hidden_truth.worn": "hidden_truth.tool_wear",
    "hidden_truth.warm_nm": "hidden_truth.thermal_nm",
    "hidden_truth.warm_s": "hidden_truth.thermal_s",
    "plant.seat_empty": "plant.part_missing",
    "*.cling": "stick_share",
    "*.rest_n": "resting_force_n",
    "loader.faults.mistaken": "wrong_part_unnoticed",
    "loader.faults.drops": "dropped",
    "loader.faults.jams": "jammed",
    "monitor.signals.*.then": "changes_to",
    "monitor.signals.*.for_s": "duration_s",
    "fault.for_s": "duration_s",
    "robot.turns": "rotary_axes_carry",
    "robot.reads_ahead": "read_ahead_lines",
    # device profiles
    "orders": "commands",
    "commands.beat": "commands.heartbeat",
    "modbus.most": "modbus.max_registers",
    "modbus.refusals": "modbus.error_replies",
    # studies
    "loops": "controllers",
    "*.unreached": "unreachable",
}
RENAMED_TYPES = {
    "handover": "plc_robot",
    "spindle_can": "cia402_spindle",
    "force_sensor_line": "force_sensor_profile",
}
"""Device types of before release 1.0, and what takes their place."""
TYPE_ADVICE = {
    "cia402_spindle": " (docs/protocols/cia402.md)",
    "force_sensor_profile": ' and profile = "force_sensor_line"',
}


def renamed_key(dotted: str) -> str | None:
    """Return the new name of a renamed dotted key, or None. The new name includes the table if that changes, too."""
    return next((new for old, new in RENAMED_KEYS.items() if fnmatchcase(dotted, old)), None)


def present_key(dotted: str) -> str:
    """Return a dotted key with the present names of its table and of itself."""
    root, dot, rest = dotted.partition(".")
    dotted = f"{renamed_key(root) or root}{dot}{rest}"
    new = (renamed_key(dotted) or dotted).partition(" ")[0]
    return new if "." in new or "." not in dotted else f"{dotted.rpartition('.')[0]}.{new}"


def present_value(old: str, value: Any) -> Any:
    """Return the present value of a dotted key of before release 1.0: a device type, or the edge of a part."""
    if old.endswith(".type") and isinstance(value, str):
        return RENAMED_TYPES.get(value, value)
    return value == "free" if old == "part.rim" else value


def present_text(text: str) -> str:
    """Return the text of a stored job file with the present names of its keys; as it is where no key was renamed.

    A text with renamed keys loses its comments. A text that is no TOML is returned as it is: its use reports the error.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return text
    present = _present_table(values, "")
    if present == values:
        return text
    import tomlkit  # this import is slow

    return f"# Converted to the key names of polishd 1.0\n{tomlkit.dumps(present)}"


def _present_table(table: Mapping[str, Any], above: str) -> dict[str, Any]:
    found = {}
    for name, value in table.items():
        key = present_key(f"{above}{name}")
        inner = _present_table(value, f"{key}.") if isinstance(value, dict) else value
        found[key.removeprefix(above)] = present_value(f"{above}{name}", inner)
    return found
