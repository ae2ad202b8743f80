"""From a config and its plugins to a cell, a recipe, and the limits of contact. Opens nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from polishd.daemon.cell import Cell, MonotonicClock
from polishd.daemon.config import CellConfig
from polishd.daemon.config_errors import did_you_mean, listed
from polishd.daemon.devices import built
from polishd.daemon.files import read_map
from polishd.daemon.instrument_file import load_profile
from polishd.daemon.plugins import Hooks
from polishd.daemon.recipe import Recipe
from polishd.daemon.safety import ContactLimits
from polishd.daemon.time_limits import Limit, too_short
from polishd.hookspecs import DeviceContext
from polishd.model.errors import ConfigError, SurfaceError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap
from polishd.ports.devices import ForceActuator, Metrology, Robot, Spindle

CROSS_CHECK_GAP = 1e-3
"""Most by which an independent solver may be better."""

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


def instrument_of(config: CellConfig) -> Instrument | None:
    """The instrument's profile, commissioned or not; None where the cell names none. ConfigError names file and key."""
    return None if config.profile_path is None else load_profile(config.profile_path).instrument


def nominal_of(config: CellConfig, hooks: Hooks) -> SurfaceMap | None:
    """The form wanted; None where the cell names none. ConfigError where its file does not say all of itself."""
    if config.part.nominal is None:
        return None
    try:
        nominal = read_map(config.resolve(config.part.nominal), hooks.surface_readers().values())
    except SurfaceError as error:
        raise config.error("part.nominal", str(error)) from error
    open_ones = sorted(nominal.unsaid - {"orientation"})  # it lies as the part's own frame does
    if open_ones:
        raise config.error("part.nominal", f"{nominal.path}: does not say its {' and '.join(open_ones)}")
    return nominal


def why_not_commissioned(config: CellConfig) -> str:
    """Why no map may drive polishing in this cell; empty where maps may."""
    if config.profile_path is None:
        problem = "the cell names no instrument's profile; write one (docs/instruments.md), commission it, name it here"
        return str(config.error("instrument.profile", problem))
    return load_profile(config.profile_path).unproved


def require_commissioned(config: CellConfig, recipe: Recipe) -> None:
    """ConfigError unless the recipe's instrument is commissioned."""
    if recipe.instrument is None or recipe.instrument.commissioned is None:
        raise ConfigError(f"{why_not_commissioned(config)} (nothing was opened)")


def make_recipe(config: CellConfig, hooks: Hooks) -> Recipe:
    """Everything that the computing steps need; ConfigError names the key that no loaded plugin serves."""
    solvers = hooks.dwell_solvers()
    cross_check = config.dwell.cross_check
    return Recipe(
        part_id=config.part.id,
        instrument=instrument_of(config),
        aperture_mm=config.part.aperture_mm,
        edge_mm=config.part.edge_mm,
        free_rim=config.part.rim == "free",
        extension=config.dwell.extension,
        alignment=config.part.alignment,
        nominal=nominal_of(config, hooks),
        spike_mads=config.instrument.spike_mads,
        grid_mm=config.process.grid_mm,
        program_offset_mm=config.program.offset_mm,
        program_rotation_deg=config.program.rotation_deg,
        process=config.tool_process(),
        robot=config.robot_model(),
        placement=config.placement(),
        options=config.compliance_options(),
        optic=config.optic(),
        tif=config.measured_tif(),
        correction=config.process.correction,
        envelope=config.envelope(),
        format=_named(config, "program.format", config.program.format, hooks.program_formats()),
        model=_named(config, "process.removal_model", config.process.removal_model, hooks.removal_models()),
        solver=_named(config, "dwell.solver", config.dwell.solver, solvers),
        cross_check=_named(config, "dwell.cross_check", cross_check, solvers) if cross_check else None,
        cross_check_gap=CROSS_CHECK_GAP,
        regularisation=config.dwell.regularisation,
        solve_s=config.dwell.within_s,
        choose=config.dwell.choose,
        budget_s=config.dwell.budget_s or math.inf,
        target_nm=config.dwell.target_nm or 0.0,
        curve=config.dwell.curve,
        kkt_tolerance=config.dwell.kkt_tolerance,
        tolerance_nm=config.job.tolerance_nm,
        tolerance_period_mm=config.job.tolerance_period_mm,
        lsf_period_mm=config.job.lsf_period_mm,
        max_rate_change=config.limits.max_rate_change,
    )


def contact_limits(config: CellConfig) -> ContactLimits:
    """What is watched in contact."""
    return ContactLimits(
        force_n=config.process.force_n,
        rpm=config.process.rpm,
        force_band=config.limits.force_band,
        grace_s=config.limits.force_grace_s,
    )


def _named(config: CellConfig, key: str, name: str, records: Mapping[str, Any]) -> Any:
    if name not in records:
        hint = did_you_mean(name, records)
        raise config.error(key, f"no loaded plugin has {name!r}{hint} The loaded plugins have: {listed(records)}")
    return records[name]
