"""INFORM jobs (.JBI) of the simulated controller: a reader apart from the plugin's.

It reads positions under ``///RECTAN``, MOVL with V in mm/s, MOVJ, TIMER, PAUSE, NOP, END and comments; DOUT, AOUT,
PULSE, MSG and CNVRT change nothing. It shows the instruction in motion, counted from NOP, which is 0.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import takewhile

from polishd.model.errors import ProgramError
from polishd.sim_backends.plc_robot.language import LanguageReader, number_of, tags_of
from polishd.sim_backends.robot.program_reader import SimProgramBlock

_NAME = re.compile(r"[A-Z]+\b")
_POSITION = re.compile(r"([CP]\d+)\s*=(.*)")
_MOVE = re.compile(r"(?:MOVL|MOVJ)\s+([CP]\d+)\s+(.*)")
LINEAR = {"V": "mm/s", "PL": "0 to 8", "ACC": "%", "DEC": "%"}
JOINT = {"VJ": "%", "PL": "0 to 8", "ACC": "%", "DEC": "%"}
NEUTRAL = frozenset({"DOUT", "AOUT", "PULSE", "MSG", "CNVRT"})
PROVED = 2
"""Waits that the driver puts before its first pause."""
MOST_TIMER_S = 655.35


class InformReader(LanguageReader):
    """Reader of one job."""

    axes = (2, 1, 0)  # Rx, Ry, Rz turn about the fixed axes
    order = (2, 1, 0)
    _is_rectangular = False
    _has_name = False
    _runs = False
    """NOP has come."""

    @staticmethod
    def inserted(lines: Sequence[bytes]) -> list[int]:
        """See LanguageReader: pauses, and up to two waits directly before the first one. Other jobs have no pauses."""
        texts = [line.strip() for line in lines]
        pauses = [at for at, text in enumerate(texts) if text == b"PAUSE"]
        if not pauses:
            return []
        first = pauses[0]
        before = takewhile(lambda at: texts[at].startswith(b"TIMER"), range(first - 1, max(first - 1 - PROVED, -1), -1))
        return sorted([*before, *pauses])

    def statement(self, text: str) -> SimProgramBlock:
        """See LanguageReader."""
        if not self._runs:
            self._head(text)
            return self.nothing()
        self.number += 1
        if text.startswith("'"):
            return self.nothing()
        name = found[0] if (found := _NAME.match(text)) else ""
        if name == "END":
            self.ended = True
        if name in {"END", "NOP"} and text != name:
            raise ProgramError(f"cannot read {text!r}")
        if name in NEUTRAL or name in {"END", "NOP"}:
            return self.nothing()
        if name == "TIMER":
            return self._timer(text)
        if text == "PAUSE":
            return SimProgramBlock("pause", self.pose)
        if name in {"MOVL", "MOVJ"}:
            return self._move(text)
        raise ProgramError(f"cannot read {text!r}")

    def _head(self, text: str) -> None:
        """Read a line above the instructions."""
        if text == "NOP":
            if not self._has_name:
                raise ProgramError("NOP before //NAME")
            self._runs = True
        elif text.startswith("//NAME"):
            named = text.removeprefix("//NAME").strip()
            if named.upper() != self.name.upper():
                raise ProgramError(f"the job is named {named!r}, its file {self.name!r}: they must be the same")
            self._has_name = True
        elif text in {"///RECTAN", "///PULSE", "///ANGLE"}:
            self._is_rectangular = text == "///RECTAN"
        elif found := _POSITION.fullmatch(text):
            if self._is_rectangular:
                self.place(found[1], found[2].split(","))
        elif not text.startswith("/"):
            raise ProgramError(f"cannot read {text!r} above NOP")

    def _timer(self, text: str) -> SimProgramBlock:
        tags = tags_of(text.removeprefix("TIMER"), {"T": "s"})
        if "T" not in tags:
            raise ProgramError("TIMER without T=")
        if number_of(tags["T"], "TIMER") > MOST_TIMER_S:
            raise ProgramError(f"TIMER: {tags['T']} s is more than {MOST_TIMER_S} s")
        return self.dwell(tags["T"], "TIMER")

    def _move(self, text: str) -> SimProgramBlock:
        found = _MOVE.fullmatch(text)
        if found is None:
            raise ProgramError(f"cannot read {text!r}")
        is_linear = text.startswith("MOVL")
        tags = tags_of(found[2], LINEAR if is_linear else JOINT)
        if tags.get("PL", "1") not in set("012345678"):
            raise ProgramError(f"PL={tags['PL']}: must be 0 to 8")
        rate = 0.0
        if is_linear:
            if "V" not in tags:
                raise ProgramError("MOVL without V=")
            rate = number_of(tags["V"], "V")
            if rate <= 0.0:
                raise ProgramError("V must be above 0")
        return self.move(found[1], rate, exact=tags.get("PL") == "0")
