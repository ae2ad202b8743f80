"""Maps of a part that a person turns by hand: taken as they come into the cell's folder, one a pose."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path

import typer

from polishd.config.cell import CellConfig
from polishd.daemon.assembly import build_cell
from polishd.daemon.lock import locked
from polishd.hooks.cell import load_cell
from polishd.hooks.loader import Hooks
from polishd.model.surface import SurfaceMap
from polishd.process.absolute import PartPose
from polishd.show.tables import stderr
from polishd.workbench.calibration.instrument import instrument_verb
from polishd.workbench.calibration.options import InstrumentOptions

Ask = Callable[[PartPose, int, int], None]
"""Have somebody lay the part so; returns when it lies: the pose, its number from 1, and how many there are."""


def calibrate_verb(cell: Path, files: Sequence[Path], asked: InstrumentOptions, *, as_json: bool) -> None:
    """As ``instrument_verb``, with a person who turns the part where no files are named."""
    config, hooks = load_cell(cell)
    instrument_verb(config, files, asked, lambda poses: asyncio.run(taken(config, hooks, poses)), as_json=as_json)


async def taken(
    config: CellConfig, hooks: Hooks, poses: Sequence[PartPose], ask: Ask | None = None
) -> list[SurfaceMap]:
    """A map at each pose. Nothing moves: of the cell's devices only the instrument is opened.

    Raises:
        ConfigError: a daemon runs the cell, which takes the maps itself; or its file is wrong.
        SurfaceError, DeviceError: as of the instrument.
    """
    cell = build_cell(config, hooks)
    found: list[SurfaceMap] = []
    with locked(config.state_dir):
        try:
            await cell.open_one(cell.used["metrology"])
            for number, pose in enumerate(poses, 1):
                await asyncio.to_thread(ask or _by_a_person, pose, number, len(poses))
                stderr.print(f"measure now: waiting for map {number} of {len(poses)}", markup=False)
                found.append(await cell.metrology.next_map(found[-1].sha256 if found else None))
        finally:
            await cell.close()
    return found


def _by_a_person(pose: PartPose, number: int, count: int) -> None:
    said = f"map {number} of {count}: lay the part at {pose}, counter-clockwise, right and up as the tool sees it"
    typer.prompt(f"{said}; Enter when it lies so", default="", show_default=False, err=True)
