"""A profile, seen from the device: the encoding of each value and state, and the writes that form a command."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

UNIT = {
    "N": 1.0, "mN": 0.001, "kN": 1000.0, "kgf": 9.80665, "gf": 0.00980665, "lbf": 4.4482216, "ozf": 0.27801385,
    "mm": 1.0, "um": 0.001, "m": 1000.0, "in": 25.4, "rpm": 1.0, "1/s": 60.0, "Hz": 60.0, "ms": 1.0, "s": 1000.0,
    "1": 1.0,
}  # fmt: skip
"""In N, mm, rpm and ms; one pair of poles."""
_STEP = re.compile(r"(\w+) *= *(\S+)")


@dataclass(frozen=True, slots=True)
class SimDeviceProfile:
    """The tables of a profile, as TOML has them."""

    raw: Mapping[str, Any]
    pole_pairs: int = 1
    """Of the motor: speed for one Hz."""

    @classmethod
    def read(cls, path: Path, pole_pairs: int = 1) -> SimDeviceProfile:
        """Folder of that file."""
        return cls(tomllib.loads(path.read_text()), pole_pairs)

    def number(self, name: str, physical: float) -> float:
        """Encode a value in N, mm, rpm or ms."""
        what = self.quantity(name)
        size = abs(physical) if "negative" in what else physical
        return float((size / self._size(what) - what.get("offset", 0.0)) / what.get("scale", 1.0))

    def physical(self, name: str, number: float) -> float:
        """Decode a value."""
        what = self.quantity(name)
        return float((number * what.get("scale", 1.0) + what.get("offset", 0.0)) * self._size(what))

    def _size(self, what: Mapping[str, Any]) -> float:
        """Scale of its unit."""
        unit = what.get("unit", "1")
        return UNIT[unit] / (self.pole_pairs if unit == "Hz" else 1)

    def quantity(self, name: str) -> Mapping[str, Any]:
        """Return its table."""
        found: Mapping[str, Any] = self.raw.get("registers", self.raw.get("values", {})).get(name, {})
        return found

    def words(self, values: Mapping[str, float | str], state: str, *, silent: bool) -> dict[str, float | str]:
        """Numbers (or text) of all that the device reports; ``silent``: with the fault of its watchdog."""
        found: dict[str, float | str] = {
            name: value if isinstance(value, str) else self.number(name, value) for name, value in values.items()
        }
        at_rest = self._rule_of("retracted") or self._rule_of("stopped")
        rules = [self._rule_of(state) or at_rest, *self.raw.get("expects", ())]
        rules += [sign for name in values if (sign := self._sign(name, values[name]))]
        for rule in filter(None, rules):
            word = rule["equals"][0]
            before = found.get(rule["when"], 0)
            if isinstance(word, str) or isinstance(before, str):
                found[rule["when"]] = word
            else:
                found[rule["when"]] = (int(before) & ~rule.get("mask", ~0)) | int(word)
        if "faults" in self.raw:
            name = self.raw["faults"]["value"]
            found[name] = self.fault if silent else found.get(name, 0)
        return found

    @property
    def fault(self) -> int:
        """The fault that the device reports after a watchdog timeout: one that can be reset, where there is one."""
        faults = self.raw["faults"]
        named = [*faults.get("clears", ()), *faults.get("bits", ()), *faults.get("codes", ())]
        return int(named[0])

    def _rule_of(self, state: str) -> Mapping[str, Any] | None:
        """The first rule that assigns a separate code to that state."""
        rules = (rule for rule in self.raw.get("states", ()) if rule["state"] == state and rule.get("equals"))
        return next(rules, None)

    def _sign(self, name: str, value: float | str) -> Mapping[str, Any] | None:
        rule = self.quantity(name).get("negative")
        return rule if rule and isinstance(value, float) and value < 0.0 else None

    def orders(self) -> Iterator[tuple[str, list[str]]]:
        """Each command with its steps."""
        yield from self.raw.get("commands", {}).items()

    def written(self, register: str, stored: Mapping[str, float]) -> tuple[str, float] | None:
        """Commands (name, value in N, rpm or ms) that a write to the register has just completed."""
        found = [
            (name, steps)
            for name, steps in self.orders()
            if register in {step(one)[0] for one in steps} and all(_is(one, stored) for one in steps)
        ]
        # A client may write in another sequence than the profile's: a running drive obeys any of them.
        for name, steps in sorted(found, key=lambda one: (step(one[1][-1])[0] != register, "asked" in one[1][-1])):
            register_of_value = next((step(one)[0] for one in steps if step(one)[1] in {"asked", "count"}), register)
            return name, self.physical(register_of_value, stored.get(register_of_value, 0.0))
        return None


def step(text: str) -> tuple[str, str]:
    """Register and value of a step."""
    match = _STEP.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"{text!r} is no write")
    return match[1], match[2]


def _is(text: str, stored: Mapping[str, float]) -> bool:
    name, value = step(text)
    return value in {"asked", "count"} or stored.get(name, 0.0) == float(int(value, 0))
