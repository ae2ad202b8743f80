"""Compiled and interpreted are one: the same numbers to the last bit, the same bytes, the same refusals."""

from __future__ import annotations

from functools import cache
from random import Random
from typing import cast

import numpy as np
import pytest

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import GcodeDialect, dialect
from polishd.plugins.rnc_robot.gcode import jit, kernels, rewrite, scanner
from polishd.util import jit as compiling
from tests.corpus.fuzz import GRAMMARS, program
from tests.corpus.table import Case, cases

NEVER = 1 << 60
Patch = pytest.MonkeyPatch


@cache
def profile(name: str) -> GcodeDialect:
    return cast(GcodeDialect, dialect(name))


def outcome(name: str, text: bytes, patch: Patch, size: int) -> Program | str:
    """The program, or why it is refused; compiled from ``size`` bytes on."""
    patch.setattr(jit, "LARGE_BYTES", size)
    try:
        return formats.read(profile(name), text, "t.nc")
    except ProgramError as error:
        return str(error)


def bits(values: np.ndarray) -> bytes:
    """Zeros have signs, and NaNs are equal."""
    return values.tobytes()


def same(one: Program | str, other: Program | str) -> None:
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
        return
    for field in Program.__dataclass_fields__:
        mine, theirs = getattr(one, field), getattr(other, field)
        if isinstance(mine, np.ndarray):
            assert (mine.dtype, mine.shape) == (theirs.dtype, theirs.shape), field
            assert bits(mine) == bits(theirs), field
        else:
            assert mine == theirs, field


def written(name: str, found: Program, times: np.ndarray, patch: Patch, size: int) -> list[bytes | str]:
    """The program with these times in every encoding, or why it cannot be."""
    patch.setattr(jit, "LARGE_BYTES", size)
    texts: list[bytes | str] = []
    for encoding in (None, "dwell", "feed", "inverse"):
        try:
            texts.append(formats.rewrite(profile(name), found, times, encoding))
        except ProgramError as error:
            texts.append(str(error))
    return texts


def agree(name: str, text: bytes, patch: Patch) -> None:
    found = outcome(name, text, patch, NEVER)
    same(found, outcome(name, text, patch, 0))
    if not isinstance(found, str):
        times = found.time_s * np.random.default_rng(len(text)).choice([1.0, 0.37, 2.6], found.n) + 0.0123456789
        assert written(name, found, times, patch, NEVER) == written(name, found, times, patch, 0)


@pytest.mark.one_of_each("case.dialect")
@pytest.mark.parametrize("case", cases(), ids=str)
def test_the_corpus(case: Case, monkeypatch: Patch) -> None:
    agree(case.dialect, case.text, monkeypatch)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", GRAMMARS)
def test_in_pieces(name: str, monkeypatch: Patch) -> None:
    """Arrays are kept from piece to piece; a larger one needs larger arrays."""
    rng = Random(name)
    for share in (0.0, 0.0, 0.02):
        text = program(name, rng, 120, share)
        head, gap = text.partition(b"\n")[::2]
        text = head + b"\n" + b"\n" * 300 + gap
        for size in (41, 200):
            monkeypatch.setattr(rewrite, "PIECE_BYTES", size)
            agree(name, text, monkeypatch)


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("G1 X#1\n", 3),
        ("G1 X1 F60\n" * 5 + "G4 P1 P2\n", 8),
        ("G1 X1 F0\n", 3),
        ("G1 X1e5 F9\n", 3),
        ("G1 X12345678901234567890 F9\n", 3),
        ("G1 X1 F9 " + "S1 " * 60 + "\n", 3),
        ("(a (b)\n", 3),
        ("\nG2 X1 F9\n", 4),
        ("M60\n", 3),
        ("G1 X1 F9\n%\n", 4),
    ],
)
def test_the_same_line_and_reason(body: str, line: int, monkeypatch: Patch) -> None:
    text = f"G21 G90\nG0 X0 Y0 Z0\n{body}M2\n".encode()
    found = outcome("rs274", text, monkeypatch, 0)
    assert isinstance(found, str)
    assert found.startswith(f"t.nc, line {line}: ")
    assert found == outcome("rs274", text, monkeypatch, NEVER)


@pytest.mark.full
def test_a_numba_without_the_private_option_gives_the_same_numbers(monkeypatch: Patch) -> None:
    assert compiling.no_refcount_option() == {"_nrt": False}, (
        "numba has lost the option: compiled code is seven times slower"
    )
    monkeypatch.setattr("numba.core.options.DefaultOptions", object())
    assert compiling.no_refcount_option() == {}
    monkeypatch.setattr(compiling, "_folder", lambda *_: None)
    monkeypatch.setattr(jit, "_register_parts", lambda: None)
    counted = jit._compiled.__wrapped__(kernels.direct)
    assert counted is not jit.kernel(kernels.direct, NEVER)
    times, old, style = np.array([0.1234, 2.0, 0.3]), np.full(3, np.nan), np.full(3, 3)
    results = []
    for run in (kernels.direct, counted):
        out = rewrite.FormattedNumbers(np.zeros(3, dtype=np.int64), np.full(3, -1))
        results.append(
            (run(times, old, np.ones(3), style, 3, 0, 0.0, out), out.mantissa.tolist(), out.decimals.tolist())
        )
    assert results[0] == results[1]


def test_large_programs_are_compiled() -> None:
    size = jit.LARGE_BYTES
    assert jit.kernel(scanner.scan, size - 1) is scanner.scan
    assert hasattr(jit.kernel(scanner.scan, size), "py_func")
    assert jit.kernel(scanner.scan, size) is jit.kernel(scanner.scan, size + 1)
    assert vars(jit.kernel(kernels.splice, size))["py_func"] is kernels.splice


def test_a_process_that_reads_many_compiles_for_small_ones(monkeypatch: Patch) -> None:
    monkeypatch.setattr(jit, "LARGE_BYTES", jit.LARGE_BYTES)
    jit.compile_always()
    assert hasattr(jit.kernel(scanner.scan, 1), "py_func")


def test_across_the_limit(monkeypatch: Patch) -> None:
    """A program whose pieces are of both kinds."""
    lines = "".join(f"G1 X{i % 90} F60\nG4 P0.{i % 900 + 100}\n" for i in range(300))
    text = f"G21 G90\nG0 X0 Y0 Z0\n{lines}M2\n".encode()
    whole = outcome("rs274", text, monkeypatch, NEVER)
    assert isinstance(whole, Program)
    expected = written("rs274", whole, whole.time_s + 0.25, monkeypatch, NEVER)
    monkeypatch.setattr(rewrite, "PIECE_BYTES", 1000)
    same(whole, outcome("rs274", text, monkeypatch, 990))
    assert written("rs274", whole, whole.time_s + 0.25, monkeypatch, 990)[0] == expected[0]
