"""``check`` and ``probe``: checks of a cell before it runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from polishd.config.cell import CellConfig
from polishd.config.job_file import JobFile
from polishd.daemon.assembly import (
    build_cell,
    build_notifiers,
    contact_limits,
    require_accepted_by_robot,
    require_time_limits,
)
from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.readiness import report_once
from polishd.daemon.cell.recorder import place, recording_to
from polishd.daemon.contact.safety import ContactLimits, make_safe
from polishd.daemon.contact.stall_removal import (
    StallRemoval,
    require_held_motion,
    require_stall_depth,
    stall_removal,
    timing_uncertainty_s,
    tolerance_nm,
)
from polishd.daemon.runtime.exit_record import locked
from polishd.daemon.runtime.process import host
from polishd.interfaces import ForceActuator
from polishd.model.devices import DeviceIdentity, port_of
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.program import Program
from polishd.pipeline import disk_space, part_handling, precheck, steps
from polishd.pipeline.acceptance import acceptance_words
from polishd.pipeline.build_recipe import make_recipes, uncommissioned_reason
from polishd.pipeline.precheck import require_fit
from polishd.pipeline.recipe import Recipe
from polishd.plugin_loader import Hooks, hooks_of_job
from polishd.process.removal import contact

if TYPE_CHECKING:
    from polishd.daemon.queue.queue import NewJob

OnStep = Callable[[str], None]
"""Callback with a description of the next step."""


def check_cell(config: CellConfig, hooks: Hooks, on_step: OnStep = lambda _: None) -> dict[str, Any]:
    """Read all files of the config and compute along each tool's programs. Opens nothing; raises the first fault."""
    on_step("part, tool and instrument")
    recipes = make_recipes(config, hooks)
    on_step("devices and their time limits")
    cell = build_cell(config, hooks)
    chain = require_time_limits(config, cell)
    notifiers = build_notifiers(config, hooks)
    along: dict[str, Any] = {}
    pits: list[tuple[StallRemoval, str]] = []
    warnings: list[str] = []
    for own, recipe in zip(config.turns, recipes, strict=True):
        of_tool = "" if recipe.turn is None else f"{recipe.turn.tool}: "
        on_step(f"reading {', '.join(path.name for path in own.program_paths)}")
        programs = precheck.read_programs(own, recipe)
        for number, program in enumerate(programs, 1):
            of_turn = f"program {number}: " if len(programs) > 1 else ""
            found, pit, warned = _along(own, cell, hooks, recipe, program, on_step=on_step)
            warnings += [of_tool + one for one in warned]
            along |= {of_tool + of_turn + key: value for key, value in found.items()}
            pits.append((pit, pit.warning(tolerance_nm(recipe))))
    pit, warning = max(pits, key=lambda one: one[0].removal_nm)
    included = ", ".join(f"{key} from {file}" for key, file in config.included.items())
    return {
        "config": str(config.path),
        **({"included": included} if included else {}),
        "plugins": ", ".join(plugin.name for plugin in hooks.report.loaded),
        "devices": _devices(cell),
        "instrument": _instrument(config, recipes[0]),
        **along,
        "accepted": acceptance_words(recipes[0]),
        "force": _force(cell, contact_limits(config)),
        "without power": ", ".join(
            f"{name} {cast(ForceActuator, cell.devices[name]).times.unpowered}" for name in cell.at("actuator")
        ),
        "signals": "; ".join(str(one) for one in cell.signals.limits) or "none",
        "notifications": ", ".join(f"{one.name} ({one.type}, {one.least})" for one in notifiers) or "none",
        "host": host(),
        "time limits": [*(limit.row() for limit in chain), pit.row()],
        "pit": pit.facts(),
        "warnings": [*([warning] if warning else []), *warnings],
    }


def _along(
    config: CellConfig, cell: Cell, hooks: Hooks, recipe: Recipe, program: Program, *, on_step: OnStep
) -> tuple[dict[str, Any], StallRemoval, list[str]]:
    """Return facts of a program of one tool, the pit of a robot that stands on it, and warnings."""
    hold = require_stall_depth(config, cell, recipe)
    require_accepted_by_robot(config, hooks, program)
    with precheck.blame_path((config, recipe, program)):
        precheck.check_pass(config, recipe, program)
        on_step(f"reach and removal at {program.n} points of {program.name}")
        answer = steps.effect_of(recipe, program, steps.process_grid(recipe))
    covers = require_fit(config, recipe, program)
    precheck.require_limits(recipe, program, hooks.check_plan, answer)
    compliance, gamma = answer.compliance_um_per_n, answer.gamma
    removal_nm = float(np.max(answer.effect.removal_nm(program.time_s)))
    held = require_held_motion(config, cell, recipe, program)
    facts = {
        "program": f"{program.name}: {program.n} timed points, {program.lines} lines, time in the {program.encoding}",
        "covers": covers,
        "seat": _seat(recipe, hooks),
        "pass": precheck.pass_words(recipe, program, answer),
        "disk": disk_space.pass_words(
            config.state_dir, config.run_dir or config.state_dir, program.lines, config.job.max_cycles
        ),
        "reach": f"all {program.n} points",
        "compliance_um_per_n": f"{compliance.min():.3f} to {compliance.max():.3f}",
        "gamma": f"{gamma.min():.3f} to {gamma.max():.3f}",
        "tolerance": precheck.tolerance_words(recipe, answer),
        "correction": recipe.correction,
        "removal of the program as it is": f"{removal_nm:.1f} nm at most",
        **(
            {}
            if "force_sensor" in cell.used
            else {"if the actuator misreads its force": _lie(config, recipe, removal_nm)}
        ),
        **({"feed hold at the controller": hold} if hold else {}),
        **({"end of a block known to": blurred} if (blurred := timing_uncertainty_s(cell, recipe)) else {}),
        **({"motion held by the robot": held} if held else {}),
    }
    pit = stall_removal(cell.limits, recipe, program, contact_limits(config).no_progress_s)
    return facts, pit, precheck.program_warnings(recipe, program, removal_nm)


def check_jobs(cell: CellConfig, hooks: Hooks, paths: Sequence[Path], judged: set[str] | None = None) -> list[NewJob]:
    """Return the jobs of these files, each checked as by ``polishd check``; raise the first fault of each.

    Jobs that differ only in name and part are checked once; ``judged``: those of earlier calls, kept by the caller.
    """
    from polishd.daemon.queue.requests import new_job  # this import is slow

    jobs, wrong, judged = [], [], set() if judged is None else judged
    for path in paths:
        try:
            file = JobFile.read(path)
            config = file.laid_over(cell)
            jobs.append(new_job(cell, hooks, file))
            values = {**config.effective(), "job": {**config.job.model_dump(), "id": ""}}
            values["part"] = {**config.part.model_dump(), "id": ""}
            if (same := json.dumps([values, jobs[-1].files], sort_keys=True)) not in judged:
                check_cell(config, hooks_of_job(cell, hooks, config))
                judged.add(same)
        except PolishdError as error:
            problem = str(error)
            wrong.append((error, problem if str(path) in problem else f"{path}: {problem}"))
    if wrong:
        raise type(wrong[0][0])("\n".join(problem for _, problem in wrong))
    return jobs


def _devices(cell: Cell) -> str:
    return ", ".join(name if cell.uses(name) else f"{name} (not used by this job)" for name in cell.devices)


def _seat(recipe: Recipe, hooks: Hooks) -> str:
    """Return how and where the seat is checked; PlanRefused if a plugin refuses a touch-off."""
    touch_off = recipe.touch_off
    if touch_off is None:
        refused = "" if recipe.turn is None else "run will refuse, because several tools need [touch_off]: "
        return f"{refused}not checked: the cell has no [touch_off]"
    part_handling.require_allowed(recipe, part_handling.plans(recipe, touch_off), hooks.check_plan)
    places = "; ".join(f"x {x:.1f}, y {y:.1f} mm" for x, y, _ in touch_off.points_mm + 0.0)
    return f"checked with {touch_off.force_n:g} N at {places}: at most {touch_off.max_offset_mm:g} mm off"


def _force(cell: Cell, limits: ContactLimits) -> str:
    """Return which devices measure the force, and its limits."""
    sensor = cell.used.get("force_sensor")
    most = f"; no reading above {limits.force_max_n:g} N ({limits.force_max_key})"
    if sensor is None:
        return f"measured by the actuator only: the cell has no [force_sensor]{most}"
    apart = f"at most {limits.apart_n:g} N apart for more than {limits.apart_s:g} s"
    return f"measured by the actuator and {sensor}: {apart}{most}"


def _lie(config: CellConfig, recipe: Recipe, removal_nm: float) -> str:
    """Return the removal by an actuator that presses with more force than it reads, which ends no contact."""
    process = recipe.process
    pressed_n = np.array([process.force_n + 1.0, config.process.most_force_n])
    more = contact.relative_removal(process, pressed_n, np.full(2, np.nan)) - 1.0
    return (
        f"an actuator that presses {pressed_n[0]:g} N and reads {process.force_n:g} N removes {more[0]:.0%} more, "
        f"{more[0] * removal_nm:.1f} nm at the worst place of the program as it is; one that presses "
        f"{pressed_n[1]:g} N removes {more[1] * removal_nm:.1f} nm more, and only the next map shows it. "
        "Recommended: an independent [force_sensor] (docs/how-to/monitors.md)"
    )


def _instrument(config: CellConfig, recipe: Recipe) -> str:
    instrument = recipe.instrument
    if instrument is None or instrument.commissioned is None:
        return f"run will refuse: {uncommissioned_reason(config)}"
    record = instrument.commissioned
    system = "" if recipe.system is None else f"; subtracted system map: {recipe.system.surface.sha256[:12]}"
    return f"{instrument.name}: commissioned {record.at:%Y-%m-%d %H:%M} with {record.artefact}{system}"


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """Identities and problems by the devices' names, and the values of the watched signals."""

    identities: Mapping[str, DeviceIdentity]
    problems: Mapping[str, str]
    signals: Mapping[str, str]


async def probe_cell(
    config: CellConfig, hooks: Hooks, only: Sequence[str] = (), record: Path | None = None
) -> ProbeResult:
    """Connect to each device and identify it, regardless of faults of others; then make all safe.

    With ``only`` these are identified and nothing else, so that no robot stops while its tool may press.
    With ``record`` the messages on their links go to that file.
    """
    cell = build_cell(config, hooks)
    require_time_limits(config, cell)
    if unknown := [name for name in only if name not in cell.devices]:
        raise ConfigError(f"--only {unknown[0]}: the cell has {', '.join(cell.devices)}. Name one of them")
    found, problems = {}, {}
    with locked(config.state_dir), recording_to(place(record, config), config) if record else nullcontext():
        try:
            for name in only or cell.devices:
                try:
                    found[name] = await cell.open_one(name)
                    if port_of(name) == "monitor":
                        await report_once(cell, name)
                except Exception as error:  # noqa: BLE001 - a plugin may raise anything: the others are probed as well
                    problems[name] = str(error) or type(error).__name__
            if not only:
                await make_safe(cell)
        finally:
            await cell.close()
    unsafe = (one.partition(": ") for one in cell.unsafe)
    problems = {name: f"not confirmed safe: {why}" for name, _, why in unsafe} | problems
    return ProbeResult(found, problems, {name: facts["text"] for name, facts in cell.signals.facts().items()})
