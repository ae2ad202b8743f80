"""``python -m polishd.sim_backends.batch``: read requests from stdin and write answers to stdout until stdin ends."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Any

import numpy as np
from pydantic import ValidationError

from polishd.config.simulator import SimConfig
from polishd.model.errors import BatchRequestError
from polishd.model.surface import FloatArray
from polishd.sim_backends.common import hidden_truth
from polishd.sim_backends.interferometer import add_instrument_errors, add_mount_errors
from polishd.sim_backends.plant import effects
from polishd.sim_backends.plant import part as parts
from polishd.sim_backends.plant.world import World
from polishd.util.array_stream import Message
from polishd.util.worker_main import AnswerFunction, serve

# One part under one tool, polished a whole pass at a time: the world of the simulated cell, fed with blocks.

STEP_MM = 0.3
"""Longest stretch that is worn as one contact: a tenth of the spot, accurate to 0.01 nm in a pass of 10 nm RMS."""


class BatchPlant:
    """A plant with a private clock: passes and maps follow at once, and wall time is process time."""

    def __init__(self, config: SimConfig, seed: int) -> None:
        """Draw the plant, as the cell's plant does with the same file and seed."""
        self.config = config
        self.world = World(
            config,
            hidden_truth.draw(config.hidden_truth, seed, config.robot_model()),
            parts.make(config.plant, seed),
            hidden_truth.stream(seed, "plant"),
            config.robot.home,
            robot_s=0.0,
            effects=effects.draw(config, seed),
        )
        self.now_s = 0.0
        self.instrument = hidden_truth.stream(seed, "interferometer")

    def polish(self, blocks: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Execute blocks. Return for each block the true contact time in s, mean force in N and mean speed in rpm."""
        begin, end, axis, seconds, force, rpm = _checked(blocks)
        pieces = np.maximum(np.ceil(np.linalg.norm(end - begin, axis=1) / STEP_MM).astype(np.int64), 1)
        block = np.repeat(np.arange(len(seconds)), pieces)
        within = np.arange(len(block)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        share = ((within + 0.5) / pieces[block])[:, None]
        tip = begin[block] + share * (end - begin)[block]
        lasts = seconds[block] / pieces[block]
        until = self.now_s + np.cumsum(lasts)
        a = np.degrees(np.arccos(np.clip(axis[:, 2], -1.0, 1.0)))
        c = np.degrees(np.arctan2(axis[:, 0], -axis[:, 1]))
        rows = np.column_stack([block, until - lasts, until, lasts, tip, a[block], c[block]])
        ends = until[np.cumsum(pieces) - 1]
        edges = np.column_stack([np.concatenate([[self.now_s], ends[:-1]]), ends]).ravel().tolist()
        for timeline, values in ((self.world.force, force), (self.world.rpm, rpm)):
            timeline.push(list(zip(edges, np.repeat(values, 2).tolist(), strict=True)), float(until[-1]))
        self.world.acted = []
        self.world.lift()
        self.world.robot_s = self.now_s
        self.world.move(rows)
        self.world.integrate(float(until[-1]))
        self.now_s = float(until[-1])
        return _executed(self.world.acted, len(seconds))

    def measure(self, wait_s: float, rotation_deg: float, shift_px: tuple[int, int]) -> FloatArray:
        """Return a map, nm, NaN outside, ``wait_s`` after the last contact, of the turned and shifted part."""
        if rotation_deg % 90:
            raise BatchRequestError(f"rotation_deg: {rotation_deg:g} is no quarter turn. Set 0, 90, 180 or 270")
        self.now_s += wait_s
        world = self.world
        height = world.part.map_nm() + parts.swelling_nm(world.part, self.config, self.now_s - world.polished_s)
        pitch = world.part.grid.pitch_mm
        return add_instrument_errors(
            height, self.config, pitch, self.instrument, quarters=int(rotation_deg // 90), shift_px=shift_px
        )

    def truth(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        """Return the hidden draws and the figure, free and as its mount holds it."""
        rms, pv = self.world.part.stats()
        drawn = {"machines": asdict(self.world.hidden), "effects": asdict(self.world.effects)}
        draws = {
            **drawn,
            "rms_nm": rms,
            "pv_nm": pv,
            "process_s": self.world.process_s,
            "pitch_mm": self.world.part.grid.pitch_mm,
        }
        height, patch = self.world.part.map_nm(), self.world.part.patch
        arrays = {} if patch is None else {"patch_nm": patch.height_nm, "patch_start_nm": patch.start_nm}
        draws |= {} if patch is None else {"patch_pitch_mm": patch.grid.pitch_mm}
        return draws, arrays | {"height_nm": height, "held_nm": add_mount_errors(height, self.config)}


def of(raw: dict[str, Any], seed: int | None) -> BatchPlant:
    """Build a plant from the sections of SIM.toml, as JSON."""
    if "cell" in raw:
        raise BatchRequestError("cell: a batch plant reads no files; send the sections of sim.toml")
    config = SimConfig.model_validate(raw)
    return BatchPlant(config, config.plant.seed if seed is None else seed)


def _checked(blocks: dict[str, FloatArray]) -> tuple[FloatArray, ...]:
    wide = {"begin_mm": True, "end_mm": True, "axis": True, "seconds": False, "force_n": False, "rpm": False}
    count = len(blocks["seconds"]) if "seconds" in blocks and blocks["seconds"].ndim else 0
    for name, three in wide.items():
        shape = (count, 3) if three else (count,)
        if name not in blocks:
            raise BatchRequestError(f"arrays: {name} is missing; polish takes {', '.join(wide)}")
        if not count or blocks[name].shape != shape:
            raise BatchRequestError(
                f"arrays: {name} is of shape {blocks[name].shape}; expected {shape}, one row for each block"
            )
        if not np.isfinite(blocks[name]).all():
            raise BatchRequestError(f"arrays: {name}: block {_first(~np.isfinite(blocks[name]))} is not finite")
    for name in ("seconds", "force_n"):
        if (blocks[name] < 0.0).any():
            raise BatchRequestError(f"arrays: {name}: block {_first(blocks[name] < 0.0)} is negative")
    wrong = np.abs(np.linalg.norm(blocks["axis"], axis=1) - 1.0) > 1e-6
    if wrong.any():
        raise BatchRequestError(f"arrays: axis: block {_first(wrong)} is not of length 1")
    return tuple(blocks[name] for name in wide)


def _first(wrong: np.ndarray) -> int:
    return int(np.argwhere(wrong)[0][0])


def _executed(acted: list[FloatArray], blocks: int) -> dict[str, FloatArray]:
    rows = np.concatenate([np.zeros((0, 4)), *acted])
    block = rows[:, 0].astype(np.int64)
    contact, force, rpm = (
        np.bincount(block, rows[:, 1] * weight, blocks) for weight in (np.ones(len(rows)), rows[:, 2], rows[:, 3])
    )
    some = np.where(contact > 0.0, contact, 1.0)
    return {"contact_s": np.asarray(contact, np.float64), "force_n": force / some, "rpm": rpm / some}


def start_worker() -> tuple[dict[str, Any], AnswerFunction]:
    """Return the identity that a worker prints when it is ready, and its request handler."""
    return {}, BatchServer().answer


class BatchServer:
    """Answer requests about the plant that was requested last."""

    def __init__(self) -> None:
        """Start without a plant."""
        self._plant: BatchPlant | None = None

    def answer(self, message: dict[str, Any], arrays: dict[str, FloatArray]) -> Message:
        """Return the answer to one request. BatchRequestError where it is invalid; nothing has been done then."""
        verb = message.get("do")
        if verb not in {"new", "polish", "measure", "truth"}:
            raise BatchRequestError(f"do: {verb!r} must be new, polish, measure or truth")
        if verb == "new":
            try:
                self._plant = of(_section(message, "config"), _whole(message, "seed"))
            except ValidationError as error:
                wrong = [f"{'.'.join(['config', *map(str, one['loc'])])}: {one['msg']}" for one in error.errors()]
                raise BatchRequestError("; ".join(wrong)) from error
            return {"done": verb}, {}
        if self._plant is None:
            raise BatchRequestError(f"do: {verb} without a plant. Send new first")
        if verb == "polish":
            executed = self._plant.polish(arrays)
            return {"done": verb, "now_s": self._plant.now_s}, executed
        if verb == "truth":
            truth, figure = self._plant.truth()
            return {"done": verb, **truth}, figure
        wait_s, turn = _number(message, "wait_s"), _number(message, "rotation_deg")
        if wait_s < 0.0:
            raise BatchRequestError(f"wait_s: {wait_s:g} is negative")
        shift = (_whole(message, "shift_columns") or 0, _whole(message, "shift_rows") or 0)
        height = self._plant.measure(wait_s, turn, shift)
        state = {"now_s": self._plant.now_s, "pitch_mm": self._plant.world.part.grid.pitch_mm}
        return {"done": verb, **state}, {"height_nm": height}


def _section(message: dict[str, Any], name: str) -> dict[str, Any]:
    value = message.get(name, {})
    if not isinstance(value, dict):
        raise BatchRequestError(f"{name}: the sections of SIM.toml as an object, not {value!r}")
    return value


def _number(message: dict[str, Any], name: str) -> float:
    value = message.get(name, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise BatchRequestError(f"{name}: a finite number, not {value!r}")
    return float(value)


def _whole(message: dict[str, Any], name: str) -> int | None:
    value = message.get(name)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
        raise BatchRequestError(f"{name}: a whole number, not {value!r}")
    return value


if __name__ == "__main__":
    sys.exit(serve(BatchServer().answer, sys.stdin.buffer, sys.stdout.buffer))
