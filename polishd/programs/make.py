"""``polishd program make``: a raster or a spiral over an aperture, as an NC program."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import typer
from scipy.spatial.transform import Rotation

from polishd.config.cell import CellConfig
from polishd.config.cell_sections import InstrumentSection
from polishd.config.table_files import read_polygon
from polishd.maps.map_files import MapSource
from polishd.model.errors import ComputeError, ConfigError, MapError, ProgramError
from polishd.model.outline import hexagon
from polishd.model.process import FLAT, ComplianceOptions, Optic, Placement
from polishd.model.program import Encoding, Program
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.pipeline import precheck
from polishd.pipeline.build_recipe import make_recipe
from polishd.plugin_loader import Hooks, load_cell
from polishd.plugins.rnc_robot.dialect import DEFAULT
from polishd.plugins.rnc_robot.dialect import dialect as dialect_named
from polishd.plugins.rnc_robot.formats import path_program, read
from polishd.process.metrology.conditioning import resample_square
from polishd.process.optic_surface import unit_normals
from polishd.process.removal import contact
from polishd.process.removal.quiet_pitch import MORE_PATH, ContactAt, QuietPitch, quiet_pitch
from polishd.process.removal.tif import HertzSpot
from polishd.process.robot.compliance import compliance_at, depth_ratio
from polishd.process.toolpath import apertures
from polishd.process.toolpath.apertures import Aperture, largest_turn_deg, over_outline, tool_axes
from polishd.process.toolpath.bent_rasters import MIN_RADIUS_MM, LineDensity, adaptive_raster, random_raster
from polishd.process.toolpath.paths import crossed_raster, raster, spiral
from polishd.programs.options import MakeOptions
from polishd.programs.rewrite import require_new_target, target_file
from polishd.programs.show import path_picture
from polishd.rendering.plots import save_picture
from polishd.rendering.terminal import emit, key_table, stderr
from polishd.util.files import require_new_file

SHAPES: dict[str, tuple[int, Callable[..., Aperture]]] = {
    "circle": (1, apertures.circle),
    "annulus": (2, apertures.annulus),
    "ellipse": (2, apertures.ellipse),
    "rectangle": (2, apertures.rectangle),
    "hexagon": (1, lambda flats_mm: apertures.over_outline(hexagon(flats_mm))),
}
"""Apertures by name: number of lengths, and constructor."""
UNCHECKED = (
    "the robot's reach and singular poses",
    "the machine's range and feeds",
    "whether the landing points lie beside the part",
)
"""Checks of a program that need its cell."""
LOWEST = 0.005
"""Share of the samples of a map that may lie below what is to be removed, as of the dwell solvers."""
UPRIGHT = Placement((0.0, 0.0, 0.0), np.eye(3))


@dataclass(frozen=True, slots=True)
class GeneratedPath:
    """A path in the part's frame."""

    aperture: Aperture
    optic: Optic
    points_mm: FloatArray
    axis: FloatArray
    largest_turn_deg: float

    @property
    def length_mm(self) -> FloatArray:
        """(n,) length of each move."""
        return np.asarray(np.linalg.norm(np.diff(self.points_mm, axis=0), axis=1), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class GeneratedProgram:
    """A program along a path."""

    path: GeneratedPath
    text: bytes
    answer: dict[str, Any]
    """Answer of ``polishd program make``."""


def make_verb(options: MakeOptions, *, as_json: bool) -> None:
    """Make the path, write the program, and describe it; write nothing where anything is refused."""
    _require_target(options)
    config, hooks = (None, None) if options.cell is None else load_cell(options.cell)
    with stderr.status("making the path"):
        program = make_program(options, config, hooks)
    answer = program.answer
    options = replace(options, pitch_mm=answer["pitch_mm"])
    _write(options, program.path, program.text)
    emit(answer, as_json=as_json, table=lambda: _table(options, answer), lines=[f"written to {options.out}"])


def make_program(options: MakeOptions, config: CellConfig | None, hooks: Hooks | None) -> GeneratedProgram:
    """Text and description of the program, without writing it.

    ComputeError or ProgramError where it is impossible, or where the cell's `plan` or `run` would refuse it.
    """
    options, quiet = _with_pitch(options, config)
    encoding = _encoding(options)
    dialect = options.dialect or (DEFAULT if config is None else dialect_of(config))
    made = make_path(options, config)
    feed, time_s = _timing(options, encoding, made.length_mm)
    points, axis = in_program_frame(config, made.points_mm, made.axis)
    text = path_program(
        points, axis, feed, _title(options), encoding=encoding, dwell_s=options.dwell_s or 0.0, to=dialect
    )
    if config is not None and hooks is not None:
        _require_cell_takes(config, hooks, read(dialect_named(dialect), text, options.out.name))
    answer = {
        "shape": options.shape,
        "dialect": dialect_named(dialect).name,
        "encoding": encoding,
        "points": len(points) - 1,
        "pitch_mm": options.pitch_mm,
        "ripple": None if quiet is None else {key: getattr(quiet, key) for key in RIPPLE_KEYS},
        "length_mm": float(made.length_mm.sum()),
        "duration_s": float(time_s.sum()),
        "bounds_mm": {name: [float(c.min()), float(c.max())] for name, c in zip("xyz", points.T, strict=True)},
        "largest_turn_deg": made.largest_turn_deg,
        "out": str(options.out),
        "not_checked": list(UNCHECKED) if config is None else [],
    }
    return GeneratedProgram(made, text, answer)


REGULAR = ("raster", "spiral", "concentric")
"""Shapes whose lines have a common distance, which can be at a null of the spot's transfer function."""
RIPPLE_KEYS = ("share", "share_high", "radius_error")


def _with_pitch(options: MakeOptions, config: CellConfig | None) -> tuple[MakeOptions, QuietPitch | None]:
    """The options with a line distance: the given one, RASTER_MM, or that with the least ripple in the cell.

    Without a budget it may cost MORE_PATH times the path of lines RASTER_MM apart. With one, the path at its feed lasts
    at most that long: its time is in inverse proportion to the distance.
    """
    budget_s = options.time_budget_s
    if budget_s is not None and options.shape not in REGULAR:
        raise typer.BadParameter(
            f"--time-budget goes with {', '.join(REGULAR)}, not with {options.shape}. Give --pitch"
        )
    if budget_s is not None and (config is None or options.pitch_mm is not None):
        raise typer.BadParameter("--time-budget chooses the line distance: give it with --cell, without --pitch")
    if options.pitch_mm is not None:
        return options, None
    if config is None or options.shape not in REGULAR:
        return replace(options, pitch_mm=RASTER_MM), None
    find = partial(quiet_lines, config, shape=options.shape, direction_deg=options.direction_deg)
    if budget_s is None:
        quiet = find(RASTER_MM)
        return replace(options, pitch_mm=quiet.pitch_mm), quiet
    if not 0 < budget_s < np.inf:
        raise typer.BadParameter(f"--time-budget {budget_s:g}: must be above 0")
    least_mm = RASTER_MM * _path_s(replace(options, pitch_mm=RASTER_MM), config) / budget_s
    for _ in range(BUDGET_ROUNDS):  # turns and landings are no part of the proportion
        least_mm = max(least_mm, LEAST_PITCH_MM)
        at_most_mm = max(RASTER_MM, MORE_PATH * least_mm)
        quiet = find(at_most_mm, more_path=at_most_mm / least_mm)
        found = replace(options, pitch_mm=quiet.pitch_mm)
        over = _path_s(found, config) / budget_s
        if over <= 1.0:
            return found, quiet
        least_mm = 1.001 * quiet.pitch_mm * over
    raise typer.BadParameter(f"--time-budget {budget_s:g}: no path with this --step and --feed is that short")


BUDGET_ROUNDS = 8
LEAST_PITCH_MM = 0.1
"""However much time there is."""


def _path_s(options: MakeOptions, config: CellConfig) -> float:
    """Seconds of the path with these options."""
    return float(_timing(options, _encoding(options), make_path(options, config).length_mm)[1].sum())


def dialect_of(config: CellConfig) -> str:
    """The cell's dialect: a shipped name, or the path of its profile."""
    own = {dialect_named(path).name: str(path) for path in config.dialect_paths}
    return own.get(config.program.format, config.program.format)


def _encoding(options: MakeOptions) -> Encoding:
    """Encoding of the time; BadParameter for invalid times."""
    for name, value in (("--feed", options.feed_mm_min), ("--dwell", options.dwell_s)):
        if value is not None and not 0 < value < np.inf:
            raise typer.BadParameter(f"{name} {value:g}: must be above 0")
    encoding = "dwell" if options.encoding == "wait" else options.encoding
    if encoding == "dwell" and options.dwell_s is None:
        raise typer.BadParameter(f"--encoding {options.encoding} needs --dwell: how long at each point")
    return encoding or ("feed" if options.dwell_s is None else "dwell")


def _require_target(options: MakeOptions) -> None:
    """ProgramError or ConfigError where the program or its picture may not be written."""
    kind, _, rest = (options.aperture or "").partition(":")
    aperture = rest if kind in ("mask", "polygon") else ""
    sources = (options.cell, aperture, options.removal)
    require_new_target(options.out, *(Path(read_from) for read_from in sources if read_from))
    if options.picture is not None and options.picture.absolute() == options.out.absolute():
        raise ConfigError(f"{options.out}: is named by --out and --picture; name two files")
    require_new_file(options.out, force=options.force)


def _write(options: MakeOptions, made: GeneratedPath, text: bytes) -> None:
    with target_file(options.out) as file:  # it gets its name when the picture is written
        file.write(text)
        if options.picture is not None:
            normals = unit_normals(made.optic, made.points_mm[:, :2])
            save_picture(
                options.picture, path_picture(made.points_mm, normals, made.aperture, _title(options)), "--picture"
            )


def make_path(options: MakeOptions, config: CellConfig | None) -> GeneratedPath:
    """Points on the optic and tool axes, in the part's frame. ComputeError where there are none."""
    aperture, optic = _aperture(options, config), _optic(options, config)
    common: dict[str, Any] = {
        "pitch_mm": RASTER_MM if options.pitch_mm is None else options.pitch_mm,
        "step_mm": options.step_mm,
        "optic": optic,
        "overrun_mm": options.overrun_mm,
        "landing_mm": options.landing_mm,
    }
    _require_shape(options)
    _require_wider(config, aperture)
    if options.shape == "raster":
        lines: dict[str, Any] = {"direction_deg": options.direction_deg, "phase": options.phase}
        if options.cross_deg is None:
            points = raster(aperture, **common, **lines)
        else:
            points = crossed_raster(aperture, **common, **lines, cross_deg=options.cross_deg)
    elif options.shape in ("spiral", "concentric"):
        turns: dict[str, Any] = {"inwards": options.inwards, "rings": options.shape == "concentric"}
        points = spiral(aperture, **common, **turns, phase=options.phase)
    else:
        bends: dict[str, Any] = {
            "direction_deg": options.direction_deg,
            "min_radius_mm": _radius_mm(options, config),
        }
        density = _density(options, aperture)
        if options.shape == "random":
            points = random_raster(aperture, **common, **bends, seed=options.seed, density=density)
        elif density is None:
            raise typer.BadParameter("adaptive needs --removal: a map of what is to be removed")
        else:
            points = adaptive_raster(aperture, density=density, **common, **bends)
    dip_deg = options.dip_deg if options.dip_deg is not None else (config.process.dip_deg if config else 0.0)
    placement, lean = (UPRIGHT, None) if config is None else (config.placement(), config.compliance_options())
    if lean is None or options.azimuth_deg is not None:
        lean = ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=options.azimuth_deg or 0.0)
    axis = tool_axes(points, optic, dip_deg, lean, placement)
    return GeneratedPath(aperture, optic, points, axis, largest_turn_deg(axis, options.turn_limit_deg))


ONLY_FOR: Mapping[str, tuple[str, ...]] = {
    "direction_deg": ("raster", "random", "adaptive"),
    "cross_deg": ("raster",),
    "phase": ("raster", "spiral", "concentric"),
    "seed": ("random",),
    "radius_mm": ("random", "adaptive"),
    "removal": ("random", "adaptive"),
    "inwards": ("spiral", "concentric"),
}
"""Shapes that an option goes with."""


def _require_shape(options: MakeOptions) -> None:
    """BadParameter for an option that the shape does not use."""
    for one in fields(options):
        shapes = ONLY_FOR.get(one.name)
        if shapes is not None and options.shape not in shapes and getattr(options, one.name) != one.default:
            name = one.name.removesuffix("_deg").removesuffix("_mm")
            raise typer.BadParameter(f"--{name} goes with {', '.join(shapes)}, not with {options.shape}. Remove it")


def _require_wider(config: CellConfig | None, aperture: Aperture) -> None:
    """ComputeError where the cell's spot is wider than the part: a path could not correct it."""
    if config is None or config.process.removal_model != "hertz_preston":
        return
    try:
        spot_mm = contact_radius_mm(config)
    except ComputeError:  # the robot does not reach the part's center: the cell's own check names the points
        return
    if spot_mm > aperture.radius_mm:
        raise ComputeError(
            f"the spot's radius of {spot_mm:.3g} mm is larger than the part's, {aperture.radius_mm:.3g} mm. "
            "Use a smaller tool, less force, or a larger --aperture"
        )


def _radius_mm(options: MakeOptions, config: CellConfig | None) -> float:
    """Smallest radius of a bent path: the machine follows it at its largest feed."""
    if options.radius_mm is not None:
        return options.radius_mm
    return MIN_RADIUS_MM if config is None else config.envelope().max_feed_mm_s ** 2 / config.envelope().accel_mm_s2


def _map_with_scale(options: MakeOptions, path: Path) -> SurfaceMap:
    """The map on square pixels; MapError where it has no lateral scale."""
    measured = resample_square(MapSource.of(options.cell).read(path))
    if measured.pitch_mm is None:
        raise MapError(
            f"{path}: has no lateral scale. Give --cell with a profile of the instrument that states it, or name a "
            "copy of the map that has one: polishd map convert MAP COPY.x3p, with --profile P.toml or --units mm,nm"
        )
    return measured


def _density(options: MakeOptions, aperture: Aperture) -> LineDensity | None:
    """Density of the lines for the map of ``--removal``: what lies above the lowest 0.5 % of its samples.

    MapError where the map is smaller than the aperture, as for a plan.
    """
    if options.removal is None:
        return None
    measured = _map_with_scale(options, options.removal)
    size_mm = np.array(measured.grid.shape[::-1]) * measured.grid.pitch_mm
    needed_mm = np.ptp(aperture.outline_mm(), axis=0)
    if (size_mm < needed_mm - measured.grid.pitch_mm).any():
        raise MapError(
            f"{options.removal}: the map is {size_mm[0]:.4g} x {size_mm[1]:.4g} mm, smaller than the aperture of "
            f"{needed_mm[0]:.4g} x {needed_mm[1]:.4g} mm. Name a map of the whole part, or check the map's pitch and "
            "--aperture"
        )
    low = float(np.quantile(measured.height_nm[measured.valid], LOWEST))
    return LineDensity.of_removal(measured.grid, measured.height_nm - low, measured.valid)


def _aperture(options: MakeOptions, config: CellConfig | None) -> Aperture:
    if options.aperture is None:
        if config is None:
            raise typer.BadParameter("name an --aperture, or a --cell that has one")
        return apertures.over_outline(config.outline())
    name, _, rest = options.aperture.partition(":")
    if name == "mask" and rest:
        measured = _map_with_scale(options, Path(rest))
        return apertures.over_mask(measured.grid, measured.valid)
    if name == "polygon" and rest:
        return apertures.over_outline(read_polygon(Path(rest)))
    count, make = SHAPES.get(name, (0, apertures.circle))
    values = _numbers("--aperture", rest)
    if not count or len(values) != count:
        raise typer.BadParameter(
            f"--aperture {options.aperture!r} is not a shape. Use circle:D, annulus:D,d, ellipse:A,B, rectangle:W,H, "
            "hexagon:W, polygon:FILE, mask:MAP"
        )
    return make(*values)


def _optic(options: MakeOptions, config: CellConfig | None) -> Optic:
    nominal = FLAT if config is None else config.optic()
    if options.optic is not None:
        name, _, rest = options.optic.partition(":")
        values = _numbers("--optic", rest)
        most = {"flat": 0, "sphere": 1, "conic": 2, "asphere": len(values)}.get(name, -1)
        if len(values) != most or (name == "asphere" and len(values) < 3):
            raise typer.BadParameter(
                f"--optic {options.optic!r} is not a surface. Use flat, sphere:R, conic:R,K, asphere:R,K,A4,A6,..."
            )
        radius, conic, *even = [*values, 0.0, 0.0][: max(len(values), 2)]
        nominal = Optic(radius if values else None, conic, tuple(even))
    return nominal if options.offset_mm is None else replace(nominal, offset_mm=options.offset_mm)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")] if text else []
    except ValueError:
        raise typer.BadParameter(f"{option}: {text!r} is no list of numbers") from None


def _timing(options: MakeOptions, encoding: Encoding, length_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Feed (n,) mm/min and time (n,) s of each move; a dwell in the feed is the time of its move."""
    feed = np.full(len(length_mm), options.feed_mm_min)
    if encoding == "dwell":
        return feed, 60 * length_mm / feed + (options.dwell_s or 0.0)
    if options.dwell_s is not None:
        feed = 60 * length_mm / options.dwell_s
    return feed, 60 * length_mm / feed


def in_program_frame(config: CellConfig | None, points: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Transform from the part's frame to that of the cell's programs."""
    if config is None:
        return points, axis
    back = Rotation.from_euler("z", -config.program.rotation_deg, degrees=True)
    return back.apply(points - np.asarray(config.program.offset_mm)), back.apply(axis)


def _require_cell_takes(config: CellConfig, hooks: Hooks, program: Program) -> None:
    """ProgramError with every reason for which the cell's `plan` or `run` would refuse the program with any map."""
    unneeded = {
        "instrument": InstrumentSection(),
        "part": config.part.model_copy(update={"form": None}),
        "touch_off": None,  # it is made like the program that this one replaces
    }
    recipe = make_recipe(config.model_copy(update=unneeded), hooks)
    found = precheck.precheck_plan(recipe, program, hooks.check_plan)
    if found:
        says = "\n".join(f"  {line}" for line in found)
        raise ProgramError(
            f"nothing was written: plan or run would refuse it in {config.path}:\n{says}\n"
            "To do: other --aperture, --landing, --dip or --azimuth, or move the part (part.origin_mm) in the cell"
        )


def _title(options: MakeOptions) -> str:
    over = options.aperture or "the cell's aperture"
    return f"{options.shape}, {over}, pitch {options.pitch_mm:.4g} mm, step {options.step_mm:g} mm"


def _table(options: MakeOptions, answer: dict[str, Any]) -> Any:
    bounds = ", ".join(f"{name} {low:.3f} to {high:.3f}" for name, (low, high) in answer["bounds_mm"].items())
    rows = [
        ("points", f"{answer['points']}, time in: {answer['encoding']}"),
        *_pitch_rows(answer),
        ("length", f"{answer['length_mm']:.1f} mm"),
        ("duration", f"{answer['duration_s']:.1f} s"),
        ("bounds", f"{bounds} mm"),
        ("largest turn of the wrist", f"{answer['largest_turn_deg']:.3g} deg in a move"),
        *(("not checked without --cell", what) for what in answer["not_checked"]),
    ]
    return key_table(f"{_title(options)} ({answer['dialect']})", rows)


def _pitch_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    """The chosen line distance with its ripple."""
    quiet = answer["ripple"]
    return [] if quiet is None else [("line distance", QuietPitch(answer["pitch_mm"], **quiet).words)]


# Width of a cell's contact, which sets the line distance of a path.


def contact_radius_mm(config: CellConfig) -> float:
    """Radius of the contact at the part's center."""
    process = config.tool_process()
    depth = contact_at_center(config).depth_ratio * contact.hertz_depth_mm(process)
    return float(contact.contact_radius_mm(process, np.array(depth)))


SPIRAL_LINES = 8
"""Directions over half a turn in which the lines of a spiral are looked at."""


def quiet_lines(
    config: CellConfig,
    at_most_mm: float,
    *,
    shape: str = "raster",
    direction_deg: float = 0.0,
    more_path: float = MORE_PATH,
) -> QuietPitch:
    """Find the line distance with the least ripple of the cell's modeled spot, 95 % value (`quiet_pitch`).

    ``direction_deg``: of a raster's lines, from the part's x. ``more_path``: path over that of the largest distance.
    """
    own = contact_at_center(config)
    across = [np.radians(direction_deg) + np.pi / 2]
    if shape != "raster":
        across = list(np.arange(SPIRAL_LINES) * np.pi / SPIRAL_LINES)
    contacts = [replace(own, across_rad=float(one)) for one in across]
    spot, error = HertzSpot(config.tool_process()), config.ripple.radius_error
    return quiet_pitch(spot, contacts, at_most_mm, radius_error=error, more_path=more_path)


def contact_at_center(config: CellConfig) -> ContactAt:
    """The contact at the part's center."""
    centre, process, placement = np.zeros((1, 3)), config.tool_process(), config.placement()
    options, optic = config.compliance_options(), config.optic()
    axes = tool_axes(centre, optic, config.process.dip_deg, options, placement)
    found = compliance_at(
        centre,
        axes,
        process,
        config.robot_model(),
        placement,
        options=options,
        optic=optic,
    )
    depth = contact.hertz_depth_mm(process)
    gamma = depth_ratio(found.compliance_mm_per_n, process, depth)
    return ContactAt(float(gamma[0]), float(np.arctan2(axes[0, 1], axes[0, 0])))


# A raster for a cell: slightly larger than its part, without ripple for its spot, with the cell's dip.

RASTER_MM = 1.0
"""Block length and largest line distance: the step without ripple is slightly less."""
OVERRUN_MM = 1.0
"""Overrun of the raster beyond the part: its turns, with the stops of the machine, lie on the ring around it."""
LANDING_MM = 6.0
"""Distance of the landing points from the part, on the ring that the part sits in."""
FEED_MM_MIN = 900.0


def own_program(config: CellConfig, name: str) -> bytes:
    """The raster as RNC text, timed by feeds."""
    return path_program(*own_path(config), FEED_MM_MIN, name)


def own_path(config: CellConfig, dwells_mm: float | None = None) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points of the raster, mm, and tool axes.

    ``dwells_mm``: largest distance of points with dwells, so that they leave no ripple along the lines.
    """
    covered = over_outline(config.outline()).larger(OVERRUN_MM)
    step = quiet_lines(config, dwells_mm or RASTER_MM).pitch_mm
    along = step if dwells_mm else RASTER_MM
    points = raster(covered, step, along, optic=config.optic(), landing_mm=LANDING_MM - OVERRUN_MM)
    axes = tool_axes(points, config.optic(), config.process.dip_deg, config.compliance_options(), config.placement())
    return points, axes
