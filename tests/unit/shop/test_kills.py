"""Shop server and link killed at each of their steps: nothing is lost, nothing is there twice, and they start again."""

from __future__ import annotations

import json
import shutil
import sqlite3
import threading
from collections import Counter
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.config.server_sections import ShopFile
from polishd.daemon.journal.journal import Journal
from polishd.daemon.queue.queue import Queue
from polishd.model import events
from polishd.plugin_loader import plugins_of
from polishd.shop import link as link_module
from polishd.shop import parts
from polishd.shop.database import DATABASE_NAME, Database
from polishd.shop.link import ShopClient, ShopLink
from polishd.shop.parts import digests, part_of
from polishd.shop.server import application, cells_of, users_of
from polishd.web.http.users import Role
from tests.kill_at_step import Steps, killed_at
from tests.unit.shop.test_link import HELD, SECTION, Desk
from tests.unit.shop.test_server import write_shop

URL = "http://127.0.0.1:8760"
JOB = '[job]\nid = "lens"\n[part]\nid = "P-1"\n'
NEXT = '[job]\nid = "disc"\n[part]\nid = "P-2"\n'


def content(shop: ShopFile) -> dict[str, Counter[Any]]:
    """All rows of its database but for times and the numbers of rows."""
    found = {}
    with closing(sqlite3.connect(shop.state_dir / DATABASE_NAME)) as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        for (table,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'").fetchall():
            columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
            kept = [name for name in columns if name not in {"id", "at", "heard", "added", "given", "ended"}]
            kept += ["ended IS NULL"] if "ended" in columns else []
            found[table] = Counter(database.execute(f"SELECT {', '.join(kept)} FROM {table}").fetchall())
    return found


# the server

_REPORT = {"journal": "J", "now": {"state": "idle"}}
REQUESTS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("ada", "add", {"content": JOB, "files": {}}),
    ("north", "cell/report", {
        **_REPORT, "first": 1, "last": 2, "before": "", "tail": "h2",
        "events": [[1, 0, 5.0, None, "state", "{}"], [2, 0, 6.0, None, "state", "{}"]],
    }),
    ("north", "cell/claim", {"request": "r1"}),
    ("north", "cell/report", {
        **_REPORT, "first": 3, "last": 2, "before": "h2", "tail": "", "claims": {"r1": {"state": "waiting"}},
    }),
    ("north", "cell/report", {
        **_REPORT, "first": 3, "last": 3, "before": "h2", "tail": "h3", "claims": {"r1": {"state": "under way"}},
        "events": [[3, 1, 7.0, 0, "state", "{}"]], "jobs": [[1, "lens", "P-1", 6.5, None, None, None]],
        "passes": [[1, 0, "ab", 7.0, 8.0, "done", "{}"]],
        "maps": [[1, 0, 6.8, '{"rms_nm": 3.0}']], "lessons": [["recipe", "lens", 0, 8.0, "pad", 1.0, 0.1]],
    }),
    ("ada", "add", {"content": NEXT, "files": {}}),
    ("north", "cell/report", {
        **_REPORT, "first": 4, "last": 3, "before": "h3", "tail": "", "claims": {"r1": {"state": "accepted"}},
    }),
    ("north", "cell/claim", {"request": "r2"}),
    ("north", "cell/refuse", {"request": "r2", "why": "out of reach"}),
    ("ada", "remove", {"job": "disc", "why": "too hard"}),
)  # fmt: skip
"""Requests of a cell and the office: the life of one part and the refusal of another, one after the other."""
ONCE = {"add": "already", "remove": "is removed"}
"""Requests that may be answered by that, where the shop was killed after it had taken them: a person reads it."""


class Marked:
    """A connection to the database with steps at its statements."""

    def __init__(self, connection: sqlite3.Connection, steps: Steps, *, all_of_them: bool) -> None:
        self._connection, self._steps, self._all = connection, steps, all_of_them

    def execute(self, sql: str, *values: Any) -> Any:
        execute = self._connection.execute
        marked = self._all or sql in {"BEGIN IMMEDIATE", "COMMIT"}
        return (self._steps.around(execute) if marked else execute)(sql, *values)

    @property
    def in_transaction(self) -> bool:
        return self._connection.in_transaction

    def close(self) -> None:
        self._connection.close()


def served(
    shop: ShopFile, tokens: Mapping[str, str], answered: Path, count: int, steps: Steps, *, all_of_them: bool
) -> None:
    """Answer all that was not answered yet, in the shop's own application."""
    begin = int(answered.read_text()) if answered.exists() else 0
    with Database.open(shop.state_dir) as database:
        database._connection = Marked(database._connection, steps, all_of_them=all_of_them)  # type: ignore[assignment]
        client = TestClient(application(shop, database), base_url=URL)
        for number, (who, path, said) in enumerate(REQUESTS[begin:count], begin):
            found = client.post(f"/api/{path}", json=said, headers={"Authorization": f"Bearer {tokens[who]}"})
            again = ONCE.get(path, "")
            assert found.status_code == 200 or (number == begin and again and again in found.text), found.text
            answered.write_text(str(number + 1))


@pytest.mark.full
@pytest.mark.parametrize(
    ("count", "all_of_them"),
    [(4, False), pytest.param(len(REQUESTS), True, marks=pytest.mark.full)],
    ids=["transactions", "statements"],
)
def test_a_shop_that_is_killed_at_each_step_has_all_it_answered_once(
    tmp_path: Path, count: int, all_of_them: bool
) -> None:
    """Steps: before and after each begin and each commit; or each statement, of more requests."""
    shop = write_shop(tmp_path)
    tokens = {"north": cells_of(shop).add("north", Role.WATCH), "ada": users_of(shop).add("ada", Role.OPERATE)}
    clean, answered = tmp_path / "clean", tmp_path / "answered"
    with Database.open(shop.state_dir):
        pass
    shutil.copytree(shop.state_dir, clean)

    def work(steps: Steps) -> None:
        served(shop, tokens, answered, count, steps, all_of_them=all_of_them)

    assert not killed_at(0, work)
    right, number = content(shop), 0
    assert right["event"]
    assert right["claim"]
    while True:
        number += 1
        shutil.rmtree(shop.state_dir)
        shutil.copytree(clean, shop.state_dir)
        answered.unlink()
        if not killed_at(number, work):
            break
        assert not killed_at(0, work), f"killed at step {number}"
        assert content(shop) == right, f"killed at step {number}"
    assert number > 4 * count


# the link


class Few(threading.Event):
    """Run this number of turns without a pause."""

    def __init__(self, turns: int) -> None:
        super().__init__()
        self._left = turns

    def wait(self, timeout: float | None = None) -> bool:
        self._left -= 1
        return self._left < 0


@pytest.mark.full
def test_a_link_that_is_killed_at_each_step_loses_nothing_and_has_no_part_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps: each question to the shop and to the daemon, each file, and between telling and what is noted of it."""
    here = tmp_path / "here"
    files = write_demo(here / "cell", None, 2.0, 4, None)
    files.cell.write_text(files.cell.read_text() + SECTION)
    config = load_config(files.cell)
    config.state_dir.mkdir()
    (here / "shop").mkdir()
    shop = write_shop(here / "shop")
    token = files.cell.parent / "shop.token"
    token.touch(0o600)
    token.write_text(cells_of(shop).add("north", Role.WATCH))
    new = [part_of(text, {}) for text in (JOB, NEXT)]
    with Database.open(shop.state_dir) as database, database.transaction() as sql:
        parts.add(sql, new, "ada", [digests(one) for one in new])
    with Journal.of_cell(config.state_dir) as journal:
        for event in (HELD, events.PassProgressed(block=3), HELD):
            journal.record_event(event)
    hooks = plugins_of(config)
    clean = tmp_path / "clean"
    shutil.copytree(here, clean)

    def linked(steps: Steps) -> None:
        desk = Desk(config)
        with Database.open(shop.state_dir) as database:
            client = TestClient(application(shop, database), base_url=URL)

            def post(_wire: ShopClient, path: str, body: bytes, token: str) -> tuple[int, bytes]:
                found = client.post(path, content=body, headers={"Authorization": f"Bearer {token}"})
                return found.status_code, found.content

            assert config.shop is not None
            with monkeypatch.context() as patched:
                patched.setattr(link_module, "check_jobs", lambda *_: [])
                patched.setattr(ShopClient, "_post", steps.around(post))
                patched.setattr(link_module.client, "request", steps.around(desk))  # type: ignore[attr-defined]
                patched.setattr(link_module, "write_atomic", steps.around(link_module.write_atomic))
                patched.setattr(ShopLink, "_clear_request", steps.around(ShopLink._clear_request))
                ShopLink(config, hooks, config.shop).run(Few(4))

    number = looked_up = 0
    while True:
        number += 1
        shutil.rmtree(here)
        shutil.copytree(clean, here)
        killed = killed_at(number, linked)
        if killed:
            assert not killed_at(0, linked), "it starts again: its lock ended with it"
        found = content(shop)
        with closing(sqlite3.connect(config.state_dir / "journal.sqlite")) as own:
            queue = own.execute("SELECT name, claim FROM queue").fetchall()
            recorded = own.execute("SELECT id FROM event WHERE name != 'pass_progressed' ORDER BY id").fetchall()
        with closing(sqlite3.connect(shop.state_dir / DATABASE_NAME)) as database:
            claims = database.execute("SELECT request, ended FROM claim").fetchall()
            states = dict(database.execute("SELECT job, state FROM part"))
            received = database.execute("SELECT seq FROM event ORDER BY seq").fetchall()
        assert [name for name, _ in queue] == ["lens"], f"killed at step {number}"
        assert claims == [(queue[0][1], None)], f"killed at step {number}"
        assert states == {"lens": "claimed", "disc": "waiting"}
        assert received == recorded
        asking = config.state_dir / "shop" / "asking"
        assert not asking.exists() or asking.read_text() == queue[0][1], "what was asked is looked up before more is"
        assert [json.loads(row[-1]) for row in found["cell"]], "the shop knows the cell"
        if asking.exists():  # with the part removed from its queue, the cell requests the next one
            with Queue.at_rest(config.state_dir) as own_queue:
                own_queue.remove_waiting("lens")
            assert not killed_at(0, linked)
            with closing(sqlite3.connect(shop.state_dir / DATABASE_NAME)) as database:
                assert dict(database.execute("SELECT job, state FROM part")) == {"lens": "aside", "disc": "claimed"}
                assert len(database.execute("SELECT request FROM claim").fetchall()) == 2
            looked_up += 1
        if not killed:
            break
    assert number > 20
    assert looked_up
