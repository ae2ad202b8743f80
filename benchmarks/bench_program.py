"""A million lines of a five-axis program, read and rewritten: ours, pygcode, gcodeparser, LinuxCNC's rs274."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np
import pygcode  # type: ignore[import-untyped]
from gcodeparser import parse_gcode_lines  # type: ignore[import-untyped]

from benchmarks.harness import MIN_REPEATS, PEER_CAP_S, Progress, Row, Runner, cpu_seconds, race
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import GcodeDialect, dialect
from polishd.plugins.rnc_robot.gcode import rewrite

LINES = 1_000_000
SLICE = 10_000
TIMES_LONGER = 10
LIMIT_MB = 200.0
RS274 = cast("GcodeDialect", dialect("rs274"))

# Peak resident memory of a child that rewrites argv[1] to argv[2] in bounded memory, MB. VmHWM counts the child alone;
# ru_maxrss would begin with its parent's value.
# ru_maxrss would begin with what its parent held.
MEMORY = """
import re, sys
from pathlib import Path
import numpy as np
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.gcode.rewrite import rewrite_stream
class Times:
    def take(self, count):
        return np.full(count, 0.1234)
    def finish(self):
        pass
with Path(sys.argv[1]).open("rb") as file, Path(sys.argv[2]).open("wb") as out:
    rewrite_stream(dialect("rs274"), file, "bench", Times(), out)
print(int(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1024)
"""
# CPU seconds of a child's first program, without its imports.
FIRST = """
import sys, time
from pathlib import Path
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect
text = Path(sys.argv[1]).read_bytes()
before = time.process_time()
program = formats.read(dialect("rs274"), text, "first")
formats.rewrite(dialect("rs274"), program, program.time_s + 0.01)
print(time.process_time() - before)
"""


def rows(progress: Progress) -> Iterator[Row]:
    """CPU per line beside the libraries, CPU beside the interpreter, the compiler's share, and memory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "program.ngc"
        progress(f"program: writing {LINES} lines")
        path.write_bytes(program(LINES))
        short = path.with_name("short.ngc")
        short.write_bytes(program(SLICE))
        yield _first(short, progress)
        in_memory(program(LINES // 100))  # compiled before the races: their runs are forks of this process
        yield from _libraries(path, short.read_text(), progress)
        if shutil.which("rs274"):
            name = f"program: {LINES} lines ({path.stat().st_size / 1e6:.0f} MB) rewritten, rs274 only reads"
            yield race(name, partial(file_to_file, path), {"rs274 -g": partial(interpreter, path)}, progress=progress)
        yield _memory(path, progress)


def program(lines: int) -> bytes:
    """Moves of five axes, each followed by its dwell."""
    n = lines // 2 - 2
    rng = np.random.default_rng(5)
    phase = np.linspace(0, 300, n)
    columns = (
        np.arange(n) * 20, 90 * np.sin(phase), 0.7 * phase - 105, np.cos(phase), 20 + 15 * np.sin(phase / 7),
        np.degrees(np.arctan2(np.sin(phase), 1.2)), np.arange(n) * 20 + 10, rng.uniform(0.02, 2, n),
    )  # fmt: skip
    point = "N{:.0f} G01 X{:.4f} Y{:.4f} Z{:.4f} A{:.4f} C{:.4f}\nN{:.0f} G04 P{:.4f}\n"
    body = "".join(map(point.format, *(column.tolist() for column in columns)))
    return f"G21 G90 G94\nG0 X0 Y0 Z5 A0 C0\nF3000\n{body}M2\n".encode()


class Times:
    """Return a dwell for each point, for any number of points."""

    def take(self, count: int) -> FloatArray:
        return np.full(count, 0.1234)

    def finish(self) -> None:
        """There are never too many."""


def file_to_file(path: Path) -> None:
    """Read a file to points, and write one with other times, as ``polishd program rewrite`` does."""
    with path.open("rb") as file, path.with_suffix(".new").open("wb") as out:
        passed = rewrite.rewrite_stream(RS274, file, "bench", Times(), out)
    if 2 * passed.points < passed.lines - 99:
        raise RuntimeError(f"{passed.points} points in {passed.lines} lines")


def in_memory(text: bytes) -> None:
    """Read to columns of points, and write other times, as a cycle of the daemon does."""
    read = formats.read(RS274, text, "bench")
    new = formats.rewrite(RS274, read, read.time_s * 1.1 + 0.001)
    if 2 * read.n < read.lines - 9 or len(new) < len(text):
        raise RuntimeError(f"{read.n} points became {len(new)} bytes")


def with_pygcode(text: str) -> None:
    """Do the same with pygcode: its machine follows the positions."""
    machine = pygcode.Machine()
    points, out = [], []
    for source in text.splitlines():
        line = pygcode.Line(source)
        machine.process_block(line.block)
        for code in line.block.gcodes:
            if code.word == "G04":
                points.append((dict(machine.pos.values), code.P))
                code.P = code.P * 1.1 + 0.001
        out.append(str(line))
    if len(points) < SLICE // 2 - 2 or len(out) < SLICE - 1:
        raise RuntimeError(f"pygcode found {len(points)} points")


def with_gcodeparser(text: str) -> None:
    """Do the same with gcodeparser, which has no positions."""
    points, out = 0, []
    for line in parse_gcode_lines(text):
        if line.command == ("G", 4):
            points += 1
            line.params["P"] = line.params["P"] * 1.1 + 0.001
        out.append(line.gcode_str)
    if points < SLICE // 2 - 2:
        raise RuntimeError(f"gcodeparser found {points} points")


def interpreter(path: Path) -> None:
    """LinuxCNC's interpreter reads the file."""
    with Path(os.devnull).open("r+b") as nothing:
        subprocess.run(
            ["rs274", "-g", path.name], cwd=path.parent, stdin=nothing, stdout=nothing, stderr=nothing, check=True
        )


def _libraries(path: Path, short: str, progress: Progress) -> Iterator[Row]:
    """All per line: the libraries run on a slice, for they take minutes for the whole."""
    runners: dict[str, tuple[Runner, int]] = {
        "file to file": (partial(file_to_file, path), LINES),
        "in memory": (partial(in_memory, path.read_bytes()), LINES),
        f"pygcode ({SLICE} lines)": (partial(with_pygcode, short), SLICE),
        f"gcodeparser ({SLICE} lines)": (partial(with_gcodeparser, short), SLICE),
    }
    taken: dict[str, list[float]] = {name: [] for name in runners}
    for turn in range(1, MIN_REPEATS + 1):
        for name, (run, lines) in runners.items():
            progress(f"program, CPU per line: {name} {turn}/{MIN_REPEATS}")
            cost = cpu_seconds(run, PEER_CAP_S)
            if cost is None:
                raise TimeoutError(f"{name} did not finish within {PEER_CAP_S:g} s")
            taken[name].append(1e6 * cost / lines)
    costs = {name: statistics.median(values) for name, values in taken.items()}
    peers = {name: cost for name, cost in costs.items() if "(" in name}
    for name in ("file to file", "in memory"):
        yield Row(f"program: read to points and rewritten {name}, CPU per line", costs[name], peers, "us/line")


def _first(path: Path, progress: Progress) -> Row:
    """Time of the compiler: once for each machine, and then the time to load its result."""
    progress("program: compiling")
    with tempfile.TemporaryDirectory() as cache:
        never, again = (float(_child(FIRST, path, cache=cache)) for _ in range(2))
    return Row(f"program: the first {SLICE} lines of a process", again, {"of a machine (compiles)": never})


def _memory(path: Path, progress: Progress) -> Row:
    """Peak resident memory, libraries and all, beside its limit."""
    progress(f"program: {TIMES_LONGER * LINES} lines in bounded memory")
    long = path.with_name("long.ngc")
    text = path.read_bytes().removesuffix(b"M2\n")
    with long.open("wb") as file:
        for _ in range(TIMES_LONGER):
            file.write(text)
        file.write(b"M2\n")
    peak_mb = float(_child(MEMORY, long, path.with_name("out.ngc")))
    size = f"{TIMES_LONGER * LINES} lines ({long.stat().st_size / 1e6:.0f} MB)"
    return Row(f"program: {size} rewritten file to file, peak memory", peak_mb, {"limit": LIMIT_MB}, "MB")


def _child(script: str, *arguments: Path, cache: str | None = None) -> str:
    environment = {**os.environ, "XDG_CACHE_HOME": cache} if cache else None
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
