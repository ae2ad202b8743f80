"""The removal of a pass as a function of the parameters, and its derivatives."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.process import ToolProcess
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.identification.parameters import ABERRATIONS, ExecutedBlocks, MapPixelData, Parameter
from polishd.process.metrology import zernike
from polishd.process.removal.dynamic_tif import PointLocation, effects_columns
from polishd.process.removal.tif import HertzSpot, Spot, WiderSpot, rotate_spot

# What the parameters make of blocks: where they lie, how deep they go, and how fast they remove. 0 changes nothing.

FIELD = "field_"
"""Prefix of the names of the rate's terms over the part; Noll's number follows."""
MOVING = ("offset_x", "offset_y", "shift_x", "shift_y", "turn", "rotation")
LEAST_RATIO = 0.01
"""Depth ratio below which no compliance sinks a block."""


class ParameterAction:
    """Values of parameters, by name (`parameters.usual_parameters`); one that is not named is 0."""

    def __init__(self, values: Mapping[str, float]) -> None:
        """The values, in the parameters' units."""
        self.at: Mapping[str, float] = defaultdict(float, values)

    @property
    def moves(self) -> bool:
        """Return whether any point or lean differs from the program."""
        return any(self.at[name] for name in MOVING)

    def laid(self, place_mm: FloatArray, azimuth_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 2) mm where programmed points really are, and (n,) rad where the spindle leans there."""
        at = self.at
        lean = azimuth_rad + np.radians(at["turn"] + at["rotation"])
        angle = np.radians(at["rotation"])
        rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])  # of rows
        off = rotate_spot(at["offset_x"], at["offset_y"], lean)
        return place_mm @ rotation + off + [at["shift_x"], at["shift_y"]], lean

    def sunk(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) depth ratios: ``1 - exp(compliance) (1 - gamma)``."""
        return np.asarray(np.maximum(1 - np.exp(self.at["compliance"]) * (1 - depth_ratio), LEAST_RATIO))

    def spot(self, spot: Spot) -> Spot:
        """Spot at its width."""
        return WiderSpot(spot, float(np.exp(self.at["width"]))) if self.at["width"] else spot

    def log_rate(self, depth_ratio: FloatArray, contact_h: FloatArray) -> FloatArray:
        """(n,) natural logarithm of each block's rate over the configured one, but for its place: at these ratios."""
        at = self.at
        return np.asarray(at["rate"] - at["wear"] * contact_h + at["exponent"] * np.log(depth_ratio))

    def log_field(self, place_mm: FloatArray, radius_mm: float) -> FloatArray:
        """(n,) what the place adds to that: Zernike terms over the circle of that radius about the part's origin."""
        names = [name for name, value in self.at.items() if name.startswith(FIELD) and value]
        values = np.array([self.at[name] for name in names])
        return values @ zernike_field([int(name.removeprefix(FIELD)) for name in names], place_mm / radius_mm)


def zernike_field(terms: list[int], place: FloatArray) -> FloatArray:
    """(t, n) terms of Noll's order at (n, 2) places over the radius: RMS 1 over the circle, and on beyond it."""
    if not terms:
        return np.zeros((0, len(place)))
    pairs = zernike.order("noll", max(terms))
    return zernike.values([pairs[k - 1] for k in terms], "rms", place[:, 0], place[:, 1])


STEP = 0.2
"""Of the spot's own step (half the radius of its core): how far a spot is moved to either side for its slope. That is
about a square of a spot's patch: over less than one a slope is that of the square, not of the spot."""
FINE = 64
"""Squares across a Hertz contact as it is laid. With a plan's 32 a pass of 10 nm RMS is off by 0.03 nm, which reads as
6 % of compliance and 0.5 % of width; with these by 0.005. Slopes are multiplied by little: theirs are as coarse."""
WIDTH_STEP = 0.04
GAMMA_STEP = 1e-3
TURN_STEP = float(np.radians(3.0))
"""A whole number of the steps in which a measured spot turns."""
NEAR = {"x": 0.1, "y": 0.1, "gamma": 0.005, "width": 0.01, "turn": 0.02}
"""Changes up to which the slopes are believed; along x and y in the spot's steps."""
SLOPES = ("x", "y", "gamma", "width", "turn")
"""Changes of the effect matrix: the spots moved along x and y (by mm), gamma and width (relative), azimuth (rad)."""


@dataclass(frozen=True, slots=True)
class BlockEffects:
    """The effect of the blocks at the geometry of some parameters, and how it changes with that."""

    theta: FloatArray
    """(k,)"""
    base: scipy.sparse.csr_array
    """(N, n) nm/s."""
    slopes: dict[str, scipy.sparse.csr_array]
    """Entries of `SLOPES` that the parameters need."""


@dataclass(frozen=True, slots=True)
class ForwardModel:
    """n blocks whose removal is seen at N samples; made by `forward`.

    ``removal = M(geometry) w``, ``w = seconds * exp(rate + field(place) - wear * hours + exponent * ln gamma)``, and
    what the instrument adds. M is the effect matrix of the blocks moved, turned and sunk as the parameters say.
    """

    grid: Grid
    mask: BoolArray
    spot: Spot
    parameters: tuple[Parameter, ...]
    blocks: ExecutedBlocks
    """Indices of the blocks with time."""
    weight_s: FloatArray
    """(n,)"""
    waves: FloatArray
    """(f, n) the rate's field, term by term, at the blocks."""
    maps: FloatArray
    """(N, i) what the instrument may add, term by term."""
    projection: str
    pixels: MapPixelData | None = None
    """Pixels of the maps, where a sample is a mean of them."""

    def values(self, theta: FloatArray) -> dict[str, float]:
        """By name; a parameter that is not fitted is 0."""
        return dict.fromkeys(_NAMES, 0.0) | dict(zip((p.name for p in self.parameters), theta.tolist(), strict=True))

    def gamma(self, theta: FloatArray) -> FloatArray:
        """(n,) depth ratios."""
        return ParameterAction(self.values(theta)).sunk(self.blocks.depth_ratio[self.projection])

    def moves(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the blocks under these parameters: (n, 2) mm their middles, (n,) rad the azimuths."""
        middle = (self.blocks.start_mm + self.blocks.end_mm) / 2
        return ParameterAction(self.values(theta)).laid(middle, self.blocks.azimuth_rad)

    def matrix(self, theta: FloatArray, change: str | None = None, by: float = 0.0) -> scipy.sparse.csr_array:
        """(N, n) nm/s of each block at these parameters' geometry, one thing of it changed; for slopes."""
        changed = {name: by if name == change else 0.0 for name in SLOPES}
        return self._matrices(self.spot, theta, [changed], gamma=changed["gamma"], turn=changed["turn"])[0]

    def fine_matrix(self, theta: FloatArray) -> scipy.sparse.csr_array:
        """(N, n) nm/s of each block at these parameters' geometry."""
        spot = self.spot
        if isinstance(spot, HertzSpot):
            spot = replace(spot, squares=max(FINE, spot.squares))
        return self._matrices(spot, theta)[0]

    def _matrices(
        self,
        spot: Spot,
        theta: FloatArray,
        changes: Sequence[Mapping[str, float]] = ({},),
        *,
        gamma: float = 0.0,
        turn: float = 0.0,
    ) -> list[scipy.sparse.csr_array]:
        """(N, n) nm/s of each block, by change of x, y and width: these share the spots, of one gamma and azimuth."""
        acting, blocks = ParameterAction(self.values(theta)), self.blocks
        start, azimuth = acting.laid(blocks.start_mm, blocks.azimuth_rad)
        end, _ = acting.laid(blocks.end_mm, blocks.azimuth_rad)
        grid, pixels, samples = self.grid, self.pixels, np.flatnonzero(self.mask)
        if pixels is not None:
            grid, azimuth = pixels.at.grid, azimuth + pixels.turn_rad
        width, lies = self.values(theta)["width"], []
        own = 1.0 if blocks.wider is None else blocks.wider[:, None]
        for change in changes:
            off = np.array([change.get("x", 0.0), change.get("y", 0.0)])
            ends = (start + off, end + off)
            if pixels is not None:
                ends = (pixels.laid(ends[0]), pixels.laid(ends[1]))
            lies.append(PointLocation(ends, own * float(np.exp(width + change.get("width", 0.0)))))
        ratio = self.gamma(theta) * (1 + gamma)
        found = effects_columns(grid, spot, lies, azimuth + turn, depth_ratio=ratio, factor=np.ones_like(ratio))
        if pixels is None:
            return [one[samples] for one in found]
        means = pixels.means[samples]
        return [scipy.sparse.csr_array(means @ one) for one in found]

    def lay(self, theta: FloatArray, slopes: dict[str, scipy.sparse.csr_array] | None = None) -> BlockEffects:
        """The effect at these parameters' geometry; with slopes from one near it, or its own by differences."""
        return BlockEffects(theta, self.fine_matrix(theta), self._slopes(theta) if slopes is None else slopes)

    def _slopes(self, theta: FloatArray) -> dict[str, scipy.sparse.csr_array]:
        names = {p.name for p in self.parameters}
        step_mm = STEP * self.step_mm(theta)
        both = {
            kind: by for kind, by in (("x", step_mm), ("y", step_mm), ("width", WIDTH_STEP)) if names & _ASKED[kind]
        }
        sides = [{kind: way * by} for kind, by in both.items() for way in (1, -1)]
        at, *moved = self._matrices(self.spot, theta, [{}, *sides])
        slopes = {
            kind: scipy.sparse.csr_array((moved[2 * k] - moved[2 * k + 1]) / (2 * by))
            for k, (kind, by) in enumerate(both.items())
        }
        for kind, by in (("gamma", GAMMA_STEP), ("turn", TURN_STEP)):
            if names & _ASKED[kind]:  # to one side: they bend little, and other spots are what takes time
                slopes[kind] = scipy.sparse.csr_array((self.matrix(theta, kind, by) - at) / by)
        return slopes

    def changes(self, theta: FloatArray, laid: BlockEffects) -> dict[str, FloatArray]:
        """By slope, (n,) how far these parameters lay the blocks from where they are laid."""
        (to, azimuth), (at, lean) = self.moves(theta), self.moves(laid.theta)
        wide = self.values(theta)["width"] - self.values(laid.theta)["width"]
        return {
            "x": to[:, 0] - at[:, 0],
            "y": to[:, 1] - at[:, 1],
            "gamma": np.log(self.gamma(theta) / self.gamma(laid.theta)),
            "width": np.full(len(to), wide),
            "turn": azimuth - lean,
        }

    def near(self, theta: FloatArray, laid: BlockEffects) -> bool:
        """Whether the slopes hold that far: of the square of such a step a hundredth of a nanometre is left."""
        scale = {"x": self.step_mm(theta), "y": self.step_mm(theta)}
        by = self.changes(theta, laid)
        return all(float(abs(change).max()) <= NEAR[kind] * scale.get(kind, 1.0) for kind, change in by.items())

    def step_mm(self, theta: FloatArray) -> float:
        """The spot's own step (`STEP`) at these parameters."""
        return float(np.median(self.spot.step_mm(self.gamma(theta))))

    def block_s(self, theta: FloatArray, weight_s: FloatArray | None = None) -> FloatArray:
        """(n,) s times all that acts on a block's rate: w."""
        at = self.values(theta)
        log = ParameterAction(at).log_rate(self.gamma(theta), self.blocks.contact_h)
        fields = np.array([at[p.name] for p in self.parameters if p.name.startswith(FIELD)])
        weight = self.weight_s if weight_s is None else weight_s
        return np.asarray(weight * np.exp(log + fields @ self.waves), dtype=np.float64)

    def removal_nm(self, theta: FloatArray, laid: BlockEffects) -> FloatArray:
        """(N,) nm with the instrument's own terms; to first order in what the geometry is from where it is laid."""
        w = self.block_s(theta)
        own = theta[[k for k, p in enumerate(self.parameters) if p.name in ABERRATIONS]]
        removal = laid.base @ w + self.maps @ own
        changes = self.changes(theta, laid)
        for kind, slope in laid.slopes.items():
            removal = removal + slope @ (w * changes[kind])
        return np.asarray(removal, dtype=np.float64)

    def columns(self, theta: FloatArray, laid: BlockEffects, weight_s: FloatArray | None = None) -> FloatArray:
        """(N, k) derivative of the removal by each parameter, nm over its unit; of another dwell where one is given."""
        w = self.block_s(theta, weight_s)
        terms, maps = iter(self.waves), iter(self.maps.T)
        found: list[FloatArray] = []
        for parameter in self.parameters:
            if parameter.name in ABERRATIONS:
                found.append(next(maps))
            elif parameter.name.startswith(FIELD):
                found.append(laid.base @ (w * next(terms)))
            else:
                found.append(self._column(parameter.name, theta, w, laid))
        return np.column_stack(found)

    def _column(self, name: str, theta: FloatArray, w: FloatArray, laid: BlockEffects) -> FloatArray:
        """(N,) of a parameter of the rate or the geometry."""
        blocks, degree = self.blocks, np.pi / 180
        base, slopes = laid.base, laid.slopes
        at, gamma = self.values(theta), self.gamma(theta)
        azimuth = blocks.azimuth_rad + degree * (at["turn"] + at["rotation"])
        middle = (blocks.start_mm + blocks.end_mm) / 2

        def moved(x: FloatArray | float, y: FloatArray | float) -> FloatArray:
            return np.asarray(slopes["x"] @ (w * x) + slopes["y"] @ (w * y), dtype=np.float64)

        def turning() -> FloatArray:
            swing = rotate_spot(-at["offset_y"], at["offset_x"], azimuth)
            return np.asarray(slopes["turn"] @ w + moved(swing[:, 0], swing[:, 1]), dtype=np.float64)

        def sinking() -> FloatArray:
            share = (gamma - 1) / gamma
            return np.asarray(slopes["gamma"] @ (w * share) + base @ (w * at["exponent"] * share), dtype=np.float64)

        rules: dict[str, Callable[[], FloatArray]] = {
            "rate": lambda: base @ w,
            "wear": lambda: -(base @ (w * blocks.contact_h)),
            "exponent": lambda: base @ (w * np.log(gamma)),
            "compliance": sinking,
            "width": lambda: slopes["width"] @ w,
            "offset_x": lambda: moved(np.sin(azimuth), -np.cos(azimuth)),
            "offset_y": lambda: moved(np.cos(azimuth), np.sin(azimuth)),
            "turn": lambda: degree * turning(),
            "shift_x": lambda: moved(1.0, 0.0),
            "shift_y": lambda: moved(0.0, 1.0),
            "rotation": lambda: degree * (moved(-middle[:, 1], middle[:, 0]) + turning()),
        }
        return np.asarray(rules[name](), dtype=np.float64)

    def of(self, projection: str) -> ForwardModel:
        """Return the model with another projection's gamma."""
        return replace(self, projection=projection)


_NAMES = (
    "rate",
    "wear",
    "exponent",
    "compliance",
    "width",
    "offset_x",
    "offset_y",
    "turn",
    "shift_x",
    "shift_y",
    "rotation",
)
_OFFSET = {"offset_x", "offset_y", "shift_x", "shift_y", "rotation", "turn"}
_ASKED = {
    "x": _OFFSET,
    "y": _OFFSET,
    "gamma": {"compliance"},
    "width": {"width"},
    "turn": {"turn", "rotation"},
}


def build_forward_model(
    blocks: ExecutedBlocks,
    grid: Grid,
    mask: BoolArray,
    spot: Spot,
    process: ToolProcess,
    *,
    parameters: tuple[Parameter, ...],
    projection: str,
    radius_mm: float,
    pixels: MapPixelData | None = None,
) -> ForwardModel:
    """The forward model of a pass; ``radius_mm`` of the circle about the part's origin that Zernike terms are over."""
    timed = blocks.time_s > 0
    some = _only(blocks, timed)  # those without time neither remove nor wear
    middle = (some.start_mm + some.end_mm) / 2 / radius_mm
    terms = [int(p.name.removeprefix(FIELD)) for p in parameters if p.name.startswith(FIELD)]
    waves = zernike_field(terms, middle)
    rows, columns = np.nonzero(mask)
    noll = [1 + ABERRATIONS.index(p.name) for p in parameters if p.name in ABERRATIONS]
    maps = zernike_field(noll, np.column_stack([grid.x_mm[columns], grid.y_mm[rows]]) / radius_mm).T
    return ForwardModel(grid, mask, spot, parameters, some, some.weight_s(process), waves, maps, projection, pixels)


def _only(blocks: ExecutedBlocks, timed: BoolArray) -> ExecutedBlocks:
    def cut(values: FloatArray | None) -> FloatArray | None:
        return None if values is None else values[timed]

    return ExecutedBlocks(
        start_mm=blocks.start_mm[timed],
        end_mm=blocks.end_mm[timed],
        time_s=blocks.time_s[timed],
        azimuth_rad=blocks.azimuth_rad[timed],
        depth_ratio={name: gamma[timed] for name, gamma in blocks.depth_ratio.items()},
        factor=cut(blocks.factor),
        force_n=cut(blocks.force_n),
        rpm=cut(blocks.rpm),
        wider=cut(blocks.wider),
    )
