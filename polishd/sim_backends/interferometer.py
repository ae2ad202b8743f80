"""The process of the interferometer: waits for a request, waits until the tool is away, writes a MetroPro file."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import ndimage

from polishd.config.simulator import SimConfig
from polishd.config.simulator_devices import MapFaults, SimInterferometerSection
from polishd.config.simulator_physics import InstrumentErrors
from polishd.model.surface import FloatArray, Grid
from polishd.sim_backends.common import metropro
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import Message, SimRuntime, replace_file

# The measurement of true heights by an interferometer: errors of its reference, imaging and mount. Pure of I/O.


def add_instrument_errors(
    true_nm: FloatArray,
    config: SimConfig,
    pitch_mm: float,
    rng: np.random.Generator,
    *,
    quarters: int = 0,
    shift_px: tuple[int, int] = (0, 0),
) -> FloatArray:
    """Return a map of the part in the instrument, (rows, columns), NaN where there are no data.

    The part is turned by so many quarters, counterclockwise, then moved by columns to the right and rows up. Errors of
    the part move with it.
    """
    errors = config.interferometer.errors
    height = _imaged(_shifted(np.rot90(add_mount_errors(true_nm, config), quarters), shift_px), errors)
    x, y = _places(height)
    noise = config.hidden_truth.map_noise_nm * rng.standard_normal(height.shape)
    if errors.retrace_nm_per_urad or errors.slope_noise_nm_per_urad:
        down, across = np.gradient(_whole(height), pitch_mm)  # nm/mm: microradians
        noise += errors.slope_noise_nm_per_urad * np.hypot(across, down) * rng.standard_normal(height.shape)
        height = height + errors.retrace_nm_per_urad * across
    if errors.tilt_nm:
        along_x, along_y = rng.uniform(-errors.tilt_nm, errors.tilt_nm, 2)
        height = height + 2.0 * (along_x * x + along_y * y)
    height = height + noise + _reference(x, y, errors)
    if errors.mount_anew:
        below, beside = rng.normal(0.0, errors.mount_nm / np.sqrt(2.0), 2)
        height = height + _trefoil(height, below) + _trefoil(height.T, beside).T
    elif not errors.mount_turns:
        height = height + _trefoil(height, errors.mount_nm)
    if errors.dead_pixels:
        dead = stream(0, "dead pixels").random(height.shape) < errors.dead_pixels  # fixed to the camera
        height = np.where(dead, np.nan, height)
    return add_imaging_errors(height, config.interferometer.faults)


def add_mount_errors(true_nm: FloatArray, config: SimConfig) -> FloatArray:
    """Return true heights with the deformation by a mount that turns with the part: every map contains it."""
    errors = config.interferometer.errors
    held = errors.mount_turns and not errors.mount_anew
    return true_nm + _trefoil(true_nm, errors.mount_nm) if held else true_nm


def add_imaging_errors(height_nm: FloatArray, faults: MapFaults) -> FloatArray:
    """Return the map of true heights by an instrument with these faults, (rows, columns)."""
    lying = np.rot90(height_nm[:, ::-1] if faults.mirror else height_nm, faults.rotation_deg // 90)
    return np.asarray(lying * (faults.sign * faults.factor))


def _places(height_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return X (right) and y (up) of the samples over the radius of the circle about them."""
    rows, columns = height_nm.shape
    half = max(rows, columns) / 2.0
    x = (np.arange(columns) - (columns - 1) / 2.0) / half
    y = ((rows - 1) / 2.0 - np.arange(rows)) / half
    return np.broadcast_to(x[None, :], height_nm.shape), np.broadcast_to(y[:, None], height_nm.shape)


def _reference(x: FloatArray, y: FloatArray, errors: InstrumentErrors) -> FloatArray:
    """Return power, astigmatism and coma; each of RMS 1 over the circle, times its size."""
    square = x**2 + y**2
    power = np.sqrt(3.0) * (2.0 * square - 1.0)
    twice = 2.0 * np.radians(errors.astigmatism_deg)
    astigmatism = np.sqrt(6.0) * ((x**2 - y**2) * np.cos(twice) + 2.0 * x * y * np.sin(twice))
    coma = np.sqrt(8.0) * (3.0 * square - 2.0) * x
    added = errors.power_nm * power + errors.astigmatism_nm * astigmatism + errors.coma_nm * coma
    return np.asarray(added, dtype=np.float64)


def _trefoil(height_nm: FloatArray, size_nm: float) -> FloatArray:
    """Return the three points of a mount, the first below."""
    x, y = _places(height_nm)
    return np.asarray(size_nm * np.sqrt(8.0) * (3.0 * x**2 * y - y**3), dtype=np.float64)


def _imaged(height_nm: FloatArray, errors: InstrumentErrors) -> FloatArray:
    """Return the image on the camera: a magnified one shows at each sample a point nearer to the center."""
    if not errors.magnification and not errors.distortion:
        return height_nm
    x, y = _places(height_nm)
    rows, columns = height_nm.shape
    larger = 1.0 + errors.magnification + errors.distortion * (x**2 + y**2)
    from_row = (np.arange(rows)[:, None] - (rows - 1) / 2.0) / larger + (rows - 1) / 2.0
    from_column = (np.arange(columns)[None, :] - (columns - 1) / 2.0) / larger + (columns - 1) / 2.0
    seen = ndimage.map_coordinates(_whole(height_nm), [from_row, from_column], order=3, mode="nearest")
    missing = ndimage.map_coordinates(np.isnan(height_nm).astype(float), [from_row, from_column], order=1, cval=1.0)
    return np.asarray(np.where(missing > 0.5, np.nan, seen), dtype=np.float64)


def _whole(height_nm: FloatArray) -> FloatArray:
    """Fill holes: each one takes the value of the nearest sample with data."""
    holes = np.isnan(height_nm)
    nearest = ndimage.distance_transform_edt(holes, return_distances=False, return_indices=True)
    return np.asarray(height_nm[tuple(nearest)])


def _shifted(height_nm: FloatArray, by_px: tuple[int, int]) -> FloatArray:
    """Move by columns to the right and rows up; NaN enters at the edge."""
    right, up = by_px
    rows, columns = height_nm.shape
    moved = np.full_like(height_nm, np.nan)
    to_rows, from_rows = slice(max(-up, 0), rows - max(up, 0)), slice(max(up, 0), rows - max(-up, 0))
    to_cols, from_cols = slice(max(right, 0), columns - max(-right, 0)), slice(max(-right, 0), columns - max(right, 0))
    moved[to_rows, to_cols] = height_nm[from_rows, from_cols]
    return moved


POLL_S = 0.03
CHUNKS = 20


@dataclass(slots=True)
class SimInterferometer:
    """One instrument and its folder."""

    runtime: SimRuntime
    folder: Path
    rng: np.random.Generator
    maps: asyncio.Queue[FloatArray] = field(default_factory=asyncio.Queue)
    part: str = ""
    """Part on the seat; empty: the cell's only part."""
    last: bytes = b""
    numbers: itertools.count[int] = field(default_factory=itertools.count)
    origin: tuple[int, int] = (0, 0)
    pitch_mm: float = 0.5

    async def run(self) -> None:
        """Serve requests until cancelled."""
        config = self.runtime.start.config.interferometer
        request = self.folder / config.request_file
        while True:
            with contextlib.suppress(FileNotFoundError):
                text = request.read_bytes()
                request.unlink()
                self.runtime.link.event("map_requested", bytes=len(text))
                self.runtime.link.send_message(measure=True, t=time.monotonic())
                await self.drop(await self.maps.get())
            await asyncio.sleep(POLL_S)

    async def drop(self, true_nm: FloatArray) -> None:
        """Measure and write the file."""
        start = self.runtime.start
        faults = start.config.interferometer.faults
        measured = add_instrument_errors(true_nm, start.config, self.pitch_mm, self.rng) + self.rng.uniform(
            -200.0, 200.0
        )
        if faults.wrong_part_first:
            await self.write("wrong", self._file(np.where(np.isfinite(measured), -measured, np.nan), "OTHER-7"))
        if faults.duplicate_first and self.last:
            await self.write("again", self.last)
        self.last = self._file(measured, self.part or start.config.plant.part_id)
        name = await self.write("map", self.last)
        self.runtime.link.event("map_dropped", file=name)

    async def write(self, stem: str, data: bytes) -> str:
        """Write a file in chunks, at the configured speed; return its name."""
        config = self.runtime.start.config.interferometer
        name = f"{stem}-{time.time_ns() // 1_000_000}-{next(self.numbers):04d}.dat"
        while_writing = self.folder / (name + config.temporary_suffix)
        with while_writing.open("wb") as file:
            if config.faults.preallocate:
                file.truncate(len(data))  # the full length at once, all zeros
            step = -(-len(data) // CHUNKS)
            for start in range(0, len(data), step):
                await asyncio.sleep(config.write_s / CHUNKS)
                file.write(data[start : start + step])
                file.flush()
            os.fsync(file.fileno())
        while_writing.rename(self.folder / name)
        return name

    def _file(self, height_nm: FloatArray, part: str) -> bytes:
        return _pack(height_nm, self.pitch_mm, part, self.origin)


def write_artefact(config: SimConfig, path: Path, rng: np.random.Generator) -> None:
    """Return one map of the artifact, as this instrument shows it."""
    artefact, pitch = config.interferometer.artefact, config.plant.pitch_mm
    n = 2 * math.ceil(artefact.diameter_mm / 2 / pitch) + 1
    grid = Grid(n, n, pitch)
    height = config.hidden_truth.map_noise_nm * rng.standard_normal(grid.shape)
    for bump in artefact.bumps:
        across = (grid.x_mm - bump.x_mm) / bump.sigma_x_mm
        down = (grid.y_mm - bump.y_mm) / bump.sigma_y_mm
        height += bump.height_nm * np.outer(np.exp(-0.5 * down**2), np.exp(-0.5 * across**2))
    height[grid.radius_mm() > artefact.diameter_mm / 2] = np.nan
    seen = add_imaging_errors(height, config.interferometer.faults)
    replace_file(path, _pack(seen, pitch, artefact.part_id, (0, 0)))


def _pack(height_nm: FloatArray, pitch_mm: float, part: str, origin_px: tuple[int, int]) -> bytes:
    now = int(time.time())
    return metropro.pack(
        metropro.DatMap(
            height_nm=height_nm,
            pitch_mm=pitch_mm,
            part=part,
            taken_s=now,
            comment="simulated",
            origin_px=origin_px,
            software=time.ctime(now),
        )
    )


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    folder = runtime.start.state / "maps"
    folder.mkdir(exist_ok=True)
    instrument = SimInterferometer(runtime, folder, stream(runtime.start.seed + runtime.boot_count, "interferometer"))
    x, y = runtime.link.welcome["origin_px"]
    instrument.origin, instrument.pitch_mm = (x, y), float(runtime.link.welcome["pitch_mm"])
    instrument.part = runtime.link.welcome["part"]

    def on_message(message: Message | FloatArray) -> None:
        if isinstance(message, dict):
            instrument.part = message["part"]
        else:
            instrument.maps.put_nowait(message)

    runtime.link.on_message = on_message
    runtime.ready(str(folder))
    await instrument.run()


SIM_DEVICES = [
    SimDevice(
        name="interferometer",
        device="interferometer",
        section=SimInterferometerSection,
        links={"watched_folder": {}},
        main=main,
    )
]
