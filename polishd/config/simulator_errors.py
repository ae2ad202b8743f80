"""``[[fault]]`` of SIM.toml: what happens to a simulated device or to its link, and when."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polishd.config.fields import ConfigSection, NotNegative, Pair, Positive, ShareOrNone

FRAMES = ("drop", "delay", "duplicate", "garble", "dribble", "late_reply", "wrong_unit", "exception")
"""What happens to single frames, ..."""
REPLIES = ("late_reply", "wrong_unit", "exception")
"""... of these to the device's own alone; ..."""
WIRES = ("hang", "unplug", "reboot")
"""... to the link as a whole; ..."""
MOTION = ("override", "stand")
"""... to the motion of a robot; ..."""
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
    """Which of them has it."""
    what: Literal[
        "drop", "delay", "duplicate", "garble", "dribble", "late_reply", "wrong_unit", "exception",
        "hang", "unplug", "reboot", "freeze", "drift", "saturate", "stick", "halt",
        "spike", "press", "lie", "reverse", "override", "stand",
    ]  # fmt: skip
    """What goes wrong."""
    link: Literal["", "rtde", "dashboard", "primary"] = ""
    """Which of the robot's links, with universal_robots; empty: all that it has."""
    direction: Literal["to_host", "to_device"] = "to_host"
    """Of the frames that suffer: from the device, or to it."""
    at_s: NotNegative | None = None
    """Begins so long after the device came up, or read this file again, wall time."""
    contact_s: NotNegative | None = None
    """Begins after so long in contact, wall time."""
    frame: Annotated[int, Field(ge=1)] | None = None
    """Begins with that frame of its direction. [1]"""
    every_s: Positive | None = None
    """Begins again and again after so long, wall time."""
    rate: Annotated[float, Field(gt=0, le=1)] | None = None
    """Share of frames that suffer: all along, or from `at_s` or `contact_s` on. [1]"""
    duration_s: NotNegative = 0.0
    """How long it goes on, wall time; 0: one frame, or once; for a rate, and for what lasts, from then on."""
    by_s: NotNegative = 0.0
    """How late: `delay` (those behind wait), `late_reply` (those behind pass it); pause between bytes: `dribble`."""
    jitter_s: NotNegative = 0.0
    """Of `delay`: by up to so much more, another for each frame."""
    drift_n_s: float = 0.0
    """Of `drift`: how fast; positive: it reads too much. [N/s]"""
    limit_n: NotNegative = 0.0
    """Of `saturate`: its largest reading."""
    percent: Annotated[float, Field(ge=0, le=200)] | None = None
    """Of `override`: the speed that is left of the programmed one. [%]"""
    ramp_s: NotNegative = 0.0
    """Of `override`: from 100 % to `percent` in so long, wall time; 0: at once."""
    reported: bool = True
    """Of `override`: the controller reports it, where its link can; false: it goes on reporting 100 %."""
    force_n: Annotated[float, Field(ge=-100, le=100)] = 0.0
    """Of `spike`: how much more acts, at once; of `press`: what it exerts in contact, whatever is asked."""
    factor: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Of `lie`: it reads this share of what acts. At 0 it reads `offset_n` only. [1]"""
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


# The section of SIM.toml that says what else is wrong with tool, contact and robot: ranges, each off by default.


class Effects(ConfigSection):
    """What the controller assumes and the machine does not do; sizes have no source but the shop's experience."""

    rate_field: ShareOrNone = 0.0
    """Most that the removal rate changes from the part's centre to its rim, either way: a smooth field. [1]"""
    pad_half_life_s: Positive | None = None
    """Contact time in which the pad loses half of its rate; left out: it does not wear."""
    warm_up: ShareOrNone = 0.0
    """Share of the rate that a cold tool lacks. [1]"""
    warm_up_s: Positive = 300.0
    """Contact time in which that falls to 37 %."""
    spot_shift_mm: NotNegative = 0.0
    """How far the spot lies off where the tool says; its direction is drawn."""
    spot_frame: Literal["tool", "part"] = "tool"
    """Whether that direction turns with the lean of the spindle, or stays with the part."""
    spot_turn_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """How far the spot is turned about the normal, either way."""
    spot_skew: ShareOrNone = 0.0
    """How much more is removed at the rim that the bonnet slides towards, and less where it comes from, or the other
    way round. [1]"""
    bonnet_pressure: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """How far the bonnet's pressure, and with it its modulus, is off, either way, relative: a soft one makes a wide and
    flat spot. [1]"""
    robot_error_mm: NotNegative = 0.0
    """How far the tool's tip lies off where the robot says, across the normal: a smooth field of its workspace. An arm
    that was not calibrated has some 0.3 mm (ISO 9283 accuracy of pose)."""
    robot_error_deg: Annotated[float, Field(ge=0, le=5)] = 0.0
    """How far the spindle leans off, likewise; some 0.02."""
    robot_error_wave_mm: Positive = 400.0
    """Length of the shortest wave of that field; the longest is three times as long."""
    vibration_mm: NotNegative = 0.0
    """Radius of a fast circle that the tool's tip runs: it smears the spot."""
    seat_shift_mm: NotNegative = 0.0
    """How far the part lies off its seat, across its normal; its direction is drawn."""
    compliance: ShareOrNone = 0.0
    """How far the compliance along the normal is off the robot's, either way, relative. [1]"""
    eq_44: Pair = (0.0, 1.0)
    """How much of what paper eq. 44 says is lost as depth where the robot gives way: 1 all of it; 0 constant depth,
    which statics gives for an actuator that holds its force. One with friction or a stiff guide is between; drawn
    between the two. [1]"""
    friction: Pair = (0.2, 0.5)
    """Coefficient of friction between bonnet and part: it pulls the tip sideways as far as the robot gives way; drawn
    between the two. [1]"""
    speed_ripple: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Amplitude of a sine of the spindle's speed, relative. [1]"""
    speed_ripple_s: Positive = 2.0
    """Its period, contact time."""
    force_ripple: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Amplitude of a sine of the force, which no sensor sees, relative. [1]"""
    force_ripple_s: Positive = 3.0
    """Its period, contact time."""
    force_lag_s: NotNegative = 0.0
    """Process time by which the true force lags behind what the actuator exerts and measures: when the tool lands, and
    where the part comes or goes, by its tilt or the robot's error along the normal (`robot_error_mm`). 0: it
    follows."""
    guide_friction_n: NotNegative = 0.0
    """Dry friction of the actuator's guide, which it does not measure: the true force is so much smaller where the part
    goes and larger where it comes, by the same causes."""

    @model_validator(mode="after")
    def _are_ranges(self) -> Self:
        for name, (least, most), end in (("eq_44", self.eq_44, 1.0), ("friction", self.friction, 2.0)):
            if not 0.0 <= least <= most <= end:
                raise ValueError(
                    f"{name}: [{least:g}, {most:g}] is no range within 0 to {end:g}; give the lower one first"
                )
        return self


# The section of SIM.toml that says what the interferometer adds to the part's true heights: all off by default.


class InstrumentErrors(ConfigSection):
    """What is in every map and not in the part. Sizes in nm are RMS over the circle about the part."""

    tilt_nm: NotNegative = 0.0
    """Most tilt by which the part is set up anew for each map, along x and along y."""
    power_nm: float = 0.0
    """Power of its reference."""
    astigmatism_nm: NotNegative = 0.0
    """Astigmatism of its reference, ..."""
    astigmatism_deg: float = 20.0
    """... high along this direction."""
    coma_nm: NotNegative = 0.0
    """Coma of its reference, along x."""
    mount_nm: NotNegative = 0.0
    """Print-through of three points of the mount: a trefoil, ..."""
    mount_turns: bool = False
    """... which turns with the part, or stays with the instrument."""
    mount_anew: bool = False
    """... whose points press otherwise with each set-up: size and direction are drawn anew for each map, `mount_nm` is
    their RMS, and nothing turns."""
    magnification: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """By how much more the part is magnified than the instrument says. [1]"""
    distortion: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """By how much more at the part's rim than in its middle; between them with the square of the radius. [1]"""
    retrace_nm_per_urad: float = 0.0
    """What a slope along x adds, where the beam does not come back the way it went. [nm/urad]"""
    slope_noise_nm_per_urad: NotNegative = 0.0
    """Noise of a sample by the slope there, beside `hidden_truth.map_noise_nm`. [nm/urad]"""
    dead_pixels: ShareOrNone = 0.0
    """Share of the samples that never have data. [1]"""
