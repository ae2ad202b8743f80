"""What an operator sees before an approval: figures of exactly that plan, beside those of the last pass."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.model.events import PlanAwaitingApproval
from tests.unit.web.filled_journal import NOW_S, FilledCell, shop_cell
from tests.unit.web.page_server import Served, served


@pytest.fixture
def web(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        yield found


def test_figures_of_that_plan_and_of_the_last_pass(web: Served) -> None:
    program = shop_cell(web.config, parts=1)
    found = web.ask("GET", f"/api/plans/{program}").json()
    assert (found["program_sha256"], found["job"], found["cycle"]) == (program, 2, 1)
    assert found["figures"]["predicted_rms_nm"] == 1.4
    assert found["figures"]["limits"][0]["key"] == "limits.max_removal_nm"
    assert found["measured"]["rms_nm"] == 4.6
    assert (found["last"]["cycle"], found["last"]["after"]["rms_nm"]) == (0, 4.6)
    assert found["last"]["run"]["plan_figures"]["before_rms_nm"] == 18.4
    assert found["approved"] is None


@pytest.mark.parametrize("kind", ["measured", "predicted", "removal"])
def test_maps_of_a_plan_that_has_no_pass_yet(web: Served, kind: str) -> None:
    shop_cell(web.config, parts=1)
    found = web.ask("GET", f"/api/jobs/2/cycles/1/map/{kind}")
    assert (found.status_code, found.json()["kind"]) == (200, kind)


def test_another_plan_has_no_figures(web: Served) -> None:
    shop_cell(web.config, parts=1)
    answer = web.ask("GET", f"/api/plans/{'ab' * 32}")
    assert answer.status_code == 404
    assert answer.json()["error"] == "no plan abababababab of the present job waits, or waited, for approval"


def test_a_plan_of_an_earlier_job_is_not_of_the_present_one(web: Served) -> None:
    cell = FilledCell(web.config, maps=False)
    cell.part("old", NOW_S - 9000, [20.0, 1.5])
    cell.waiting_plan(1, 0, "cd" * 32, 20.0, 1.4, NOW_S - 8000)
    cell.part("new", NOW_S - 600, [20.0], "under way")
    cell.write()
    assert web.ask("GET", f"/api/plans/{'cd' * 32}").status_code == 404


@pytest.mark.parametrize("name", ["x", "AB" * 32, "ab" * 33, "%00", "..%2f.."])
def test_what_is_no_hash_is_no_plan(web: Served, name: str) -> None:
    assert web.ask("GET", f"/api/plans/{name}").status_code == 404


def test_an_approved_plan_says_by_whom(web: Served) -> None:
    cell = FilledCell(web.config, maps=False)
    cell.part("now", NOW_S - 600, [20.0], "under way")
    cell.waiting_plan(1, 0, "ef" * 32, 20.0, 1.4, NOW_S - 300)
    cell.approved(1, 0, "ef" * 32, "ben (web)", NOW_S - 200)
    cell.write()
    found = web.ask("GET", f"/api/plans/{'ef' * 32}").json()
    assert (found["approved"]["by"], found["last"], found["has_maps"]) == ("ben (web)", None, False)


def test_a_plan_of_an_earlier_polishd_has_no_figures(web: Served) -> None:
    cell = FilledCell(web.config, maps=False)
    cell.part("now", NOW_S - 600, [20.0], "under way")
    cell.event(1, NOW_S, PlanAwaitingApproval(cycle=0, program_sha256="ef" * 32, predicted_rms_nm=1.0, dwell_s=60.0))
    cell.write()
    assert web.ask("GET", f"/api/plans/{'ef' * 32}").json()["figures"] is None


def test_the_alarm_of_a_waiting_plan_is_a_sentence(web: Served) -> None:
    shop_cell(web.config, parts=1)
    (alarm,) = web.ask("GET", "/api/alarms").json()["alarms"]
    assert alarm["what"] == "a plan of 5 min to 1.40 nm RMS waits for approval"
