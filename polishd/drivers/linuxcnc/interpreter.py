"""LinuxCNC's interpreter as an independent reader: it converts a program to canonical machine calls.

``rs274 -g`` always prints four decimals. The Python module ``gcode`` of the same package runs the same interpreter and
gives doubles and line numbers, so it is used if it is installed.
"""

from __future__ import annotations

import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, NamedTuple

from polishd.model.errors import ProgramError
from polishd.util.files import environment_without_secrets

LIMIT_S = 900.0
"""Longest run: a million lines take 8 s; the limit ends an endless loop."""
PRINTED = 0.5e-4
"""Half of the last digit that ``rs274 -g`` prints."""

TOOLS = 99
"""Tools that ``G43 H`` may name; all of length 0."""

PROGRAM = "program.ngc"

_EXACT = Path(__file__).with_name("exact_calls.py")
_PYTHONS = ("/usr/bin/python3", "/usr/local/bin/python3")
_DECOR = ("executing",)


class Call(NamedTuple):
    """A canonical call: ``STRAIGHT_FEED(1.0, 2.0, ...)``."""

    line: int
    """1-based line of the program; 0 if the interpreter does not report it (``rs274 -g``)."""
    name: bytes
    arguments: bytes
    """As printed, without the brackets."""

    def numbers(self) -> list[float]:
        """Return the arguments as numbers. ValueError for other arguments (units, comments)."""
        return [float(word) for word in self.arguments.split(b",")]


@cache
def exact_python() -> str | None:
    """Return the Python with LinuxCNC's module ``gcode``, tested with a small program; None if there is none."""
    for python in _PYTHONS:
        if Path(python).exists():
            with _folder(b"G43 H1\nM2\n") as folder:
                tried = subprocess.run(
                    [python, "-I", str(_EXACT), PROGRAM],
                    cwd=folder,
                    env=_home(folder),
                    capture_output=True,
                    check=False,
                )
            if tried.returncode == 0:
                return python
    return None


@contextmanager
def canonical_calls(program: bytes | Path, name: str, *, exact: bool = False) -> Iterator[Iterator[Call]]:
    """Run a program through LinuxCNC's interpreter and yield its calls in bounded memory.

    Args:
        program: The program's text, or its file. It must end with M2, M30 or ``%``.
        name: The program's name, for messages.
        exact: Doubles (lengths in inches) and line numbers, from the module ``gcode`` (see ``exact_python``).
            False: the output of ``rs274 -g``, four decimals.

    Raises:
        ProgramError: LinuxCNC is not installed, or its interpreter refuses the program (with its message).
            Raised while the calls are read.
    """
    command = _command(exact=exact)
    with (
        _folder(program) as folder,
        Path(folder, "stderr").open("w+b") as said,
        _started(command, folder, said) as process,
    ):
        yield _calls(process, said, name)


@contextmanager
def _folder(program: bytes | Path) -> Iterator[str]:
    """Folder for one run: the interpreter writes variables to its working folder, and tools to the home folder."""
    with TemporaryDirectory(prefix="polishd-rs274-") as folder:
        file = Path(folder, PROGRAM)
        if isinstance(program, Path):
            file.symlink_to(program.absolute())
        else:
            file.write_bytes(program)
        # Tools without lengths and no variables, not those of a machine on this computer
        Path(folder, "tool.tbl").write_text("".join(f"T{tool} P{tool} Z0\n" for tool in range(1, TOOLS + 1)))
        Path(folder, "program.var").touch()
        yield folder


def _home(folder: str) -> dict[str, str]:
    """Environment with its own home folder: ~/.tool.mmap would be shared with other runs and a running LinuxCNC."""
    return environment_without_secrets({"HOME": folder})


def _command(*, exact: bool) -> list[str]:
    if exact:
        python = exact_python()
        if python is not None:
            return [python, "-I", str(_EXACT), PROGRAM]
    rs274 = shutil.which("rs274")
    if rs274 is None:
        raise ProgramError(
            "LinuxCNC's interpreter rs274 is not installed. Install it with apt-get install --no-install-recommends "
            "linuxcnc-uspace (Debian), or omit --with rs274."
        )
    return [rs274, "-t", "tool.tbl", "-v", "program.var", "-g", PROGRAM]


@contextmanager
def _started(command: list[str], folder: str, said: IO[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """Run the interpreter's process, which ends with the block or at the time limit."""
    with subprocess.Popen(
        command, cwd=folder, env=_home(folder), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said
    ) as process:
        watch = threading.Timer(LIMIT_S, process.kill)
        watch.daemon = True
        watch.start()
        try:
            yield process
        finally:
            watch.cancel()
            process.kill()


def _calls(process: subprocess.Popen[bytes], said: IO[bytes], name: str) -> Iterator[Call]:
    if process.stdout is None:
        return
    for printed in process.stdout:
        head, bracket, arguments = printed.partition(b"(")
        words = head.split()
        if not bracket or len(words) != 3:
            raise ProgramError(f"{name}: rs274 printed {printed[:80]!r}, which is not a canonical call.")
        number = words[1].removeprefix(b"N")
        yield Call(int(number) if number.isdigit() else 0, words[2], arguments.rstrip().removesuffix(b")"))
    if process.wait() != 0:
        raise ProgramError(f"{name}: {_complaint(process.returncode, said)}")


def _complaint(code: int, said: IO[bytes]) -> str:
    """Return the interpreter's error message."""
    said.seek(0)
    lines = said.read(4096).decode("utf-8", "replace").splitlines()
    words = "; ".join(line.strip() for line in lines if line.strip() and line.strip() not in _DECOR)
    if not words:
        words = f"no reason, exit code {code}"
        if code < 0:
            words = f"it ended with signal {-code}" + (f", perhaps at the limit of {LIMIT_S:g} s" if code == -9 else "")
    return f"LinuxCNC's interpreter refuses it: {words}. Correct the program, or verify without --with rs274."
