"""``polishd run`` that is killed at a commit of its journal.

``python -m tests.campaigns.crash.killed_daemon N WHERE CELL ...``.

``WHERE``: ``before`` the N-th COMMIT, ``amid`` its rows (after the first), or ``after`` it, when no caller knows that
it is durable.
"""

from __future__ import annotations

import functools
import os
import signal
import sqlite3
import sys
from pathlib import Path
from typing import Any

from polishd.daemon.journal.journal import Journal

WHERE = ("before", "amid", "after")


class Attacked(sqlite3.Connection):
    """Counts its commits."""

    left, where = 0, ""

    def execute(self, sql: str, values: Any = (), /) -> sqlite3.Cursor:
        """One statement; perhaps the last."""
        commits = sql == "COMMIT"
        if self.left == 1 and self.where == "before" and commits:
            os.kill(os.getpid(), signal.SIGKILL)
        cursor = super().execute(sql, values)
        if self.left == 1 and (commits if self.where == "after" else self.where == "amid" and self.in_transaction):
            os.kill(os.getpid(), signal.SIGKILL)
        self.left -= commits
        return cursor


def connect(path: Path) -> sqlite3.Connection:
    """A ``Connect`` for the journal."""
    return sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0, factory=Attacked)


if __name__ == "__main__":
    Attacked.left, Attacked.where = int(sys.argv[1]), sys.argv[2]
    Journal.of_cell = functools.partial(Journal.of_cell, connect=connect)  # type: ignore[method-assign]
    from polishd.__main__ import main

    sys.argv = ["polishd", "run", *sys.argv[3:]]
    main()
