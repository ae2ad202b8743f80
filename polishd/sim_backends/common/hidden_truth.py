"""The hidden truth: true properties of the simulated machines, drawn from the seed. The controller never gets it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from polishd.config.simulator_physics import Plant, Truth
from polishd.model.process import HybridRobot, MeasuredCompliance, RobotModel, SerialRobot
from polishd.model.surface import FloatArray

STIFFNESSES = (
    "limb_stiffness_n_per_mm",
    "up_bending_n_mm2",
    "up_torsion_n_mm2",
    "a_stiffness_n_mm_per_rad",
    "c_stiffness_n_mm_per_rad",
)


@dataclass(frozen=True, slots=True)
class HiddenTruth:
    """One draw."""

    rate: float
    """Removal rate relative to Preston's nominal constant."""
    drift: float
    drift_period_s: float
    drift_phase: float
    accel_mm_s2: float
    overhead_s: float
    robot: RobotModel

    def rate_at(self, process_s: FloatArray) -> FloatArray:
        """Return (n,) rate factors at process times (n,)."""
        angle = self.drift_phase + math.tau * process_s / self.drift_period_s
        return np.asarray(self.rate * (1.0 + self.drift * np.sin(angle)))


def draw(config: Truth, seed: int, nominal: RobotModel | None = None) -> HiddenTruth:
    """Draw the truth of the shipped robot or another. The same seed gives the same machines."""
    rng = np.random.default_rng([seed, 1])
    robot = _stiffened(nominal or HybridRobot(), config.stiffness, rng)
    return HiddenTruth(
        rate=1.0 + float(rng.uniform(*config.rate)),
        drift=config.drift,
        drift_period_s=config.drift_period_s * float(rng.uniform(0.8, 1.2)),
        drift_phase=float(rng.uniform(0.0, math.tau)),
        accel_mm_s2=config.accel_mm_s2 * (1.0 + config.accel_spread * float(rng.uniform(-1.0, 1.0))),
        overhead_s=config.overhead_s * (1.0 + config.overhead_spread * float(rng.uniform(-1.0, 1.0))),
        robot=robot,
    )


def _stiffened(nominal: RobotModel, off: float, rng: np.random.Generator) -> RobotModel:
    """Return that robot with each stiffness off by at most ``relative``; all values of a table change by one factor."""
    if isinstance(nominal, MeasuredCompliance):
        return replace(
            nominal, compliance_um_per_n=nominal.compliance_um_per_n / (1.0 + off * float(rng.uniform(-1.0, 1.0)))
        )
    if isinstance(nominal, SerialRobot):
        joints = np.array(nominal.joint_stiffness_n_mm_per_rad)
        factors = 1.0 + off * rng.uniform(-1.0, 1.0, len(joints))
        return replace(nominal, joint_stiffness_n_mm_per_rad=tuple((joints * factors).tolist()))
    factors = 1.0 + off * rng.uniform(-1.0, 1.0, len(STIFFNESSES))
    truth = {name: getattr(nominal, name) * float(factor) for name, factor in zip(STIFFNESSES, factors, strict=True)}
    if nominal.limb_ea_n is not None:
        truth["limb_ea_n"] = nominal.limb_ea_n * float(factors[0])
    return replace(nominal, **truth)


def stream(seed: int, name: str) -> np.random.Generator:
    """Return a device's private random numbers: independent of who else draws, and when."""
    return np.random.default_rng([seed, *name.encode()])


# Frames: program to part to the robot's base, and the tool axis that A and C mean.


def rotation_z(deg: float) -> FloatArray:
    """Return the rotation about z."""
    c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_rpy(rpy_deg: tuple[float, float, float]) -> FloatArray:
    """Return the intrinsic x-y'-z'' rotation."""
    (ca, sa), (cb, sb) = [(math.cos(math.radians(v)), math.sin(math.radians(v))) for v in rpy_deg[:2]]
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, ca, -sa], [0.0, sa, ca]])
    about_y = np.array([[cb, 0.0, sb], [0.0, 1.0, 0.0], [-sb, 0.0, cb]])
    return np.asarray(about_x @ about_y @ rotation_z(rpy_deg[2]))


def tool_axis(a_deg: FloatArray, c_deg: FloatArray) -> FloatArray:
    """Turn (n,) A and C into (n, 3) tool axes in the program's frame, from the tip into the spindle."""
    a, c = np.radians(a_deg), np.radians(c_deg)
    return np.stack([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)], axis=1)


@dataclass(frozen=True, slots=True)
class Frames:
    """The poses of the part and of the program."""

    plant: Plant
    to_part: FloatArray = field(init=False)
    to_base: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Fix the rotations."""
        object.__setattr__(self, "to_part", rotation_z(self.plant.program_rotation_deg))
        object.__setattr__(self, "to_base", rotation_rpy(self.plant.rotation_rpy_deg))

    def in_part(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Turn (n, 5) X Y Z A C of the program into tips (n, 3) in mm and tool axes (n, 3), part frame."""
        tips = pose[:, :3] @ self.to_part.T + np.array(self.plant.program_offset_mm)
        return tips, tool_axis(pose[:, 3], pose[:, 4]) @ self.to_part.T

    def in_base(self, tips: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Turn tips and tool axes of the part's frame into the robot's base frame."""
        return tips @ self.to_base.T + np.array(self.plant.origin_mm), axes @ self.to_base.T
