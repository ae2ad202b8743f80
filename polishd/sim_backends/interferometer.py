"""The interferometer's process: waits to be asked, waits until the tool is away, drops a MetroPro file."""

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

from polishd.config.simulator import SimConfig
from polishd.model.surface import FloatArray, Grid
from polishd.sim_backends import metropro
from polishd.sim_backends.bus import Message
from polishd.sim_backends.runtime import SimRuntime, replace_file
from polishd.sim_backends.seeing import add_imaging_errors, add_instrument_errors
from polishd.sim_backends.truth import stream

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
    """What is on the seat; empty: the cell's one part."""
    last: bytes = b""
    numbers: itertools.count[int] = field(default_factory=itertools.count)
    origin: tuple[int, int] = (0, 0)
    pitch_mm: float = 0.5

    async def run(self) -> None:
        """Serve requests for ever."""
        config = self.runtime.start.config.interferometer
        request = self.folder / config.request_file
        while True:
            with contextlib.suppress(FileNotFoundError):
                text = request.read_bytes()
                request.unlink()
                self.runtime.link.event("map_requested", bytes=len(text))
                self.runtime.link.ask(measure=True, t=time.monotonic())
                await self.drop(await self.maps.get())
            await asyncio.sleep(POLL_S)

    async def drop(self, true_nm: FloatArray) -> None:
        """Measure and write."""
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
        """Write a file in chunks, as slowly as configured; returns its name."""
        config = self.runtime.start.config.interferometer
        name = f"{stem}-{time.time_ns() // 1_000_000}-{next(self.numbers):04d}.dat"
        while_writing = self.folder / (name + config.temporary_suffix)
        with while_writing.open("wb") as file:
            if config.faults.preallocate:
                file.truncate(len(data))  # at once: its full length, all zeros
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
    """One map of the artefact, as this instrument sees it."""
    artefact, pitch = config.interferometer.artefact, config.plant.pitch_mm
    n = 2 * math.ceil(artefact.diameter_mm / 2 / pitch) + 1
    grid = Grid(n, n, pitch)
    height = config.truth.map_noise_nm * rng.standard_normal(grid.shape)
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
    """The device coroutine."""
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
