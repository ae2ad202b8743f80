"""The file beside a program that declares its positions: a .dat beside a .src, a .dtx beside a .pgx."""

from __future__ import annotations

from pathlib import Path

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile


def beside_of(profile: LanguageProfile, program: Path) -> bytes:
    """Content of the file beside a program; empty where the language has none, or where none is there.

    ProgramError where several may be meant, or where it cannot be read.
    """
    rules = profile.data_file
    if rules is None:
        return b""
    try:
        there = sorted(
            path for path in program.parent.iterdir() if path.suffix.lower() == rules.ending and path.is_file()
        )
        found = [path for path in there if path.stem.lower() == program.stem.lower()]
        if not found and rules.any_name:
            found = there
        if len(found) > 1:
            raise ProgramError(
                f"{program.name}: {', '.join(path.name for path in found)} stand beside it, and which of them "
                "declares its positions is not known. To do: keep that one there only."
            )
        return found[0].read_bytes() if found else b""
    except OSError as error:
        raise ProgramError(
            f"{program.name}: {rules.title} cannot be read: {error.strerror}. To do: check {program.parent}."
        ) from error
