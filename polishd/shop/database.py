"""The shop's one database, and how it is used: whole transactions, by several threads and processes in turn."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from polishd.model.errors import ConfigError, LinkError
from polishd.shop.schema import DATABASE_NAME, open_database


class Database:
    """One connection to it, which threads use in turn; ``with`` closes it."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._use = threading.RLock()

    @classmethod
    def open(cls, state_dir: Path) -> Self:
        """That of a shop's folder; ConfigError where it cannot be used."""
        return cls(open_database(state_dir / DATABASE_NAME))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Idempotent."""
        self._connection.close()

    @contextmanager
    def transaction(self) -> Iterator[DatabaseTransaction]:
        """All of it, durable at the end of this block, or nothing. LinkError where the disk, or its turn, fails.

        ConfigError where a row does not go with the others.
        """
        with self._use:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                try:
                    yield DatabaseTransaction(self._connection)
                except BaseException:
                    self._connection.execute("ROLLBACK")
                    raise
                self._connection.execute("COMMIT")
            except sqlite3.IntegrityError as error:
                raise ConfigError(
                    f"that does not go with what the shop has: {error}; nothing of it was taken"
                ) from error
            except sqlite3.Error as error:
                raise LinkError(f"the shop's database: {error}; nothing of this was taken; look at its disk") from error


class DatabaseTransaction:
    """What is read and written as one."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def rows(self, sql: str, *values: Any) -> list[dict[str, Any]]:
        """All rows, each by column."""
        cursor = self._connection.execute(sql, values)
        names = [column[0] for column in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]

    def row(self, sql: str, *values: Any) -> dict[str, Any] | None:
        """The first one; None where there is none."""
        return next(iter(self.rows(sql, *values)), None)

    def run(self, sql: str, *values: Any) -> int:
        """Write; how many rows that changed."""
        return self._connection.execute(sql, values).rowcount

    def insert(self, how: str, values: Mapping[str, Any]) -> None:
        """One row; ``how``: ``INSERT INTO table``, or what stands for it."""
        marks = ", ".join("?" * len(values))
        self.run(f"{how} ({', '.join(values)}) VALUES ({marks})", *values.values())

    def word(self, who: str, what: str, job: str, cell: str = "", why: str = "") -> None:
        """The shop decided that, and this is who wanted it."""
        row = {"at": time.time(), "who": who, "what": what, "job": job, "cell": cell, "why": why}
        self.insert("INSERT INTO word", row)
