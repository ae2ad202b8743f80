"""From a config and its plugins to the recipe of a job. Opens nothing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from polishd.config.cell import CellConfig
from polishd.config.instrument_profile import InstrumentProfile, load_profile
from polishd.config.toml_loader import did_you_mean, join_words
from polishd.hookspecs import Learner, RemovalModel, SurfaceReader
from polishd.model.errors import ConfigError, ProgramError, SurfaceError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap
from polishd.pipeline.part_handling import between_of, touch_off_of
from polishd.pipeline.recipe import Recipe, ToolStep
from polishd.pipeline.run_folder import read_map
from polishd.plugin_loader import Hooks
from polishd.process.metrology.absolute_test import AbsoluteTestResult, SystemMap

OWN = "rate"
"""What a removal model learns that is asked for nothing else."""


def instrument_of(config: CellConfig) -> Instrument | None:
    """The instrument's profile, commissioned or not; None where the cell names none. ConfigError names file and key."""
    path = config.profile_path
    return None if path is None else load_profile(config.file("instrument.profile", path)).instrument


def nominal_of(config: CellConfig, hooks: Hooks) -> SurfaceMap | None:
    """The form wanted; None where the cell names none. ConfigError where its file does not say all of itself."""
    if config.part.form is None:
        return None
    try:
        nominal = read_map(config.resolve(config.part.form), hooks.surface_readers().values())
    except SurfaceError as error:
        raise config.error("part.form", str(error)) from error
    open_ones = sorted(nominal.unsaid - {"orientation"})  # it lies as the part's own frame does
    if open_ones:
        raise config.error("part.form", f"{nominal.path}: does not say its {' and '.join(open_ones)}")
    return nominal


def system_of(config: CellConfig, hooks: Hooks) -> SystemMap | None:
    """The instrument's own error; None where its profile names no map. ConfigError where it is not to be trusted."""
    if config.profile_path is None:
        return None
    return system_of_profile(load_profile(config.profile_path), hooks.surface_readers().values(), config.path.name)


def system_of_profile(
    profile: InstrumentProfile, readers: Collection[SurfaceReader], cell: str = "CELL.toml"
) -> SystemMap | None:
    """System map of a profile; ``cell`` is the cell's file for the advice of errors."""
    record, again = profile.system, f"polishd calibrate instrument {cell} makes another"
    if record is None:
        return None
    try:
        surface = read_map(profile.path.parent / record.map, readers)
    except SurfaceError as error:
        raise profile.error("system.map", str(error)) from error
    if surface.sha256 != record.map_sha256:
        raise profile.error("system.map", f"{record.map} is not the file that was calibrated: put it back, or {again}")
    if record.profile_sha256 != profile.sha256:
        problem = f"the profile was edited after {record.at:%Y-%m-%d %H:%M}, when its system map was made; {again}"
        raise profile.error("system.map", problem)
    step = surface.history
    if step is None or step.options.get("result") != "instrument" or not step.profiled:
        problem = f"{record.map} says of itself no instrument's own error, read by a profile; {again}"
        raise profile.error("system.map", problem)
    try:
        return SystemMap(surface, AbsoluteTestResult.load(step.options["terms"]))
    except (KeyError, TypeError, ValueError) as error:
        raise profile.error(
            "system.map", f"{record.map} does not state the uncertainty of its terms; {again}"
        ) from error


def uncommissioned_reason(config: CellConfig) -> str:
    """Reason why maps must not drive polishing in this cell; empty where they may."""
    if config.profile_path is None:
        problem = (
            "the cell names no instrument profile; write one (docs/how-to/instruments.md), commission it, name it here"
        )
        return str(config.error("instrument.profile", problem))
    return load_profile(config.profile_path).unproved


def require_commissioned(config: CellConfig, instrument: Instrument | None) -> None:
    """ConfigError unless the instrument that this config names is commissioned."""
    if instrument is None or instrument.commissioned is None:
        raise ConfigError(f"{uncommissioned_reason(config)} (nothing was opened)")


def make_recipes(config: CellConfig, hooks: Hooks) -> tuple[Recipe, ...]:
    """A recipe for each tool, in the order in which they polish; one where the cell has one. ConfigError as below."""
    if not config.tools:
        return (make_recipe(config, hooks),)
    turns = [ToolStep(name, tool.passes, tool.change_s) for name, tool in config.tools.items()]
    return tuple(replace(make_recipe(own, hooks), turn=turn) for own, turn in zip(config.turns, turns, strict=True))


def make_recipe(config: CellConfig, hooks: Hooks) -> Recipe:
    """Build the input of the computing steps; ConfigError names a key that no loaded plugin serves."""
    solvers = hooks.dwell_solvers()
    program = _named(config, "program.format", config.program.format, hooks.program_formats())
    if config.touch_off is not None and program.made_like is not None and config.program_path.is_file():
        try:  # the touch-off moves in the same frame
            program = program.made_like(config.program_path.read_bytes(), config.program_path.name)
        except ProgramError as error:
            raise config.error("touch_off", str(error)) from error
    instrument = instrument_of(config)
    cross_check = config.dwell.cross_check
    return Recipe(
        part=config.part,
        outline=config.outline(),
        program=config.program,
        dwell=config.dwell,
        job=config.job,
        instrument=instrument,
        spike_threshold_mad=config.instrument.spike_threshold_mad,
        nominal=nominal_of(config, hooks),
        grid_mm=config.process.grid_mm,
        process=config.tool_process(),
        robot=config.robot_model(),
        placement=config.placement(),
        options=config.compliance_options(),
        optic=config.optic(),
        tif=config.measured_tif(),
        correction=config.process.correction,
        envelope=config.envelope(),
        max_rate_change=config.limits.max_rate_change,
        format=program,
        model=_model(config, hooks),
        solver=_named(config, "dwell.solver", config.dwell.solver, solvers),
        cross_check=_named(config, "dwell.cross_check", cross_check, solvers) if cross_check else None,
        finding=config.limits.finding,
        ripple_errors=config.ripple.errors,
        tolerance=config.lines,
        remembers=config.estimates.use_previous,
        touch_off=touch_off_of(config, program),
        part_handling=between_of(config, instrument),
        system=system_of(config, hooks),
    )


def _model(config: CellConfig, hooks: Hooks) -> RemovalModel:
    """The removal model with the cell's learner."""
    process = config.process
    model: RemovalModel = _named(config, "process.removal_model", process.removal_model, hooks.removal_models())
    own = {OWN: Learner(model.beliefs, model.learn, model.later)}
    ways = {**own, **model.learners}
    if process.estimates not in ways:
        hint = did_you_mean(process.estimates, ways)
        problem = (
            f"the removal model {model.name!r} does not learn {process.estimates!r}{hint} It has: {join_words(ways)}"
        )
        raise config.error("process.estimates", problem)
    way = ways[process.estimates]
    return replace(model, beliefs=way.beliefs, learn=way.learn, later=way.later)


def _named(config: CellConfig, key: str, name: str, records: Mapping[str, Any]) -> Any:
    if name not in records:
        hint = did_you_mean(name, records)
        raise config.error(key, f"no loaded plugin has {name!r}{hint} The loaded plugins have: {join_words(records)}")
    return records[name]
