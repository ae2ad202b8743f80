"""From a config and its plugins to a cell, a recipe, and the limits of contact. Opens nothing."""

from __future__ import annotations

from typing import TypeVar, cast

from polishd.config.cell import CellConfig
from polishd.daemon.cell import Cell, MonotonicClock
from polishd.daemon.devices import built
from polishd.daemon.safety import ContactLimits
from polishd.daemon.time_limits import Limit, too_short
from polishd.hooks.loader import Hooks
from polishd.hookspecs import DeviceContext
from polishd.model.errors import ConfigError
from polishd.ports.devices import ForceActuator, Metrology, Robot, Spindle
from polishd.recipe.making import instrument_of

T = TypeVar("T")


def build_cell(config: CellConfig, hooks: Hooks) -> Cell:
    """The devices that the config names, not yet open; each has all that its port asks.

    ConfigError or PluginError where one cannot be built, or lacks something.
    """
    context = DeviceContext(
        base_dir=config.base_dir,
        state_dir=config.state_dir,
        part_id=config.part.id,
        readers=tuple(hooks.surface_readers().values()),
        instrument=instrument_of(config),
    )
    return Cell(
        robot=cast(Robot, built(config, hooks, "robot", context)),
        actuator=cast(ForceActuator, built(config, hooks, "actuator", context)),
        spindle=cast(Spindle, built(config, hooks, "spindle", context)),
        metrology=cast(Metrology, built(config, hooks, "metrology", context)),
        clock=MonotonicClock(),
    )


def require_time_limits(config: CellConfig, cell: Cell) -> tuple[Limit, ...]:
    """The chain of time limits; ConfigError with each one that is shorter than what it guards."""
    chain = cell.limits.chain(config.job.lookahead_s)
    found = [config.source.error(tuple(key.split(".")), problem) for key, problem in too_short(chain)]
    if found:
        raise ConfigError("\n".join(found))
    return chain


def contact_limits(config: CellConfig) -> ContactLimits:
    """What is watched in contact."""
    return ContactLimits(
        force_n=config.process.force_n,
        rpm=config.process.rpm,
        force_band=config.limits.force_band,
        grace_s=config.limits.force_grace_s,
    )
