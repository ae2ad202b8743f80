"""The trap corpus: small NC programs beside what each says, or why it must be refused, by its dialect's own rules."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).with_name("programs")


@dataclass(frozen=True)
class Case:
    """One program and its row in ``programs/cases.toml``, whose head says what the keys mean."""

    dialect: str
    name: str
    said: dict[str, Any]

    @property
    def path(self) -> Path:
        return FOLDER / self.dialect / f"{self.name}.nc"

    @property
    def text(self) -> bytes:
        return self.path.read_bytes()

    @property
    def refused(self) -> str | None:
        """Regex of the reason."""
        return self.said.get("refused")

    def __str__(self) -> str:
        return f"{self.dialect}/{self.name}"


def cases() -> list[Case]:
    """All of them, in the table's order."""
    table = tomllib.loads((FOLDER / "cases.toml").read_text(encoding="utf-8"))
    return [Case(dialect, name, said) for dialect, group in table.items() for name, said in group.items()]


def reason(message: str) -> tuple[int, str]:
    """Line (0: the whole file) and reason of a refusal, without the text it shows and without its advice."""
    before = message.partition(" To do: ")[0]
    found = re.match(r"[^:]*?(?:, line (\d+)|:(\d+))?: (.*)", before, re.DOTALL)
    assert found, message
    return int(found[1] or found[2] or 0), found[3].split(': "')[0]
