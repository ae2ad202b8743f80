"""polishd, the controller daemon of an unattended robotic polishing cell, with the names of `polishd.analysis`."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

__version__ = "1.0.0"


def __getattr__(name: str) -> Any:
    """What a researcher computes with: late, for the daemon and its drivers need none of it.

    ``from polishd import hookspecs`` asks for the module here first: modules of polishd's own are left to the import.
    """
    if not name.startswith("_") and find_spec(f"{__name__}.{name}") is None:
        researcher = import_module("polishd.analysis")
        if name in researcher.__all__:
            return getattr(researcher, name)
    raise AttributeError(f"module 'polishd' has no attribute {name!r}")
