"""The scanner and the writer, compiled by numba where a program is large.

Small programs are run by the interpreter itself: the same functions, no compiler to wait for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from polishd.plugins.rnc_robot.gcode import kernels, scanner
from polishd.util.jit import compile_cached, has_compiler, no_refcount_option

LARGE_BYTES = 350_000
"""From here on compiled code, loaded in 0.3 s, is the quicker way."""
_ENTRIES = ("scan", "direct", "reciprocal", "splice")
"""What is called from outside."""


def kernel(function: Callable[..., Any], size: int) -> Callable[..., Any]:
    """The function, compiled where it is to work on so many bytes."""
    return _compiled(function) if size >= LARGE_BYTES and has_compiler() else function


def compile_always() -> None:
    """Compile for small programs, too: a process that reads thousands of them, as a study's worker, waits once."""
    global LARGE_BYTES  # noqa: PLW0603  (of the process, and said once)
    LARGE_BYTES = 0


@cache
def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    _register_parts()
    return compile_cached(function, Path(__file__).parent.glob("*.py"))


@cache
def _register_parts() -> None:
    """Let compiled functions call those of all parts."""
    from numba.extending import register_jitable

    jitable = register_jitable(**no_refcount_option())
    for module in (scanner, kernels):
        for name, value in vars(module).items():
            if callable(value) and getattr(value, "__module__", "") == module.__name__ and name not in _ENTRIES:
                jitable(value)
