"""Reports of cells are stored once: also when sent again, incomplete, out of order, or of another journal."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from polishd.model.errors import ConfigError, LinkError
from polishd.shop import database, server
from polishd.shop.database import CellReport, Database


@pytest.fixture
def shop(tmp_path: Path) -> Iterator[Database]:
    with Database.open(tmp_path / "state") as found:
        yield found


def report_of(first: int, last: int, **more: Any) -> CellReport:
    events = [(seq, 1, 100.0 + seq, None, "held", f'{{"n": {seq}}}') for seq in range(first, last + 1)]
    return CellReport(
        journal="J", first=first, last=last, before=f"h{first - 1}" if first > 1 else "", tail=f"h{last}",
        now={"state": "idle"}, events=events, **more,
    )  # fmt: skip


def take(shop: Database, report: CellReport, cell: str = "north") -> int:
    with shop.transaction() as sql:
        return database.take(sql, cell, report)


def numbers(shop: Database, cell: str = "north") -> list[int]:
    with shop.transaction() as sql:
        return [row["seq"] for row in sql.rows("SELECT seq FROM event WHERE cell = ? ORDER BY seq", cell)]


def test_each_event_is_taken_once(shop: Database) -> None:
    assert take(shop, report_of(1, 3)) == 3
    assert take(shop, report_of(1, 3)) == 3, "its answer was lost, and it is sent again"
    assert take(shop, report_of(4, 6)) == 6
    assert numbers(shop) == [1, 2, 3, 4, 5, 6]


def test_a_gap_is_refused_and_the_answer_says_where_to_begin(shop: Database) -> None:
    take(shop, report_of(1, 3))
    assert take(shop, report_of(6, 8)) == 3
    assert take(shop, report_of(2, 8)) == 3, "nor a part of it twice"
    assert numbers(shop) == [1, 2, 3]


def test_an_empty_range_means_nothing_new(shop: Database) -> None:
    take(shop, report_of(1, 3))
    assert take(shop, replace(report_of(4, 3), events=(), tail="")) == 3
    assert take(shop, report_of(4, 4)) == 4


def test_progress_is_left_out_and_counted(shop: Database) -> None:
    report = report_of(1, 5)
    assert take(shop, replace(report, events=report.events[::2])) == 5
    assert numbers(shop) == [1, 3, 5]


def test_another_cell_and_another_journal_count_by_themselves(shop: Database) -> None:
    take(shop, report_of(1, 3))
    assert take(shop, report_of(1, 2), "south") == 2
    assert take(shop, replace(report_of(1, 2), journal="K")) == 2
    assert numbers(shop) == [1, 1, 2, 2, 3]


def test_a_journal_that_was_put_back_to_an_older_copy_is_refused_loudly(shop: Database) -> None:
    take(shop, report_of(1, 3))
    with pytest.raises(ConfigError, match="of 3 events that this shop has, the last is another now"):
        take(shop, replace(report_of(4, 5), before="other"))
    assert numbers(shop) == [1, 2, 3]


@pytest.mark.parametrize("seqs", [(1, 1, 2), (2, 1), (1, 9)])
def test_a_report_whose_events_are_out_of_order_is_no_report(shop: Database, seqs: tuple[int, ...]) -> None:
    events = [(seq, 1, 0.0, None, "held", "{}") for seq in seqs]
    with pytest.raises(ValueError, match="out of their order"):
        take(shop, replace(report_of(1, 3), events=events))
    assert numbers(shop) == []


def test_jobs_passes_and_maps_are_known_once_as_they_are_now(shop: Database) -> None:
    job, row = [1, "lens", "P-1", 5.0, None, None, None], [1, 0, "ab", 6.0, None, None, "{}"]
    maps = [[1, 0, 5.5, '{"rms_nm": 9.5}']]
    take(shop, report_of(1, 3, jobs=[job], passes=[row], maps=maps))
    job, row = [*job[:4], 8.0, "in_tolerance", None], [*row[:4], 7.0, "done", "{}"]
    maps = [*maps, [1, 1, 7.5, '{"rms_nm": 1.5}']]
    for _ in range(2):
        take(shop, report_of(4, 5, jobs=[job], passes=[row], maps=maps))
    with shop.transaction() as sql:
        (found,) = server.history(sql)["jobs"]
        assert len(sql.rows("SELECT * FROM pass")) == 1
    assert (found["name"], found["outcome"], found["passes"], found["rms_nm"]) == (
        "lens",
        "in_tolerance",
        1,
        [9.5, 1.5],
    )


def test_what_one_cell_has_learned_is_offered_to_the_others_with_its_uncertainty(shop: Database) -> None:
    lesson = ["r1", "lens", 2, 50.0, "bonnet 7", 0.87, 0.004]
    take(shop, report_of(1, 1, lessons=[lesson]))
    take(shop, report_of(1, 1, lessons=[["r1", "disc", 0, 40.0, "bonnet 7", 0.95, 0.01]]), "south")
    with shop.transaction() as sql:
        assert database.offers(sql, "north")[0]["rate"] == 0.95
        (offer,) = database.offers(sql, "west")
    assert offer == {
        "recipe": "r1", "cell": "north", "job": "lens", "of_cycle": 2, "at_s": 50.0, "rate": 0.87, "sigma": 0.004,
    }  # fmt: skip


def test_a_row_that_is_none_takes_nothing_of_its_report(shop: Database) -> None:
    with pytest.raises(ConfigError, match="nothing"):
        take(shop, report_of(1, 3, jobs=[[1, None, "P", 5.0, None, None, None]]))
    with pytest.raises(ValueError, match="zip"):
        take(shop, report_of(1, 3, jobs=[[1]]))
    assert numbers(shop) == []
    with shop.transaction() as sql:
        assert server.status_view(sql, ())["cells"] == []


class Failing:
    """A connection whose next COMMIT fails, with SQLite's own rollback or without it."""

    def __init__(self, connection: sqlite3.Connection, *, rolls_back: bool) -> None:
        self._connection, self._rolls_back, self._fails = connection, rolls_back, True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    def execute(self, sql: str, *values: Any) -> Any:
        if sql == "COMMIT" and self._fails:
            self._fails = False
            if self._rolls_back:
                self._connection.execute("ROLLBACK")
            raise sqlite3.OperationalError("database or disk is full")
        return self._connection.execute(sql, *values)


@pytest.mark.parametrize("rolls_back", [False, True])
def test_a_commit_that_fails_is_named_and_the_next_request_works(shop: Database, rolls_back: bool) -> None:
    shop._connection = Failing(shop._connection, rolls_back=rolls_back)  # type: ignore[assignment]
    with pytest.raises(LinkError, match="database or disk is full"):
        take(shop, report_of(1, 3))
    assert numbers(shop) == []
    assert take(shop, report_of(1, 3)) == 3


def test_a_database_that_is_full_is_named(shop: Database) -> None:
    """SQLite then rolls back without a command; a second rollback would hide the cause."""
    with shop.transaction() as sql:
        (pages,) = sql.row("PRAGMA page_count").values()  # type: ignore[union-attr]
        sql.rows(f"PRAGMA max_page_count = {pages + 1}")
    with pytest.raises(LinkError, match="full"), shop.transaction() as sql:
        sql.insert("file", {"sha256": "a", "content": b"x" * 1_000_000})
    assert take(shop, replace(report_of(1, 0), events=())) == 0
