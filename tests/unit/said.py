"""What a call of the command line left behind."""

from __future__ import annotations

import json
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
        """The JSON on stdout of a call that went well."""
        assert self.code == 0, self.err
        return json.loads(self.out)


Polishd = Callable[..., Said]
