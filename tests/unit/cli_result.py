"""Result of a call of the command line."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class CliResult:
    """Exit code, stdout and stderr."""

    code: int
    out: str
    err: str

    @property
    def answer(self) -> Any:
        """Return the JSON on stdout of a successful call."""
        assert self.code == 0, self.err
        return json.loads(self.out)

    @property
    def failure(self) -> int:
        """Return the exit code of a failed call with --json, whose JSON on stdout says the same."""
        facts = json.loads(self.out)
        assert (facts["ok"], facts["exit_code"], f"polishd: {facts['error']}\n") == (False, self.code, self.err)
        return self.code


def unwrapped(table: str) -> str:
    """Return the words of a printed table without its borders: where a cell breaks depends on its figures."""
    return " ".join(re.sub("[─-╿]", " ", table).split())


Polishd = Callable[..., CliResult]
