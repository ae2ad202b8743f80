"""Result of a call of the command line."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Said:
    """Exit code, stdout and stderr."""

    code: int
    out: str
    err: str

    @property
    def answer(self) -> Any:
        """Return the JSON on stdout of a successful call."""
        assert self.code == 0, self.err
        return json.loads(self.out)


def unwrapped(table: str) -> str:
    """Return the words of a printed table without its borders: where a cell breaks depends on its figures."""
    return " ".join(re.sub("[─-╿]", " ", table).split())


Polishd = Callable[..., Said]
