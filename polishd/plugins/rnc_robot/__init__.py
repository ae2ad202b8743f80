"""Robot programs: RNC programs in all dialects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from polishd.api import ProgramFormat, hookimpl
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.formats import format_of, shipped_formats

POLISHD_API = 1


@hookimpl
def polishd_program_formats(profiles: Sequence[Path]) -> Sequence[ProgramFormat]:
    """One a shipped dialect, and one a profile of the user's."""
    return [*shipped_formats(), *map(format_of, map(dialect, profiles))]
