"""The history of a force or a speed, as its device vouches for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from polishd.model.surface import FloatArray


@dataclass(slots=True)
class Timeline:
    """Piecewise linear in wall time; constant after the last point up to the mark."""

    rest: float = 0.0
    """Value when the device is not there: no power, no force, no speed."""
    times: list[float] = field(default_factory=lambda: [-math.inf])
    values: list[float] = field(default_factory=lambda: [0.0])
    mark_s: float = math.inf
    """Nothing before it will change any more; infinite while no device is connected."""

    def connect(self, at_s: float) -> None:
        """A device has powered up; it vouches for nothing yet."""
        self.step(at_s, self.rest)
        self.mark_s = at_s

    def disconnect(self, at_s: float, *, stays: bool = False) -> None:
        """The device is gone: the value falls to rest at once, or stays what it was."""
        self.step(max(at_s, self.times[-1]), self.values[-1] if stays else self.rest)
        self.mark_s = math.inf

    def push(self, samples: list[tuple[float, float]], mark_s: float) -> None:
        """Take points in time order and the new mark. A point before the one known last is moved up to it."""
        for time_s, value in samples:
            self.times.append(max(time_s, self.times[-1]))
            self.values.append(value)
        self.mark_s = mark_s

    def at(self, times_s: FloatArray) -> FloatArray:
        """Values at times before the mark."""
        return np.asarray(np.interp(times_s, self.times[1:] or [0.0], self.values[1:] or [self.rest]))

    def forget(self, before_s: float) -> None:
        """Drop what lies before, but for the last point."""
        keep = max(int(np.searchsorted(self.times, before_s)) - 2, 0)
        if keep > 100:
            del self.times[1:keep], self.values[1:keep]

    def step(self, at_s: float, value: float) -> None:
        """Another value from then on."""
        self.times += [at_s, at_s]
        self.values += [self.values[-1], value]
