"""A shop, its cells and their links as processes: parts, a link that is lost, and a cell that is given up."""

from __future__ import annotations

import contextlib
import json
import signal
from pathlib import Path

import pytest

from tests.campaigns.shop.judge import has_unsent_events, lost_or_twice, polished, twice
from tests.system.shop_rig import Shop, over, parts_of, polishd, shop_cell, wait_attended
from tests.system.sim_rig import wait_for

PASSES = "SELECT job, cycle FROM pass ORDER BY job, cycle"

pytestmark = [pytest.mark.system, pytest.mark.full]


def test_two_cells_work_a_shops_parts_while_it_is_killed_and_tell_it_all_once(tmp_path: Path) -> None:
    shop = Shop(tmp_path / "shop")
    with contextlib.ExitStack() as kept:
        kept.callback(shop.server.kill)
        cells = [
            kept.enter_context(shop_cell(tmp_path / name, name, shop, seed)) for seed, name in enumerate(("a", "b"))
        ]
        shop.server.start()
        shop.add([(f"job-{number}", f"P-{number}") for number in range(3)])
        for cell in cells:
            cell.daemon.start()
            cell.link.start()
        wait_attended(cells, lambda: "begun" in shop.states().values(), "a part to begin")
        shop.server.kill()
        cells[0].link.kill()
        ended = "SELECT 1 FROM job WHERE outcome IS NOT NULL"
        wait_attended(cells, lambda: any(cell.rows(ended) for cell in cells), "a part to end without the shop")
        shop.server.start()
        cells[0].link.start()
        wait_attended(cells, lambda: over(shop), "the parts")
        assert set(shop.states().values()) == {"done"}
        wait_for(lambda: not has_unsent_events(shop, cells), "the last reports")
        assert lost_or_twice(shop, cells) == []
        found = {cell.name: polished(cell) for cell in cells}
        assert list(twice(found)) == []
        assert {part for parts in found.values() for part in parts} == {f"P-{number}" for number in range(3)}
        status = json.loads(polishd("shop", "status", shop.file, "--json"))
        assert [cell["cell"] for cell in status["cells"]] == ["a", "b"]
        assert len(json.loads(polishd("shop", "history", shop.file, "--json"))["jobs"]) == 3
        assert json.loads(polishd("shop", "estimates", shop.file, "--json"))["lessons"]
        assert all(cell.link.end() == 0 for cell in cells)
        assert shop.server.end() == -signal.SIGTERM, "as polishd web: the server ends by the signal itself"


def test_a_cell_that_was_given_up_learns_it_before_it_polishes_and_the_next_begins_with_its_lesson(
    tmp_path: Path,
) -> None:
    shop = Shop(tmp_path / "shop")
    with contextlib.ExitStack() as kept:
        kept.callback(shop.server.kill)
        first = kept.enter_context(shop_cell(tmp_path / "first", "first", shop))
        shop.server.start()
        shop.add([("one", "P-1"), ("two", "P-2")])
        first.daemon.start()
        first.link.start()
        wait_attended([first], lambda: shop.states()["one"] == "done" and shop.states()["two"] != "waiting", "the next")
        first.daemon.kill()
        first.link.kill()
        before = first.rows(PASSES)
        polishd("shop", "release", shop.file, "two", "--by", "ada", "--cell-is-gone")

        second = kept.enter_context(shop_cell(tmp_path / "second", "second", shop, 2))
        second.daemon.start()
        second.link.start()
        first.daemon.start()
        first.link.start()
        wait_attended([second], lambda: over(shop), "the parts")
        assert {one["job"]: one["cell"] for one in parts_of(shop)} == {"one": "first", "two": "second"}
        ended = "SELECT 1 FROM queue WHERE name = 'two' AND verdict IS NOT NULL"
        wait_attended([first], lambda: first.rows(ended), "the cell to learn it")
        assert first.rows(PASSES) == before
        assert "P-2" in polished(second)
        ((notes,),) = second.rows("SELECT json_extract(stats, '$.notes') FROM map ORDER BY id LIMIT 1")
        assert "of job 'one' of the cell 'first'" in notes
