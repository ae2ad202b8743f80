"""The section of SIM.toml that says what else is wrong with tool, contact and robot: ranges, each off by default."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polishd.config.values import ConfigSection, NotNegative, Pair, Positive, ShareOrNone


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
