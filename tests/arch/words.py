"""Private phrases that source, messages and documentation avoid; `make check` looks for them.

The actor's name takes their place: the daemon, the driver, the solver, the operator, you. A technical use that has no
better word is listed in ALLOWED with its reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from tests.arch.repository_rules import tracked_files

FORBIDDEN = re.compile(
    r"\b(nobody|somebody|whoever|everybody|told|tells|thereafter|of its own|by itself|stands for|is said)\b",
    re.IGNORECASE,
)
FOLDERS = ("polishd/", "docs/")
SUFFIXES = {".py", ".md", ".toml", ".html", ".jinja", ".js", ".css", ".1"}
# (file, phrase, why): what no rule of wording can change.
ALLOWED: tuple[tuple[str, str, str], ...] = ()


def found_words(root: Path) -> Iterator[str]:
    """Yield ``FILE:LINE: phrase: the line`` for each forbidden phrase that is not allowed there."""
    allowed = {(file, phrase) for file, phrase, _ in ALLOWED}
    for path in tracked_files(root):
        name = path.relative_to(root).as_posix()
        if not name.startswith(FOLDERS) or path.suffix not in SUFFIXES:
            continue
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
            for match in FORBIDDEN.finditer(line):
                if (name, match[0].lower()) not in allowed:
                    yield f"{name}:{number}: {match[0]!r}: {line.strip()[:90]}"


def plain_words(root: Path) -> list[str]:
    """Source and documentation use plain technical English: no phrase of tests/arch/words.py."""
    return list(found_words(root))
