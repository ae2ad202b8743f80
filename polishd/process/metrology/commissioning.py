"""Proof of an instrument's profile: a map of an artefact with asymmetric bumps must show it as it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.errors import ConfigError, MapError
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.process.frames import ORIENTATIONS, ArrayOrientation, orientations
from polishd.process.metrology.resampling import resample_registered
from polishd.process.metrology.statistics import polynomial

# A map explained by another: turned, negated and moved, how well does it fit?

REACH_MM = 5.0
"""Largest shift that is looked for."""
OVERLAP = 0.5
"""Share of the smaller mask that must overlap for a shift to count."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """One map turned one way, and how it fits another where it fits best."""

    orientation: ArrayOrientation
    negated: bool
    correlation: float
    """At the best shift; not negative: ``negated`` holds the sign."""
    shift_mm: tuple[float, float]
    """(x, y) by which the turned map must be moved."""

    @property
    def name(self) -> str:
        """Name of the turn and sign: "as it is", "negated", "turned 90 and negated"."""
        if not self.negated:
            return self.orientation.name
        return "negated" if self.orientation == ORIENTATIONS[0] else f"{self.orientation.name} and negated"

    @property
    def as_it_is(self) -> bool:
        """Return whether the map was only moved."""
        return self.orientation == ORIENTATIONS[0] and not self.negated

    def turn(self, height_nm: FloatArray) -> FloatArray:
        """The map turned and signed, not moved."""
        return np.asarray(self.orientation.turn(-height_nm if self.negated else height_nm), dtype=np.float64)

    def turn_mask(self, mask: BoolArray) -> BoolArray:
        """Its mask, turned."""
        return np.asarray(self.orientation.turn(mask), dtype=np.bool_)

    def samples(self, pitch_mm: float) -> tuple[int, int]:
        """(down, right) the shift in whole samples."""
        x, y = self.shift_mm
        return round(-y / pitch_mm), round(x / pitch_mm)


def explanations(
    height_nm: FloatArray, seen_nm: FloatArray, mask: BoolArray, seen_mask: BoolArray, pitch_mm: float
) -> Iterator[Explanation]:
    """Each turn and flip that keeps the array's shape, plain and negated, at the shift where it fits best.

    Args:
        height_nm: (ny, nx) the map to be turned, without piston.
        seen_nm: (ny, nx) the one to be explained.
        mask: (ny, nx) of the first.
        seen_mask: (ny, nx) of the second.
        pitch_mm: of both.
    """
    reach = max(1, round(REACH_MM / pitch_mm))
    for orientation in orientations(mask.shape):
        turned_mask = np.asarray(orientation.turn(mask), dtype=np.bool_)
        found = correlations(orientation.turn(height_nm), turned_mask, seen_nm, seen_mask, reach)
        for negated in (False, True):
            value, row, column = peak(np.maximum(-found if negated else found, 0.0))
            yield Explanation(orientation, negated, value, (column * pitch_mm, -row * pitch_mm))


def correlations(a: FloatArray, a_mask: BoolArray, b: FloatArray, b_mask: BoolArray, reach: int) -> FloatArray:
    """Correlation of b with a moved by (row, column) shifts up to ``reach`` samples, over where the masks overlap.

    The mean of the overlap is taken out for each shift, so that nothing outside the masks weighs in
    (D. Padfield, IEEE Trans. Image Processing 21, 2012).

    Returns:
        (2 reach + 1, 2 reach + 1); [reach + i, reach + j] is for a moved down by i and right by j. 0 where too
        little overlaps, or where either is even.
    """
    shape = [scipy.fft.next_fast_len(n + reach, real=True) for n in a.shape]
    ones_a, ones_b = (scipy.fft.rfft2(mask.astype(np.float64), shape) for mask in (a_mask, b_mask))
    a, b = np.where(a_mask, a, 0.0), np.where(b_mask, b, 0.0)
    fa, fb = scipy.fft.rfft2(a, shape), scipy.fft.rfft2(b, shape)

    def over_shifts(first: FloatArray, second: FloatArray) -> FloatArray:
        """Sum over x of first(x - s) second(x)."""
        all_shifts = scipy.fft.irfft2(np.conj(first) * second, shape)
        near = np.arange(-reach, reach + 1)
        return np.asarray(all_shifts[np.ix_(near, near)])

    count = np.maximum(over_shifts(ones_a, ones_b), 1.0)
    sum_a, sum_b = over_shifts(fa, ones_b), over_shifts(ones_a, fb)
    cross = over_shifts(fa, fb) - sum_a * sum_b / count
    square_a = over_shifts(scipy.fft.rfft2(a**2, shape), ones_b) - sum_a**2 / count
    square_b = over_shifts(ones_a, scipy.fft.rfft2(b**2, shape)) - sum_b**2 / count
    least_a, least_b = 1e-9 * (a**2).sum(), 1e-9 * (b**2).sum()
    fair = (square_a > least_a) & (square_b > least_b)
    fair &= count >= OVERLAP * min(a_mask.sum(), b_mask.sum())
    found = np.where(fair, cross / np.sqrt(np.where(fair, square_a * square_b, 1.0)), 0.0)
    return np.asarray(np.clip(found, -1.0, 1.0), dtype=np.float64)


def peak(found: FloatArray) -> tuple[float, float, float]:
    """Value and (row, column) shift, in samples, of the largest magnitude; between samples by a parabola each way."""
    reach = found.shape[0] // 2
    i, j = np.unravel_index(int(abs(found).argmax()), found.shape)
    value, size = float(found[i, j]), abs(found)
    row = _vertex(size[max(i - 1, 0) : i + 2, j])
    column = _vertex(size[i, max(j - 1, 0) : j + 2])
    return value, float(i - reach + row), float(j - reach + column)


def _vertex(three: FloatArray) -> float:
    if three.size < 3:
        return 0.0  # at the border of what was searched
    curvature = three[0] - 2 * three[1] + three[2]
    return float(0.5 * (three[0] - three[2]) / curvature) if curvature < 0 else 0.0


ACROSS = 120
"""Samples a side of the grid that a map is proved on."""
SEARCH = 64
"""Pitch of the grid for the search of orientation and size."""
LEAST_CORRELATION = 0.9
MARGIN = 0.1
"""Least advantage in correlation of the artefact as it is over any other orientation."""
SCALE_TOLERANCE = 0.05
PITCH_TOLERANCE = 0.02
"""Largest error of height and size."""
MAX_TURN_DEG = 10.0
BASE_DEGREE = 2
"""Total degree of what the artefact's base may have: 10 nm of power made 150 nm bumps look 3 % too small."""
SETTLED = 0.95
"""Correlation at which no further size is tried: least squares find what is left."""
RATIOS = tuple(float(2 ** (k / 5)) for k in range(-7, 8))
"""Sizes of the artefact in the map, relative to its own, that are tried."""


@dataclass(frozen=True, slots=True)
class ArtefactBump:
    """A Gaussian bump (a dimple where the height is negative) on a flat base."""

    x_mm: float
    y_mm: float
    sigma_x_mm: float
    sigma_y_mm: float
    height_nm: float
    angle_deg: float = 0.0
    """Counter-clockwise turn of its axes."""


@dataclass(frozen=True, slots=True)
class ProfileProof:
    """Agreement of a map with the artefact."""

    correlation: float
    next_best: float
    """Best correlation of any other of the 8 turns and flips, plain or negated."""
    next_best_name: str
    scale: float
    """Height in the map over the artefact's own."""
    shift_mm: tuple[float, float]
    turn_deg: float
    pitch_ratio: float
    """Size in the map over the artefact's own: by this the pitch is too large."""


def artefact_heights(bumps: Sequence[ArtefactBump], grid: Grid) -> FloatArray:
    """(ny, nx) nm, the sum of the bumps."""
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    return _heights(bumps, x, y)


def require_asymmetric(bumps: Sequence[ArtefactBump]) -> None:
    """Refuse an artefact that looks about the same turned, flipped or negated: it would prove nothing.

    Raises:
        ConfigError: no bumps, bumps without size, or a symmetric arrangement, named.
    """
    if not bumps or any(min(b.sigma_x_mm, b.sigma_y_mm) <= 0 or b.height_nm == 0 for b in bumps):
        raise ConfigError("the artefact needs bumps with sigma_x_mm, sigma_y_mm > 0 and a height_nm")
    half = max(float(np.hypot(b.x_mm, b.y_mm)) + 3 * max(b.sigma_x_mm, b.sigma_y_mm) for b in bumps)
    grid = Grid(SEARCH, SEARCH, 2 * half / SEARCH)
    mask = np.ones(grid.shape, dtype=np.bool_)
    height = _bare(artefact_heights(bumps, grid), mask)
    same = _others(list(explanations(height, height, mask, mask, grid.pitch_mm)), ORIENTATIONS[0], negated=False)
    if same.correlation > 1 - MARGIN:
        raise ConfigError(f"the artefact looks like itself {same.name} (correlation {same.correlation:.2f}): it "
                          "cannot prove a profile; move a bump, or give it another height or shape")  # fmt: skip


def prove_profile(surface: SurfaceMap, bumps: Sequence[ArtefactBump]) -> ProfileProof:
    """Show that a map shows the artefact as it is: not turned, flipped or negated, and of its height and size.

    Args:
        surface: the map of the artefact, as the profile turns and scales it (`process.instrument.as_profiled`).
        bumps: the artefact.

    Raises:
        MapError: it does not; what it shows instead is named, with the profile's values that would mend it.
        ConfigError: the artefact is symmetric.
    """
    require_asymmetric(bumps)
    ratio, found = _best_ratio(*_on_square(surface, SEARCH), bumps)
    seen, mask, grid = _on_square(surface, ACROSS)
    best = max(found, key=lambda e: e.correlation)
    upright = best.orientation.undone.turn(-seen if best.negated else seen)
    own_mask = np.asarray(best.orientation.undone.turn(mask), dtype=np.bool_)
    start = best.orientation.undone.turn_vector(best.shift_mm)
    proof = _placed(upright, own_mask, grid, bumps, (*start, ratio))
    rival = _others(found, best.orientation, negated=best.negated)
    proof = replace(proof, next_best=rival.correlation, next_best_name=rival.name)
    if proof.correlation < LEAST_CORRELATION or abs(proof.turn_deg) > MAX_TURN_DEG:
        raise MapError(f"the map does not show the artefact: {best.name} and {proof.pitch_ratio:.2f} times as large it "
                     f"correlates best, with {proof.correlation:.2f}, and {LEAST_CORRELATION:g} is needed; centre and "
                     "seat the artefact, and check its bumps")  # fmt: skip
    if np.hypot(*proof.shift_mm) > REACH_MM:  # the rivals were tried within it only
        x, y = proof.shift_mm
        raise MapError(f"the map shows the artefact at ({x:+.1f}, {y:+.1f}) mm from its place, and {REACH_MM:g} mm are "
                     "allowed: centre it in the map, or mend x_mm and y_mm of its bumps")  # fmt: skip
    if proof.next_best > proof.correlation - MARGIN:
        raise MapError(f"the map shows the artefact {rival.name} about as well as {best.name} ({rival.correlation:.2f} "
                     f"and {proof.correlation:.2f}): bring all its bumps into view")  # fmt: skip
    wrong, mend, elsewhere = _mistakes(surface, best, proof)
    if wrong:
        todo = [f"set {', '.join(mend)} in the instrument's profile"] if mend else []
        todo = [*todo, *elsewhere, "prove it again"]
        raise MapError(f"the map shows the artefact {' and '.join(wrong)}: {', '.join(todo[:-1])} and {todo[-1]}")
    return proof


def _heights(bumps: Sequence[ArtefactBump], x: FloatArray, y: FloatArray) -> FloatArray:
    height = np.zeros(np.broadcast(x, y).shape)
    for b in bumps:
        turn = np.radians(b.angle_deg)
        along = (x - b.x_mm) * np.cos(turn) + (y - b.y_mm) * np.sin(turn)
        across = -(x - b.x_mm) * np.sin(turn) + (y - b.y_mm) * np.cos(turn)
        height += b.height_nm * np.exp(-0.5 * ((along / b.sigma_x_mm) ** 2 + (across / b.sigma_y_mm) ** 2))
    return height


def _bare(height_nm: FloatArray, mask: BoolArray) -> FloatArray:
    """(ny, nx) without piston, tilt, power and astigmatism, which are the base's and its mount's; zero outside."""
    return np.where(mask, np.where(mask, height_nm, 0.0) - polynomial(height_nm, mask, BASE_DEGREE), 0.0)


def _on_square(surface: SurfaceMap, across: int) -> tuple[FloatArray, BoolArray, Grid]:
    """The map on a square grid, so that all eight orientations can be tried, without its base's form."""
    if surface.pitch_mm is None:
        raise MapError("the map has no lateral scale: give the instrument's profile a pitch")
    side = max(surface.height_nm.shape) * surface.pitch_mm
    grid = Grid(across, across, side / across)
    height = resample_registered(surface.height_nm, surface.grid, grid)
    mask = np.isfinite(height)
    if np.count_nonzero(mask) < across:
        raise MapError("the map holds no data")
    return _bare(height, mask), mask, grid


def _best_ratio(
    seen: FloatArray, mask: BoolArray, grid: Grid, bumps: Sequence[ArtefactBump]
) -> tuple[float, list[Explanation]]:
    """The size of the artefact that fits best in any orientation, and all the orientations at that size."""
    tried = []
    for ratio in sorted(RATIOS, key=lambda ratio: abs(np.log(ratio))):
        scaled = _bare(artefact_heights(bumps, Grid(grid.ny, grid.nx, grid.pitch_mm / ratio)), mask)
        tried.append((ratio, list(explanations(scaled, seen, mask, mask, grid.pitch_mm))))
        if max(e.correlation for e in tried[-1][1]) > SETTLED:
            break
    return max(tried, key=lambda pair: max(e.correlation for e in pair[1]))


def _others(found: Sequence[Explanation], orientation: ArrayOrientation, *, negated: bool) -> Explanation:
    """The best of all explanations but this one."""
    others = (e for e in found if (e.orientation, e.negated) != (orientation, negated))
    return max(others, key=lambda e: e.correlation)


def _placed(
    seen: FloatArray, mask: BoolArray, grid: Grid, bumps: Sequence[ArtefactBump], start: tuple[float, float, float]
) -> ProfileProof:
    """Least squares of shift, turn and size; height and base follow linearly from each (variable projection)."""
    x, y = (v[mask] for v in np.meshgrid(grid.x_mm, grid.y_mm))
    base = np.linalg.qr(np.column_stack([np.ones(x.size), x, y, x**2, y**2, x * y]))[0]
    measured = seen[mask] - base @ (base.T @ seen[mask])

    def model(values: FloatArray) -> FloatArray:
        dx, dy, turn, size = values[0], values[1], values[2], np.exp(values[3])
        u, v = (x - dx) / size, (y - dy) / size
        height = _heights(bumps, u * np.cos(turn) + v * np.sin(turn), -u * np.sin(turn) + v * np.cos(turn))
        return np.asarray(height - base @ (base.T @ height), dtype=np.float64)

    def left(values: FloatArray) -> FloatArray:
        height = model(values)
        return np.asarray(measured - height * float(height @ measured) / max(float(height @ height), 1e-300))

    first, steps = [start[0], start[1], 0.0, np.log(start[2])], [1.0, 1.0, 0.02, 0.02]
    found = scipy.optimize.least_squares(left, first, x_scale=steps, max_nfev=40).x
    height = model(found)
    own, energy = float(height @ measured), float(height @ height)
    correlation = own / float(np.sqrt(energy * (measured @ measured))) if energy > 0 and measured.any() else 0.0
    turn = float(np.degrees(found[2]))
    return ProfileProof(
        correlation, 0.0, "", own / max(energy, 1e-300), (float(found[0]), float(found[1])), turn,
        float(np.exp(found[3])),
    )  # fmt: skip


def _mistakes(surface: SurfaceMap, best: Explanation, proof: ProfileProof) -> tuple[list[str], list[str], list[str]]:
    """What the map shows amiss, the profile's values that would mend it, and what is to be done elsewhere.

    A pitch that the file says is not mended by the profile: another one there is refused beside the file's.
    """
    profile = surface.factors.get("profile", {})
    wrong, mend, elsewhere = [], [], list[str]()
    if not best.as_it_is:
        was = ArrayOrientation(profile.get("mirror", False), profile.get("rotation_deg", 0))
        right = was.then(best.orientation.undone)
        wrong.append(best.name)
        mend += [f"mirror = {str(right.mirror).lower()}", f"rotation_deg = {right.rotation_deg}",
                 f"sign = {profile.get('sign', 1) * (-1 if best.negated else 1)}"]  # fmt: skip
    if abs(proof.scale - 1) > SCALE_TOLERANCE:
        known = next((f for f in (0.5, 2.0) if abs(proof.scale / f - 1) <= SCALE_TOLERANCE), proof.scale)
        wrong.append(f"{proof.scale:.3f} times as high")
        mend.append(f"factor = {profile.get('factor', 1.0) / known:.4g}")
    if abs(proof.pitch_ratio - 1) > PITCH_TOLERANCE:
        wrong.append(f"{proof.pitch_ratio:.3f} times as large")
        said, true_mm = surface.grid.pitch_mm, surface.grid.pitch_mm / proof.pitch_ratio
        if profile.get("pitch_from") == "file":
            elsewhere.append(
                f"calibrate the lateral scale at the instrument, whose files say {said:.6g} mm a pixel where the "
                f"artefact says {true_mm:.6g} (no profile replaces that), or correct its bumps' places; remeasure"
            )
        else:
            mend.append(f"pitch_mm = {true_mm:.6g}")
    return wrong, mend, elsewhere
