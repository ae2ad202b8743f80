"""``polishd calibrate instrument``: the instrument's error from maps of a rotated part."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import typer

from polishd.commissioning.calibration.options import InstrumentOptions
from polishd.config.cell import CellConfig
from polishd.config.instrument_profile import InstrumentProfile, load_profile, write_system
from polishd.daemon.assembly import build_cell
from polishd.daemon.runtime.exit_record import locked
from polishd.maps.absolute_test import poses_of, separate_maps
from polishd.maps.convert import require_target, store
from polishd.maps.map_files import MapSource
from polishd.maps.options import AbsoluteOptions
from polishd.model.errors import ConfigError
from polishd.model.instrument import SystemErrorRecord
from polishd.model.surface import SurfaceMap
from polishd.plugin_loader import Hooks, load_cell
from polishd.process.metrology.absolute_poses import LEVEL, PartPose, PoseOptions, family_name, next_poses, terms
from polishd.process.metrology.absolute_test import AbsoluteTestResult
from polishd.process.metrology.instrument import apply_profile
from polishd.rendering.terminal import emit, stderr

ORDER = 4
"""Radial order up to which poses are advised: power, astigmatism, coma, trefoil, spherical, tetrafoil ..."""
STEP_DEG = 45
"""Step of the advised angles."""
SHIFT = 0.1
"""Share of the part's radius: the shift that determines rotationally symmetric terms to twice a map's noise."""
ENOUGH = 0.25
"""Share of the tolerance: largest standard error of each term."""
POWER = (2, 0)
NOISE_NM = 0.3
"""Noise of a map, if the profile has none."""

Take = Callable[[Sequence[PartPose]], Sequence[SurfaceMap]]
"""Maps of the part at each pose, in their order, as they come into the cell's folder."""


def instrument_verb(
    config: CellConfig, files: Sequence[Path], request: InstrumentOptions, take: Take, *, as_json: bool
) -> None:
    """Show the needed poses; or write the system map into the profile, from maps at given poses.

    Args:
        config: the cell whose instrument it is.
        files: maps; none: they are taken as they come.
        request: the poses and their uncertainty; without poses, the needed ones are only shown.
        take: takes maps as they come.
        as_json: for programs.

    Raises:
        ConfigError: the cell names no commissioned profile, or what is to be written cannot be.
        MapError, SurfaceError, DeviceError: of the maps.
    """
    profile = _profile(config)
    if request.angles is None and request.at is None:
        _advise(config, profile, as_json=as_json)
        return
    source = MapSource.of(config.path, profile.path, partly=False, system=False)
    options = _options(config, profile, request)
    if request.at is not None and not files:
        raise typer.BadParameter("--at lists files: name them, or say --angles and take maps as they come")
    if (request.power is None) != (request.power_sigma is None):
        raise typer.BadParameter("--power and --power-sigma go together: a reference says how well it is known")
    poses = poses_of(options, files)
    target = request.out or profile.path.parent / f"system-{datetime.now(UTC):%Y%m%d-%H%M%S}.x3p"
    require_target(target, files, source, force=False)
    if files:
        surfaces = [source.read(path) for path in files]
    else:
        surfaces = [apply_profile(one, profile.instrument) for one in take(poses)]
    separation = separate_maps(surfaces, poses, options, source)
    instrument = separation.instrument
    if request.power is not None and request.power_sigma is not None:
        instrument = _with_power(
            instrument, AbsoluteTestResult.of(separation.found), request.power, request.power_sigma
        )
    more = ["nothing was written: --dry-run"]
    if not request.dry_run:
        stored = store(instrument, target, source)
        separation.answer["instrument"] |= stored
        _record(profile, target, stored["sha256"])
        more = [f"{profile.path}: [system] names it; it goes off each map from now on"]
    separation.show(as_json=as_json, more=more)


def needed_poses(radius_mm: float, noise_nm: float, sigma_nm: float) -> tuple[list[PartPose], dict[str, str]]:
    """Return the fewest poses that determine the low terms, the first one unrotated, and the undetermined terms."""
    first = PartPose(0.0)
    shift = SHIFT * radius_mm
    turns = [PartPose(float(angle)) for angle in range(STEP_DEG, 360, STEP_DEG)]
    candidates = (*turns, PartPose(0.0, shift, 0.0), PartPose(0.0, 0.0, shift))
    wanted = dict.fromkeys(terms(ORDER)[LEVEL:], sigma_nm)
    found = next_poses(wanted, [first], PoseOptions(candidates, radius_mm, noise_nm))
    needs = {family_name(*term): what for term, what in found.demanded.items()}
    return [first, *found.poses], needs


def _profile(config: CellConfig) -> InstrumentProfile:
    """Require a commissioned profile: without it the orientation of its maps is unknown."""
    if config.profile_path is None:
        raise config.error(
            "instrument.profile", "is missing: write one (docs/how-to/instruments.md), and commission it first"
        )
    profile = load_profile(config.profile_path)
    if profile.unproved:
        raise ConfigError(profile.unproved)
    return profile


def _options(config: CellConfig, profile: InstrumentProfile, request: InstrumentOptions) -> AbsoluteOptions:
    return AbsoluteOptions(
        profile=profile.path,
        cell=config.path,
        angles=request.angles,
        shifts=request.shifts,
        at=request.at,
        noise=request.noise,
        angle_error=request.angle_error,
        shift_error=request.shift_error,
    )


def _with_power(instrument: SurfaceMap, result: AbsoluteTestResult, power_nm: float, sigma_nm: float) -> SurfaceMap:
    """Add the power from a reference, which poses cannot determine, to the system map."""
    height = instrument.height_nm + power_nm * result.shape(POWER, instrument.valid)
    step = instrument.history
    if step is None:
        return instrument.with_height(height)
    facts = result.with_reference(POWER, sigma_nm).facts()
    left = [name for name in step.options["without"] if name != family_name(*POWER)]
    reference = f"power {power_nm:g} nm, known to {sigma_nm:g} nm"
    options = {**step.options, "terms": facts, "without": left, "reference": reference}
    return replace(instrument, height_nm=height, history=replace(step, options=options))


def _record(profile: InstrumentProfile, target: Path, sha256: str) -> None:
    named = Path(os.path.relpath(target.absolute(), profile.path.parent.absolute())).as_posix()
    at = datetime.now(UTC).replace(microsecond=0)
    write_system(profile.path, SystemErrorRecord(named, at, sha256, profile.sha256))


def _advise(config: CellConfig, profile: InstrumentProfile, *, as_json: bool) -> None:
    noise = profile.instrument.repeatability_nm or NOISE_NM
    limit = min((line.limit for line in config.lines if line.bounded), default=10 * noise)
    sigma = max(2 * noise, ENOUGH * limit)
    poses, needs = needed_poses(config.outline().radius_mm, noise, sigma)
    angles = ",".join(f"{pose.angle_deg:g}" for pose in poses)
    shifts = ":".join(f"{pose.x_mm:g},{pose.y_mm:g}" for pose in poses)
    command = f"polishd calibrate instrument {config.path.name} --angles {angles}"
    command += f" --shifts {shifts}" if any(pose.x_mm or pose.y_mm for pose in poses) else ""
    answer = {
        "poses": [{"angle_deg": pose.angle_deg, "shift_mm": [pose.x_mm, pose.y_mm]} for pose in poses],
        "sigma_nm": sigma,
        "demanded": needs,
        "next": command,
    }
    lines = [
        f"poses wanted: {'; '.join(map(str, poses))}",
        f"they determine all terms up to order {ORDER} to {sigma:.2g} nm, at {noise:g} nm of noise a map, except:",
        *(f"  {name} needs {what}" for name, what in needs.items()),
        f"next: {command}",
        "the operator then rotates the part, and each new map is taken; or name the maps after the cell",
    ]
    emit(answer, as_json=as_json, lines=lines)


# Maps of a part that the operator rotates: each new map of the cell's folder is one pose.

Prompt = Callable[[PartPose, int, int], None]
"""Ask the operator to place the part: the pose, its number from 1, and the number of poses. Returns when it is done."""


def calibrate_verb(cell: Path, files: Sequence[Path], request: InstrumentOptions, *, as_json: bool) -> None:
    """Run ``instrument_verb``; without files the operator rotates the part."""
    config, hooks = load_cell(cell)
    instrument_verb(
        config, files, request, lambda poses: asyncio.run(measure_poses(config, hooks, poses)), as_json=as_json
    )


async def measure_poses(
    config: CellConfig, hooks: Hooks, poses: Sequence[PartPose], prompt: Prompt | None = None
) -> list[SurfaceMap]:
    """Take a map at each pose. Nothing moves; only the instrument is opened.

    Raises:
        ConfigError: a daemon runs the cell and takes the maps, or the cell's file is wrong.
        SurfaceError, DeviceError: as of the instrument.
    """
    cell = build_cell(config, hooks)
    found: list[SurfaceMap] = []
    with locked(config.state_dir):
        try:
            await cell.open_one(cell.used["metrology"])
            for number, pose in enumerate(poses, 1):
                await asyncio.to_thread(prompt or _by_a_person, pose, number, len(poses))
                stderr.print(f"measure now: waiting for map {number} of {len(poses)}", markup=False)
                found.append(await cell.metrology.next_map(found[-1].sha256 if found else None))
        finally:
            await cell.close()
    return found


def _by_a_person(pose: PartPose, number: int, count: int) -> None:
    text = f"map {number} of {count}: place the part at {pose}, counter-clockwise, right and up as the tool sees it"
    typer.prompt(f"{text}; press Enter when it is in place", default="", show_default=False, err=True)
