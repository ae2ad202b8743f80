"""Points and positions of a program in a robot language, as columns: an object for each would take a kilobyte."""

from __future__ import annotations

import math
from array import array
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Generic, Literal, TypeVar

import numpy as np

from polishd.model.program import IntArray
from polishd.model.surface import FloatArray

H = TypeVar("H", bound=Hashable)
NONE = -1
"""No declared position."""


class ValueNumbers(Generic[H]):
    """Values by number, each once: what few values say of many points."""

    def __init__(self) -> None:
        self._number: dict[H, int] = {}

    def of(self, value: H) -> int:
        """The number of a value, a new one where it is new."""
        return self._number.setdefault(value, len(self._number))

    def values(self) -> list[H]:
        """By number."""
        return list(self._number)


Context = tuple[str | None, str | None]
"""Tool and frame, as written."""


@dataclass(slots=True)
class PointColumns:
    """Points in the order of their dwells, n of them; 100 bytes each."""

    xyz_mm: array[float] = field(default_factory=lambda: array("d"))
    """(3 n) where the move leads; of one to a declared position, how far beside it."""
    turn: array[float] = field(default_factory=lambda: array("d"))
    """(k n) orientation in the profile's convention; NaN of a move to a declared position."""
    feed_mm_min: array[float] = field(default_factory=lambda: array("d"))
    time: array[float] = field(default_factory=lambda: array("d"))
    """As written."""
    move_line: array[int] = field(default_factory=lambda: array("q"))
    dwell_line: array[int] = field(default_factory=lambda: array("q"))
    """1-based, where the statement begins."""
    number_line: array[int] = field(default_factory=lambda: array("q"))
    """The line that the dwell's number stands in."""
    start: array[int] = field(default_factory=lambda: array("q"))
    end: array[int] = field(default_factory=lambda: array("q"))
    """Byte offsets of that number."""
    target: array[int] = field(default_factory=lambda: array("l"))
    """Number of the declared position's name; ``NONE`` where the move has its own."""
    context: array[int] = field(default_factory=lambda: array("l"))
    """Number of the move's tool and frame."""
    targets: ValueNumbers[str] = field(default_factory=ValueNumbers)
    contexts: ValueNumbers[Context] = field(default_factory=ValueNumbers)

    def __len__(self) -> int:
        return len(self.time)


class StatedBy(IntEnum):
    """What states the time of a move."""

    APPROACH = -1
    """It is no feed move."""
    UNKNOWN = 0
    """No number."""
    TIME = 1
    """The seconds that the move itself states."""
    RATE = 2
    """The speed that the move itself states."""
    MODAL = 3
    """The speed that was set last."""
    FIXED = 4
    """The name of a speed, which is never rewritten."""


@dataclass(slots=True)
class MoveColumns:
    """All motions in program order, m of them; 150 bytes each. Kept until a dwell shows that dwells carry the time."""

    xyz_mm: array[float] = field(default_factory=lambda: array("d"))
    """(3 m) as of `PointColumns`; NaN where the program does not state it."""
    turn: array[float] = field(default_factory=lambda: array("d"))
    move_line: array[int] = field(default_factory=lambda: array("q"))
    target: array[int] = field(default_factory=lambda: array("l"))
    context: array[int] = field(default_factory=lambda: array("l"))
    targets: ValueNumbers[str] = field(default_factory=ValueNumbers)
    contexts: ValueNumbers[Context] = field(default_factory=ValueNumbers)
    stated: array[int] = field(default_factory=lambda: array("b"))
    """`StatedBy`"""
    number: array[float] = field(default_factory=lambda: array("d"))
    """As written; NaN: none."""
    factor: array[float] = field(default_factory=lambda: array("d"))
    """One unit of it, in s or in mm/min."""
    start: array[int] = field(default_factory=lambda: array("q"))
    end: array[int] = field(default_factory=lambda: array("q"))
    """Byte offsets of the number, of a modal speed in the statement that set it; -1: none."""
    here: array[int] = field(default_factory=lambda: array("q"))
    there: array[int] = field(default_factory=lambda: array("q"))
    """Byte offsets that enclose what states the time; -1: the move has no such location."""
    begin: array[int] = field(default_factory=lambda: array("q"))
    until: array[int] = field(default_factory=lambda: array("q"))
    """Byte offsets of the statement."""
    stops: array[int] = field(default_factory=lambda: array("b"))
    arc: array[int] = field(default_factory=lambda: array("b"))
    feed_of: array[int] = field(default_factory=lambda: array("l"))
    """Number of the name that the move's speed is set by; ``NONE``: no name."""
    names: ValueNumbers[str] = field(default_factory=ValueNumbers)
    dwell: array[int] = field(default_factory=lambda: array("q"))
    """Number of the point whose dwell stands behind the move; ``NONE``: no dwell."""

    def __len__(self) -> int:
        return len(self.stated)


@dataclass(slots=True)
class Positions:
    """Declared positions by name, in the order of their declaration."""

    number: dict[str, int] = field(default_factory=dict)
    """By name, folded where the language ignores case."""
    xyz_mm: array[float] = field(default_factory=lambda: array("d"))
    turn: array[float] = field(default_factory=lambda: array("d"))
    line: array[int] = field(default_factory=lambda: array("q"))
    context: array[int] = field(default_factory=lambda: array("l"))
    contexts: ValueNumbers[Context] = field(default_factory=ValueNumbers)

    def __contains__(self, name: object) -> bool:
        return name in self.number

    def add(self, name: str, place: WrittenPose, line: int, context: Context) -> None:
        """One more, of a new name."""
        self.number[name] = len(self.line)
        self.xyz_mm.extend(place.xyz_mm)
        self.turn.extend(place.turn)
        self.line.append(line)
        self.context.append(self.contexts.of(context))


@dataclass(frozen=True, slots=True)
class WrittenPose:
    """A pose as written: position in mm, orientation in the profile's convention."""

    xyz_mm: tuple[float, float, float]
    turn: tuple[float, ...]


def table(column: array[float], rows: int) -> FloatArray:
    """A column of so many rows as (rows, k); the same memory."""
    return np.frombuffer(column, dtype=np.float64).reshape(rows, -1) if rows else np.zeros((0, 3))


def numbers(column: array[int]) -> IntArray:
    """A column of whole numbers, (n,)."""
    return np.array(column, dtype=np.int64)


# From how a robot language writes an orientation to the tool axis.

Convention = Literal["quaternion", "euler_deg", "rotation_vector_rad", "rotary_deg", "vector"]

UNIT_WITHIN = 1e-3
"""How far a quaternion's norm may be from 1: the rounding of three or more written digits, and no more."""


def is_rotation(convention: Convention, values: Sequence[float]) -> bool:
    """Whether the numbers (2 to 4) of one orientation are one: finite, a quaternion or vector of unit length."""
    if not all(map(math.isfinite, values)):
        return False
    if convention == "vector":
        return abs(math.hypot(*values) - 1) <= UNIT_WITHIN
    return convention != "quaternion" or abs(math.hypot(*values) - 1) <= UNIT_WITHIN


def _z_of_quaternion(w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """(n, 3) the z axis turned by unit quaternions."""
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z], axis=1)


def _turned_z(axes: str, angle_rad: FloatArray) -> FloatArray:
    """(n, 3) the z axis turned by (n, k) angles about k axes: turned ones in upper case, fixed ones in lower case."""
    turned = [np.zeros(len(angle_rad)), np.zeros(len(angle_rad)), np.ones(len(angle_rad))]
    about = list(zip(axes.upper(), angle_rad.T, strict=True))
    for axis, angle in reversed(about) if axes.isupper() else about:
        i = "XYZ".index(axis)
        sine, cosine, one, other = np.sin(angle), np.cos(angle), (i + 1) % 3, (i + 2) % 3
        turned[one], turned[other] = (
            cosine * turned[one] - sine * turned[other],
            sine * turned[one] + cosine * turned[other],
        )
    return np.stack(turned, axis=1)


def tool_axis(convention: Convention, axes: str, values: FloatArray, *, tool_z_into_part: bool) -> FloatArray:
    """Unit tool axis (n, 3), from the tip into the spindle, of n orientations.

    A ``vector`` is the tool's z itself; ``rotary_deg`` are two rotary axes, ``axes`` CA: Rz(C) Rx(A) (0, 0, 1).

    ``values`` is (n, 4) for quaternions (scalar first) and (n, 3) otherwise; ``axes`` are those of Euler angles in
    degrees, in the order of ``values``, upper case for turned axes (``ZYX``: KUKA's A, B, C), lower for fixed ones
    (``xyz``: FANUC's W, P, R). The tool's z is the rotation's third column; it
    mostly points from the tip into the part.
    """
    # Only this column is computed: scipy's rotations are matrices, and their import takes longer than a program.
    found: FloatArray
    if convention == "vector":
        found = values / np.linalg.norm(values, axis=1, keepdims=True)
    elif convention == "quaternion":
        found = _z_of_quaternion(*(values / np.linalg.norm(values, axis=1, keepdims=True)).T)
    elif convention == "rotation_vector_rad":
        half = np.linalg.norm(values, axis=1, keepdims=True) / 2
        found = _z_of_quaternion(np.cos(half[:, 0]), *(np.sinc(half / np.pi) / 2 * values).T)
    else:
        found = _turned_z(axes.translate(str.maketrans("ABC", "XYZ")), np.radians(values))
    return np.negative(found, out=found) if tool_z_into_part else found
