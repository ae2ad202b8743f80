"""The plant: motion, force and speed together wear the part. Pure of I/O."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.simulator import SimConfig
from polishd.model.surface import BoolArray, FloatArray
from polishd.sim_backends.common.hidden_truth import Frames, HiddenTruth
from polishd.sim_backends.common.runtime import ROW, replace_file
from polishd.sim_backends.plant.effects import PlantEffects
from polishd.sim_backends.plant.part import Local, Shape, TruePart
from polishd.sim_backends.plant.tool import ContactPoints, ForceDynamics, Tool

# The history of a force or a speed, vouched for by its device.


@dataclass(slots=True)
class Timeline:
    """Piecewise linear in wall time; constant after the last point up to the mark."""

    rest: float = 0.0
    """Value while the device is absent: no power, no force, no speed."""
    times: list[float] = field(default_factory=lambda: [-math.inf])
    values: list[float] = field(default_factory=lambda: [0.0])
    mark_s: float = math.inf
    """Values before it are final; infinite while no device is connected."""

    def connect(self, at_s: float) -> None:
        """Take the power-up of a device; it vouches for nothing yet."""
        self.step(at_s, self.rest)
        self.mark_s = at_s

    def disconnect(self, at_s: float, *, stays: bool = False) -> None:
        """Take the end of a device: the value falls to rest at once, or keeps its last value."""
        self.step(max(at_s, self.times[-1]), self.values[-1] if stays else self.rest)
        self.mark_s = math.inf

    def push(self, samples: list[tuple[float, float]], mark_s: float) -> None:
        """Take points in time order and the new mark. A point before the last one is moved up to it."""
        for time_s, value in samples:
            self.times.append(max(time_s, self.times[-1]))
            self.values.append(value)
        self.mark_s = mark_s

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return values at times before the mark."""
        return np.asarray(np.interp(times_s, self.times[1:] or [0.0], self.values[1:] or [self.rest]))

    def forget(self, before_s: float) -> None:
        """Drop the points before, except the last."""
        keep = max(int(np.searchsorted(self.times, before_s)) - 2, 0)
        if keep > 100:
            del self.times[1:keep], self.values[1:keep]

    def step(self, at_s: float, value: float) -> None:
        """Set another value from then on."""
        self.times += [at_s, at_s]
        self.values += [self.values[-1], value]


# The plant's own account of dwell: it proves that nothing was polished twice.


@dataclass(slots=True)
class ContactExitRecord:
    """Removal from a moment on: the cost of leaving contact. The cause of the fault marks that moment (SIGUSR1)."""

    from_s: float
    """Wall time (monotonic) of the mark."""
    removed_nm: FloatArray
    standing_nm: FloatArray
    contact_s: float = 0.0
    standing_s: float = 0.0
    until_s: float = 0.0
    """Wall time of the last contact."""

    def report(self) -> dict[str, float]:
        """Seconds of contact (process time) and the largest depth, in all and at standstill."""
        seconds = {name: getattr(self, name) for name in ("from_s", "until_s", "contact_s", "standing_s")}
        return {
            **seconds,
            "peak_nm": float(self.removed_nm.max()),
            "standing_peak_nm": float(self.standing_nm.max()),
        }


@dataclass(slots=True)
class Pit:
    """Removal beyond plan from the first wrong moment on: the cost of a fault of motion or force.

    Planned is the set point of the force for the duration of the planned motion. A tool that stands, is slow, or
    presses more removes more; one that is being lifted removes less.
    """

    from_s: float
    """Wall time (monotonic) of the first wrong moment."""
    excess_nm: FloatArray
    contact_s: float = 0.0
    """Process time of contact since."""
    until_s: float = 0.0
    """Wall time of the last contact."""

    def report(self, part: TruePart) -> dict[str, Any]:
        """Times, and the worst point in the part's own x and y."""
        row, column = np.unravel_index(int(self.excess_nm.argmax()), self.excess_nm.shape)
        return {
            **{name: getattr(self, name) for name in ("from_s", "until_s", "contact_s")},
            "peak_nm": float(self.excess_nm.max()),
            "at_mm": [float(part.grid.x_mm[column]), float(part.grid.y_mm[row])],
            **self._on_part(part),
        }

    def _on_part(self, part: TruePart) -> dict[str, float]:
        """Worst point of the part itself, without the ring on which the tool lands, and the planned removal there."""
        on_part = np.pad(part.valid, part.pad)
        worst = int(np.where(on_part, self.excess_nm, -np.inf).argmax())
        planned_nm = part.start_nm - part.height_nm - self.excess_nm
        return {"part_nm": float(self.excess_nm.flat[worst]), "planned_nm": float(planned_nm.flat[worst])}


@dataclass(slots=True)
class DwellAccount:
    """Contact seconds (process time) for each block of each program, and at standstill."""

    programs: dict[str, FloatArray] = field(default_factory=dict)
    loads: dict[str, int] = field(default_factory=dict)
    current: str = ""
    standstill_s: float = 0.0
    stands: list[dict[str, float]] = field(default_factory=list)
    way_out: ContactExitRecord | None = None
    pit: Pit | None = None

    def load(self, sha256: str, blocks: int) -> None:
        """Take the load of a program; one that was loaded before continues its old account."""
        self.current = sha256
        self.loads[sha256] = self.loads.get(sha256, 0) + 1
        known = self.programs.get(sha256)
        if known is None or len(known) != blocks:
            self.programs[sha256] = np.zeros(blocks)

    def dwell(self, program: str, seq: FloatArray, seconds: FloatArray) -> None:
        """Book contact in blocks."""
        book = self.programs.get(program)
        if book is not None and len(seq):
            np.add.at(book, seq.astype(np.int64), seconds)

    def stand(
        self, x_mm: float, y_mm: float, at_s: float, seconds: float, *, force_n: float = 0.0, rpm: float = 0.0
    ) -> None:
        """Book contact at standstill, under that force and at that speed of the spindle."""
        self.standstill_s += seconds
        last = self.stands[-1] if self.stands else None
        if last and at_s - last["until_s"] < 0.5 and abs(last["x_mm"] - x_mm) + abs(last["y_mm"] - y_mm) < 0.01:
            last["seconds"] += seconds
            last["until_s"] = at_s
            last["most_n"], last["most_rpm"] = max(last["most_n"], force_n), max(last["most_rpm"], rpm)
        else:
            times = {"from_s": at_s, "until_s": at_s, "seconds": seconds}
            self.stands.append({"x_mm": x_mm, "y_mm": y_mm, **times, "most_n": force_n, "most_rpm": rpm})

    def write(self, folder: Path, part: TruePart, process_s: float, until_s: float) -> None:
        """Write ``dwell_account.json`` and ``truth.npz``, each replaced whole, complete up to that wall time."""
        rms, pv = part.stats()
        books: list[dict[str, Any]] = [
            {"sha256": sha, "blocks": len(book), "loads": self.loads[sha], "contact_s": np.round(book, 7).tolist()}
            for sha, book in self.programs.items()
        ]
        message = {
            "process_s": process_s,
            "until_s": until_s,
            "rms_nm": rms,
            "pv_nm": pv,
            "standstill_contact_s": self.standstill_s,
            "stands": self.stands,
            "way_out": self.way_out.report() if self.way_out is not None else None,
            "pit": self.pit.report(part) if self.pit is not None else None,
            "programs": books,
            "truth": "truth.npz",
        }
        replace_file(folder / "dwell_account.json", json.dumps(message).encode())
        part.write(folder / "truth.npz")


REACH_MM = 4.5
"""Stroke over which the actuator keeps the bonnet on the surface."""
TOUCH_UM = 5000.0
"""Position of the actuator at which the tool's tip is where the program commands it."""
TOUCH_N = 0.02
SEQ, WALL0, WALL1, DT, X = range(len(ROW) - 4)
GAP_S = 1e-5
STAND_S = 0.02


@dataclass(slots=True)
class World:
    """All physics. ``integrate(horizon)`` wears the part by all motion, force and speed vouched for up to then."""

    config: SimConfig
    hidden: HiddenTruth
    part: TruePart
    rng: np.random.Generator
    pose: tuple[float, float, float, float, float]
    robot_s: float
    """Wall time up to which motion is known."""
    force: Timeline = field(default_factory=Timeline)
    rpm: Timeline = field(default_factory=Timeline)
    """Of the spindle, with a sign: positive turns counterclockwise, seen from above the part."""
    set_point: Timeline = field(default_factory=Timeline)
    """Force of the actuator."""
    pace: Timeline = field(default_factory=lambda: Timeline(rest=1.0, values=[1.0]))
    """Planned motion within a second of motion: below 1 where an override slows it, 0 where the robot stands."""
    account: DwellAccount = field(default_factory=DwellAccount)
    effects: PlantEffects = field(default_factory=PlantEffects)
    process_s: float = 0.0
    contact_s: float = 0.0
    """Process time that the tool has polished: it determines wear and warming."""
    acted: list[FloatArray] | None = None
    """Where kept: (n, 4) block, seconds, N and rpm of each stretch of contact, as actuator and spindle measure them."""
    polished_s: float = -math.inf
    """Wall time of the last contact of a tool that turned."""
    _queue: list[tuple[str, FloatArray]] = field(default_factory=list)
    _noise: float = 0.0
    _lag: ForceDynamics | None = None
    _frames: Frames = field(init=False)
    _tool: Tool = field(init=False)
    _shape: Shape = field(init=False)

    def __post_init__(self) -> None:
        """Fix the frames, the tool and the optic."""
        self._frames, self._shape = Frames(self.config.plant), Shape(self.config.plant)
        self.mount(self.config)
        lags = self.effects.force_lag_s, self.effects.guide_friction_n
        self._lag = ForceDynamics(*lags) if any(lags) else None

    def mount(self, config: SimConfig) -> None:
        """Take SIM.toml as it is now: the truth from here on, and the tool on the spindle."""
        self.config = config
        self._tool = Tool.of(config, self.hidden.robot, self.effects)

    def move(self, rows: FloatArray) -> None:
        """Take motion as the robot reports it (``bus.ROW``); earlier time without a row was standstill."""
        if not len(rows):
            return
        self.stand_until(float(rows[0, WALL0]))
        self._queue.append((self.account.current, rows))
        self.robot_s = float(rows[-1, WALL1])
        self._turn_to(rows[-1, X:])

    def stand_until(self, wall_s: float, pose: Sequence[float] | None = None) -> None:
        """Take a standstill from the last known motion up to that time, in place or at the given pose."""
        if pose is not None:
            self._turn_to(pose)
        span = wall_s - self.robot_s
        if span <= GAP_S:
            return
        edges = np.linspace(self.robot_s, wall_s, math.ceil(span / STAND_S) + 1)
        rows = np.column_stack(
            [
                np.full(len(edges) - 1, -1.0),
                edges[:-1],
                edges[1:],
                np.diff(edges),
                np.tile(self.pose, (len(edges) - 1, 1)),
            ]
        )
        self._queue.append((self.account.current, rows))
        self.robot_s = wall_s

    def lift(self) -> None:
        """End the contact in no time."""
        if self._lag is not None:
            self._lag.lift()

    def _turn_to(self, pose: Sequence[float] | FloatArray) -> None:
        x, y, z, a, c = (float(value) for value in pose)
        self.pose = (x, y, z, a, c)

    @property
    def touch_um(self) -> float | None:
        """Position of the actuator, um, at which the tool meets the part; None where nothing is within its reach."""
        place, axis = self._frames.in_part(np.array([self.pose]))
        local = self._shape.under(place)
        if not self._within(place, local)[0]:
            return None
        up = float(local.normal[0, 2]) / float(local.normal[0] @ axis[0])  # along the tool, for one up the part's z
        return round(TOUCH_UM + 1000.0 * float(self._gap_mm(place, local)[0]) * up, 0)

    @property
    def acting_n(self) -> float:
        """The actuator's true force between tool and part now, whatever it reports."""
        return self.force.values[-1] if self.touch_um is not None else 0.0

    def integrate(self, horizon_s: float) -> list[tuple[float, float]]:
        """Wear the part; return (wall, process) pairs of the clocks."""
        clocks, due = [], list[tuple[str, FloatArray]]()
        process_s = self.process_s
        while self._queue and self._queue[0][1][0, WALL1] <= horizon_s:
            program, rows = self._queue.pop(0)
            count = int(np.searchsorted(rows[:, WALL1], horizon_s, side="right"))
            if count < len(rows):
                self._queue.insert(0, (program, rows[count:]))
            due.append((program, rows[:count]))
            clocks.append((float(rows[0, WALL0]), process_s))
            process_s += float(rows[:count, DT].sum())
            clocks.append((float(rows[count - 1, WALL1]), process_s))
        for program, rows in self._together(due):
            self._wear(program, rows)
            self.process_s += float(rows[:, DT].sum())
        self.force.forget(horizon_s)
        self.rpm.forget(horizon_s)
        self.set_point.forget(horizon_s)
        self.pace.forget(horizon_s)
        return clocks

    def _together(self, due: Sequence[tuple[str, FloatArray]]) -> Iterator[tuple[str, FloatArray]]:
        """Join the rows of one program: an arm's poses cost as much for a few rows as for a hundred.

        While a second account is open, each report is worn alone, because its begin and its end lie between reports.
        """
        if self.account.way_out is not None or self.account.pit is not None:
            yield from due
            return
        for program, parts in groupby(due, key=lambda item: item[0]):
            yield program, np.vstack([rows for _, rows in parts])

    def _wear(self, program: str, rows: FloatArray) -> None:
        middle = (rows[:, WALL0] + rows[:, WALL1]) / 2.0
        force = self.force.at(middle)
        if not (force > TOUCH_N).any():
            return
        place, axis = self._frames.in_part(rows[:, X:])
        touching = (force > TOUCH_N) & self._within(place, self._shape.under(place))
        if not touching.any():
            return
        begin = self.process_s + np.cumsum(rows[:, DT]) - rows[:, DT]
        rows, force, place, axis, begin = (v[touching] for v in (rows, force, place, axis, begin))
        acting_n = force
        force = force * (1.0 + self._force_noise(rows[:, DT]))
        rpm = self.rpm.at(middle[touching])
        turning = np.where(rpm != 0.0, rows[:, DT], 0.0)
        worked = self.contact_s + np.cumsum(turning) - turning / 2.0
        self.contact_s += float(turning.sum())
        rpm = rpm * self.effects.speed(worked)
        if self.acted is not None:
            self.acted.append(np.column_stack([rows[:, SEQ], rows[:, DT], force, rpm]))
        force = self._true_force(force, place, axis, begin_s=begin, lasts_s=rows[:, DT])
        force = force * self.effects.force(worked)
        if rpm.any():
            self.polished_s = float(rows[-1, WALL1])
        booked = self.account.way_out is not None or self.account.pit is not None
        before = self.part.height_nm.copy() if booked else None
        touches = ContactPoints(place, axis, self._shape.under(place))
        rate = (
            (1.0 - self.config.hidden_truth.tool_wear) * self.hidden.rate_at(begin) * self.effects.rate(place, worked)
        )
        seconds = rows[:, DT] * rate
        self._tool.wear(self.part, touches, self._frames, force_n=force, rpm=rpm, seconds=seconds)
        self._book(program, rows, place, np.stack([force, np.abs(rpm)], axis=1))
        if before is not None:
            removed_nm = before - self.part.height_nm
            self._book_way_out(rows, removed_nm)
            self._book_pit(rows, removed_nm, touches, force=force, acting=acting_n, rpm=rpm, seconds=seconds)

    def mark_way_out(self, at_s: float) -> None:
        """Start a second account, of the cost of leaving contact."""
        nothing = np.zeros_like(self.part.height_nm)
        self.account.way_out = ContactExitRecord(at_s, nothing, nothing.copy(), until_s=at_s)

    def _book_way_out(self, rows: FloatArray, removed_nm: FloatArray) -> None:
        way_out = self.account.way_out
        if way_out is None or rows[0, WALL0] < way_out.from_s:
            return
        seconds, standing = rows[:, DT], rows[:, SEQ] < 0
        way_out.removed_nm += removed_nm
        way_out.contact_s += float(seconds.sum())
        way_out.until_s = float(rows[-1, WALL1])
        if standing.any():
            way_out.standing_s += float(seconds[standing].sum())
            way_out.standing_nm += removed_nm

    def mark_pit(self, at_s: float) -> None:
        """Start another account, of the removal beyond plan; only the first such moment counts."""
        if self.account.pit is None:
            self.account.pit = Pit(at_s, np.zeros_like(self.part.height_nm), until_s=at_s)

    def _book_pit(
        self,
        rows: FloatArray,
        removed_nm: FloatArray,
        touches: ContactPoints,
        *,
        force: FloatArray,
        acting: FloatArray,
        rpm: FloatArray,
        seconds: FloatArray,
    ) -> None:
        """``force`` (n,) is the true one, ``acting`` the actuator's."""
        pit = self.account.pit
        if pit is None or rows[-1, WALL1] < pit.from_s:
            return
        middle = (rows[:, WALL0] + rows[:, WALL1]) / 2.0
        planned = replace(self.part, height_nm=np.zeros_like(self.part.height_nm), patch=None)
        self._tool.wear(
            planned,
            touches,
            self._frames,
            force_n=force * self.set_point.at(middle) / acting,
            rpm=rpm,
            seconds=seconds * np.where(rows[:, SEQ] < 0, 0.0, self.pace.at(middle)),
        )
        pit.excess_nm += removed_nm + planned.height_nm
        pit.contact_s += float(rows[:, DT].sum())
        pit.until_s = float(rows[-1, WALL1])

    def _book(self, program: str, rows: FloatArray, place: FloatArray, acted: FloatArray) -> None:
        """``acted`` (n, 2): force in N and spindle speed in rpm, without its sign."""
        moving = rows[:, SEQ] >= 0
        self.account.dwell(program, rows[moving, SEQ], rows[moving, DT])
        for row, spot, (force_n, rpm) in zip(rows[~moving], place[~moving], acted[~moving].tolist(), strict=True):
            self.account.stand(
                float(spot[0]), float(spot[1]), float(row[WALL1]), float(row[DT]), force_n=force_n, rpm=rpm
            )

    def _within(self, place: FloatArray, local: Local) -> BoolArray:
        grid = self.part.grid
        half_x, half_y = grid.nx * grid.pitch_mm / 2.0, grid.ny * grid.pitch_mm / 2.0
        flat = (np.abs(place[:, 0]) <= half_x) & (np.abs(place[:, 1]) <= half_y)
        if self.config.plant.part_missing:
            flat &= ~self.config.plant.outline.contains(place[:, 0], place[:, 1])
        return np.asarray(flat & (np.abs(self._gap_mm(place, local)) <= REACH_MM))

    def _gap_mm(self, place: FloatArray, local: Local) -> FloatArray:
        """(n,) distance from the part, as it truly lies, up its frame's z to the tool's tip."""
        plant = self.config.plant
        about_x, about_y = (math.tan(math.radians(angle)) for angle in plant.seat_tilt_deg)
        level = place[:, 2] - local.height_mm
        return np.asarray(level - plant.seat_height_mm - about_x * place[:, 1] + about_y * place[:, 0])

    def _true_force(
        self, coil_n: FloatArray, place: FloatArray, axis: FloatArray, *, begin_s: FloatArray, lasts_s: FloatArray
    ) -> FloatArray:
        """(n,) true force for the coil's force: equal to it except for `Lag`."""
        if self._lag is None:
            return coil_n
        local = self._shape.under(place)
        up = local.normal[:, 2] / np.einsum("ni,ni->n", local.normal, axis)
        gap_mm = (self._gap_mm(place, local) + self.effects.height.at(self._frames.in_base(place, axis)[0])[:, 0]) * up
        stiff = self._tool.stiffness_n_per_mm(coil_n, local.curvature_per_mm)
        return self._lag.truly(coil_n, begin_s=begin_s, lasts_s=lasts_s, gap_mm=gap_mm, stiff=stiff)

    def _force_noise(self, seconds: FloatArray) -> FloatArray:
        """Relative force error, correlated over ``force_noise_s`` of process time."""
        hidden_truth = self.config.hidden_truth
        keep = np.exp(-seconds / hidden_truth.force_noise_s)
        kick = hidden_truth.force_noise * np.sqrt(1.0 - keep**2) * self.rng.standard_normal(len(seconds))
        noise = np.empty(len(seconds))
        level = self._noise
        for k, (k_keep, k_kick) in enumerate(zip(keep.tolist(), kick.tolist(), strict=True)):
            level = level * k_keep + k_kick
            noise[k] = level
        self._noise = level
        return noise
