"""The look-ahead speed profile: trapezoids under one acceleration, for whole buffers at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray


@dataclass(frozen=True, slots=True)
class Trapezoids:
    """n moves: speeds in, at the top and out (mm/s), and seconds of the three phases."""

    v_in: FloatArray
    v_top: FloatArray
    v_out: FloatArray
    t_up: FloatArray
    t_top: FloatArray
    t_down: FloatArray

    @property
    def seconds(self) -> FloatArray:
        """(n,) duration."""
        return self.t_up + self.t_top + self.t_down


def junctions(length: FloatArray, cap: FloatArray, start: float, accel: float) -> FloatArray:
    """Squared speeds at the n + 1 junctions of n moves.

    ``cap`` (n + 1,) is the squared speed allowed at each junction; the last is where it must be able to stop.
    Forward and backward pass in closed form: ``u[i+1] <= u[i] + 2 a L`` is a running minimum of ``cap - sum 2 a L``.
    """
    gain = np.concatenate([[0.0], np.cumsum(2.0 * accel * length)])
    limit = cap.copy()
    limit[0] = start
    forward = np.minimum.accumulate(limit - gain) + gain
    backward = np.minimum.accumulate((forward + gain)[::-1])[::-1] - gain
    squared = np.maximum(backward, 0.0)
    squared[0] = start
    return np.asarray(squared)


def trapezoids(length: FloatArray, feed: FloatArray, squared: FloatArray, accel: float) -> Trapezoids:
    """The moves between junctions of known speed. Moves of no length take no time."""
    u_in, u_out = squared[:-1], squared[1:]
    u_top = np.minimum(feed**2, accel * length + (u_in + u_out) / 2.0)
    v_in, v_out = np.sqrt(u_in), np.sqrt(u_out)
    v_top = np.sqrt(np.maximum.reduce([u_top, u_in, u_out]))
    t_up, t_down = (v_top - v_in) / accel, (v_top - v_out) / accel
    ramps = (v_top + v_in) / 2.0 * t_up + (v_top + v_out) / 2.0 * t_down
    rest = np.maximum(length - ramps, 0.0)
    t_top = np.divide(rest, v_top, out=np.zeros_like(rest), where=v_top > 0.0)
    moving = length > 0.0
    return Trapezoids(v_in, v_top, v_out, t_up * moving, t_top * moving, t_down * moving)


def along(shape: Trapezoids, k: np.ndarray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance travelled (mm) and speed (mm/s) in moves ``k`` (m,) at ``t`` (m,) seconds after their start."""
    up = np.minimum(t, shape.t_up[k])
    top = np.clip(t - shape.t_up[k], 0.0, shape.t_top[k])
    down = np.clip(t - shape.t_up[k] - shape.t_top[k], 0.0, shape.t_down[k])
    v_in, v_top, v_out = shape.v_in[k], shape.v_top[k], shape.v_out[k]
    rise = np.divide(v_top - v_in, shape.t_up[k], out=np.zeros_like(t), where=shape.t_up[k] > 0.0)
    fall = np.divide(v_top - v_out, shape.t_down[k], out=np.zeros_like(t), where=shape.t_down[k] > 0.0)
    distance = v_in * up + rise * up**2 / 2.0 + v_top * top + v_top * down - fall * down**2 / 2.0
    speed = np.where(down > 0.0, v_top - fall * down, np.where(t < shape.t_up[k], v_in + rise * up, v_top))
    return distance, speed
