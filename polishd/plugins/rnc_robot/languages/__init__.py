"""Robot languages (RAPID, KRL, FANUC TP, URScript, and your own), read and rewritten by profiles that are data."""

from __future__ import annotations

from polishd.plugins.rnc_robot.languages.data_file import beside_of
from polishd.plugins.rnc_robot.languages.move_times import recode_moves
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.plugins.rnc_robot.languages.program import read, rewrite, split, tool_and_frame

__all__ = [
    "LanguageProfile",
    "beside_of",
    "read",
    "recode_moves",
    "rewrite",
    "split",
    "tool_and_frame",
]
