"""VAL3 programs (.pgx) of the simulated controller: a reader apart from the plugin's.

It reads positions as ``p.trsf={...}``, movel and movej, ``mdesc.tvel`` and ``mdesc.blend``, waitEndMove and delay, and
the calls of polPause and polDwell that polishd adds. It shows how many moves and calls began (getMoveId counts moves).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from polishd.model.errors import ProgramError
from polishd.sim_backends.plc_robot.language import LanguageReader, number_of
from polishd.sim_backends.robot.program_reader import SimProgramBlock

_NAME = r"[A-Za-z_]\w*(?:\[\d+\])?"
_PLACE = re.compile(rf"({_NAME})\.trsf\s*=\s*\{{([^{{}}]*)\}}")
_FIELD = re.compile(rf"({_NAME})\.(\w+)\s*=\s*([-+.\w]+)")
_CALL = re.compile(r"(\w+)\s*\(([^()]*)\)")
_XML = re.compile(r"<[^<>!]*>|<!\[CDATA\[|\]\]>")
NEUTRAL = frozenset({"resetMotion", "putln", "put", "userPage", "cls", "title"})
LIMITS = frozenset({"vel", "accel", "decel", "rvel", "leave", "reach"})
BLENDS = frozenset({"off", "joint", "cartesian", "Cartesian"})


class Val3Reader(LanguageReader):
    """Reader of one program."""

    axes = (0, 1, 2)  # rx, ry, rz turn about X, the new Y, the new Z
    order = (0, 1, 2)
    _runs = False
    _waited = True
    """waitEndMove has come since the last move."""

    def __init__(self, pose: tuple[float, float, float, float, float], name: str) -> None:
        """See LanguageReader."""
        super().__init__(pose, name)
        self._speeds: dict[str, float] = {}
        self._exact: dict[str, bool] = {}

    @staticmethod
    def inserted(lines: Sequence[bytes]) -> list[int]:
        """See LanguageReader: calls."""
        return [at for at, line in enumerate(lines) if line.strip().startswith(b"call ")]

    def statement(self, text: str) -> SimProgramBlock:
        """See LanguageReader."""
        text = _XML.sub("", text).partition("//")[0].strip()
        if not text:
            return self.nothing()
        if not self._runs:
            if text != "begin":
                raise ProgramError(f"cannot read {text!r} before begin")
            self._runs = True
            return self.nothing()
        if text == "end":
            self.ended = True
            return self.nothing()
        if found := _PLACE.fullmatch(text):
            self.place(found[1], found[2].split(","))
            return self.nothing()
        if found := _FIELD.fullmatch(text):
            self._set(*found.groups())
            return self.nothing()
        if text.startswith("call "):
            return self._call(text.removeprefix("call ").strip())
        found = _CALL.fullmatch(text)
        if found is None:
            raise ProgramError(f"cannot read {text!r}")
        return self._instruction(found[1], [part.strip() for part in found[2].split(",")] if found[2].strip() else [])

    def _set(self, name: str, field: str, value: str) -> None:
        if field == "tvel":
            speed = number_of(value, f"{name}.tvel")
            if speed <= 0.0:
                raise ProgramError(f"{name}.tvel must be above 0")
            self._speeds[name] = speed
        elif field == "blend" and value in BLENDS:
            self._exact[name] = value == "off"
        elif field in LIMITS:
            number_of(value, f"{name}.{field}")
        else:
            raise ProgramError(f"cannot read {name}.{field}={value}")

    def _call(self, text: str) -> SimProgramBlock:
        """Call a program of the resident application: both wait for the end of the motion first."""
        found = _CALL.fullmatch(text)
        if found is None or found[1] not in {"polPause", "polDwell"} or (found[1] == "polPause" and found[2].strip()):
            raise ProgramError(f"call {text}: this program is not known")
        self.number += 1
        self._waited = True
        return SimProgramBlock("pause", self.pose) if found[1] == "polPause" else self.dwell(found[2], "polDwell")

    def _instruction(self, name: str, arguments: list[str]) -> SimProgramBlock:
        if name in {"movel", "movej"}:
            return self._move(name, arguments)
        if name == "waitEndMove" and not arguments:
            self._waited = True
            return self.nothing(exact=True)
        if name == "delay" and len(arguments) == 1:
            if not self._waited:
                raise ProgramError("delay does not wait for the end of the motion: waitEndMove() must be before it")
            return self.dwell(arguments[0], "delay")
        if name in NEUTRAL:
            return self.nothing()
        raise ProgramError(f"cannot read {name}({', '.join(arguments)})")

    def _move(self, name: str, arguments: list[str]) -> SimProgramBlock:
        if len(arguments) != 3:
            raise ProgramError(f"{name} has {len(arguments)} arguments, not 3")
        target, _tool, mdesc = arguments
        if name == "movel" and mdesc not in self._speeds:
            raise ProgramError(f"{mdesc}.tvel is not set in the program")
        self._waited = False
        self.number += 1
        rate = self._speeds[mdesc] if name == "movel" else 0.0
        return self.move(target, rate, exact=self._exact.get(mdesc, False))
