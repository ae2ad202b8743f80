"""Write a program along a path in a robot language, by the texts of its profile."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count

import numpy as np
import scipy

from polishd.api import ProgramError
from polishd.model.program import Encoding
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.languages.columns import is_rotation
from polishd.plugins.rnc_robot.languages.move_times import (
    MISFIT,
    WrittenNumber,
    carried_speed,
    misfit,
    time_number,
    unnumbered,
)
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile, MakeForm, MoveTime
from polishd.process.frames import angles_from_axis

AT = re.compile("<at[05]?>")
FIELD = re.compile(r"<([a-z_][a-z0-9_]*)>")
SAFE_Z_MM = 20.0


@dataclass(frozen=True, slots=True)
class PathTimes:
    """What is asked of the moves of a path."""

    encoding: Encoding
    feed_mm_min: FloatArray
    """(n - 1,) of the move to each point but the first."""
    dwell_s: FloatArray
    """(n - 1,) waits, where they carry the time."""


def orientations(profile: LanguageProfile, axis: FloatArray) -> FloatArray:
    """(n, k) orientations, as the profile writes them, of tools with these axes (n, 3), from the tip into the spindle.

    Each is turned out of the upright orientation by the least rotation.
    """
    notation = profile.orientation
    into = notation.tool_z == "into_part"
    down = -1.0 if into else 1.0
    z = down * axis
    upright = np.array([0.0, 0.0, down])
    turn = np.cross(upright, z)
    sine = np.linalg.norm(turn, axis=1, keepdims=True)
    angle = np.arctan2(sine, (z @ upright)[:, None])
    unit = np.divide(turn, sine, out=np.tile([1.0, 0.0, 0.0], (len(z), 1)), where=sine > 1e-12)
    turns = scipy.spatial.transform.Rotation  # its import is slow: only here
    rotation = turns.from_rotvec(unit * angle) * (
        turns.from_euler("x", 180, degrees=True) if into else turns.identity()
    )
    if notation.convention == "vector":
        return z
    if notation.convention == "rotary_deg":
        if notation.axes != "CA":
            raise ProgramError(f"no programs are made with the rotary axes {notation.axes}. To do: take CA.")
        return np.stack(angles_from_axis(z)[::-1], axis=1)
    if notation.convention == "quaternion":
        return np.asarray(rotation.as_quat(canonical=True)[:, [3, 0, 1, 2]])
    if notation.convention == "euler_deg":
        with warnings.catch_warnings():  # of an upright tool the third angle is zero where the axes are ZYZ
            warnings.filterwarnings("ignore", message="Gimbal lock", category=UserWarning)
            return np.asarray(rotation.as_euler(notation.axes, degrees=True))
    return np.asarray(rotation.as_rotvec())


def language_program(
    profile: LanguageProfile, points_mm: FloatArray, axis: FloatArray, times: PathTimes, name: str
) -> bytes:
    """A program to above the first of (n, 3) points, down to it, along the points, and up from the last.

    ProgramError where the language writes no programs, or where it cannot state a time.
    """
    form, rules = profile.make, profile.move_time
    if form is None or rules is None:
        raise ProgramError(
            f"{name}: no programs are made in {profile.name}. To do: take another dialect, or add [make] and "
            "[move_time] to your own profile."
        )
    return _Maker(profile, form, rules, times, name, count(rules.first_number)).text(points_mm, axis)


@dataclass(slots=True)
class _Maker:
    profile: LanguageProfile
    form: MakeForm
    rules: MoveTime
    times: PathTimes
    name: str
    numbers: Iterator[int]
    """Of the lines."""
    positions: list[str] = field(default_factory=list)
    residue_s: float = 0.0
    holds: bytes = b""
    """The speed that was set last."""

    def text(self, points_mm: FloatArray, axis: FloatArray) -> bytes:
        """The whole program."""
        form, units = self.form, points_mm / self.profile.unit_mm
        turns = np.round(orientations(self.profile, axis), form.turn_decimals) + 0.0
        places = np.round(units, form.decimals) + 0.0
        bad = [k for k, turn in enumerate(turns.tolist()) if not is_rotation(self.profile.orientation.convention, turn)]
        if bad:
            raise ProgramError(f"{self.name}: point {bad[0]}: {form.turn_decimals} decimals leave no rotation.")
        length = np.linalg.norm(np.diff(places, axis=0), axis=1) * self.profile.unit_mm
        if not (length > 0).all():
            at = int(np.argmin(length))
            raise ProgramError(f"{self.name}: points {at} and {at + 1} are one place: no speed states its time.")
        above = [places[k] + [0, 0, round(SAFE_Z_MM / self.profile.unit_mm, form.decimals)] for k in (0, -1)]
        comment = re.sub(r"[^ -~]|[()<>]", "_", f"{self.name}: {len(places)} points")[:60]
        head = self._filled(form.head, {"comment": comment})
        body = [
            self._filled(form.approach, self._pose(above[0], turns[0])),
            self._filled(form.travel, self._pose(places[0], turns[0])),
        ]
        for k, way in enumerate(length.tolist()):
            body += self._move(k, way, self._pose(places[k + 1], turns[k + 1]))
        body.append(self._filled(form.travel, self._pose(above[1], turns[-1])))
        tail = self._filled(form.tail, {})
        text = "".join(part.strip("\n") + "\n" for part in [head, *body, tail])
        counts = {"<count>": str(next(self.numbers) - 1), "<npos>": str(len(self.positions))}
        for what, value in {"<positions>": "".join(self.positions), **counts}.items():
            text = text.replace(what, value)
        self._require_lines(len(body))
        return (text.replace("\n", "\r\n") if form.ending == "crlf" else text).encode("ascii")

    def _require_lines(self, lines: int) -> None:
        limit = self.profile.line_limit
        if limit and lines > limit:
            raise ProgramError(
                f"{self.name}: {lines} lines in the program, the controller takes {limit}. "
                "To do: make longer steps, or several programs."
            )

    def _filled(self, form: str, values: Mapping[str, str]) -> str:
        """A text with its fields filled in; ``<positions>`` and ``<count>`` are filled in at the end."""
        known = {
            "program": self.form.name, "tool": self.form.tool, "frame": self.form.frame,
            "positions": "<positions>", "count": "<count>", "npos": "<npos>", "zone": self.form.stop, "timing": "",
            "feed_of": self.form.feed_of, **values,
        }  # fmt: skip

        def value(match: re.Match[str]) -> str:
            if match[1] == "n":
                return f"{next(self.numbers):4d}"
            if match[1] not in known:
                raise ProgramError(f"{self.profile.name}: make: the field <{match[1]}> is not known. To do: remove it.")
            return known[match[1]]

        if AT.search(form):
            known |= {
                "at": str(len(self.positions) + 1),
                "at5": f"{len(self.positions) + 1:05d}",
                "at0": str(len(self.positions)),
            }
            self.positions.append("")
            self.positions[-1] = FIELD.sub(value, self.form.position).lstrip("\n")
        return FIELD.sub(value, form)

    def _pose(self, place: FloatArray, turn: FloatArray) -> dict[str, str]:
        form, names, sign = self.form, self.profile.orientation.fields, "+" if self.form.signs else ""
        pose = {axis: f"{number:{sign}.{form.decimals}f}" for axis, number in zip("xyz", place.tolist(), strict=True)}
        return pose | {
            each: f"{number:{sign}.{form.turn_decimals}f}" for each, number in zip(names, turn.tolist(), strict=True)
        }

    def _move(self, k: int, length_mm: float, pose: dict[str, str]) -> list[str]:
        """The lines of one timed move."""
        rules, form, encoding = self.rules, self.form, self.times.encoding
        waits = encoding == "dwell"
        pose["zone"] = form.stop if waits else form.blend
        new_s = 60 * length_mm / float(self.times.feed_mm_min[k])
        if encoding == "time":
            number = self._kept(k, length_mm, new_s, self._time(new_s), None)
            self._require_form(rules.time, "time of a move")
            pose["timing"] = rules.time.replace("<t>", number.plain.decode())
            return [self._filled(form.move, pose)]
        factor = self.profile.feed_units_mm_min[rules.speed_unit]
        number = carried_speed(rules, length_mm, new_s, 0.0 if waits else self.residue_s, factor)
        self._kept(k, length_mm, new_s, number, factor, carry=not waits)
        before = []
        if rules.feed_line:
            if number.plain != self.holds:
                before, self.holds = (
                    [self._statement(rules.feed_line, {"feed": number.plain.decode()})],
                    number.plain,
                )
        else:
            self._require_form(rules.feed, "speed of a move")
            pose["timing"] = rules.feed.replace("<feed>", number.plain.decode())
        lines = [*before, self._filled(form.move, pose)]
        return [*lines, self._wait(k)] if waits else lines

    @property
    def _indent(self) -> str:
        """Blanks before a statement beside the moves."""
        return self.form.move[: len(self.form.move) - len(self.form.move.lstrip())]

    def _time(self, new_s: float) -> WrittenNumber:
        unit_s = self.rules.units_s.get(self.rules.time_unit, 1.0)
        return time_number(self.rules.quantum_s, unit_s, new_s + self.residue_s)

    def _require_form(self, form: str, what: str) -> None:
        if not form:
            raise ProgramError(
                f"{self.name}: {self.profile.name} has no form of the {what}. To do: take another --encoding."
            )

    def _kept(
        self, k: int, length_mm: float, new_s: float, number: WrittenNumber, factor: float | None, *, carry: bool = True
    ) -> WrittenNumber:
        if reason := misfit(self.rules, length_mm, new_s, number, factor):
            raise ProgramError(f"{self.name}: point {k + 1}: {reason}. To do: {MISFIT}.")
        if carry:
            self.residue_s += new_s - number.time_s
        return number

    def _wait(self, k: int) -> str:
        dwell, new_s = self.profile.dwell, float(self.times.dwell_s[k])
        self._require_form(self.rules.wait, "wait")
        if not dwell.quantum_s <= new_s <= dwell.max_s:
            raise ProgramError(
                f"{self.name}: dwells of {new_s:g} s: {self.profile.name} takes {dwell.quantum_s:g} to "
                f"{dwell.max_s:g} s. To do: ask for such."
            )
        number = time_number(dwell.quantum_s, dwell.unit_s, new_s + self.residue_s)
        self.residue_s += new_s - number.time_s
        return self._statement(self.rules.wait, {"time": number.plain.decode()})

    def _statement(self, form: str, values: Mapping[str, str]) -> str:
        """A statement beside the moves, indented and numbered as they are."""
        form = form if "<n>" in self.form.move else unnumbered(form)
        return "\n".join(self._indent + line for line in self._filled(form.strip("\n"), values).split("\n"))
