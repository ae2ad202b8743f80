"""What the devices told last, for whoever watches: kept where it is heard anyway, so that nobody is asked for it.

A reading has its age with it. One that nobody reads any more, out of contact say, only grows older: what is shown as
live without its age would be a guess.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

from polishd.model.devices import ForceSample, RobotProgress, SensedForce, SpeedSample


@dataclass(slots=True)
class LiveValues:
    """Of one cell's job; None: nothing was told yet. Times are of ``time.monotonic``."""

    force: ForceSample | None = None
    speed: SpeedSample | None = None
    sensed: SensedForce | None = None
    robot: RobotProgress | None = None
    robot_s: float = 0.0
    """When the robot told that."""

    def robot_told(self, progress: RobotProgress) -> None:
        """The robot's last word."""
        self.robot, self.robot_s = progress, time.monotonic()

    def facts(self) -> dict[str, dict[str, Any] | None]:
        """Each reading with its age, ``age_s``."""
        samples = {"force": self.force, "speed": self.speed, "sensed": self.sensed}
        told: dict[str, dict[str, Any] | None] = {
            name: None if sample is None else _aged(asdict(sample), sample.at_s) for name, sample in samples.items()
        }
        return {**told, "robot": None if self.robot is None else _aged(asdict(self.robot), self.robot_s)}


def _aged(facts: dict[str, Any], at_s: float) -> dict[str, Any]:
    """With the age in the place of a time that means nothing elsewhere."""
    facts.pop("at_s", None)
    return {**facts, "age_s": round(max(time.monotonic() - at_s, 0.0), 3)}
