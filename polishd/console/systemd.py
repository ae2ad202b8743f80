"""What all units of systemd share: command lines as it reads them, and where a unit belongs."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable

from polishd.model.errors import ConfigError

NETWORK = """\
After=network-online.target
Wants=network-online.target
"""
HARDENED = """\
NoNewPrivileges=yes
LockPersonality=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
"""
PROTECTED = """\
ProtectSystem=full
ProtectControlGroups=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
"""
"""What only the system's own systemd may give."""


def command_line(words: Iterable[str]) -> str:
    """Of ``ExecStart``: this Python's polishd, with those words."""
    return " ".join([quoted(sys.executable, executable=True), *map(quoted, ("-m", "polishd", *words))])


def target(*, system: bool) -> str:
    """What wants it, at each boot or at each login."""
    return "multi-user.target" if system else "default.target"


def quoted(word: str, *, executable: bool = False) -> str:
    """One word of ``ExecStart``: systemd reads escapes, ``%`` and, but in the program's own path, ``$`` in it.

    ConfigError for a line break or another control character, which no unit can hold.
    """
    if re.search(r"[\x00-\x1f\x7f]", word):
        raise ConfigError(f"{word!r}: a unit of systemd cannot name it; rename the file")
    text = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    text = text if executable else text.replace("$", "$$")
    return text if re.fullmatch(r"[\w./+=:@,-]+", text, re.ASCII) else f'"{text}"'
