"""True machine effects that the controller's model omits: drawn once from the seed, independent of all other draws."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from polishd.config.simulator import SimConfig
from polishd.config.simulator_physics import Effects
from polishd.model.surface import FloatArray
from polishd.sim_backends.common.hidden_truth import stream


@dataclass(frozen=True, slots=True)
class Waves:
    """A smooth field of the workspace with two components, each a sine."""

    most: float = 0.0
    """Largest length."""
    per_mm: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    """Wave vectors of the two, radians per mm of the base frame."""
    phase: tuple[float, float] = (0.0, 0.0)

    def at(self, tip_mm: FloatArray) -> FloatArray:
        """(n, 2) at tips (n, 3)."""
        return np.asarray(self.most / math.sqrt(2.0) * np.sin(tip_mm @ np.array(self.per_mm).T + self.phase))


@dataclass(frozen=True, slots=True)
class PlantEffects:
    """One draw. The default does nothing, to the last bit."""

    linear: float = 0.0
    """Change of the rate from the center to the rim along ``field_deg``, relative."""
    square: float = 0.0
    """Change from the center to the rim, the same all round, relative."""
    field_deg: float = 0.0
    rim_mm: float = 1.0
    halvings_per_s: float = 0.0
    """Of the pad's rate, for each second of contact."""
    warm_up: float = 0.0
    warm_up_s: float = 1.0
    spot_mm: tuple[float, float] = (0.0, 0.0)
    """Of the tool's frame (across the lean, along it) or, with ``spot_on_part``, of the part's x and y."""
    spot_on_part: bool = False
    seat_mm: tuple[float, float] = (0.0, 0.0)
    """Offset of the part's center from its nominal position, in its x and y."""
    compliance: float = 1.0
    eq_44: float = 1.0
    friction: float = 0.0
    ripple: float = 0.0
    ripple_s: float = 1.0
    force_ripple: float = 0.0
    force_ripple_s: float = 1.0
    turn_deg: float = 0.0
    """Of the spot about the normal, counterclockwise."""
    skew: float = 0.0
    bonnet: float = 1.0
    """Factor of its modulus."""
    robot: Waves = field(default_factory=Waves)
    """Tip off, mm, of the part's x and y."""
    lean: Waves = field(default_factory=Waves)
    """Spindle's axis off, radians, likewise."""
    vibration_mm: float = 0.0
    height: Waves = field(default_factory=Waves)
    """Tip off along the normal, mm: the first component. The actuator takes it up, as fast as it can."""
    force_lag_s: float = 0.0
    guide_friction_n: float = 0.0

    def rate(self, place_mm: FloatArray, contact_s: FloatArray) -> FloatArray:
        """(n,) factor of the removal at points (n, >= 2) after so long (n,) in contact."""
        x, y = ((place_mm[:, k] - self.seat_mm[k]) / self.rim_mm for k in (0, 1))
        angle = math.radians(self.field_deg)
        field = 1.0 + self.linear * (math.cos(angle) * x + math.sin(angle) * y) + self.square * (x**2 + y**2)
        cold = 1.0 - self.warm_up * np.exp(-contact_s / self.warm_up_s)
        return np.asarray(np.maximum(field, 0.0) * cold * 0.5 ** (contact_s * self.halvings_per_s))

    def speed(self, contact_s: FloatArray) -> FloatArray:
        """(n,) factor of the spindle's speed after so long in contact."""
        return np.asarray(1.0 + self.ripple * np.sin(math.tau * contact_s / self.ripple_s))

    def force(self, contact_s: FloatArray) -> FloatArray:
        """(n,) factor of the force, likewise."""
        return np.asarray(1.0 + self.force_ripple * np.sin(math.tau * contact_s / self.force_ripple_s))


def draw(config: SimConfig, seed: int) -> PlantEffects:
    """Draw the effects. The same seed gives the same machine; the range of one effect does not change another draw."""
    ranges: Effects = config.effects
    rng = stream(seed, "effects")
    angles, shares = rng.uniform(0.0, math.tau, 3), rng.uniform(-1.0, 1.0, 3)
    lost = _within(ranges.eq_44, float(rng.uniform()))
    turn, skew, pressure = (float(share) for share in rng.uniform(-1.0, 1.0, 3))
    robot, lean = _waves(rng, ranges.robot_error_wave_mm), _waves(rng, ranges.robot_error_wave_mm)
    height, friction = _waves(rng, ranges.robot_error_wave_mm), _within(ranges.friction, float(rng.uniform()))
    return PlantEffects(
        linear=ranges.rate_field * float(shares[0]),
        square=ranges.rate_field * (1.0 - abs(float(shares[0]))) * math.copysign(1.0, shares[1]),
        field_deg=math.degrees(angles[0]),
        rim_mm=config.plant.outline.radius_mm,
        halvings_per_s=0.0 if ranges.pad_half_life_s is None else 1.0 / ranges.pad_half_life_s,
        warm_up=ranges.warm_up,
        warm_up_s=ranges.warm_up_s,
        spot_mm=_towards(ranges.spot_shift_mm, float(angles[1])),
        spot_on_part=ranges.spot_frame == "part",
        seat_mm=_towards(ranges.seat_shift_mm, float(angles[2])),
        compliance=1.0 + ranges.compliance * float(shares[2]),
        eq_44=lost,
        friction=friction,
        ripple=ranges.speed_ripple,
        ripple_s=ranges.speed_ripple_s,
        force_ripple=ranges.force_ripple,
        force_ripple_s=ranges.force_ripple_s,
        turn_deg=ranges.spot_turn_deg * turn,
        skew=ranges.spot_skew * math.copysign(1.0, skew),
        bonnet=1.0 + ranges.bonnet_pressure * math.copysign(1.0, pressure),
        robot=replace(robot, most=ranges.robot_error_mm),
        lean=replace(lean, most=math.radians(ranges.robot_error_deg)),
        vibration_mm=ranges.vibration_mm,
        height=replace(height, most=ranges.robot_error_mm),
        force_lag_s=ranges.force_lag_s,
        guide_friction_n=ranges.guide_friction_n,
    )


def _waves(rng: np.random.Generator, shortest_mm: float) -> Waves:
    """Draw two directions, and lengths between the shortest and three times that."""
    ways, phases = rng.standard_normal((2, 3)), rng.uniform(0.0, math.tau, 2)
    ways /= np.linalg.norm(ways, axis=1)[:, None] * shortest_mm * 3.0 ** rng.uniform(0.0, 1.0, 2)[:, None]
    first, second = (math.tau * ways).tolist()
    return Waves(0.0, (tuple(first), tuple(second)), (float(phases[0]), float(phases[1])))


def _within(span: tuple[float, float], share: float) -> float:
    least, most = span
    return least + (most - least) * share


def _towards(length: float, angle: float) -> tuple[float, float]:
    return length * math.cos(angle), length * math.sin(angle)
