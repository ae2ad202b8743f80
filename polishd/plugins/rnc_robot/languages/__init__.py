"""Robot languages (RAPID, KRL, FANUC TP, URScript, and a user's own), read and rewritten by profiles that are data.

A profile says in templates which statement moves, which waits, and which changes neither place nor time; everything
else is refused. Time sits in the dwells: ``encoding`` is always ``"dwell"``.
"""

from __future__ import annotations

from polishd.plugins.rnc_robot.languages.profile import LanguageProfile, parse
from polishd.plugins.rnc_robot.languages.reader import read
from polishd.plugins.rnc_robot.languages.rewriter import rewrite, split

__all__ = ["LanguageProfile", "parse", "read", "rewrite", "split"]
