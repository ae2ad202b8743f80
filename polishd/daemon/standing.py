"""What it costs that a robot tells late: the pit where somebody else stops it, and the blur of when a block ended."""

from __future__ import annotations

from polishd.config.cell import CellConfig
from polishd.daemon.cell import Cell
from polishd.process.spot_figures import measured_figures, spot_figures
from polishd.recipe.recipe import Recipe


def require_shallow(config: CellConfig, cell: Cell, recipe: Recipe) -> str:
    """How deep that is; ConfigError where it is deeper than ``limits.pit_nm``. Empty where the robot tells at once."""
    robot, actuator = cell.limits.robot, cell.limits.actuator
    if not robot.unseen_stop_s:
        return ""
    stands_s = robot.unseen_stop_s + actuator.release_s
    rate_nm_s = _peak_nm_s(recipe)
    said = (
        f"{rate_nm_s * stands_s:.1f} nm at most: {1e3 * robot.unseen_stop_s:.0f} ms until it is told, "
        f"{1e3 * actuator.release_s:.0f} ms until the force is off, at {rate_nm_s:.0f} nm/s"
    )
    if rate_nm_s * stands_s > config.limits.pit_nm:
        raise config.error(
            "limits.pit_nm",
            f"a feed hold at the controller would dig {said}; more than {config.limits.pit_nm:g} nm. Have the "
            "controller report faster, state what the actuator truly takes (actuator.release_s), or wire its signal "
            "'in motion' to the actuator (in_motion_wired in its profile)",
        )
    return said


def blur(cell: Cell, recipe: Recipe) -> str:
    """How well it is known when a block ended, in time and in removal; empty where the robot tells it exactly."""
    end_s = cell.limits.robot.block_end_s
    return f"{1e3 * end_s:.0f} ms rms, {_peak_nm_s(recipe) * end_s:.1f} nm; it does not add up" if end_s else ""


def _peak_nm_s(recipe: Recipe) -> float:
    """What a tool that stands removes in its spot's middle, each second."""
    tif, process = recipe.tif, recipe.process
    return (spot_figures(process) if tif is None else measured_figures(tif, process)).peak_nm_s
