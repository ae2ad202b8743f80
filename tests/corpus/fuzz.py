"""Programs for the fuzz: valid lines of each dialect in many styles, lines of the corpus, and damaged ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from random import Random

from tests.corpus.table import cases

_ODD = [b"\0", b"\r", b"\t", b"\xe4", b"\xff", b"(", b")", b";", b"%", b"#", b"[", b"/", b"*", b"$", b"=", b".", b"-",
        b"+", b"e", b"G", b"M", b"P", b"X", b"F", b"O", b"N", b"9" * 30, b" ", b"G4", b"P9", b"@", b":", b'"',
        b"!", b"~"]  # fmt: skip


@dataclass(frozen=True)
class Grammar:
    """How a valid program of a dialect looks."""

    head: str
    dwells: tuple[str, ...]
    """Formats of a dwell of {s} seconds, {ms} whole milliseconds."""
    inverse: bool = True
    tail: str = "M30\n"
    comments: tuple[str, ...] = ("(G4 P9)", "; G4 P8", "(x)")
    rotary: tuple[str, ...] = (" A{:.2f}", " C{:.3f}", "")
    point: bool = False
    """Numbers need a decimal point."""
    seconds_per: float = 60.0


_G21 = "G21 G90 G94 G17\nG0 X0. Y0. Z0. A0. C0.\n"
_TAPE = "%\nO0001 (PART)\n"
GRAMMARS = {
    "rs274": Grammar(_G21, ("G4 P{s}", "g 4 p{s}", "P{s} G4", "G04P{s}", "G4 P {s}"), tail="M2\n"),
    "fanuc": Grammar(_TAPE + _G21, ("G04 P{ms}", "G04 X{s}", "G04 U{s}", "g04p{ms}"), tail="M30\n%\n",
                     comments=("(G04 P9)", "(x)"), point=True),
    "haas": Grammar(_TAPE + _G21, ("G04 P{ms}", "G4 P{s}", "g04p{s}"), tail="M30\n%\n",
                    comments=("(G04 P9)", "(x)"), point=True),
    "siemens": Grammar("G71 G90 G94 G17\nG0 X0 Y0 Z0 A0 C0\n", ("G4 F{s}", "g4 f{s}", "G04 F{s}"),
                       comments=("; G4 F9", ";x (")),
    "siemens-iso": Grammar(_G21, ("G04 P{ms}", "G04 X{s}", "G04 U{s}"), point=True, comments=("(G04 P9)", "(x)")),
    "twincat-nci": Grammar("G71 G90 G17\nG0 X0 Y0 Z0 A0 C0\n", ("G04 X{s}", "G4 F{s}", "g4 x{s}"), inverse=False,
                           comments=("(G04 X9)", "(x)")),
    "twincat-cnc": Grammar("G71 G90 G94 G17\nG0 X0 Y0 Z0 A0 C0\n", ("G04 X{s}", "G04 {s}", "#TIME {s}", "G4 {s}")),
    "grbl": Grammar("G21 G90 G94\nG0 X0 Y0 Z0\n", ("G4 P{s}", "G4P{s}"), tail="M2\n", rotary=("",)),
    "weihong": Grammar(_G21.replace(" A0. C0.", ""), ("G04 P{ms}", "g4 p{ms}"), inverse=False, rotary=("",),
                       point=True),
    "codesys": Grammar("G90 G17\nG0 X0 Y0 Z0\n", ("G4 T{s}", "G4 Time={s}", "g4 t{s}"), inverse=False, rotary=("",),
                       comments=("(G4 T9)", "(x)"), seconds_per=1.0),
}  # fmt: skip


def program(dialect: str, rng: Random, lines: int, damage: float) -> bytes:
    """A program of about so many lines, of which a share was damaged or taken from the corpus."""
    grammar = GRAMMARS[dialect]
    encoding = rng.choice(["dwell", "dwell", "feed", "inverse"] if grammar.inverse else ["dwell", "dwell", "feed"])
    end = rng.choice(["\n", "\n", "\r\n"])
    write = _Lines(grammar, rng, encoding)
    text = grammar.head + ("G93\n" if encoding == "inverse" else "") + write.first()
    body = [line.encode("latin-1") for line in text.splitlines()]
    while len(body) < lines:
        fresh = [line.encode("latin-1") for line in write.point()]
        body += [_spoilt(dialect, line, rng) if rng.random() < damage else line for line in fresh]
    body += [line.encode() for line in grammar.tail.splitlines()]
    joined = end.encode().join(body)
    return joined + (b"" if rng.random() < 0.2 else end.encode())


class _Lines:
    """Writes points, one after the other, in one encoding."""

    def __init__(self, grammar: Grammar, rng: Random, encoding: str) -> None:
        self._grammar, self._rng, self._encoding = grammar, rng, encoding
        self._number = 0
        self._small = rng.random() < 0.15
        self._commented = rng.random()
        self._place = [0.0, 0.0, 0.0]

    def first(self) -> str:
        return f"F{self._feed()}\n" if self._encoding == "feed" else ""

    def point(self) -> list[str]:
        rng, grammar = self._rng, self._grammar
        found = [self._move()]
        if self._encoding == "dwell":
            seconds = rng.choice([0.0, 0.001, rng.uniform(0, 0.01), rng.random(), rng.uniform(0, 100)])
            number = _number(seconds, rng, True)
            found.append(rng.choice(grammar.dwells).format(s=number, ms=int(seconds * 1000)))
        return [self._style(line) for line in found]

    def _move(self) -> str:
        rng = self._rng
        words = []
        for axis, letter in enumerate("XYZ"):
            if axis == 0 or rng.random() < 0.6:
                self._place[axis] += rng.uniform(1.1, 4) * rng.choice([1, -1])
                words.append(letter + _number(self._place[axis], rng, self._grammar.point))
        turned = rng.choice(self._grammar.rotary).format(rng.uniform(0, 90))
        feed = ""
        if self._encoding == "inverse" or rng.random() < 0.4 or self._number == 0:
            feed = f" F{self._feed()}"
        self._number += 1
        return f"{rng.choice(['G1', 'G01', 'G1'])} {' '.join(words)}{turned}{feed}"

    def _feed(self) -> str:
        return _number(self._rng.uniform(0.5, 40) * self._grammar.seconds_per, self._rng, self._grammar.point)

    def _style(self, line: str) -> str:
        rng, comments = self._rng, self._grammar.comments
        if self._small:
            line = line.lower()
        if rng.random() < 0.2 and not line.startswith("#"):
            line = f"N{self._number}0 {line}"
        if rng.random() < self._commented * 0.3:
            line = f"{line} {rng.choice(comments)}"
        return line + rng.choice(["", "", "", " ", "\t"])


def _number(value: float, rng: Random, point: bool) -> str:
    """The value as somebody may write it."""
    text = f"{value:.{rng.randrange(5)}f}"
    if "." not in text:
        text += "." if point or rng.random() < 0.2 else ""
    elif rng.random() < 0.2 and not point:
        text = text.rstrip("0")
    if float(text) == 0:
        text = text.lstrip("-")
    elif rng.random() < 0.1 and text.startswith("0."):
        text = text[1:]
    return text if any(char.isdigit() for char in text) else "0."


@cache
def _corpus(dialect: str) -> list[bytes]:
    return [line for case in cases() if case.dialect == dialect for line in case.text.splitlines() if line.strip()]


def _spoilt(dialect: str, line: bytes, rng: Random) -> bytes:
    kind: Callable[[bytes, Random], bytes] = rng.choice([_cut, _insert, _double, _flip, _swap, _odd])
    return rng.choice(_corpus(dialect)) if rng.random() < 0.25 else kind(line, rng)


def _at(line: bytes, rng: Random) -> int:
    return rng.randrange(len(line) + 1)


def _cut(line: bytes, rng: Random) -> bytes:
    first, last = sorted((_at(line, rng), _at(line, rng)))
    return line[:first] + line[last:]


def _insert(line: bytes, rng: Random) -> bytes:
    at = _at(line, rng)
    return line[:at] + rng.choice(_ODD) + line[at:]


def _double(line: bytes, rng: Random) -> bytes:
    at = _at(line, rng)
    return line[:at] + line[at:] + line[at:]


def _flip(line: bytes, rng: Random) -> bytes:
    at = _at(line, rng)
    return line[:at] + bytes([rng.randrange(256)]).replace(b"\n", b"") + line[at + 1 :]


def _swap(line: bytes, rng: Random) -> bytes:
    words = line.split(b" ")
    rng.shuffle(words)
    return b" ".join(words)


def _odd(line: bytes, rng: Random) -> bytes:
    return rng.choice(_ODD) * rng.randrange(1, 4) + line * rng.randrange(2)
