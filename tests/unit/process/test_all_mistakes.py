"""Every way to declare an instrument wrong: 8 turns and flips, 2 signs, 3 factors. Each is detected by a known check.

A part with marks and an artefact are measured by one true instrument. A profile that is wrong by one of the 48
combinations shows them accordingly; what the cell does with such maps is played through the three that watch:
commissioning (the artefact), registration (the marks), and the gate (the removal of a pass planned on such a map).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.outline import Circle
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.process.frames import ORIENTATIONS, ArrayOrientation
from polishd.process.identification.removal_check import check_removal
from polishd.process.metrology.commissioning import artefact_heights, prove_profile
from polishd.process.metrology.instrument import apply_profile
from polishd.process.metrology.registration import register
from tests.unit.process.gaussian import rough
from tests.unit.process.metrology.placed_parts import BUMPS, MARKS_MM, punched, seen_px

GRID = Grid(160, 160, 0.7)
PART = GRID.radius_mm() <= 52
RIGHT = Instrument("shop", fiducials_mm=MARKS_MM, register_by="fiducials")
FIGURE = 200 + rough(GRID, rms_nm=18)
rng = np.random.default_rng(7)
NOISE = [rng.normal(0, 0.3, GRID.shape) for _ in range(3)]


@dataclass(frozen=True)
class Mistake:
    """A profile that is wrong by this."""

    way: ArrayOrientation
    sign: Literal[1, -1]
    factor: float

    @property
    def none(self) -> bool:
        return self == Mistake(ORIENTATIONS[0], 1, 1.0)

    @property
    def profile(self) -> Instrument:
        way = self.way
        return replace(RIGHT, mirror=way.mirror, rotation_deg=way.rotation_deg, sign=self.sign, factor=self.factor)

    def shown(self, height_nm: FloatArray) -> SurfaceMap:
        """What the cell has of a map."""
        return apply_profile(SurfaceMap(height_nm, GRID.pitch_mm), self.profile)

    def __str__(self) -> str:
        return f"{self.way.name}, sign {self.sign:+d}, factor {self.factor:g}"


SIGNS: tuple[Literal[1, -1], ...] = (1, -1)
ALL = [Mistake(way, sign, factor) for way in ORIENTATIONS for sign in SIGNS for factor in (1.0, 0.5, 2.0)]
MARKS_PX = seen_px(MARKS_MM, GRID, 0.4, (0.3, -0.2))
BEFORE = punched(np.where(PART, FIGURE, np.nan), MARKS_PX, 5.0)


def commissioning(mistake: Mistake) -> str:
    try:
        prove_profile(mistake.shown(np.where(PART, artefact_heights(BUMPS, GRID) + NOISE[0], np.nan)), BUMPS)
    except MapError as refused:
        return str(refused)
    return ""


def fiducials(mistake: Mistake) -> str:
    try:
        register(mistake.shown(BEFORE), mistake.profile, Circle(52.0))
    except MapError as refused:
        return str(refused)
    return ""


def gate(mistake: Mistake) -> str:
    """A pass takes off what the map before shows as high, where the machine really is; the map after shows the rest."""
    before = mistake.shown(np.where(PART, FIGURE, np.nan) + NOISE[1])
    predicted = before.height_nm - np.nanmin(before.height_nm) + 20
    after = mistake.shown(np.where(PART, FIGURE - np.where(PART, predicted, 0.0), np.nan) + NOISE[2])
    return check_removal(predicted, before.height_nm - after.height_nm, PART, GRID.pitch_mm).stop


@cache
def caught_by(mistake: Mistake) -> dict[str, str]:
    watchers: tuple[Callable[[Mistake], str], ...] = (commissioning, fiducials, gate)
    said = {watcher.__name__: watcher(mistake) for watcher in watchers}
    return {name: reason for name, reason in said.items() if reason}


@pytest.mark.full
@pytest.mark.parametrize("mistake", ALL, ids=str)
def test_each_mistake_is_caught_by_those_who_can_see_it(mistake: Mistake) -> None:
    expected = set() if mistake.none else {"commissioning", "gate"}
    if mistake.way != ORIENTATIONS[0]:
        expected.add("fiducials")  # marks have no height: they see turns and flips only
    assert set(caught_by(mistake)) == expected


@pytest.mark.one_of_each("mistake.way.mirror", "mistake.sign")
@pytest.mark.parametrize("mistake", [m for m in ALL if not m.none], ids=str)
def test_each_is_called_by_its_name(mistake: Mistake) -> None:
    said = caught_by(mistake)
    turned, negated = mistake.way != ORIENTATIONS[0], mistake.sign < 0
    for name in ("commissioning", "gate"):
        assert (mistake.way.name in said[name].split("as it is")[0]) == turned, said[name]
        assert ("negated" in said[name]) == negated, said[name]
    if turned or negated:
        assert "mirror = false, rotation_deg = 0, sign = 1" in said["commissioning"]
    if mistake.factor != 1:
        assert "factor = 1 in" in said["commissioning"]
        assert f"{mistake.factor:.2f}" in said["gate"] or f"{mistake.factor:.3f}" in said["gate"]
    if mistake.way.mirror:
        assert "mirror image" in said["fiducials"]
    elif turned:
        assert "rotation_deg" in said["fiducials"]


COARSE = Grid(70, 70, 1.6)
X, Y = np.meshgrid(COARSE.x_mm, COARSE.y_mm)
RADIUS = np.hypot(X, Y)
PARTS = {
    "rectangle off the middle": (X > -40) & (X < 30) & (Y > -20) & (Y < 45),
    "D": (RADIUS < 50) & (X < 22),
    "ring with a notch": (RADIUS < 50) & (RADIUS > 18) & ~((X > 0) & (abs(Y - 10) < 6)),
    "triangle": (Y > -35) & (Y < 35 + 1.4 * X) & (Y < 50 - 1.2 * X),
}


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", PARTS)
def test_the_gate_knows_them_on_other_parts(name: str) -> None:
    """Where the part turned over covers half of itself, too: the two are compared where both have data."""
    part, figure = PARTS[name], 200 + rough(COARSE, rms_nm=18, seed=len(name))
    rng = np.random.default_rng(8)
    for mistake in ALL:
        if mistake.factor != (1.0, 0.5, 2.0)[(ORIENTATIONS.index(mistake.way) + mistake.sign) % 3]:
            continue
        maps = [apply_profile(SurfaceMap(np.where(part, figure + rng.normal(0, 0.3, part.shape), np.nan), 1.6),
                            mistake.profile)]  # fmt: skip
        planned = maps[0].height_nm - np.nanmin(maps[0].height_nm) + 20
        rest = figure - np.where(maps[0].valid, planned, 0.0) + rng.normal(0, 0.3, part.shape)
        maps.append(apply_profile(SurfaceMap(np.where(part, rest, np.nan), 1.6), mistake.profile))
        common = part & maps[0].valid
        stop = check_removal(planned, maps[0].height_nm - maps[1].height_nm, common, 1.6).stop
        assert bool(stop) != mistake.none, mistake
        assert mistake.way.name in stop or mistake.way == ORIENTATIONS[0], (mistake, stop)
        assert ("negated" in stop) == (mistake.sign < 0), (mistake, stop)


def test_all_combinations_are_tried() -> None:
    assert len(set(ALL)) == 8 * 2 * 3
    assert [m for m in ALL if m.none] == ALL[:1]


def test_a_removal_that_shows_no_turn_is_not_said_to_be_right() -> None:
    """Where the gate is blind it says so: marks and commissioning then carry the proof."""
    ring = 40 * np.exp(-(((GRID.radius_mm() - 25) / 10) ** 2))
    verdict = check_removal(ring, np.rot90(ring) + NOISE[0], PART, GRID.pitch_mm)
    assert verdict.stop == ""
    assert {way.name for way in ORIENTATIONS[1:]} <= set(verdict.undecidable)
