"""Damaged programs whose moves carry their time, and damaged files beside them: read, or refused with a remedy.

What is read moves as before whatever times are written, and no text takes long.
"""

from __future__ import annotations

import re
import time
from random import Random

import numpy as np
import pytest

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.languages.statements import LONGEST_LINE, ProgramSource, statements
from polishd.plugins.rnc_robot.verify import verify
from tests.corpus import fuzz
from tests.unit.plugins.rnc_robot.languages.robot_programs import LANGUAGES, profile
from tests.unit.plugins.rnc_robot.languages.test_data_file import DAT, DTX, KRL, PGX
from tests.unit.plugins.rnc_robot.languages.test_foreign_programs import READ
from tests.unit.plugins.rnc_robot.languages.test_move_times import ENCODINGS, made, takes
from tests.unit.plugins.rnc_robot.test_fuzz import SPEED, TIME, UNWRITABLE

ENDINGS = {"rapid": ".mod", "krl": ".src", "fanuc-tp": ".ls", "inform": ".jbi", "val3": ".pgx", "heidenhain": ".h"}
WORDS = [b" ", b"\n", b"\r", b";", b"0", b"9", b".", b"-", b",", b"(", b")", b'"', b"{", b"\\", b"!", b"\xe4", b"E1"]


def sources(name: str) -> list[tuple[bytes, bytes]]:
    """Programs of a language, each with the file beside it."""
    found = [(made(name, encoding), b"") for encoding in ENCODINGS if takes(name, encoding)]
    ending = ENDINGS.get(name, "none")
    shapes = [text.encode("latin-1") for one, text, _ in READ if one.endswith(ending)]
    found += [(text, DTX if name == "val3" else b"") for text in shapes]
    return found + {"krl": [(KRL, DAT)], "val3": [(PGX, DTX)]}.get(name, [])


def damaged(text: bytes, name: str, rng: Random) -> bytes:
    """Some bytes other, or some lines twice, lost, swapped or of another statement."""
    lines = text.split(b"\n")
    for _ in range(rng.choice([1, 1, 2, 4])):
        at = rng.randrange(len(lines))
        line = lines[at]
        where, cut = rng.randrange(len(line) + 1), rng.choice([0, 0, 1, 3, 9])
        match rng.randrange(6):
            case 0:
                lines.insert(at, rng.choice(lines))
            case 1:
                del lines[at : at + rng.choice([0, 1])]
            case 2:
                lines[at] = rng.choice(fuzz.LANGUAGES[name].odd).encode()
            case _:
                lines[at] = line[:where] + rng.choice(WORDS) * rng.choice([0, 1, 1, 2]) + line[where + cut :]
    return b"\n".join(lines)


def check(name: str, text: bytes, beside: bytes, rng: Random) -> bool:
    """Whether it was read; every promise is kept either way."""
    language = profile(name)
    began = time.thread_time()
    try:
        program = formats.read(language, text, "f.txt", beside)
    except ProgramError as refused:
        assert re.match(r"f\.txt.*: .*To do: .+\.$", str(refused)), str(refused)  # noqa: PT017  it may also be read
        return False
    finally:
        assert time.thread_time() - began < 5
    assert formats.rewrite(language, program, program.time_s) == text
    asked = program.time_s * np.array([rng.uniform(0.7, 1.5) for _ in range(program.n)])
    new = written(name, program, asked, None)
    if new is not None:
        again = formats.read(language, new, "f.txt", beside)
        np.testing.assert_array_equal(again.end_mm, program.end_mm)
        np.testing.assert_array_equal(again.axis, program.axis)
        number = (TIME if program.encoding == "dwell" else SPEED)[name]
        assert number.sub(b"", new) == number.sub(b"", text)
    target = rng.choice(ENCODINGS)
    new = written(name, program, asked, target)
    if new is not None and target != program.encoding:
        proof = verify(text, new, language, beside=beside)
        assert proof.identical_motion, proof.difference
    return True


def written(name: str, program: Program, asked: np.ndarray, encoding: str | None) -> bytes | None:
    try:
        return formats.rewrite(profile(name), program, asked, encoding)  # type: ignore[arg-type]
    except ProgramError as refused:
        assert "To do: " in str(refused)  # noqa: PT017  it may also be written
        assert encoding is not None or UNWRITABLE.search(str(refused)), refused  # noqa: PT017
        return None


def campaign(name: str, rounds: int, seed: int) -> tuple[int, int]:
    """Programs read and refused."""
    rng = Random(f"{name} {seed}")
    counts, texts = [0, 0], sources(name)
    for _ in range(rounds):
        text, beside = rng.choice(texts)
        if beside and rng.random() < 0.5:
            beside = damaged(beside, name, rng)
        else:
            text = damaged(text, name, rng)
        try:
            counts[check(name, text, beside, rng)] += 1
        except Exception as error:
            raise AssertionError(f"{name}, seed {seed}: {text!r}, beside {beside!r}") from error
    return counts[1], counts[0]


@pytest.mark.parametrize("name", LANGUAGES)
def test_sources_are_read(name: str) -> None:
    rng = Random(name)
    assert all(check(name, text, beside, rng) for text, beside in sources(name))


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", LANGUAGES)
def test_some_damaged_programs(name: str) -> None:
    read, refused = campaign(name, 60, 0)
    assert read >= 5
    assert refused >= 5


@pytest.mark.slow
@pytest.mark.parametrize("part", range(1, 6))
@pytest.mark.parametrize("name", LANGUAGES)
def test_many_damaged_programs(name: str, part: int) -> None:
    campaign(name, 400, part)


PIECES = [
    b" ", b"\n", b"(", b"[", b"{", b"<", b"<!--", b"0", b"a", b"a,", b"1,", b"\\", b"M3 ", b"~\n", b",$A=B(C)",
    b"<Data ",
]  # fmt: skip


@pytest.mark.one_of_each
@pytest.mark.parametrize("piece", PIECES)
@pytest.mark.parametrize("name", LANGUAGES)
def test_no_text_takes_long(name: str, piece: bytes) -> None:
    """Of a program that goes on with one piece after some part of a move, or of a file beside it."""
    language, grammar = profile(name), fuzz.LANGUAGES[name]
    move = grammar.moves[0].format(n=1, x=1, y=1, mx=0.1, my=0.1).encode()
    long = piece * (LONGEST_LINE // 2 // len(piece))
    began = time.thread_time()
    for text, beside in ((grammar.head.encode() + move[: len(move) // 2] + long, b""), (grammar.head.encode(), long)):
        with pytest.raises(ProgramError):
            formats.read(language, text, "f.txt", beside)
    assert time.thread_time() - began < 2


@pytest.mark.parametrize(
    ("name", "begin", "piece"),
    [
        ("fanuc-tp", b"P[1]{GP1:UF:", b" \n"),
        ("fanuc-tp", b"P[1]{GP1:UF:1,UT:1,CONFIG:'N',X=1 mm,Y=1 mm,Z=1 mm,W=1 deg,P=1 deg,R=1 deg GP2:", b" \n"),
        ("rapid", b"MoveJ p10,v100\\T:=", b" \n"),
        ("rapid", b"x " + b"a:=" * 600, b"1,\n"),
        ("rapid", b"VAR num n:=", b"," + b" " * 2000 + b"\n"),
    ],
)
def test_no_statement_over_many_lines_takes_long(name: str, begin: bytes, piece: bytes) -> None:
    text = begin + piece * ((1 << 18) // len(piece))
    began = time.thread_time()
    with pytest.raises(ProgramError):
        list(statements(profile(name), ProgramSource(text, "f.txt")))
    assert time.thread_time() - began < 2
