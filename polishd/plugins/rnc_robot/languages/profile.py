"""The profile of a robot language: everything in which one differs from another, as strict data."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal, NamedTuple, get_args

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polishd.plugins.rnc_robot.languages.columns import Convention

# The notation of statement templates: ``MoveL <target>,<speed>,<zone>,<tool><? \WObj:=<frame>?>;``.

# Possessive: a long run of digits or letters is gone over once, however a template goes on.
NUMBER = r"[-+]?(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][-+]?[0-9]++)?+"
NAME = r"[A-Za-z_][A-Za-z0-9_]*+"

_TOKEN = re.compile(
    r"(?P<open><\?)|(?P<close>\?>)|<(?P<field>[a-z_][a-z0-9_]*)>|<(?P<choice>\w+(?:\|\w+)+)>"
    r"|(?P<blank>[ ]+)|(?P<word>\w+)|(?P<mark>.)"
)
_WORDY = ("field", "choice", "word")
MARKERS = frozenset({"here", "there"})
"""Fields of no length: a move's speed or time is written between them."""


@dataclass(frozen=True, slots=True)
class Writing:
    """How a language is written, as far as all its templates share it."""

    ignore_case: bool
    span_lines: bool
    comments: Sequence[str]
    numbers: frozenset[str]
    """Names of the fields that are numbers."""
    fields: Mapping[str, str]
    """Regular expressions of fields that are neither numbers nor names."""


def compiled(template: str, writing: Writing) -> re.Pattern[bytes]:
    """The regular expression of one template, a group for each field. re.error where it or a field is none."""
    blank = r"[ \t\r\n]" if writing.span_lines else r"[ \t]"
    tokens = [(match.lastgroup or "", match[match.lastgroup or 0]) for match in _TOKEN.finditer(template.strip())]
    parts = [_part(index, tokens, blank, writing) for index in range(len(tokens))]
    if tokens[-1:] != [("mark", ";")]:
        ends = "|".join([r"\r?\n", r"\Z", *map(re.escape, writing.comments)])
        parts.append(rf"[ \t]*+(?={ends})")
    flags = re.IGNORECASE if writing.ignore_case else re.NOFLAG
    return re.compile("".join(parts).encode(), flags)


def _part(index: int, tokens: Sequence[tuple[str, str]], blank: str, writing: Writing) -> str:
    kind, text = tokens[index]
    match kind:
        case "open":
            return "(?:"
        case "close":
            return ")?"
        case "blank":
            between = _wordy(tokens[index - 1 :: -1]) and _wordy(tokens[index + 1 :])
            return f"{blank}{'++' if between else '*+'}"
        case "field":
            if text in MARKERS:
                return f"(?P<{text}>)"
            default = NUMBER if text in writing.numbers else NAME
            return f"(?P<{text}>{writing.fields.get(text, default)})"
        case "choice":
            return f"(?:{text})"
        case "word":
            return text
    if text in "<>":
        raise re.error(f"{text} belongs to no field, choice or <? ... ?>")
    last = index == len(tokens) - 1
    return f"{blank}*+{re.escape(text)}" + ("" if last else f"{blank}*+")


def _wordy(tokens: Sequence[tuple[str, str]]) -> bool:
    """Whether the nearest token is a word, number or field, whatever may be there or not in between."""
    between = {"open", "close"}
    nearest = next((kind for kind, text in tokens if kind not in between and text not in MARKERS), "mark")
    return nearest in _WORDY


Kind = Literal[
    "move", "dwell", "dwell_in_position", "approach", "position", "speed", "context", "neutral", "begin", "end", "run",
    "call", "finish", "assumed", "refused",
]  # fmt: skip
TAKEN: tuple[Kind, ...] = get_args(Kind)[:-2]
"""What a language's statements may be, in the order in which their templates are tried."""
Text = Annotated[str, Field(min_length=1)]
Templates = list[Text]
MOST_DECIMALS = 9
"""Of a dwell's number."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


class OrientationNotation(_Strict):
    """How an orientation is written."""

    convention: Convention
    fields: list[Text]
    """Names of the fields: scalar first for a quaternion, in the order of ``axes`` for Euler angles."""
    axes: str = ""
    """Of Euler angles: three of XYZ about turned axes, or of xyz about fixed ones; of rotary axes: two of ABC, the
    outermost first."""
    tool_z: Literal["into_part", "out_of_part"] = "into_part"
    """Where the tool frame's z points."""

    @model_validator(mode="after")
    def _complete(self) -> OrientationNotation:
        count = {"quaternion": 4, "rotary_deg": 2}.get(self.convention, 3)
        if len(self.fields) != count:
            raise ValueError(f"{self.convention} has {count} fields")
        form = {"euler_deg": "[XYZ]{3}|[xyz]{3}", "rotary_deg": "[ABC]{2}"}.get(self.convention, "")
        if not re.fullmatch(form, self.axes):
            raise ValueError(
                "axes: three of XYZ (turned) or xyz (fixed) with euler_deg, two of ABC with rotary_deg, none otherwise"
            )
        return self


class Dwell(_Strict):
    """What a dwell's number means, and how finely and how far it may be written."""

    unit_s: float = Field(1.0, ge=1e-9, le=1e6)
    quantum_s: float = Field(ge=1e-9, le=1e3)
    """Step of the times that are written: as fine as numbers go, or the cycle that the controller ends a dwell with."""
    max_s: float = Field(float("inf"), gt=0)
    fly_by: Literal["refuse", "warn"] = "refuse"
    """What to do with a dwell after a move that need not stop: ``warn`` where the controller stops there anyway."""

    @model_validator(mode="after")
    def _decimal(self) -> Dwell:
        if not self._whole(self.decimals):
            raise ValueError(f"quantum_s: a number of unit_s with at most {MOST_DECIMALS} decimals")
        return self

    @property
    def decimals(self) -> int:
        """Decimals of a number that resolves one quantum."""
        decimals = 0
        while decimals < MOST_DECIMALS and not self._whole(decimals):
            decimals += 1
        return decimals

    @property
    def steps(self) -> int:
        """One quantum, in units of the last of these decimals."""
        return round(self.quantum_s / self.unit_s * 10.0**self.decimals)

    def _whole(self, decimals: int) -> bool:
        steps = self.quantum_s / self.unit_s * 10.0**decimals
        return round(steps) > 0 and abs(steps - round(steps)) < 1e-6


class MoveTime(_Strict):
    """How a move states its time, what may be written of it, and what the blend at its end does to it.

    ``time``, ``feed``, ``feed_line`` and ``wait`` are texts with fields ``<t>``, ``<feed>``, ``<time>`` and ``<n>`` (a
    line's number); empty: the language, or this controller, has no such form.
    """

    units_s: dict[str, Annotated[float, Field(ge=1e-9, le=1e6)]] = Field(default_factory=lambda: {"": 1.0})
    """One written unit of ``t`` by what the field ``t_unit`` holds (lower case; "" where there is none)."""
    time_unit: str = ""
    """Key of ``units_s``: the unit of a ``t`` that is written anew."""
    quantum_s: float = Field(0.001, ge=1e-9, le=1e3)
    """Step of a written ``t``, s."""
    speed_quantum: float = Field(ge=1e-12, le=1e3)
    """Step of a written speed, in its unit."""
    speed_unit: str = ""
    """Key of ``feed_units_mm_min``: the unit of a speed that is written anew."""
    fixed_feeds: bool = False
    """The field ``feed`` is the name of a constant: another speed is written between <here> and <there>."""
    feed_holds: bool = False
    """The speed of a move holds for the moves behind it that state none."""
    least_mm_s: float = Field(gt=0)
    greatest_mm_s: float = Field(gt=0)
    """Least and greatest speed of a timed move. A faster move leads in, out or across, and is no point."""
    blend_share: float = Field(0.0, ge=-0.5, le=1.0)
    """Time that the blend at a move's end adds, as a share of the move's time; negative where it saves time."""
    time: str = ""
    """A move's time, between <here> and <there>."""
    feed: str = ""
    """A move's speed, between <here> and <there>."""
    feed_line: str = ""
    """A statement before a move that sets the speed from there on."""
    wait: str = ""
    """A statement behind a move."""
    first_number: int = Field(1, ge=0, le=1)
    """Number of the first line, where lines are numbered."""
    numbered_lines: str = ""
    """Regular expression of the head's count of numbered lines, the count in a group: it is written anew."""

    @model_validator(mode="after")
    def _sound(self) -> MoveTime:
        if self.least_mm_s >= self.greatest_mm_s:
            raise ValueError("least_mm_s: must be less than greatest_mm_s")
        for name, field in (("time", "<t>"), ("feed", "<feed>"), ("feed_line", "<feed>"), ("wait", "<time>")):
            text = getattr(self, name)
            if text and text.count(field) != 1:
                raise ValueError(f"{name}: needs the field {field} once")
        if self.numbered_lines and re.compile(self.numbered_lines.encode()).groups != 1:
            raise ValueError("numbered_lines: needs one group")
        return self


class MakeForm(_Strict):
    """How a program along a path is written: texts with fields, <x> <y> <z> and the orientation's among them."""

    head: str
    """Up to the first motion; fields ``program``, ``comment``, ``points``."""
    approach: str
    """A joint move to above the first point."""
    travel: str
    """A straight move that is no point, faster than ``greatest_mm_s``: down to the first point, up from the last."""
    move: str
    """A timed move; ``<timing>`` is its speed or time, ``<feed>`` the speed of moves to a wait."""
    tail: str
    """After the last motion."""
    position: str = ""
    """A declaration at ``<positions>`` in head or tail, where a move names a position by its number ``<at>``."""
    decimals: int = Field(4, ge=0, le=9)
    """Of positions."""
    turn_decimals: int = Field(5, ge=0, le=9)
    """Of orientations."""
    signs: bool = False
    """Positions are written with their plus."""
    feed_of: str = ""
    """``<feed_of>`` of ``move_time.feed_line``."""
    stop: str = ""
    """``<zone>`` of a move that stops."""
    blend: str = ""
    """``<zone>`` of a move that blends into the next one."""
    tool: str = ""
    frame: str = ""
    """``<tool>`` and ``<frame>``: the names or numbers of the controller."""
    unnamed_frame: str = ""
    """Frame of a move that names none; empty: it is not known."""
    name: Annotated[str, Field(min_length=1)] = "POLISH"
    """``<program>``"""
    ending: Literal["lf", "crlf"] = "lf"


class DataFile(_Strict):
    """The file beside a program that declares its positions."""

    ending: Annotated[str, Field(pattern=r"\.[a-z]+")]
    any_name: bool = False
    """It serves all programs of its folder: the only file of this ending there may have another name."""
    form: Literal["statements", "xml"] = "statements"
    """``statements``: lines of the language, of which those that declare a position, a speed or a tool and frame count.
    ``xml``: ``<Data name= type=>`` with a ``<Value key= .../>`` an element."""
    positions: list[Text] = []
    """xml: types of positions; their values are attributes named as the fields are, 0 where they are missing."""
    frame: str = ""
    """xml: attribute of a position that names its frame."""
    speeds: list[Text] = []
    """xml: types that hold a speed under the name ``feed_of``."""
    feed: str = ""
    zone: str = ""
    """xml: attributes of their speed and of their ``zone``."""

    @property
    def title(self) -> str:
        """Its name in messages."""
        return f"the {self.ending} file beside it"


class Statements(_Strict):
    """Templates by what the statement is; in each list they are tried from the top."""

    move: Templates = []
    """A feed move: x, y, z and the orientation's fields, or ``target``: a declared position (dx, dy, dz added).

    It may have ``zone``, ``tool``, ``frame``, ``feed`` or ``rate`` (a speed that is a number) with ``feed_unit``, and
    ``t`` with ``t_unit``: a time that it takes itself. <here> and <there> enclose what states its speed or time.
    """
    dwell: Templates = []
    """A wait for ``time``."""
    dwell_in_position: Templates = []
    """A wait that begins only when the robot stands still."""
    approach: Templates = []
    """Any other motion: it leads to no point. With ``target`` or a pose it says where the next move begins.

    ``machine``: words in machine coordinates. The axes that it names are unknown until they are stated again.
    """
    position: Templates = []
    """A position declared under the name ``target``."""
    speed: Templates = []
    """A speed ``rate`` declared under the name ``feed_name``."""
    context: Templates = []
    """A ``tool`` and a ``frame`` declared under the name ``context_name``; refused with ``held_part``."""
    neutral: Templates = []
    """What changes neither place nor time. ``tool`` and ``frame`` must be the same at all moves.

    ``feed`` and ``zone`` hold for the moves behind it that state none; with ``feed_of`` for those of that name.
    ``target``: a position that is declared in a way that is not read. ``section``: see ``position_section``.
    ``override`` must be 100, and ``speed_limit`` (in the unit "" of speeds) at least ``greatest_mm_s``, where moves
    carry their time. ``ends``, of any statement: the program ends there; no motion and no dwell may follow.
    """
    begin: Templates = []
    end: Templates = []
    """Begin and end of a routine; there may be several, but only one may move."""
    run: Templates = []
    """The call of routine ``program``, outside of any."""
    call: Templates = []
    """The call of routine ``routine``, inside of one: of the routine that moves, once, or of one that does not move."""
    finish: Templates = []
    """End of the file: nothing but comments may follow."""


NUMBERS = frozenset({"x", "y", "z", "dx", "dy", "dz", "t", "time", "rate"})
"""Fields that are numbers in any language, as the orientation's are; ``feed`` is one unless the profile narrows it."""


class RefusedStatement(_Strict):
    """Statements that are known and refused, with the reason."""

    reason: str
    advice: str = "have it posted without"
    templates: Templates


class AssumedContext(_Strict):
    """Statements that are read over, at the price of a warning."""

    warning: str
    templates: Templates


class Pattern(NamedTuple):
    """One template, ready to match."""

    kind: Kind
    regex: re.Pattern[bytes]
    note: str = ""
    advice: str = ""


class LanguageProfile(_Strict):
    """A robot language."""

    name: str
    kind: Literal["template"]
    summary: str = ""
    comments: list[Text]
    """What begins a comment that runs to the end of the line."""
    ignore_case: bool = False
    span_lines: bool = False
    """Whether a statement may run over several lines."""
    unit_mm: float = Field(1.0, ge=1e-9, le=1e6)
    """Length of a written unit of x, y, z."""
    feed_units_mm_min: dict[str, Annotated[float, Field(gt=0)]] = Field(default_factory=dict)
    """One written unit of ``feed`` by what the field ``feed_unit`` holds (lower case; "" where there is none)."""
    exact_stop: list[Text] = []
    """What the field ``zone`` of a move that stops holds (lower case); no zone and a zone of 0 stop too."""
    blends_without_zone: bool = False
    """A move without ``zone`` blends into the next one."""
    modal_axes: bool = False
    """A coordinate that a move does not state holds from before; a rotary one is 0 at first."""
    modal_positions: bool = False
    """The tool and the frame that were set last hold for a declared position."""
    declare_before_use: bool = False
    position_section: str = ""
    """What the field ``section`` of the last neutral statement that has one must hold for the declared positions behind
    it to be in ``unit_mm`` and degrees; others are known, and no move may use them. Empty: there are no sections."""
    position_count: str = ""
    """Regular expression of the head's count of declared positions, or of its counts by kind with commas between them,
    in a group. Counts of 0 are not compared."""
    rising_numbers: bool = False
    """The number of a line is its address: numbers (``n``) that do not rise are refused; no number and 0 count for
    none."""
    line_limit: int = Field(0, ge=0, le=1_000_000_000)
    """Lines of a routine that the controller takes; 0: any number."""
    orientation: OrientationNotation
    dwell: Dwell
    move_time: MoveTime | None = None
    """None: only dwells carry time."""
    make: MakeForm | None = None
    """None: no programs are made in this language."""
    data_file: DataFile | None = None
    """None: a program is one file."""
    fields: dict[str, Text] = Field(default_factory=dict)
    """Regular expressions of the templates' fields."""
    statements: Statements
    added: Statements = Statements()
    """Of a profile that extends another: templates that are tried before the other's of the same kind."""
    refused: list[RefusedStatement] = []
    assumed: list[AssumedContext] = []

    @model_validator(mode="after")
    def _usable(self) -> LanguageProfile:
        """A language whose templates cannot give a point is refused before a program is."""
        for name, regex in self.fields.items():
            if name in self.numbers | MARKERS:
                raise ValueError(f"fields.{name}: is a number, and no regular expression makes it another")
            try:
                re.compile(regex.encode())
            except re.error as error:
                raise ValueError(f"fields.{name}: {error.msg}") from error
        for pattern in self.patterns:
            lacking = _lacking(pattern, {"x", "y", "z", *self.orientation.fields})
            if lacking:
                raise ValueError(f"statements.{pattern.kind}: a template lacks <{'>, <'.join(sorted(lacking))}>")
            if pattern.regex.match(b""):
                raise ValueError(f"statements.{pattern.kind}: a template fits where nothing is written")
        if "move" not in self.kinds or not self.kinds & {"dwell", "dwell_in_position"}:
            raise ValueError("statements: a language needs a move and a dwell")
        if self.position_count and re.compile(self.position_count.encode()).groups != 1:
            raise ValueError("position_count: needs one group")
        if self.move_time is not None and self.move_time.speed_unit not in self.feed_units_mm_min:
            raise ValueError(f"move_time.speed_unit: {self.move_time.speed_unit!r} is none of feed_units_mm_min")
        return self

    @property
    def numbers(self) -> frozenset[str]:
        """Names of the fields that must be numbers."""
        return NUMBERS | set(self.orientation.fields)

    @cached_property
    def patterns(self) -> tuple[Pattern, ...]:
        """All templates, in the order in which they are tried."""
        return tuple(_patterns(self))

    @cached_property
    def kinds(self) -> frozenset[Kind]:
        """What the language's statements may be at all."""
        return frozenset(pattern.kind for pattern in self.patterns)


def _patterns(profile: LanguageProfile) -> Iterator[Pattern]:
    writing = Writing(
        profile.ignore_case,
        profile.span_lines,
        profile.comments,
        profile.numbers | {"feed"},
        profile.fields,
    )
    listed: list[tuple[Kind, str, str, Templates]] = [
        (kind, "", "", [*getattr(profile.added, kind), *getattr(profile.statements, kind)]) for kind in TAKEN
    ]
    listed += [("assumed", assumed.warning, "", assumed.templates) for assumed in profile.assumed]
    listed += [("refused", refused.reason, refused.advice, refused.templates) for refused in profile.refused]
    for kind, note, advice, templates in listed:
        for template in templates:
            try:
                yield Pattern(kind, compiled(template, writing), note, advice)
            except re.error as error:
                raise ValueError(f"statements.{kind}: {template!r}, or a field in it: {error.msg}") from error


def _lacking(pattern: Pattern, place: set[str]) -> set[str]:
    """Fields without which the template's statement cannot be read."""
    fields = set(pattern.regex.groupindex)
    if pattern.kind == "move" and "target" not in fields:
        return place - fields
    if pattern.kind == "position":
        return {*place, "target"} - fields
    if pattern.kind == "speed":
        return {"feed_name", "rate"} - fields
    if pattern.kind == "context":
        return {"context_name", "tool", "frame"} - fields
    if pattern.kind == "call":
        return {"routine"} - fields
    return {"time"} - fields if pattern.kind.startswith("dwell") else set()
