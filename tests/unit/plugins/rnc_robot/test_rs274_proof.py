"""Rewritten programs, run by LinuxCNC's own interpreter: the same motion, and the times that were asked for."""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from numpy.typing import NDArray

from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect
from tests.corpus.changes import quanta_s, strayed
from tests.corpus.table import Case, cases

pytestmark = pytest.mark.skipif(shutil.which("rs274") is None, reason="no rs274 (LinuxCNC) on this machine")

RS274 = dialect("rs274")
PRINTED = 5e-5
"""Half of the last digit that the interpreter prints."""
ENCODINGS = ("dwell", "feed", "inverse")
SHAPES = [(encoding, units, mode) for encoding in ENCODINGS for units in ("G21", "G20") for mode in ("G90", "G91")]
# One of each encoding, each unit and each mode.
QUICK = [("feed", "G20", "G91")]


@dataclass(frozen=True)
class Run:
    """What the interpreter says that a program does."""

    motion: list[str]
    """All it prints but times, in order."""
    dwell_s: NDArray[np.float64]
    feed: NDArray[np.float64]
    """Speed that held at each feed move, in the program's units a minute; under G93 too, where F is not that."""


def interpret(path: Path) -> Run:
    command = ["rs274", "-g", path.name]
    # a separate home: two at once share ~/.tool.mmap, and die of SIGBUS now and then
    with TemporaryDirectory() as home:
        done = subprocess.run(
            command,
            cwd=path.parent,
            env={**os.environ, "HOME": home},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
        )
    assert done.returncode == 0, done.stderr[-500:]
    motion, dwells, feeds, feed = [], [], [], np.nan
    for line in done.stdout.decode("latin-1").splitlines():
        said = line.split(None, 2)[2]  # 12 N..... STRAIGHT_FEED(1.0000, ...)
        if said.startswith("DWELL"):
            dwells.append(float(said[6:-1]))
            said = "DWELL"
        elif said.startswith("SET_FEED_RATE"):
            feed = float(said[14:-1])
            continue  # an F word that was added changes no motion
        elif said.startswith(("STRAIGHT_FEED", "ARC_FEED")):
            feeds.append(feed)
        motion.append(said)
    return Run(motion, np.array(dwells), np.array(feeds))


def written(encoding: str, units: str, mode: str, n: int) -> tuple[bytes, NDArray[np.float64]]:
    """A program of n points, and the length of each move in its own units; every digit is one that is printed."""
    rng = np.random.default_rng(n)
    steps = np.round(rng.uniform(-2, 2, (n, 3)), 3)
    steps[:, 0] = np.where(steps[:, 0] == 0, 0.25, steps[:, 0])
    words = np.round(np.cumsum(steps, axis=0), 3) if mode == "G90" else steps
    feed = np.round(rng.uniform(50, 3000, n), 1)
    lines = ["(G4 P9)", f"{units} G90 G94 G64 P0.005", "G0 X0 Y0 Z0 A0 C0", "G4 P2.5", mode]
    if encoding == "inverse":
        lines.append("G93")
    for index, ((x, y, z), f) in enumerate(zip(words.tolist(), feed.tolist(), strict=True)):
        place = f"X{x:.3f} Y{y:.3f} Z{z:.3f} A{index % 40} C{index % 360}.5"
        if encoding == "dwell" and index % 7 == 3 and (arc := _arc(steps[index], x, y)):
            lines.append(arc)
        elif encoding == "dwell":
            lines.append(f"G1 {place} F{f}" if index % 5 == 0 else f"N{index} g1{place.lower()}")
        else:
            # in a feed program every third F holds over from the move before
            lines.append(f"G1 {place}" + (f" F{f}" if encoding == "inverse" or index % 3 == 0 else ""))
        if encoding == "dwell":
            lines.append(("G4 P{:.3f} (P3)", "g4p{:.2f}", "P {:.1f} G4 ; P4")[index % 3].format(f / 1500))
    return "\n".join([*lines, "G0 Z50", "M2", ""]).encode(), np.sqrt((steps**2).sum(axis=1))


def _arc(step: NDArray[np.float64], x: float, y: float) -> str:
    """Half a circle or a helix in the plane, around the middle of the way."""
    i, j = step[:2] / 2
    return f"G2 X{x:.3f} Y{y:.3f} I{i:.4f} J{j:.4f}"


def prove(folder: Path, encoding: str, units: str, mode: str, n: int) -> None:
    old, length = written(encoding, units, mode, n)
    program = formats.read(RS274, old, "proof.ngc")
    assert (program.n, program.encoding) == (n, encoding)
    asked = program.time_s * np.random.default_rng(1).uniform(0.2, 5, n) + 0.01
    new = formats.rewrite(RS274, program, asked)
    assert strayed(program, new) == []
    (folder / "old.ngc").write_bytes(old)
    (folder / "new.ngc").write_bytes(new)
    before, after = interpret(folder / "old.ngc"), interpret(folder / "new.ngc")
    assert before.motion == after.motion
    if encoding == "dwell":
        assert after.dwell_s[0] == before.dwell_s[0] == 2.5  # leads to no point
        was, got, printed = before.dwell_s[1:], after.dwell_s[1:], np.full(n, PRINTED)
    else:
        was, got = 60 * length / before.feed, 60 * length / after.feed
        printed = got / after.feed * PRINTED
    assert (np.abs(program.time_s - was) <= (was / before.feed * PRINTED if encoding == "inverse" else 1e-9)).all()
    quanta = quanta_s(program, new, asked)
    assert (np.abs(got - asked) <= quanta + printed).all()
    exact = formats.read(RS274, new, "new.ngc").time_s
    assert (np.abs(exact - got) <= printed + 1e-12).all()
    assert abs(exact.sum() - asked.sum()) <= quanta.max()


@pytest.mark.one_of_each
@pytest.mark.parametrize("shape", SHAPES, ids="-".join)
def test_small(tmp_path: Path, shape: tuple[str, str, str]) -> None:
    prove(tmp_path, *shape, n=500)


@pytest.mark.full
@pytest.mark.parametrize("shape", QUICK, ids="-".join)
def test_100_000_points(tmp_path: Path, shape: tuple[str, str, str]) -> None:
    prove(tmp_path, *shape, n=100_000)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape not in QUICK], ids="-".join)
def test_100_000_points_in_every_shape(tmp_path: Path, shape: tuple[str, str, str]) -> None:
    prove(tmp_path, *shape, n=100_000)


READ = [case for case in cases() if case.dialect == "rs274" and case.refused is None]


@pytest.mark.one_of_each
@pytest.mark.parametrize("case", READ, ids=str)
def test_the_corpus_expects_what_the_interpreter_does(case: Case) -> None:
    run = interpret(case.path)
    said = case.said
    if said.get("encoding", "dwell") == "dwell":
        # the interpreter also runs the dwells that are no points
        assert set(np.round(said["time_s"], 4)) <= set(np.abs(run.dwell_s))
    else:
        assert len(run.feed) == len(said["time_s"])
    ends = ends_mm(run.motion)
    for end in said.get("end_mm", []):
        assert any(np.allclose(end, place, atol=1e-3) for place in ends), (end, ends)


def ends_mm(motion: list[str]) -> list[list[float]]:
    """Return the end of each feed move, mm."""
    unit, plane, found = 1.0, "XY", []
    for said in motion:
        if said.startswith("USE_LENGTH_UNITS"):
            unit = 25.4 if "INCH" in said else 1.0
        elif said.startswith("SELECT_PLANE"):
            plane = said[-3:-1]
        elif "_FEED(" in said:
            first, second, third, *more = (float(value) * unit for value in said.partition("(")[2][:-1].split(","))
            if said.startswith("ARC"):  # its end in the plane, its centre, its turns, and where the third axis goes
                third = more[2]
                turned = {"XY": [first, second, third], "XZ": [second, third, first], "YZ": [third, first, second]}
                found.append(turned[plane])
            else:
                found.append([first, second, third])
    return found
