"""The tool on the part: contact position, depth and removal.

The plant has a separate removal law: Hertz's contact and Preston's equation with the true values at each moment.
Units: mm, N, MPa, s, rad; removal in nm. Deflection of the robot, and the depth lost by it: `giving`.

Speeds are signed: positive turns counterclockwise, seen from above the part. Pressure times sliding speed is the same
in both directions, as the feed is far below the spin and omitted. A reversed spindle slides the other way, which
mirrors a spot across the plane of its normal and axis: ``skew``, friction's drag and a measured spot change sides. The
viscous shift of the pressure (paper eq. 29, 1 um), which changes sides too, is omitted here.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import ndimage
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from polishd.config.simulator import SimConfig
from polishd.config.simulator_physics import CLOSEST
from polishd.model.process import (
    HybridRobot,
    MeasuredCompliance,
    MeasuredTif,
    Projection,
    RobotModel,
    SerialRobot,
    ToolProcess,
)
from polishd.model.surface import FloatArray, Grid
from polishd.sim_backends.common.hidden_truth import Frames
from polishd.sim_backends.common.mechanics import tip_gives_mm_per_n
from polishd.sim_backends.plant.effects import PlantEffects
from polishd.sim_backends.plant.part import Local, TruePart

CHUNK = 192
"""Steps worn at once: enough to hide Python's overhead between two arrays, and few enough for the cache."""
NODES, WEIGHTS = (0.5 + 0.5 * np.polynomial.legendre.leggauss(3)[0], 0.5 * np.polynomial.legendre.leggauss(3)[1])
"""Of lines through a cell: with three a cell is right to 0.4 % of the peak, at its rim."""


def plane_strain_modulus_mpa(tool: ToolProcess) -> float:
    """E* of the pair."""
    soft = (1.0 - tool.tool_poisson**2) / tool.tool_modulus_mpa
    hard = (1.0 - tool.part_poisson**2) / tool.part_modulus_mpa
    return 1.0 / (soft + hard)


def contact_radius_mm(tool: ToolProcess, curvature_per_mm: FloatArray) -> FloatArray:
    """(n,) radius of the sphere that presses on a flat as the bonnet does on a part so curved, positive where concave.

    For two different curvatures the mean is taken: the contact is an ellipse of nearly that area.
    """
    own = 1.0 / tool.tool_radius_mm
    return np.asarray(1.0 / (own - np.minimum(curvature_per_mm, CLOSEST * own)))


def hertz_depth_mm(tool: ToolProcess, force_n: FloatArray, radius_mm: FloatArray | None = None) -> FloatArray:
    """Indentation of the bonnet under a force, (n,); ``radius_mm`` (n,) of the contact; omitted: on a flat."""
    radius = tool.tool_radius_mm if radius_mm is None else radius_mm
    stiff = 4.0 / 3.0 * plane_strain_modulus_mpa(tool) * np.sqrt(radius)
    return np.asarray((np.maximum(force_n, 0.0) / stiff) ** (2.0 / 3.0))


def worn_depth_mm(
    tool: ToolProcess,
    force_n: FloatArray,
    axis: FloatArray,
    compliance: FloatArray,
    radius_mm: FloatArray | None = None,
) -> FloatArray:
    """Depth that is left after the robot's deflection: gamma d, gamma = 1 - c F / (d cos(dip)), (n,); 0 at worst.

    ``axis`` (n, 3) in a frame whose z is the surface normal.
    """
    cosine = np.maximum(axis[:, 2], 1e-3)
    depth = hertz_depth_mm(tool, force_n if tool.normal_force == "axial" else force_n / cosine, radius_mm)
    lost = compliance * force_n / cosine
    return np.asarray(np.maximum(depth - lost, 0.0))


def wear(
    surface_nm: FloatArray,
    grid: Grid,
    tool: ToolProcess,
    *,
    centre_mm: FloatArray,
    axis: FloatArray,
    depth_mm: FloatArray,
    rpm: FloatArray,
    seconds: FloatArray,
    radius_mm: FloatArray | None = None,
    stretch: FloatArray | None = None,
    skew: float = 0.0,
) -> None:
    """Take material off ``surface_nm`` in place: n contacts at ``centre_mm`` (n, 2) for ``seconds`` (n,) each.

    ``seconds`` contains the rate factor too. ``rpm`` is signed. ``radius_mm`` (n,) is that of the contact, and
    ``stretch`` (n, 2, 2) turns offsets in x and y into those along the surface, the frame of ``axis``; omitted: as on a
    flat. ``skew`` is the relative excess of removal at the rim towards which the bonnet slides. Cell averages, by three
    lines through each cell.
    """
    n = len(centre_mm)
    radius = np.full(n, tool.tool_radius_mm) if radius_mm is None else radius_mm
    along = np.tile(np.eye(2), (n, 1, 1)) if stretch is None else stretch
    active = (depth_mm > 0.0) & (seconds > 0.0) & (rpm != 0.0)
    index = np.flatnonzero(active)
    for start in range(0, len(index), CHUNK):
        take = index[start : start + CHUNK]
        _wear_chunk(
            surface_nm,
            grid,
            tool,
            centre_mm=centre_mm[take],
            axis=axis[take],
            depth_mm=depth_mm[take],
            turns=rpm[take] * seconds[take],
            radius_mm=radius[take],
            stretch=along[take],
            skew=skew,
        )


def _wear_chunk(
    surface_nm: FloatArray,
    grid: Grid,
    tool: ToolProcess,
    *,
    centre_mm: FloatArray,
    axis: FloatArray,
    depth_mm: FloatArray,
    turns: FloatArray,
    radius_mm: FloatArray,
    stretch: FloatArray,
    skew: float,
) -> None:
    pitch = grid.pitch_mm
    reach = math.sqrt(float((radius_mm * depth_mm).max())) / pitch
    cells = math.floor(2.0 * reach) + 2  # that a length of twice the reach can touch
    first_col = np.floor((centre_mm[:, 0] - grid.x_mm[0]) / pitch - reach + 0.5).astype(np.int64)
    first_row = np.floor((grid.y_mm[0] - centre_mm[:, 1]) / pitch - reach + 0.5).astype(np.int64)
    edges = (np.arange(cells + 1) - 0.5) * pitch
    x = (grid.x_mm[0] + first_col * pitch - centre_mm[:, 0])[:, None] + edges
    y = (grid.y_mm[0] - first_row * pitch - centre_mm[:, 1])[:, None] - edges
    ellipse = _Ellipse.of(tool, depth_mm, radius_mm, stretch)
    # lines that end where the contact does: across its rim the rate is no polynomial
    inside_y = np.clip(y, -ellipse.top_mm, ellipse.top_mm)
    high = np.maximum(inside_y[:, :-1] - inside_y[:, 1:], 0.0)
    lines = inside_y[:, 1:, None] + high[:, :, None] * NODES
    skewed = skew * sliding(axis, turns) / np.sqrt(radius_mm * depth_mm)[:, None]
    rate = _rate(
        x, lines.reshape(len(x), -1), ellipse, axis=axis, down_mm=depth_mm - tool.tool_radius_mm, skewed=skewed
    )
    # preston cm^2/N = 100 mm^2/N; 1e6 nm/mm; rpm * s = 60 turns, one turn = 2 pi rad
    turned = (tool.preston_cm2_per_n * 100.0 * 1e6 * math.tau / 60.0 / pitch**2) * np.abs(turns)[:, None, None]
    mean = np.einsum("nrjc,nrj->nrc", rate.reshape(*lines.shape, cells), high[:, :, None] * turned * WEIGHTS)
    rows = (first_row[:, None] + np.arange(cells))[:, :, None]
    cols = (first_col[:, None] + np.arange(cells))[:, None, :]
    inside = (rows >= 0) & (rows < grid.ny) & (cols >= 0) & (cols < grid.nx)
    flat = np.where(inside, rows * grid.nx + cols, 0)
    np.subtract.at(surface_nm.reshape(-1), flat.ravel(), np.where(inside, mean, 0.0).ravel())


@dataclass(frozen=True, slots=True)
class _Ellipse:
    """n contacts seen along the part's z; each (n, 1), or (n, 1, 1) where lines cross it."""

    peak_mpa: FloatArray
    """Half of the pressure at its center."""
    stretch: tuple[FloatArray, ...]
    """(ux, uy, vx, vy): along the surface is ``(ux x + uy y, vx x + vy y)``."""
    across: FloatArray
    """``1 - pressure^2`` is ``across (x + shear y)^2 + (y / top)^2``."""
    shear: FloatArray
    top_mm: FloatArray
    """Its largest y."""

    @classmethod
    def of(cls, tool: ToolProcess, depth_mm: FloatArray, radius_mm: FloatArray, stretch: FloatArray) -> _Ellipse:
        """``stretch`` (n, 2, 2)."""
        ux, uy, vx, vy = (stretch[:, i, j, None, None] for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)))
        square = (radius_mm * depth_mm)[:, None, None]
        across = (ux**2 + vx**2) / square
        shear = (ux * uy + vx * vy) / square / across
        top = 1.0 / np.sqrt((uy**2 + vy**2) / square - across * shear**2)
        peak = plane_strain_modulus_mpa(tool) / math.pi * np.sqrt(depth_mm / radius_mm)
        return cls(peak[:, None, None], (ux, uy, vx, vy), across, shear, top[:, :, 0])


def _rate(
    x: FloatArray, y: FloatArray, ellipse: _Ellipse, *, axis: FloatArray, down_mm: FloatArray, skewed: FloatArray
) -> FloatArray:
    """Pressure times sliding speed for an angular speed of 1 between neighbors of x, MPa mm^2, (n, lines, x - 1).

    ``x`` (n, x) and ``y`` (n, lines) are offsets from the contact, ``down_mm`` (n,) the height of its center over the
    bonnet's own, ``skewed`` (n, 2) the growth of the rate along them. The pressure is integrated exactly along each
    line; the speed is taken at the center of pressure. A pass spends nearly all its time here, in few array operations.
    """
    line = y[:, :, None]
    chord = np.maximum(1.0 - (line / ellipse.top_mm[:, :, None]) ** 2, 1e-12)
    half = np.sqrt(chord / ellipse.across)
    moved = ellipse.shear * line
    share = x[:, None, :] / half
    share += moved / half
    np.clip(share, -1.0, 1.0, out=share)
    left = 1.0 - share * share
    root = np.sqrt(left)
    left *= root
    root *= share
    root += np.arcsin(share)
    pressure = root[:, :, 1:] - root[:, :, :-1]
    middle = left[:, :, :-1] - left[:, :, 1:]
    middle /= np.maximum(pressure, 1e-300)
    middle *= half * (2.0 / 3.0)
    middle -= moved
    (ux, uy, vx, vy), down = ellipse.stretch, down_mm[:, None, None]
    a, b, c = (axis[:, k, None, None] for k in range(3))
    # sliding, of the part's turned frame, is (x0 + x1 middle, y0 + y1 middle)
    x0, x1, y0, y1 = b * down - c * vy * line, -c * vx, c * uy * line - a * down, c * ux
    square = (x1**2 + y1**2) * middle
    square += 2.0 * (x0 * x1 + y0 * y1)
    square *= middle
    square += x0**2 + y0**2
    pressure *= np.sqrt(np.maximum(square, 0.0, out=square), out=square)
    pressure *= chord / np.sqrt(ellipse.across) * ellipse.peak_mpa
    if skewed.any():
        u, v = ux * middle + uy * line, vx * middle + vy * line
        pressure *= 1.0 + skewed[:, 0:1, None] * u + skewed[:, 1:2, None] * v
    return pressure


def sliding(axis: FloatArray, speed: FloatArray) -> FloatArray:
    """(n, 2) unit directions in which the bonnet slides at the center of its contact; 0 where its axis is the normal.

    ``axis`` (n, 3) where the normal is z. Only the sign of ``speed`` (n,) matters: positive turns counterclockwise,
    seen from above.
    """
    lean = np.hypot(axis[:, 0], axis[:, 1])[:, None]
    way = np.sign(speed)[:, None] * np.column_stack([-axis[:, 1], axis[:, 0]])
    return np.asarray(np.divide(way, lean, out=np.zeros((len(axis), 2)), where=lean > 0.0))


# A measured spot, as the plant removes with it: turned with the spindle, scaled as Hertz's contact is.

TOGETHER_MM = 0.1
"""Contacts nearer to each other than this are one: a map resolves no less."""
FINE_MM = 1.0 / 6.0
"""Largest distance between the points of a cell's mean; at least two of them along each of its sides."""


@dataclass(frozen=True, slots=True)
class MeasuredStamp:
    """The TIF, and the contact in which it was measured: that of ``tool`` with its force, speed and dip."""

    tif: MeasuredTif
    tool: ToolProcess
    _half_mm: float = field(init=False)
    """From its center to its farthest corner."""
    _depth_mm: float = field(init=False)
    """Contact of that measurement."""

    @property
    def reach_mm(self) -> float:
        """From its center to its farthest corner, as it was measured."""
        return self._half_mm

    def __post_init__(self) -> None:
        """Size and depth."""
        half = math.hypot(*self.tif.rate_nm_s.shape) * self.tif.pitch_mm / 2.0
        dip = 1.0 if self.tool.normal_force == "axial" else math.cos(math.radians(self.tool.dip_deg))
        rigid = hertz_depth_mm(self.tool, np.array([self.tool.force_n / dip]))
        object.__setattr__(self, "_half_mm", half)
        object.__setattr__(self, "_depth_mm", float(rigid[0]) * self.tif.depth_ratio)

    def wear(
        self,
        surface_nm: FloatArray,
        grid: Grid,
        *,
        centre_mm: FloatArray,
        axis: FloatArray,
        depth_mm: FloatArray,
        turns: FloatArray,
        stretch: FloatArray,
        skew: float = 0.0,
    ) -> None:
        """Take material off in place: n contacts, rpm times seconds in ``turns`` (n,); the rest as `removal.wear`.

        The spot was measured with ``tool.rpm``, which is positive: a reversed spindle removes with its mirror image.
        """
        active = (depth_mm > 0.0) & (turns != 0.0)
        if not active.any():
            return
        first, weight = _together(centre_mm[active], turns[active])
        shares = (_mean(values[active], first, weight) for values in (centre_mm, axis, depth_mm, stretch))
        centre_mm, axis, depth_mm, stretch = shares
        turns = np.add.reduceat(weight, first) * np.sign(turns[active][first])
        for k in range(len(first)):
            size = math.sqrt(float(depth_mm[k]) / self._depth_mm)
            reach = self._half_mm * size / grid.pitch_mm
            column = (centre_mm[k, 0] - grid.x_mm[0]) / grid.pitch_mm
            row = (grid.y_mm[0] - centre_mm[k, 1]) / grid.pitch_mm
            rows = _span(row, reach, grid.ny)
            columns = _span(column, reach, grid.nx)
            if rows.size and columns.size:
                fine = max(2, math.ceil(grid.pitch_mm / FINE_MM))
                x = _midpoints(columns - column, fine) * grid.pitch_mm
                y = _midpoints(row - rows, fine) * grid.pitch_mm
                offset = np.stack(np.meshgrid(x, y))
                along = np.einsum("ij,jyx->iyx", stretch[k], offset)
                seen = along if turns[k] > 0.0 else _mirrored(along, axis[k])
                rate = self._rate(seen / size, axis[k]) * size
                if skew:
                    rim = math.sqrt(self.tool.tool_radius_mm * float(depth_mm[k]))
                    way = sliding(axis[k : k + 1], turns[k : k + 1])[0]
                    rate *= 1.0 + skew * np.einsum("i,iyx->yx", way, along) / rim
                mean = rate.reshape(rows.size, fine, columns.size, fine).mean(axis=(1, 3))
                surface_nm[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] -= mean * (
                    abs(float(turns[k])) / self.tool.rpm
                )

    def _rate(self, offset_mm: FloatArray, axis: FloatArray) -> FloatArray:
        """nm/s at offsets (2, ny, nx) along the surface, for a spindle with that ``axis`` (3,)."""
        turn = math.atan2(axis[1], axis[0]) - math.radians(self.tif.azimuth_deg) if self.tif.rotates else 0.0
        x = math.cos(turn) * offset_mm[0] + math.sin(turn) * offset_mm[1]
        y = math.cos(turn) * offset_mm[1] - math.sin(turn) * offset_mm[0]
        ny, nx = self.tif.rate_nm_s.shape
        at = np.stack([(ny - 1) / 2.0 - y / self.tif.pitch_mm, (nx - 1) / 2.0 + x / self.tif.pitch_mm])
        return np.asarray(ndimage.map_coordinates(self.tif.rate_nm_s, at, order=1, mode="constant"))


def _mirrored(offset_mm: FloatArray, axis: FloatArray) -> FloatArray:
    """Mirror offsets (2, ny, nx) across the lean of an axis (3,); unchanged for an axis without lean."""
    lean = math.hypot(axis[0], axis[1])
    if lean == 0.0:
        return offset_mm
    x, y = axis[0] / lean, axis[1] / lean
    return np.asarray(2.0 * np.multiply.outer([x, y], x * offset_mm[0] + y * offset_mm[1]) - offset_mm)


def _together(centre_mm: FloatArray, turns: FloatArray) -> tuple[np.ndarray, FloatArray]:
    """Start of each group of successive contacts within `TOGETHER_MM`, and the weight of each contact (n,).

    All contacts of a group turn the same way.
    """
    apart = np.hypot(*np.diff(centre_mm, axis=0).T) + TOGETHER_MM * (np.diff(np.sign(turns)) != 0.0)
    way = np.concatenate([[0.0], np.cumsum(apart)])
    return np.unique(np.floor(way / TOGETHER_MM), return_index=True)[1], np.abs(turns)


def _mean(values: FloatArray, first: np.ndarray, weight: FloatArray) -> FloatArray:
    """(groups, ...) weighted means of (n, ...)."""
    wide = weight.reshape(-1, *[1] * (values.ndim - 1))
    total = np.add.reduceat(weight, first).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values * wide, first, axis=0) / total)


def _span(middle: float, reach: float, count: int) -> np.ndarray:
    """Cells of an axis that a spot there touches."""
    return np.arange(max(math.floor(middle - reach), 0), min(math.ceil(middle + reach), count - 1) + 1)


def _midpoints(cells: FloatArray, fine: int) -> FloatArray:
    """(n fine,) of n cells, in cells, in the cells' own direction."""
    step = np.sign(cells[-1] - cells[0]) if len(cells) > 1 else 1.0
    return np.asarray((cells[:, None] + step * ((np.arange(fine) + 0.5) / fine - 0.5)).ravel())


# Deflection of the robot under the tool: its own mechanics, or a table of measured values.

THIN_MM = 1.0
"""A table that is not thicker than this in one direction has no extent there."""


@dataclass(frozen=True, slots=True)
class TipDeflection:
    """Deflection of the tip at n points, mm/N; 0 out of reach."""

    along: FloatArray
    """(n,) equivalent, along the normal."""
    matrix: FloatArray
    """(n, 3, 3) base frame; 0 where only the other value was measured."""


Giving = Callable[[FloatArray, FloatArray, FloatArray], TipDeflection]
"""Tips (n, 3) mm, tool axes (n, 3) and normals (n, 3), base frame."""


def giving(robot: RobotModel, projection: Projection) -> Giving:
    """Return it for that robot. A table without a value uses the nearest point; a model out of reach gives 0."""
    if isinstance(robot, MeasuredCompliance):
        table = _by_table(robot)
        return lambda tip, _axis, _normal: TipDeflection(table(tip), np.zeros((len(tip), 3, 3)))
    return lambda tip, axis, normal: given_way(robot, tip, axis, normal, projection)


def given_way(
    robot: HybridRobot | SerialRobot,
    tip_mm: FloatArray,
    axis: FloatArray,
    normal: FloatArray,
    projection: Projection = "linear",
) -> TipDeflection:
    """Return it for a robot with mechanics. Along the surface normal it is the equivalent compliance of paper eq. 43.

    ``tip_mm``, ``axis`` (n, 3) and ``normal`` (3,) or (n, 3) in the base frame. The eigenvector nearest the tool axis
    is omitted: the voice coil gives way along it. Only ``normal`` includes it, as a loading test along the normal does.
    """
    can, matrix = tip_gives_mm_per_n(robot, tip_mm, axis)
    normal = np.broadcast_to(normal, tip_mm.shape)
    if projection == "normal":
        return TipDeflection(np.einsum("ni,nij,nj->n", normal, matrix, normal, optimize=True), matrix)
    values, vectors = np.linalg.eigh(matrix)
    nearest = np.argmax(np.abs(np.einsum("nik,ni->nk", vectors, axis)), axis=1)
    shown = np.abs(np.einsum("nik,ni->nk", vectors, normal))
    share = values * (shown if projection == "linear" else shown**2)
    share[np.arange(len(share)), nearest] = 0.0
    return TipDeflection(np.where(can, share.sum(axis=1), 0.0), matrix)


def _by_table(table: MeasuredCompliance) -> Callable[[FloatArray], FloatArray]:
    """Interpolate linearly between the points, in as many dimensions as they extend; beyond them take the nearest."""
    centre = table.tip_mm.mean(axis=0)
    directions = np.linalg.svd(table.tip_mm - centre, full_matrices=False)[2]
    along = directions[np.ptp((table.tip_mm - centre) @ directions.T, axis=0) > THIN_MM]
    place, value = (table.tip_mm - centre) @ along.T, table.compliance_um_per_n * 1e-3
    nearest = NearestNDInterpolator(place, value)
    if len(along) == 1:
        order = np.argsort(place[:, 0])
        return lambda tip: np.interp((tip - centre) @ along[0], place[order, 0], value[order])
    between = LinearNDInterpolator(place, value)

    def at(tip: FloatArray) -> FloatArray:
        where = (tip - centre) @ along.T
        found = between(where)
        return np.asarray(np.where(np.isnan(found), nearest(where), found))

    return at


GOLDEN = math.pi * (3.0 - math.sqrt(5.0))


@dataclass(frozen=True, slots=True)
class ContactPoints:
    """n points at which the tool touches the part, in its frame."""

    place_mm: FloatArray
    """(n, 3) the tool's tip."""
    axis: FloatArray
    """(n, 3) from the tip into the spindle."""
    local: Local


@dataclass(frozen=True, slots=True)
class Tool:
    """A bonnet on its robot."""

    process: ToolProcess
    giving: Giving
    stamp: MeasuredStamp | None
    """Its measured removal, where there is one."""
    effects: PlantEffects = field(default_factory=PlantEffects)

    @classmethod
    def of(cls, config: SimConfig, robot: RobotModel, effects: PlantEffects) -> Tool:
        """Build the tool of SIM.toml on the true robot; ConfigError where its TIF cannot be read."""
        process, tif = config.process.tool(), config.measured_tif()
        stamp = None if tif is None else MeasuredStamp(tif, process)
        inflated = replace(process, tool_modulus_mpa=process.tool_modulus_mpa * effects.bonnet)
        return cls(inflated, giving(robot, config.process.projection), stamp, effects)

    def wear(
        self,
        part: TruePart,
        touches: ContactPoints,
        frames: Frames,
        *,
        force_n: FloatArray,
        rpm: FloatArray,
        seconds: FloatArray,
    ) -> None:
        """Take material off the part, in place; ``seconds`` (n,) contain the rate factor; ``rpm`` (n,) is signed."""
        local, off = touches.local, self.effects
        tips, axes = frames.in_base(touches.place_mm, touches.axis)
        axis = _leaning(local.levelled(touches.axis), off.lean.at(tips))
        given = self.giving(tips, axes, local.normal @ frames.to_base.T)
        radius = contact_radius_mm(self.process, local.curvature_per_mm)
        depth = worn_depth_mm(self.process, force_n, axis, given.along * (off.compliance * off.eq_44), radius)
        turned = _turn(-math.radians(off.turn_deg)) @ local.stretch
        centre = touches.place_mm[:, :2] + off.robot.at(tips) + _circling(len(tips)) * off.vibration_mm
        centre = centre + self._offset_mm(axis, turned) - np.array(off.seat_mm)
        if off.friction:
            dragged = self._dragged_mm(given.matrix, ContactPoints(touches.place_mm, axis, local), frames, force_n, rpm)
            centre = centre + np.linalg.solve(local.stretch, dragged[:, :2, None])[:, :, 0]
            depth = np.maximum(depth - off.eq_44 * dragged[:, 2], 0.0)
        at = {"axis": axis, "depth_mm": depth, "stretch": turned, "rpm": rpm, "seconds": seconds, "radius_mm": radius}
        self._wear(part.height_nm, part.grid, centre, at)
        if part.patch is not None:
            seen = centre - part.patch.centre_mm
            largest_mm = math.sqrt(float((radius * depth).max(initial=0.0)))
            reach = 2.0 * (largest_mm if self.stamp is None else self.stamp.reach_mm)
            near = (np.abs(seen) < reach + part.patch.grid.pitch_mm * part.patch.grid.nx / 2).all(axis=1)
            if near.any():
                self._wear(part.patch.height_nm, part.patch.grid, seen[near], {key: of[near] for key, of in at.items()})

    def _wear(self, height_nm: FloatArray, grid: Grid, centre_mm: FloatArray, at: dict[str, FloatArray]) -> None:
        """Take the removal of n contacts off a surface, in place, by the measured removal where there is one."""
        off, shared = (
            self.effects,
            {"centre_mm": centre_mm, **{key: at[key] for key in ("axis", "depth_mm", "stretch")}},
        )
        if self.stamp is not None:
            turns = at["rpm"] * at["seconds"] * off.bonnet
            self.stamp.wear(height_nm, grid, turns=turns, skew=off.skew, **shared)
        else:
            more = {key: at[key] for key in ("rpm", "seconds", "radius_mm")}
            wear(height_nm, grid, self.process, skew=off.skew, **more, **shared)

    def stiffness_n_per_mm(self, force_n: FloatArray, curvature_per_mm: FloatArray) -> FloatArray:
        """(n,) of the contact under forces (n,) on a part so curved: Hertz's dF/dd, 1.5 F over the depth."""
        depth = hertz_depth_mm(self.process, force_n, contact_radius_mm(self.process, curvature_per_mm))
        return np.asarray(1.5 * force_n / np.maximum(depth, 1e-9))

    def _dragged_mm(
        self, matrix: FloatArray, at: ContactPoints, frames: Frames, force_n: FloatArray, rpm: FloatArray
    ) -> FloatArray:
        """(n, 3) pull of friction on the tip along the surface and off it, where the normal is z.

        It acts against the sliding direction of the bonnet, and grows with the normal force. The sideways motion by the
        normal force itself is the same everywhere, and the tool setup removes it. ``at.axis`` is levelled.
        """
        against = at.local.raised(-sliding(at.axis, rpm)) @ frames.to_base.T
        pull_n = self.effects.friction * self.effects.compliance * force_n / np.maximum(at.axis[:, 2], 1e-3)
        moved = np.einsum("nij,nj->ni", matrix, against) * pull_n[:, None]
        return at.local.levelled(moved @ frames.to_base)

    def _offset_mm(self, axis: FloatArray, turned: FloatArray) -> FloatArray:
        """(n, 2) from the tool's tip to the spot's centre, in the part's x and y; ``turned`` (n, 2, 2) as stretch."""
        off = self.effects
        on_tool = (0.0, 0.0) if off.spot_on_part else off.spot_mm
        across, along = np.add(self.process.spot_offset_mm, on_tool)
        lean = axis[:, :2] / np.maximum(np.hypot(axis[:, 0], axis[:, 1]), 1e-12)[:, None]
        offset = across * np.column_stack([lean[:, 1], -lean[:, 0]]) + along * lean
        on_part = np.array(off.spot_mm if off.spot_on_part else (0.0, 0.0))
        return np.asarray(np.linalg.solve(turned, offset[:, :, None])[:, :, 0] + on_part)


def _leaning(axis: FloatArray, by: FloatArray) -> FloatArray:
    """(n, 3) axes, more (n, 2) radians to x and y."""
    if not by.any():
        return axis
    leaning = axis.copy()
    leaning[:, :2] += by
    return np.asarray(leaning / np.linalg.norm(leaning, axis=1)[:, None])


def _turn(radians: float) -> FloatArray:
    c, s = math.cos(radians), math.sin(radians)
    return np.array([[c, -s], [s, c]])


def _circling(count: int) -> FloatArray:
    """(n, 2) points of the unit circle, evenly all round: of a tip much faster than the path."""
    angle = GOLDEN * np.arange(count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


# The true force behind the actuator's: a damped coil on a springy contact; the part may go and come back.

TOGETHER_S = 1e-3
"""Process time between contacts beyond which the tool has lifted and lands again."""


@dataclass(slots=True)
class ForceDynamics:
    """The force between tool and part, continued from contact to contact."""

    lag_s: float
    """tau, process time."""
    friction_n: float = 0.0
    """f."""
    _force_n: float = 0.0
    """Of the contact and of the friction, together."""
    _held_n: float = 0.0
    """Caused by the friction, positive where it takes from the contact."""
    _gap_mm: float = 0.0
    _middle_s: float = 0.0
    _until_s: float = -math.inf

    def lift(self) -> None:
        """The tool leaves the part: the next contact is a landing."""
        self._until_s = -math.inf

    def truly(
        self, force_n: FloatArray, *, begin_s: FloatArray, lasts_s: FloatArray, gap_mm: FloatArray, stiff: FloatArray
    ) -> FloatArray:
        """(n,) mean forces of contacts in which the coil exerts ``force_n``; 0 at least.

        ``begin_s``, ``lasts_s`` process time; ``gap_mm`` from the part out along the tool to where the robot holds it,
        in the middle of each; ``stiff`` the contact's stiffness, N/mm.
        """
        means = np.empty(len(force_n))
        columns = (force_n, begin_s, lasts_s, gap_mm, stiff)
        for row, (coil, begin, lasts, gap, k) in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
            middle = begin + lasts / 2.0
            pushed = 0.0
            if begin - self._until_s > TOGETHER_S:
                self._force_n, self._held_n = 0.0, self.friction_n  # it comes out, and is held back
            elif middle > self._middle_s:
                before, way_n = self._held_n, k * (gap - self._gap_mm)
                self._held_n = min(max(before + way_n, -self.friction_n), self.friction_n)
                pushed = self.lag_s * (self._held_n - before - way_n) / (middle - self._middle_s)
            settled = max(coil + pushed, self._held_n)  # nothing pulls
            ratio = lasts / self.lag_s if self.lag_s else math.inf
            behind = (self._force_n - settled) * -math.expm1(-ratio)
            mean = settled + (behind / ratio if ratio > 0.0 else self._force_n - settled)
            means[row] = max(mean - self._held_n, 0.0)
            self._force_n -= behind
            self._gap_mm, self._middle_s, self._until_s = gap, middle, begin + lasts
        return means
