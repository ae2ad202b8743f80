"""``[[fault]]`` of SIM.toml: what happens to a simulated device or to its link, and when."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polishd.config.fields import ConfigSection, NotNegative, Positive

FRAMES = ("drop", "delay", "duplicate", "garble", "dribble", "late_reply", "wrong_unit", "exception")
"""What happens to single frames, ..."""
REPLIES = ("late_reply", "wrong_unit", "exception")
"""... of these to the device's own alone; ..."""
WIRES = ("hang", "unplug", "reboot")
"""... to the link as a whole; ..."""
MOTION = ("override", "stand")
"""... to the motion of a robot; ..."""
PANEL = ("estop", "manual")
"""... at a robot's panel, where the operator presses the emergency stop or turns the key to manual; ..."""
STATES = ("freeze", "drift", "saturate", "stick", "halt", "spike", "press", "lie", "reverse", *MOTION)
"""... and to the device behind it."""
NEEDS = {
    "late_reply": ("by_s",),
    "dribble": ("by_s",),
    "drift": ("drift_n_s",),
    "saturate": ("limit_n",),
    "spike": ("force_n",),
    "press": ("force_n",),
}
"""Keys that such a fault must have."""
KNOWS = {"by_s": ("delay", "late_reply", "dribble"), "jitter_s": ("delay",), "drift_n_s": ("drift",)}
KNOWS |= {"limit_n": ("saturate",), "direction": FRAMES, "rate": FRAMES}
KNOWS |= {"percent": ("override",), "ramp_s": ("override",), "reported": ("override",)}
KNOWS |= {"force_n": ("spike", "press"), "factor": ("lie",), "offset_n": ("lie",)}
"""Keys that others than these must not have."""


class FaultSection(ConfigSection):
    """Simulated fault (examples: docs/reference/faults.md). Several act together, in the order of the file."""

    device: Literal["robot", "actuator", "spindle", "loader", "force_sensor", "monitor"]
    """Device with the fault."""
    what: Literal[
        "drop", "delay", "duplicate", "garble", "dribble", "late_reply", "wrong_unit", "exception",
        "hang", "unplug", "reboot", "freeze", "drift", "saturate", "stick", "halt",
        "spike", "press", "lie", "reverse", "override", "stand", "estop", "manual",
    ]  # fmt: skip
    """Kind of the fault."""
    link: Literal["", "rtde", "dashboard", "primary"] = ""
    """Link of a `universal_robots` robot; empty: all."""
    direction: Literal["to_host", "to_device"] = "to_host"
    """Direction of the affected frames: from the device, or to it."""
    at_s: NotNegative | None = None
    """Begin after the start of the device, or after it read this file again, wall time."""
    contact_s: NotNegative | None = None
    """Begin after this time in contact, wall time."""
    frame: Annotated[int, Field(ge=1)] | None = None
    """Number of the first affected frame in its direction. [1]"""
    every_s: Positive | None = None
    """Period of repetition, wall time."""
    rate: Annotated[float, Field(gt=0, le=1)] | None = None
    """Share of affected frames, from the start, `at_s` or `contact_s` on. [1]"""
    duration_s: NotNegative = 0.0
    """Duration in wall time; 0: one frame, or once; a rate and a lasting fault never end."""
    by_s: NotNegative = 0.0
    """Delay of `delay` (later frames wait) and `late_reply` (they pass it); pause between bytes of `dribble`."""
    jitter_s: NotNegative = 0.0
    """Of `delay`: largest additional delay, drawn for each frame."""
    drift_n_s: float = 0.0
    """Of `drift`: rate; positive: the reading rises. [N/s]"""
    limit_n: NotNegative = 0.0
    """Of `saturate`: its largest reading."""
    percent: Annotated[float, Field(ge=0, le=200)] | None = None
    """Of `override`: speed relative to the programmed one. [%]"""
    ramp_s: NotNegative = 0.0
    """Of `override`: time from 100 % to `percent`, wall time; 0: at once."""
    reported: bool = True
    """Of `override`: the controller reports it if its link can; false: it reports 100 %."""
    force_n: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Of `spike`: additional force; of `press`: force in contact, independent of the command."""
    factor: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Of `lie`: share of the true force that it reads. At 0 it reads `offset_n` only. [1]"""
    offset_n: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Of `lie`: it reads so much more."""

    @model_validator(mode="after")
    def _hangs_together(self) -> Self:
        for key, problem in (*self._when(), *self._what(), *self._how_much()):
            raise ValueError(f"{key}: {problem}")
        return self

    def _when(self) -> Iterator[tuple[str, str]]:
        """(key, what is wrong with it) of those that say when."""
        begins = [key for key in ("at_s", "contact_s", "frame", "every_s") if getattr(self, key) is not None]
        if not begins and self.rate is None:
            yield "what", f"nothing says when to {self.what}; add at_s, contact_s, frame, every_s or rate"
        if len(begins) > 1:
            yield begins[1], f"it cannot begin by {' and by '.join(begins)}; write a [[fault]] for each"
        if self.rate is not None and set(begins) & {"frame", "every_s"}:
            yield "rate", f"does not go with {begins[0]}; give at_s or contact_s beside it, or nothing"
        if self.what == "reboot" and self.duration_s:
            yield "duration_s", "means nothing for reboot: it takes the time that it takes"
        if self.what in PANEL and self.duration_s:
            yield "duration_s", f"means nothing for {self.what}: the operator acts once. Remove the key"

    def _what(self) -> Iterator[tuple[str, str]]:
        """The same of the others."""
        for key, known in KNOWS.items():
            if key in self.model_fields_set and self.what not in known:
                yield key, f"means nothing for {self.what}; it is for {', '.join(known)}"
        for key in NEEDS.get(self.what, ()):
            if not getattr(self, key):
                yield key, f"{self.what} needs it, other than 0"
        if self.what == "delay" and not self.by_s and not self.jitter_s:
            yield "by_s", "delay needs it, or jitter_s"
        if self.what in REPLIES and self.direction == "to_device":
            yield "direction", f"{self.what} happens to replies; it must be to_host"
        if self.link and self.what not in (*FRAMES, "hang", "unplug"):
            yield "link", f"means nothing for {self.what}, which happens to the device"

    def _how_much(self) -> Iterator[tuple[str, str]]:
        """The same of numbers that need a value, or a sign."""
        if self.what == "override" and self.percent is None:
            yield "percent", "override needs it"
        if self.what == "press" and self.force_n < 0:
            yield "force_n", "press needs a force above 0"
        if self.what == "lie" and self.factor == 1.0 and not self.offset_n:
            yield "factor", "lie needs it, other than 1, or offset_n, other than 0"
