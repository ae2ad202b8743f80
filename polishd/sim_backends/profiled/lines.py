"""A profile's requests and answers, as a device on lines of text has them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from string import Formatter
from typing import Any

from polishd.sim_backends.actuator import ascii as numbered
from polishd.sim_backends.profiled.machine import ProfileDeviceModel
from polishd.sim_backends.profiled.sheet import SimDeviceProfile

FORMATS = ("{:.3f}", "{:.2f}", "{:.1f}", "{:.0f}", "{:+.3f}", "{:+.2f}", "{:+.1f}")
NUMBER = r"([-+]?\d+(?:\.\d+)?)"
TEXTS = {"range": "value out of range", "fault": "a fault is set", "unknown": "no such request"}


@dataclass(slots=True)
class LineSlave:
    """Answers each line by one line, or none where the profile says so."""

    sheet: SimDeviceProfile
    machine: ProfileDeviceModel
    _buffer: bytes = b""
    _asked: dict[str, float] = field(default_factory=dict)

    @property
    def table(self) -> Mapping[str, Any]:
        """``[lines]``."""
        table: Mapping[str, Any] = self.sheet.raw["lines"]
        return table

    def feed(self, data: bytes, _now_s: float) -> Iterable[tuple[int, bytes]]:
        """(bytes of the request, answer) for each whole request."""
        end = self.table.get("ending", "\r\n").encode()[-1:]
        self._buffer += data
        while end in self._buffer:
            raw, self._buffer = self._buffer.split(end, 1)
            answer = self._framed(raw.strip(b"\r\n"))
            if answer is not None:
                yield len(raw) + 1, answer
        self._buffer = self._buffer[-numbered.MAX_LINE :]

    def _framed(self, raw: bytes) -> bytes | None:
        if self.table.get("framing") != "numbered":
            answer = self._answer(raw.decode("latin-1"))
            return None if answer is None else answer.encode() + self.table.get("answer_ending", "\r\n").encode()
        number, _, request = (numbered.body(raw) or "").partition(",")
        answer = self._answer(request) if number.isdigit() else None
        return None if answer is None else numbered.line(f"{number},{answer}")

    def _answer(self, request: str) -> str | None:
        machine = self.machine
        machine.heard()
        for ask in self.sheet.raw["asks"].values():
            if ask["send"] == request:
                words = self.sheet.words(machine.values(), machine.state(), silent=machine.watchdog_fault())
                return spoken(ask["answer"], words)
        refusal = self._order(request)
        if refusal:
            why = TEXTS[refusal]
            refused = self.table.get("refused", "")
            return spoken(refused, {"why": f"{refusal},{why}"}) if refused else f"?{why}"
        accepted = self.table.get("accepted", "OK")
        return spoken(accepted, {}) if accepted else None

    def _order(self, request: str) -> str:
        """Do what the request orders; why not, where it does not."""
        for name, steps in sorted(self.sheet.orders(), key=lambda one: "{" in one[1][-1]):
            for at, step in enumerate(steps):
                match = re.fullmatch(pattern(step), request)
                if match is None:
                    continue
                if match.groups():
                    self._asked[name] = float(match[1])
                if at == len(steps) - 1:
                    return self.machine.order(name, self._asked.get(name, 0.0))
                return ""
        return "unknown"


def pattern(step: str) -> str:
    """A regular expression of what a step sends."""
    parts = Formatter().parse(step)
    return "".join(re.escape(text) + (NUMBER if slot is not None else "") for text, slot, _, _ in parts)


def spoken(regex: str, words: Mapping[str, float | str]) -> str:
    """A text that the expression fits, with these words in its named groups; all else in it must be plain."""
    said, at = "", 0
    while at < len(regex):
        if regex.startswith("(?P<", at):
            end = _closed(regex, at)
            name, inner = regex[at + 4 : end].split(">", 1)
            said += _formatted(words.get(name, 0), inner)
            at = end + 1
        elif regex[at] == "\\":
            said += regex[at + 1]
            at += 2
        elif regex[at] in "([{*+?|.":
            raise ValueError(f"the simulator cannot make up a text that {regex!r} fits")
        else:
            said += regex[at]
            at += 1
    return said


def _closed(regex: str, start: int) -> int:
    """Where the bracket that opens there closes."""
    depth, at = 0, start
    while True:
        if regex[at] == "\\":
            at += 1
        elif regex[at] in "()":
            depth += 1 if regex[at] == "(" else -1
            if depth == 0:
                return at
        at += 1


def _formatted(value: float | str, inner: str) -> str:
    texts = [value] if isinstance(value, str) else [form.format(value) for form in FORMATS]
    fitting = [text for text in texts if re.fullmatch(inner, text)]
    if not fitting:
        raise ValueError(f"the simulator cannot say {value!r} as {inner!r}")
    return fitting[0]
