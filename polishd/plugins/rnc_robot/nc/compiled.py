"""The scanner and the writer, compiled by numba where a program is large.

Small programs are run by the interpreter itself: the same functions, no compiler to wait for. Compiled code is kept in
the user's cache, in a folder named after the sources, so that no change of them meets code of before.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from polishd.plugins.rnc_robot.nc import block, moves, scan, words, write

LARGE_BYTES = 100_000
"""From here on compiled code, loaded in 0.2 s, is the quicker way."""
_ENTRIES = ("scan", "direct", "reciprocal", "splice")
"""What is called from outside."""


def kernel(function: Callable[..., Any], size: int) -> Callable[..., Any]:
    """The function, compiled where it is to work on so many bytes."""
    return function if size < LARGE_BYTES else _compiled(function)


def for_many() -> None:
    """Compile for small programs, too: a process that reads thousands of them, as a study's worker, waits once."""
    global LARGE_BYTES  # noqa: PLW0603  (of the process, and said once)
    LARGE_BYTES = 0


@cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    import numba

    _register_parts()
    settings: Any = numba.config
    folder = _folder(numba.__version__)
    before, settings.CACHE_DIR = settings.CACHE_DIR, folder or ""
    try:
        compiled: Callable[..., Any] = numba.njit(cache=folder is not None, nogil=True, **_uncounted())(function)
    finally:
        settings.CACHE_DIR = before
    return compiled


def _uncounted() -> dict[str, Any]:
    """The option by which compiled code counts no references; nothing where this numba has none.

    Nothing here allocates, and counting a dozen arrays at every call takes forty times the time (a whole program is
    read in seven times the time). The option is numba's own and not in its manual; a numba without it compiles the
    same code to the same numbers. What it offers instead (inlining by its own means or LLVM's) is as slow.
    """
    from numba.core import options

    return {"_nrt": False} if hasattr(getattr(options, "DefaultOptions", None), "_nrt") else {}


@cache
def _register_parts() -> None:
    """Let compiled functions call those of all parts."""
    from numba.extending import register_jitable

    jitable = register_jitable(**_uncounted())
    for module in (words, moves, block, scan, write):
        for name, value in vars(module).items():
            if callable(value) and getattr(value, "__module__", "") == module.__name__ and name not in _ENTRIES:
                jitable(value)


def _folder(version: str) -> str | None:
    """Where compiled code of these sources is kept; None where there is no home: then each process compiles."""
    digest = hashlib.sha256(version.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
        folder = base / "polishd" / digest.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (OSError, RuntimeError):  # nobody's home
        return None
    return str(folder)
