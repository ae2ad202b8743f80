"""KRL module for the controller: the plan's lines with triggers that report the block, and waits where it may stop.

The lines themselves are unchanged (docs/protocols/kuka_kvp.md).
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise

import numpy as np

from polishd.api import DeviceRefused, Plan, ProtocolError
from polishd.drivers.transport.program_tracker import ProgramFile, ProgramTracker, time_shares

LONGEST_LINE = 4096
NAME = "POLISHD"
"""Of the module."""

_WHOLE = re.compile(r"-?\d{1,10}", re.ASCII)
_CONSTANT = re.compile(r"#\w{1,24}", re.ASCII)
_MOVE = re.compile(r"(S?)(?:LIN|PTP|CIRC)\s", re.IGNORECASE)
_DWELL = re.compile(r"WAIT\s+SEC\s+([0-9.eE+-]+)", re.IGNORECASE)
_WAIT = re.compile(r"WAIT\b", re.IGNORECASE)
_FRAME = re.compile(r"(?:GLOBAL\s+)?DEF\s+\w+\s*\(\s*\)|END|&.*|INI|DEFDAT\s.*|ENDDAT", re.IGNORECASE)
_DEF = re.compile(r"(?:GLOBAL\s+)?DEF\s", re.IGNORECASE)
_DECLARES = re.compile(
    r"(?:DECL|EXT|EXTFCT|INT|REAL|BOOL|CHAR|E6POS|E6AXIS|POS|FRAME|AXIS)\s|(?:GLOBAL\s+)?INTERRUPT\s+DECL\s",
    re.IGNORECASE,
)
_OTHER = re.compile(r"[$A-Za-z_][$\w.\[\],]*\s*=|(?:BAS|SET_CD_PARAMS)\s*\(|INTERRUPT\s+ON\s", re.IGNORECASE)
"""Lines that take no time: assignments, and calls of the system's own set-up."""


@dataclass(frozen=True, slots=True)
class KrlLine:
    """One line of the plan."""

    text: bytes
    moves: bool = False
    dwell_s: float | None = None
    """Waiting time, s; None for a line that does not wait."""
    is_spline: bool = False
    declares: bool = False
    frame: bool = False
    """Whether the line is structure of the file (``DEF``, ``END``, a header) that is not run."""


def krl_lines(lines: Sequence[bytes]) -> list[KrlLine]:
    """Classify each line. DeviceRefused for what cannot be tracked: loops, branches, several routines."""
    found = [_line_of(text, seq) for seq, text in enumerate(lines)]
    if sum(_DEF.match(_code(line.text)) is not None for line in found) > 1:
        raise DeviceRefused("the program has several routines, which cannot be followed. Post it as one routine.")
    if not any(line.moves or line.dwell_s for line in found):
        raise DeviceRefused("no line of the program moves or waits in KRL. Check [program] format.")
    return found


def _line_of(text: bytes, seq: int) -> KrlLine:
    code = _code(text)
    if match := _MOVE.match(code):
        return KrlLine(text, moves=True, is_spline=bool(match[1]))
    if match := _DWELL.fullmatch(code):
        try:
            return KrlLine(text, dwell_s=float(match[1]))
        except ValueError:
            raise DeviceRefused(f"block {seq}: {match[1]} is no time in seconds") from None
    if not code or _FRAME.fullmatch(code):
        return KrlLine(text, frame=bool(code))
    if _DECLARES.match(code):
        return KrlLine(text, declares=True)
    if _OTHER.match(code) and not _WAIT.match(code):
        return KrlLine(text)
    raise DeviceRefused(
        f"block {seq}: {code[:40]!r} cannot be followed. "
        "Post the program as one routine of moves, waits and assignments."
    )


def _code(text: bytes) -> str:
    return text.decode("latin-1").partition(";")[0].strip()


# The names of the program: the module and its data list must declare them, or the controller would take a global one.

_DECLARATION = re.compile(
    r"(?:GLOBAL\s+)?(?:DECL\s+(?:(?:GLOBAL|CONST)\s+)*\w+|INT|REAL|BOOL|CHAR|E6POS|E6AXIS|POS|FRAME|AXIS)\s+(.+)",
    re.IGNORECASE,
)
_DATA_FRAME = re.compile(r"&.*|DEFDAT\s.*|ENDDAT", re.IGNORECASE)
_GLOBAL = re.compile(rb"^(\s*(?:DECL\s+)?)GLOBAL\s+", re.IGNORECASE)
_INNER = re.compile(r"\{[^{}]*\}|\"[^\"]*\"|\[[^\[\]]*\]")
_NAME = re.compile(r"(?<![\w$#.])[A-Z_]\w*(?!\w|\s*\()")
"""A variable: no system variable, constant, component or call."""
_WORDS = re.compile(
    r"S?LIN|S?PTP|S?CIRC|C_(?:DIS|VEL|ORI|PTP|SPL)|WITH|TRUE|FALSE|NOT|AND|OR|EXOR|INTERRUPT|ON"
    # of each controller's own data, and no positions
    r"|[FPL]DAT_ACT|FHOME|[PL]DEFAULT|(?:TOOL|BASE|LOAD)_DATA"
)
_HOME = "XHOME"
"""Position of each controller's own data: polishd has not checked a motion to it."""


def _without_values(code: str) -> str:
    """Return a line in upper case without aggregates, texts and indices."""
    count = 1
    while count:
        code, count = _INNER.subn("", code)
    return code.upper()


def _declared(code: str) -> list[str]:
    """Return the names that a line declares."""
    match = _DECLARATION.fullmatch(code)
    if match is None:
        return []
    return [one.partition("=")[0].strip() for one in _without_values(match[1]).split(",")]


def require_declared(lines: Sequence[KrlLine], beside: bytes) -> None:
    """Raise DeviceRefused for a name that neither the program nor the file beside it (``.dat``) declares."""
    codes = [_code(line.text) for line in lines if line.declares]
    known = {name for code in [*codes, *map(_code, beside.split(b"\n"))] for name in _declared(code)}
    if own := sorted(name for name in known if name.startswith(NAME)):
        raise DeviceRefused(f"it declares {own[0]}, and names with {NAME} belong to polishd. Rename it in the program.")
    for number, line in enumerate(lines, 1):
        if line.frame or line.declares or line.dwell_s is not None:
            continue
        for name in _NAME.findall(_without_values(_code(line.text))):
            is_known = name in known or _WORDS.fullmatch(name) or (name == _HOME and not line.moves)
            if not is_known:
                raise DeviceRefused(
                    f"line {number}: neither the program nor the .dat file beside it declares {name}. Put the "
                    "declaration into the .dat file, also if the controller has it in $CONFIG.DAT."
                )


def data_list(beside: bytes) -> bytes:
    """Return the data list of the module: the declarations of the file beside the program, known to the module only."""
    lines = (line.rstrip() for line in beside.split(b"\n"))
    kept = [_GLOBAL.sub(rb"\1", line) for line in lines if (code := _code(line)) and not _DATA_FRAME.fullmatch(code)]
    return b"\n".join([b"&ACCESS RV", b"DEFDAT " + NAME.encode(), *kept, b"ENDDAT", b""])


class KrlPhase(IntEnum):
    """``POLISHD_PHASE``."""

    NONE = 0
    WAITS = 1
    RUNS = 2
    DONE = 3


_HEAD = """&ACCESS RV
DEF {name}( )
;Written by polishd: the program of the plan, with what reports its progress.
{declarations}BAS(#INITMOV,0)
POLISHD_TOKEN=0
POLISHD_BLOCK=0
POLISHD_PHASE=1
PTP $AXIS_ACT
WAIT SEC 0
WAIT FOR POLISHD_SEEN==0
POLISHD_TOKEN={token}
"""
_GATE = """WAIT SEC 0
POLISHD_BLOCK={seq}
POLISHD_PHASE=1
WAIT FOR (POLISHD_GO=={token}) AND (POLISHD_UNTIL>{seq})
POLISHD_PHASE=2
"""
_TAIL = """WAIT SEC 0
POLISHD_BLOCK={blocks}
POLISHD_PHASE=3
END
"""
_TRIGGERS = {
    False: b"TRIGGER WHEN DISTANCE=0 DELAY=0 DO POLISHD_BLOCK=%d",
    True: b"TRIGGER WHEN PATH=0 ONSTART DELAY=0 DO POLISHD_BLOCK=%d",
}
"""Reports of the block in motion, before a motion and before a spline motion."""


class KrlProgram(ProgramFile):
    """The module with the plan's lines, a wait before its first line and before each stop, and its data list."""

    def __init__(self, blocks: Sequence[KrlLine], stops: Iterable[int], token: int, beside: bytes = b"") -> None:
        """``beside``: content of the file beside the program, which declares its positions."""
        self.blocks, self.token, self.data = len(blocks), token, data_list(beside)
        self.stops = tuple(sorted({stop for stop in stops if 0 < stop < self.blocks}))
        self.inserted, self.pauses = [], {}
        declarations = b"".join(line.text.strip() + b"\n" for line in blocks if line.declares).decode("latin-1")
        head = _HEAD.format(name=NAME, declarations=declarations, token=token).encode("latin-1")
        lines = [head.removesuffix(b"\n")]
        for seq, line in enumerate(blocks):
            if seq == 0 or seq in self.stops:
                lines.append(_GATE.format(seq=seq, token=token).encode().removesuffix(b"\n"))
            if line.moves:
                lines.append(_TRIGGERS[line.is_spline] % seq)
            elif line.dwell_s is not None:
                lines += [b"WAIT SEC 0", b"POLISHD_BLOCK=%d" % seq]
            if not (line.frame or line.declares):
                lines.append(line.text)
        self.text = b"\n".join([*lines, _TAIL.format(blocks=self.blocks).encode()])
        self.lines = tuple(self.text.split(b"\n"))


# Snapshots of the controller.

FREE, ACTIVE, STOPPED = "#P_FREE", "#P_ACTIVE", "#P_STOP"
SYSTEM = (
    "$PRO_STATE1",
    "$PRO_NAME1[]",
    "$PRO_STATE0",
    "$MODE_OP",
    "$OV_PRO",
    "$PERI_RDY",
    "$STOPMESS",
    "$ROB_STOPPED",
)
OWN = ("POLISHD_TOKEN", "POLISHD_PHASE", "POLISHD_RUN", "POLISHD_SEEN", "POLISHD_CLOCK", "POLISHD_SESSION")
READ_NAMES = (*SYSTEM, *OWN)
"""The running time before the block: at the first it had not ended if the second is still under way."""
KEPT = 64
"""Blocks of which the watchdog keeps the begin."""


def begin_names(blocks: Iterable[int]) -> list[str]:
    """Return the variables in which the watchdog keeps the begins of the blocks."""
    return [f"POLISHD_BEGINS[{block % KEPT + 1}]" for block in blocks]


MODES = {"#T1": "T1", "#T2": "T2"}
AUTOMATIC = ("#AUT", "#EX", "#EXT")


@dataclass(frozen=True, slots=True)
class KukaSample:
    """State of the controller at one reading. Times are on the timer of the watchdog, s."""

    state: str
    """``$PRO_STATE1``."""
    selected: str
    """Name of the selected program, of which the state is."""
    submit_state: str
    """State of the submit interpreter."""
    mode: str
    override: float
    """``$OV_PRO`` as a fraction."""
    drives_ready: bool
    stop_message: bool
    robot_stopped: bool
    token: int
    """Token of the program that reported last."""
    phase: int
    run_s: float
    """Time for which it has run, without its waits before a stop."""
    block: int
    """Its present block."""
    time_s: float
    session: int
    """Start of the watchdog."""
    is_watched: bool = True
    """The watchdog runs: its clock does."""
    begins: tuple[tuple[int, float], ...] = ()
    """Block and running time at which the watchdog saw it begin, for the blocks since the sample before."""

    @classmethod
    def of(cls, values: Mapping[str, str]) -> KukaSample:
        """Parse the values. ProtocolError if one has another type."""
        return cls(
            _constant(values, "$PRO_STATE1"),
            values["$PRO_NAME1[]"].strip('"'),
            _constant(values, "$PRO_STATE0"),
            _constant(values, "$MODE_OP"),
            read_number(values, "$OV_PRO") / 100.0,
            _flag(values, "$PERI_RDY"),
            _flag(values, "$STOPMESS"),
            _flag(values, "$ROB_STOPPED"),
            read_number(values, "POLISHD_TOKEN"),
            read_number(values, "POLISHD_PHASE"),
            read_number(values, "POLISHD_RUN") / 1e3,
            read_number(values, "POLISHD_SEEN"),
            read_number(values, "POLISHD_CLOCK") / 1e3,
            read_number(values, "POLISHD_SESSION"),
        )

    @property
    def active(self) -> bool:
        """Whether a program runs, or waits in a line."""
        return self.state == ACTIVE

    @property
    def plays(self) -> bool:
        """Whether a program runs, or the robot moves. A program of polishd that waits at a stop does not."""
        return not self.robot_stopped or (self.active and self.phase != KrlPhase.WAITS)

    @property
    def is_other(self) -> bool:
        """Whether a program is selected that is not polishd's."""
        return self.state != FREE and self.selected.upper() != NAME

    def obstacle(self) -> str:
        """Return why the controller would not run a program as written; empty if it would."""
        if self.mode not in AUTOMATIC:
            return f"it is in mode {MODES.get(self.mode, self.mode)} (turn it to automatic at the pendant)"
        if self.stop_message:
            return "a stop message is active (release the emergency stop and acknowledge the messages)"
        if not self.drives_ready:
            return "its drives are off (switch them on at the pendant)"
        if self.override < 1.0:
            return f"its program override is at {100.0 * self.override:.5g} % (set it to 100 %)"
        if self.is_other:
            return f"the program {self.selected} is selected (deselect it at the pendant)"
        if self.submit_state != ACTIVE:
            return "its submit interpreter does not run (select and start SPS at the pendant)"
        if not self.is_watched:
            return "its watchdog does not run (call POLISHD_WATCH in SPS.SUB, docs/protocols/kuka_kvp.md)"
        return ""


def read_number(values: Mapping[str, str], name: str) -> int:
    """Return a whole number. ProtocolError if the value is none."""
    if not _WHOLE.fullmatch(values[name]):
        raise ProtocolError(f"{name}: {values[name][:40]!r} is no whole number")
    return int(values[name])


def _constant(values: Mapping[str, str], name: str) -> str:
    """Return a constant of an enumeration, as ``#P_STOP``."""
    if not _CONSTANT.fullmatch(values[name]):
        raise ProtocolError(f"{name}: {values[name][:40]!r} is no constant of an enumeration")
    return values[name]


def _flag(values: Mapping[str, str], name: str) -> bool:
    if values[name] not in ("TRUE", "FALSE"):
        raise ProtocolError(f"{name}: {values[name][:40]!r} is neither TRUE nor FALSE")
    return values[name] == "TRUE"


def _last_of_each_time(sample: KukaSample) -> Iterator[tuple[int, float]]:
    """Yield the begins, of blocks that begin at one time the last; the sample's block with its running time if unknown.

    The blocks before it share the time: they ended within one cycle of the watchdog.
    """
    begins = [(block, began_s) for block, began_s in sample.begins if block < sample.block]
    last_s = next((began_s for block, began_s in sample.begins if block == sample.block), sample.run_s)
    for (block, began_s), (_, next_s) in pairwise([*begins, (sample.block, last_s)]):
        if began_s < next_s:
            yield block, began_s
    yield sample.block, last_s


START_S = 5.0
"""Time that may pass with standstill after a command, on our clock."""


class KrlProgramTracker(ProgramTracker):
    """Tracker of one program from its load to its end.

    The watchdog reports the block in motion and when it saw each begin, to one of its cycles. A block counts only after
    a second sample that does not contradict the first, so that one damaged number counts no block.
    """

    def __init__(self, plan: Plan, blocks: int, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__(plan, blocks)
        self.token = 0
        self.live = False
        """Whether the module waits or runs on the controller, or is stopped within its lines."""
        self.until = 0
        """Blocks below this one may begin."""
        self.holds = False
        """A stop was commanded, and is expected."""
        self._now_s = now_s
        self._ordered_s = self._waits_since_s = 0.0
        self._moves = np.zeros(blocks, dtype=bool)
        self._dwells = np.zeros(blocks, dtype=bool)
        self._dwell_s = np.zeros(blocks)
        self._low_s = 0.0
        """Running time of the sample before the last."""
        self._last: KukaSample | None = None

    def sent(self, file: KrlProgram, lines: Sequence[KrlLine]) -> None:
        """Record that the module was delivered; it waits before its first line."""
        self.file, self.token, self.until, self.live, self._last = file, file.token, 0, False, None
        self._moves = np.array([line.moves for line in lines], dtype=bool)
        self._dwells = np.array([line.dwell_s is not None for line in lines], dtype=bool)
        self._dwell_s = np.array([line.dwell_s or 0.0 for line in lines])

    def go(self, time_s: float, detail: str = "") -> None:
        """Begin to run, or continue, up to ``until``."""
        super().go(time_s, detail)
        self._ordered_s, self.holds = self._now_s(), False

    def drop(self, reason: str) -> None:
        """End the program: it will not be continued."""
        super().drop(reason)
        self.live = False

    def forget(self) -> None:
        """Track the module no more: it will be stopped and deselected."""
        self.token, self.live = 0, False

    def update(self, sample: KukaSample) -> None:
        """Process a sample. ProtocolError if it is impossible."""
        if not self.token or self.dropped or self.state == "done":
            return
        if sample.token != self.token:
            if self.live:
                self._fail("the controller runs another program, or has restarted")
            return
        before, self._last = self._last, sample
        if before is not None:
            self._book(before, sample)  # in a fault, too: the robot stands in the block that it reported last
        if not self.ended:
            self.live = True
            self._judge(before or sample, sample)

    def _book(self, before: KukaSample, sample: KukaSample) -> None:
        if not before.block <= sample.block <= self.blocks:
            raise ProtocolError(f"the robot reports block {sample.block} of {self.blocks}, after block {before.block}")
        if sample.run_s < before.run_s:
            raise ProtocolError(f"the robot reports {sample.run_s:g} s of running, after {before.run_s:g} s")
        for block, began_s in _last_of_each_time(before):
            if block > len(self):
                self._advance(block, min(max(began_s, self._low_s, self.began_s), sample.run_s))
        self._low_s, self.clock_s = before.run_s, sample.run_s

    def _judge(self, before: KukaSample, sample: KukaSample) -> None:
        """Set the state, and end the program if it cannot continue."""
        if sample.phase == KrlPhase.DONE:
            if len(self) == self.blocks:
                self.state, self.detail, self.live = "done", "", False
            return
        if why := sample.obstacle():
            self._fail(why)
        elif sample.state == STOPPED:
            self._stopped(before)
        elif not sample.active:
            self._fail("the program was stopped at the controller")
        elif sample.phase == KrlPhase.WAITS:
            if before.phase != KrlPhase.WAITS:
                self._waits_since_s = self._now_s()
            self._waits(sample)
        elif not self.holds:
            self.state, self.detail = "running", ""

    def _stopped(self, before: KukaSample) -> None:
        """Handle a stop: as commanded, not yet started again, or by the operator, who leaves the tool on the part."""
        if self.holds:
            self.state, self.detail = "held", ""
        elif before.active or self._now_s() - self._ordered_s > START_S:
            self._fail("the program was stopped at the controller")

    def _waits(self, sample: KukaSample) -> None:
        """Handle waiting before a block: as commanded, or because the command has not arrived yet.

        The watchdog reports the block up to a cycle later than the program reports that it waits.
        """
        if sample.block >= self.until:
            self.state, self.detail = "held", ""
            self.held_at = sample.block if self.started and len(self) == sample.block else None
        elif self._now_s() - max(self._ordered_s, self._waits_since_s) > START_S:
            self._fail(f"it does not begin block {sample.block}")

    def _fail(self, why: str) -> None:
        self.state, self.detail, self.live = "fault", why, False

    def _advance(self, to: int, high_s: float) -> None:
        """Record all blocks below ``to`` as executed: dwells get their programmed time, moves the rest, others none."""
        first = len(self)
        moves, dwells, asked_s = self._moves[first:to], self._dwells[first:to], self._dwell_s[first:to]
        if not (moves | dwells).any():
            self.stretch(np.zeros(to - first), high_s=self.began_s)
            return
        rest = moves if moves.any() or asked_s.any() else dwells
        took_s = high_s - self.began_s
        self.stretch(time_shares(took_s, asked_s, float(asked_s.sum()), rest), high_s=high_s)
