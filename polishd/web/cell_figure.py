"""The cell of a pass for the page: the robot's joints along the plan, the path and the part, in the base frame."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polishd.config.cell import CellConfig
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.surface import FloatArray
from polishd.process import frames
from polishd.process.optic_surface import sag_mm
from polishd.process.robot.stick_figure import stick_figure, up_direction
from polishd.process.toolpath.apertures import tool_axes

MOST_POSES = 600
"""Most points of the plan with the robot's joints."""
MOST_PATH = 6000
"""Most points of the path."""
CACHE_SIZE = 8
"""Figures that stay in memory."""
FigureKey = tuple[str, str, int]
"""Plan's name in the store, tool, and job: the configuration in force does not change while the server runs."""


class CellFigures:
    """Figures of passes, each computed once. Safe in threads: the second request of a figure waits for the first."""

    def __init__(self) -> None:
        self._cache: OrderedDict[FigureKey, dict[str, Any]] = OrderedDict()
        self._computing = threading.Lock()

    def of(self, key: FigureKey, config: CellConfig, plan: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        """Return the figure of a plan; ``key`` names it and its configuration."""
        with self._computing:
            if key not in self._cache:
                self._cache[key] = cell_figure(config, plan)
                while len(self._cache) > CACHE_SIZE:
                    self._cache.popitem(last=False)
            self._cache.move_to_end(key)
            return self._cache[key]


def cell_figure(config: CellConfig, plan: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return robot, path and part of a plan, mm in the robot's base frame.

    The tool axis is the configuration's: the optic's normal with the dip of ``[process]``. Where the robot cannot take
    a pose or has no kinematics, ``problem`` says so, and there are no joints.

    Raises:
        ConfigError: arrays of the plan are missing, or the part and its placement cannot be.
    """
    try:
        ends, block = np.asarray(plan["end_mm"], dtype=np.float64), np.asarray(plan["block"])
        dwell_s = np.asarray(plan["time_s"], dtype=np.float64)
        if not ends.size or ends.shape != (block.size, 3) or dwell_s.shape != block.shape:
            raise ValueError(f"{ends.shape} points, {block.shape} blocks, {dwell_s.shape} times")
        if not (np.isfinite(ends).all() and np.isfinite(dwell_s).all()):
            raise ValueError("a point or its dwell is no finite number")
    except (KeyError, ValueError, TypeError) as error:
        raise ConfigError(f"the arrays of this plan are not those of a pass ({error!r}); it cannot be shown") from error
    robot, placement = config.robot_model(), config.placement()
    path = _every(len(ends), MOST_PATH)
    found: dict[str, Any] = {
        "robot": config.kinematics.type,
        "up": up_direction(robot),
        "tool_radius_mm": config.process.tool_radius_mm,
        "path": {
            "block": block[path].tolist(),
            "dwell_s": _rounded(dwell_s[path], 5),
            "mm": _rounded(frames.points_to_base(placement, ends[path]), 2),
        },
        "names": [],
        "links": [],
        "poses": {"block": [], "joints_mm": []},
        "problem": "",
    }
    chosen = _every(len(ends), MOST_POSES)
    try:
        found["part"] = _part(config)
        tip = frames.points_to_base(placement, ends[chosen])
        axis = tool_axes(ends, config.optic(), config.process.dip_deg, config.compliance_options(), placement)[chosen]
        figure = stick_figure(robot, tip, frames.directions_to_base(placement, axis))
    except ComputeError as error:
        return {"part": None, **found, "problem": str(error)}
    return {
        **found,
        "names": figure.names,
        "links": figure.links,
        "poses": {"block": block[chosen].tolist(), "joints_mm": _rounded(figure.joints_mm, 1)},
    }


def _part(config: CellConfig) -> dict[str, Any]:
    """Rim and clear aperture of the part on its surface, its center, and the normal there."""
    placement, optic = config.placement(), config.optic()
    rim = config.outline().corners()
    surface = np.column_stack([rim, sag_mm(optic, rim)])
    center = np.array([[0.0, 0.0, float(sag_mm(optic, np.zeros((1, 2)))[0])]])
    return {
        "rim_mm": _rounded(frames.points_to_base(placement, surface), 2),
        "center_mm": _rounded(frames.points_to_base(placement, center)[0], 2),
        "normal": _rounded(frames.surface_normals(placement, center, optic)[0], 6),
    }


def _every(count: int, most: int) -> NDArray[np.intp]:
    """Numbers of at most ``most`` of ``count`` points, evenly spaced, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))


def _rounded(values: FloatArray, digits: int) -> Any:
    return np.round(values, digits).tolist()
