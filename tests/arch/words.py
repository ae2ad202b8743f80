"""Private phrases that source, messages, documentation and tests avoid; `make check` looks for them.

The actor's name takes their place: the daemon, the driver, the solver, the operator, you. A technical use that has no
better word is listed in ALLOWED with its reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from tests.arch.repository_rules import tracked_files

_PHRASES = "nobody|somebody|whoever|everybody|told|tells|thereafter|of its own|by itself|stands for|is said"
FORBIDDEN = re.compile(rf"\b({_PHRASES})\b", re.IGNORECASE)
FORBIDDEN_IN_TESTS = re.compile(rf"\b({_PHRASES}|anybody|whom|heard|hears|gullible|nasty)\b", re.IGNORECASE)
"""Programs of other languages and the corpus are exempt: only Python files of tests are checked."""
FOLDERS = ("polishd/", "docs/")
EXEMPT_TESTS = (
    "tests/arch/words.py",
    "tests/arch/test_rules.py",
    "tests/campaigns/result_files.py",
    "tests/campaigns/codecs/",
    "tests/campaigns/crash/",
    "tests/campaigns/faults/",
    "tests/campaigns/pits/",
)
"""This rule with its test; and the campaigns whose results depend on the hash of these files."""
SUFFIXES = {".py", ".md", ".toml", ".html", ".jinja", ".js", ".css", ".1"}
# (file, phrase, why): what no rule of wording can change.
ALLOWED: tuple[tuple[str, str, str], ...] = (
    ("tests/unit/cli/test_cell_notify.py", "told", "key of the file of waiting notifications"),
    ("tests/unit/cli/test_command_group.py", "nobody", "the test forbids it in option help"),
    ("tests/unit/cli/test_command_group.py", "somebody", "the test forbids it in option help"),
    ("tests/unit/cli/test_command_group.py", "whoever", "the test forbids it in option help"),
    ("tests/unit/cli/test_top.py", "heard", "label of the view"),
    ("tests/unit/shop/test_kills.py", "heard", "column of the shop's database"),
)


def _forbidden_in(name: str) -> re.Pattern[str] | None:
    """Return the phrases that the file must not contain; None where it is not checked."""
    if name.startswith("tests/"):
        return FORBIDDEN_IN_TESTS if name.endswith(".py") and not name.startswith(EXEMPT_TESTS) else None
    return FORBIDDEN if name.startswith(FOLDERS) and Path(name).suffix in SUFFIXES else None


def found_words(root: Path) -> Iterator[str]:
    """Yield ``FILE:LINE: phrase: the line`` for each forbidden phrase that is not allowed there."""
    allowed = {(file, phrase) for file, phrase, _ in ALLOWED}
    for path in tracked_files(root):
        name = path.relative_to(root).as_posix()
        forbidden = _forbidden_in(name)
        if forbidden is None:
            continue
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
            for match in forbidden.finditer(line):
                if (name, match[0].lower()) not in allowed:
                    yield f"{name}:{number}: {match[0]!r}: {line.strip()[:90]}"


def plain_words(root: Path) -> list[str]:
    """Source, documentation and tests use plain technical English: no phrase of tests/arch/words.py."""
    return list(found_words(root))
