"""A 1024 x 1024 masked map from its file to its figures, beside prysm for the steps that prysm has.

Import (.dat), registration by the outline, levelling, holes filled, 37 Zernike terms, PSD, three bands, slope.
prysm neither registers nor fills, and has no slope; its bands are two filters of a map whose missing samples are 0 (its
band RMS needs `numpy.trapz`, which NumPy 2 has not). Its levelling is of tilt alone. CPU seconds, in turns; the last
rows are wall time of ours on the available cores, and memory. Aims: 1 s and 600 MB.
"""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from prysm.interferogram import Interferogram
from prysm.polynomials import lstsq, noll_to_nm, zernike_nm_sequence

from benchmarks.harness import Progress, Row, peak_mb, race
from polishd.maps.figures import figured
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.process.metrology import registration, zernike
from polishd.process.metrology.conditioning import fill_holes
from polishd.process.metrology.spectra import radial_psd, split_bands
from polishd.process.metrology.statistics import remove_terms, slope

SIDE = 1024
PITCH_MM = 0.44
RADIUS_MM = 220.0
EDGES_MM = (33.0, 3.0)
TERMS = 37
TURNS = 5
AIM_S = 1.0
AIM_MB = 600.0


def rows(progress: Progress) -> Iterator[Row]:
    """Each step, the whole, and its memory."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "map.dat"
        path.write_bytes(written(measured()))
        for name, (ours, prysm) in steps(path).items():
            yield race(f"map: {name}", ours, {} if prysm is None else {"prysm": prysm}, progress=progress)
        height, mask = METROPRO.read(path).height_nm, METROPRO.read(path).valid
        yield race(
            "map: figures: level, bands, PSD, 37 terms, slope (aim 1 s; prysm: no slope)",
            partial(figures, height, mask),
            {"prysm": partial(figures_prysm, Interferogram.from_zygo_dat(path))},
            progress=progress,
        )
        surface = METROPRO.read(path)
        yield race(
            "map: all that `polishd map` says of it", lambda: figured(surface, 0, EDGES_MM), {}, progress=progress
        )
        yield race(
            "map: import to bands (prysm: import, level, 37 terms, PSD)",
            partial(whole, path),
            {"prysm": partial(whole_prysm, path)},
            progress=progress,
        )
        run: dict[str, Callable[[], object]] = {"ours": partial(whole, path), "prysm": partial(whole_prysm, path)}
        wall = {name: in_a_fork(partial(wall_s, each)) for name, each in run.items()}
        yield Row(f"map: the same, wall (aim {AIM_S:g} s)", wall["ours"], {"prysm": wall["prysm"]})
        for kind, measure in (("tracemalloc", peak_mb), ("resident, over the imports'", resident_mb)):
            peak = {name: in_a_fork(partial(measure, each)) for name, each in run.items()}
            yield Row(f"map: peak memory, {kind} (aim {AIM_MB:g} MB)", peak["ours"], {"prysm": peak["prysm"]}, "MB")


def measured() -> SurfaceMap:
    """A part of 440 mm with figure, ripple and noise, 40 small holes, and a tilt."""
    grid = Grid(SIDE, SIDE, PITCH_MM)
    rng = np.random.default_rng(6)
    frequency = np.hypot(np.fft.fftfreq(SIDE, PITCH_MM)[:, None], np.fft.rfftfreq(SIDE, PITCH_MM)[None, :])
    size = np.where(frequency > 0, np.maximum(frequency, 1e-3) ** -1.8, 0.0)
    height = np.fft.irfft2(size * np.exp(2j * np.pi * rng.random(frequency.shape)), grid.shape)
    height *= 20 / height.std()
    height += 300 * grid.x_mm[None, :] / RADIUS_MM
    valid = grid.radius_mm() <= RADIUS_MM
    for x, y, radius in rng.uniform((-150, -150, 0.5), (150, 150, 2.0), (40, 3)):
        valid &= np.hypot(grid.x_mm[None, :] - x, grid.y_mm[:, None] - y) > radius
    return SurfaceMap(np.where(valid, height, np.nan), PITCH_MM)


def written(surface: SurfaceMap) -> bytes:
    """Return the map's .dat."""
    assert METROPRO.write is not None
    return METROPRO.write(surface)


def steps(path: Path) -> dict[str, tuple[Callable[[], object], Callable[[], object] | None]]:
    """Our and prysm's runner of each step, with the results of the steps before."""
    surface = METROPRO.read(path)
    height, mask = surface.height_nm, surface.valid
    level = remove_terms(height, mask, "tilt")
    theirs = Interferogram.from_zygo_dat(path)
    return {
        "import .dat": (lambda: METROPRO.read(path), lambda: Interferogram.from_zygo_dat(path)),
        "level": (lambda: remove_terms(height, mask, "tilt"), lambda: theirs.copy().remove_tiptilt()),
        "register by the outline": (lambda: register(height), None),
        "fill 40 holes": (lambda: filled(level, mask), None),
        f"{TERMS} Zernike terms": (lambda: zernike.fit(level, mask, TERMS), lambda: zernike_prysm(theirs)),
        "PSD, radial": (lambda: radial_psd(level, mask, PITCH_MM), lambda: psd_prysm(theirs)),
        "three bands": (lambda: split_bands(level, mask, PITCH_MM, EDGES_MM), lambda: bands_prysm(theirs)),
        "slope": (lambda: slope(level, mask, PITCH_MM), None),
    }


def figures(height_nm: FloatArray, mask: np.ndarray) -> object:
    """Compute each figure that prysm has, and slope, one after the other."""
    level = remove_terms(height_nm, mask, "tilt")
    bands = split_bands(level, mask, PITCH_MM, EDGES_MM)
    terms = zernike.fit(level, mask, TERMS)
    return bands, terms, radial_psd(level, mask, PITCH_MM), slope(level, mask, PITCH_MM)


def figures_prysm(surface: Interferogram) -> object:
    """Compute prysm's share of it."""
    level = surface.copy()
    level.remove_piston()
    level.remove_tiptilt()
    return bands_prysm(level), zernike_prysm(level), psd_prysm(level)


def whole(path: Path) -> object:
    """All steps, one after the other."""
    surface = METROPRO.read(path)
    height, mask = surface.height_nm, surface.valid
    place = register(height)
    level = remove_terms(height, mask, "tilt")
    whole_surface = filled(level, mask)
    terms = zernike.fit(level, mask, TERMS)
    psd = radial_psd(level, mask, PITCH_MM)
    return place, whole_surface, terms, psd, split_bands(level, mask, PITCH_MM, EDGES_MM)


def whole_prysm(path: Path) -> object:
    """Compute prysm's share of it."""
    surface = Interferogram.from_zygo_dat(path)
    surface.remove_piston()
    surface.remove_tiptilt()
    return zernike_prysm(surface), psd_prysm(surface)


def register(height_nm: FloatArray) -> object:
    """Return the position of the part, by its rim."""
    return registration.fit_circle(height_nm, PITCH_MM, 2 * RADIUS_MM, 2.0)


def filled(height_nm: FloatArray, mask: np.ndarray) -> FloatArray:
    """Return the map with its holes filled; beyond the rim there are none."""
    from scipy import ndimage

    part = ndimage.binary_fill_holes(mask)
    return np.where(part, fill_holes(np.where(part, height_nm, 0.0)), np.nan)


def zernike_prysm(surface: Interferogram) -> object:
    """37 Noll terms by prysm's least squares."""
    pairs = [noll_to_nm(index) for index in range(1, TERMS + 1)]
    return lstsq(list(zernike_nm_sequence(pairs, surface.r / RADIUS_MM, surface.t, norm=True)), surface.data)


def bands_prysm(surface: Interferogram) -> object:
    """Two filters make three bands."""
    kept = []
    for edge in EDGES_MM:
        copy = surface.copy()
        copy.fill(0)
        copy.filter(1 / edge)
        kept.append(copy.data)
    return kept


def psd_prysm(surface: Interferogram) -> object:
    """Compute prysm's PSD, which takes no missing samples, averaged over directions."""
    copy = surface.copy()
    copy.fill(0)
    return copy.psd().slices().azavg


def wall_s(run: Callable[[], object]) -> float:
    """Median wall seconds."""
    taken = []
    for _ in range(TURNS):
        start = time.perf_counter()
        run()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def resident_mb(run: Callable[[], object]) -> float:
    """Return the growth of the process's largest resident size, MB."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    run()
    return (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1e3


def in_a_fork(run: Callable[[], float]) -> float:
    """Return a figure of a run in a separate process, so that no run uses another's memory."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_answered, args=(run, sender))
    process.start()
    sender.close()
    found = float(receiver.recv())
    process.join()
    return found


def _answered(run: Callable[[], float], sender: Connection) -> None:
    sender.send(run())
