"""Print a program's canonical calls as ``rs274 -g`` does, but with doubles and line numbers.

A separate script: it runs in the Python that LinuxCNC's module ``gcode`` is built for, not in polishd's. The module
gives lengths in inches, whatever the program's unit is.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import Any

ANSWERS = {
    "check_abort": False,
    "get_external_length_units": 1.0,  # millimetres a machine unit
    "get_external_angular_units": 1.0,  # degrees a machine unit
    "get_axis_mask": 0x3F,  # X, Y, Z, A, B, C
    "get_block_delete": False,  # the switch is off: a line that begins with / is read, as ``rs274 -g`` does
}
"""Machine parameters for the interpreter."""


class Canon:
    """Machine interface for the interpreter: no tools; prints each call."""

    parameter_file = "program.var"

    def __init__(self) -> None:
        self._line = 0
        self._count = 0

    def __getattr__(self, name: str) -> Callable[..., object]:
        def call(*arguments: object) -> None:
            self._count += 1
            shown = ", ".join(map(repr, arguments)).replace("\n", " ")
            sys.stdout.write(f"{self._count} N{self._line} {name.upper()}({shown})\n")

        found = (lambda: ANSWERS[name]) if name in ANSWERS else call
        setattr(self, name, found)  # cached for the next call of this name
        return found

    def next_line(self, state: Any) -> None:
        """Record that the interpreter begins a line."""
        self._line = state.sequence_number

    def get_tool(self, pocket: int) -> tuple[float, ...]:
        """Return the tool in a pocket, of length 0."""
        return (pocket, *(0.0,) * 12, 0)


def load_tools() -> None:
    """Load tool.tbl into the interpreter's tool memory: without it the interpreter crashes at ``G43 H1``."""
    data = ctypes.CDLL("libtooldata.so.0")
    data["_Z17tool_mmap_creatorPK13EMC_TOOL_STATi"](None, 0)
    data["_Z13tooldata_loadPKcPPc"](b"tool.tbl", None)


def main(path: str) -> int:
    """Interpret a file; return 1 and print the reason on stderr if the interpreter refuses it."""
    import gcode  # type: ignore[import-not-found]  # LinuxCNC's, in the system's Python

    load_tools()
    result, line = gcode.parse(path, Canon(), "G21", "G90")
    if result <= gcode.MIN_ERROR:
        return 0
    # a line that cannot be read counts already, one that cannot be run does not
    sys.stderr.write(f"at or before line {line}: {gcode.strerror(result)}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
