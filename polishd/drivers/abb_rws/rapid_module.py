r"""RAPID module for the controller: the plan's lines, with a report of each point, and a stop where the plan has one.

Positions, speeds and times of the lines are unchanged; a ``\V``, which a trigger cannot have, becomes speeddata. A move
to a fly-by point gets a trigger at the point, because the program pointer runs ahead of the motion; after a stop point
and after a wait, a call reports (docs/protocols/abb_rws.md).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from polishd.api import DeviceRefused

LONGEST_LINE = 2048
MODULE = "polishd_part"
MARK = b" ! polishd"
"""End of each line that the driver adds."""
TRIGGERS = 8
"""A trap reports its number modulo this, so that a report that the controller drops during a stop is made up for."""
NO_STOP, AT_END = -1, -2
"""Values of ``polishd_stop`` while no stop of the file is reached, and after the last block."""

_HEAD = """MODULE {module}
PERS pos polishd_seen:=[0,0,{token}];
PERS num polishd_stop:=-1;
PERS num polishd_stood;
VAR clock polishd_clock;
"""
_TRIGGER = """VAR intnum polishd_i{n};
VAR triggdata polishd_p{n};
"""
_TAIL = """PROC polishd_begin()
polishd_stop:=-1;
polishd_stood:=0;
polishd_seen:=[0,0,{token}];
{connects}ClkReset polishd_clock;
ClkStart polishd_clock;
ENDPROC
PROC polishd_mark(num count)
polishd_seen:=[count,ClkRead(polishd_clock)-polishd_stood,{token}];
ENDPROC
PROC polishd_go()
polishd_stop:=-1;
polishd_seen:=[polishd_seen.x,ClkRead(polishd_clock)-polishd_stood,{token}];
ENDPROC
PROC polishd_pass(num at)
VAR num ahead;
ahead:=(at-polishd_seen.x MOD {triggers}+{triggers}) MOD {triggers};
IF ahead>0 AND ahead<={most} THEN
polishd_mark polishd_seen.x+ahead;
ENDIF
ENDPROC
"""
_CONNECT = """IDelete polishd_i{n};
CONNECT polishd_i{n} WITH polishd_t{n};
TriggInt polishd_p{n},0,polishd_i{n};
"""
_TRAP = """TRAP polishd_t{n}
polishd_pass {n};
ENDTRAP
"""

_ACTS = re.compile(rb"\s*(Move|Trigg)(L|C|J|AbsJ)\b|\s*WaitTime\b", re.IGNORECASE)
_MODULE = re.compile(rb"\s*MODULE\b", re.IGNORECASE)
_ENDMODULE = re.compile(rb"\s*ENDMODULE\b", re.IGNORECASE)
_PROC = re.compile(rb"\s*(?:LOCAL\s+)?PROC\s+(\w+)\s*\(\s*\)", re.IGNORECASE)
_ENDPROC = re.compile(rb"\s*ENDPROC\b", re.IGNORECASE)
_BRANCHES = re.compile(
    rb"\s*(?:IF|ELSEIF|ELSE|FOR|WHILE|TEST|CASE|GOTO|RETURN|TRAP|FUNC|EXIT|ExitCycle|Break|Stop|RAISE|RETRY|TRYNEXT)\b",
    re.IGNORECASE,
)
_FINE = re.compile(rb"\s*(?:fine\b|\[\s*TRUE\b)", re.IGNORECASE)
_OWN_SPEED = re.compile(rb"\s*v\d+\s*\\V:=\s*([\d.]+)\s*", re.IGNORECASE)
"""A speed that RAPID declares, with another value for the tool; its other values are those of ``_SPEED``."""
_SPEED = b"[%b,500,5000,1000]"
_TARGETS = {b"L": 1, b"J": 1, b"C": 2, b"ABSJ": 1}
"""Arguments before the speed, by kind of move."""


@dataclass(frozen=True, slots=True)
class RapidLine:
    """One line of the plan."""

    text: bytes
    acts: bool
    """It moves or waits; the others take no time."""
    moves: bool = False
    flies_by: bool = False
    """A move to a point at which the robot does not stop."""
    joints: bool = False
    """A move to joint angles, which takes no trigger."""


def rapid_lines(lines: Sequence[bytes]) -> list[RapidLine]:
    """Classify each line. DeviceRefused for lines whose position cannot be tracked."""
    found = [_classified(seq, line) for seq, line in enumerate(lines)]
    if not any(line.acts for line in found):
        raise DeviceRefused("no line of the program moves or waits in RAPID. Check [program] format.")
    _routine(found)
    return found


def _classified(seq: int, raw: bytes) -> RapidLine:
    line = raw.rstrip()
    if _BRANCHES.match(line):
        word = line.split()[0].decode("latin-1")
        raise DeviceRefused(f"block {seq}: {word} cannot be tracked. Post the program as one routine without branches.")
    match = _ACTS.match(line)
    if match is None:
        return RapidLine(line, acts=False)
    code, end, rest = _code(line).partition(b";")
    if not end or rest.strip():
        raise DeviceRefused(f"block {seq}: a line must hold one statement. Post the program with a statement a line.")
    if match[1] is None:
        return RapidLine(line, acts=True)
    if match[1].lower() == b"trigg":
        raise DeviceRefused(f"block {seq}: polishd adds the triggers. Post the program with Move{match[2].decode()}.")
    kind = match[2].upper()
    arguments = _arguments(code[match.end() :])
    zone = _TARGETS[kind] + 1
    if len(arguments) != zone + 2:
        raise DeviceRefused(f"block {seq}: a Move{match[2].decode()} has {zone + 2} arguments, not {len(arguments)}.")
    flies_by = _FINE.match(arguments[zone]) is None
    speed = arguments[zone - 1]
    has_own = b"\\V:=" in speed.replace(b" ", b"").upper()
    if flies_by and kind != b"ABSJ" and has_own and not _OWN_SPEED.fullmatch(speed):
        raise DeviceRefused(
            f"block {seq}: a trigger has no \\V, and the speed is none of v5 to v7000. Post speeddata or \\T."
        )
    return RapidLine(line, acts=True, moves=True, flies_by=flies_by, joints=kind == b"ABSJ")


def _code(line: bytes) -> bytes:
    """Return the line without its comment; a ``!`` in quotes is text."""
    quoted = False
    for at, byte in enumerate(line):
        quoted ^= byte == 0x22
        if byte == 0x21 and not quoted:
            return line[:at]
    return line


def _arguments(text: bytes) -> list[bytes]:
    """Split at the commas outside brackets."""
    parts, depth, start = [], 0, 0
    for at, byte in enumerate(text):
        depth += (byte in b"[(") - (byte in b"])")
        if byte == 0x2C and depth == 0:
            parts.append(text[start:at])
            start = at + 1
    return [*parts, text[start:]]


def _with_trigger(line: bytes, number: int) -> bytes:
    """Return a move to a fly-by point as the instruction with a trigger; its arguments mean the same."""
    code = _code(line)
    match = _ACTS.match(code)
    if match is None or match[2] is None:
        return line
    arguments = _arguments(code[match.end() :])
    zone = _TARGETS[match[2].upper()] + 1
    if own := _OWN_SPEED.fullmatch(arguments[zone - 1]):
        arguments[zone - 1] = _SPEED % own[1]
    head = code[: match.start(1)] + b"Trigg" + match[2]
    arguments.insert(zone, b"polishd_p%d" % (number % TRIGGERS))
    return head + b",".join(arguments) + line[len(code) :]


@dataclass(frozen=True, slots=True)
class MovingRoutine:
    """The routine that moves: its name (empty: the lines are in none) and the line of its ``ENDPROC``."""

    name: str
    end: int


def _routine(lines: Sequence[RapidLine]) -> MovingRoutine:
    """Find the routine that moves. DeviceRefused where several do."""
    found: MovingRoutine | None = None
    opened, acts = "", False
    for seq, line in enumerate(lines):
        if (match := _PROC.match(line.text)) is not None:
            opened, acts = match[1].decode("latin-1"), False
        elif _ENDPROC.match(line.text):
            if acts and found is not None:
                raise DeviceRefused(f"block {seq}: a second routine moves. Post the program as one routine.")
            found = MovingRoutine(opened, seq) if acts else found
            opened, acts = "", False
        acts |= line.acts
    if acts and (opened or found is not None):
        raise DeviceRefused("a routine of the program has no ENDPROC, or lines outside the routine move.")
    return found or MovingRoutine("", len(lines))


@dataclass(slots=True)
class RapidModule:
    """The module for the controller, and what its reports say."""

    token: int
    stops: tuple[int, ...] = ()
    """Blocks before which the program stops."""
    lines: list[bytes] = field(default_factory=list, repr=False)
    done_after: list[int] = field(default_factory=lambda: [0], repr=False)
    """Blocks that are executed at each report, by the report's number."""
    block_of: list[int] = field(default_factory=list, repr=False)
    """Block of each line, 0-based; -1 for added lines."""

    @property
    def text(self) -> bytes:
        """Content of the file."""
        return b"\n".join([*self.lines, b""])

    @property
    def last_report(self) -> int:
        """Number of the report at the end of the program."""
        return len(self.done_after) - 1

    def keep(self, seq: int, line: bytes) -> None:
        """Add the line of a block."""
        self.lines.append(line)
        self.block_of.append(seq)

    def add(self, source: str) -> None:
        """Add lines of the driver."""
        for line in source.splitlines():
            self.lines.append(line.encode() + MARK)
            self.block_of.append(-1)


def assemble(lines: Sequence[RapidLine], stops: Iterable[int], token: int) -> RapidModule:
    """Build the module, with a stop before each of the blocks ``stops``."""
    routine = _routine(lines)
    first = next(seq for seq, line in enumerate(lines) if line.acts)
    own = sorted({stop for stop in stops if max(first, 1) <= stop <= min(routine.end, len(lines) - 1)})
    module = RapidModule(token, stops=tuple(own))
    head = _HEAD.format(module=MODULE, token=token) + "".join(_TRIGGER.format(n=n) for n in range(TRIGGERS))
    tail = _tail(lines, routine, token)
    has_module = any(_MODULE.match(line.text) for line in lines)
    if not has_module:
        module.add(head if routine.name else f"{head}PROC main()\n")
    for seq, line in enumerate(lines):
        if seq == first:
            module.add("polishd_begin;")
        if seq in own:
            module.add(f"WaitRob\\InPos;\npolishd_stop:={seq};\nStop;\npolishd_go;")
        if seq == routine.end:
            _end(module, len(lines))
        if _MODULE.match(line.text):
            module.keep(seq, b"MODULE " + MODULE.encode())
            module.add(head.partition("\n")[2])
            continue
        if _ENDMODULE.match(line.text):
            module.add(tail)
        _keep(module, seq, line, _done(lines, own, seq))
    if not routine.name:
        _end(module, len(lines))
        module.add("ENDPROC")
    if not has_module:
        module.add(tail + "ENDMODULE")
    return module


def _tail(lines: Sequence[RapidLine], routine: MovingRoutine, token: int) -> str:
    """Return the routines of the driver, with a ``main`` where the program has none."""
    connects = "".join(_CONNECT.format(n=n) for n in range(TRIGGERS))
    tail = _TAIL.format(token=token, connects=connects, triggers=TRIGGERS, most=TRIGGERS // 2)
    tail += "".join(_TRAP.format(n=n) for n in range(TRIGGERS))
    names = {match[1].decode("latin-1").lower() for line in lines if (match := _PROC.match(line.text))}
    if routine.name and "main" not in names:
        tail += f"PROC main()\n{routine.name};\nENDPROC\n"
    return tail


def _keep(module: RapidModule, seq: int, line: RapidLine, done: int) -> None:
    """Add a line of the program with its report; a move by joints to a fly-by point has none."""
    number = len(module.done_after)
    has_trigger = line.flies_by and not line.joints
    module.keep(seq, _with_trigger(line.text, number) if has_trigger else line.text)
    if line.acts and not (line.flies_by and line.joints):
        module.done_after.append(done)
        if not has_trigger:
            module.add(f"polishd_mark {number};")


def _end(module: RapidModule, total: int) -> None:
    """Add the report at the end of the routine."""
    number = len(module.done_after)
    module.done_after.append(total)
    module.add(f"WaitRob\\InPos;\npolishd_mark {number};\npolishd_stop:={AT_END};")


def _done(lines: Sequence[RapidLine], stops: Sequence[int], seq: int) -> int:
    """Return the number of blocks that are executed once block ``seq`` is: up to the next that acts, or to a stop."""
    following = next((at for at in range(seq + 1, len(lines)) if lines[at].acts), seq + 1)
    return min([following, *(stop for stop in stops if stop > seq)])
