"""The queue as the page shows it: order, recipe, who added a job, and when it is expected to begin."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.web import queue_view
from tests.unit.web.filled_journal import DAY_S, HOUR_S, NOW_S, FilledCell
from tests.unit.web.page_server import Served, served


@pytest.fixture
def web(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.setattr(queue_view.time, "time", lambda: NOW_S)
    with served(tmp_path) as found:
        yield found


def filled(web: Served, *, finished: int = 3) -> None:
    cell = FilledCell(web.config, maps=False)
    for number in range(finished):
        cell.part(f"done-{number}", NOW_S - (9 - number) * DAY_S, [20.0, 1.5], hours=float(1 + number))
    cell.part("now", NOW_S - 0.5 * HOUR_S, [20.0], "under way")
    cell.queued("next", NOW_S - DAY_S, by="anna (web)")
    other = '[job]\nid = "other"\n[part]\nid = "part-other"\naperture_mm = 60.0\n[process]\nforce_n = 8.0\n'
    cell.queued("other", NOW_S - HOUR_S, text=other)
    cell.write()


def test_jobs_are_in_working_order_with_their_recipe(web: Served) -> None:
    filled(web)
    found = web.ask("GET", "/api/queue").json()
    assert [(one["name"], one["state"]) for one in found["jobs"]] == [
        ("now", "under way"), ("next", "waiting"), ("other", "waiting"),
    ]  # fmt: skip
    details = found["jobs"][2]["details"]
    assert (details["outline"], details["force_n"]) == ("a circle of 60 mm", 8.0)
    assert details["tolerance"] == [{"what": "RMS", "limit": 2.0, "unit": "nm"}]
    assert found["jobs"][1]["details"]["outline"] == "a circle of 100 mm"
    assert [one["name"] for one in found["ended"]] == ["done-2", "done-1", "done-0"]
    assert found["ended_total"] == 3


def test_who_added_a_job_is_known_from_the_journal(web: Served) -> None:
    filled(web)
    jobs = web.ask("GET", "/api/queue").json()["jobs"]
    assert [one["by"] for one in jobs] == ["", "anna (web)", ""]


def test_begin_and_time_are_expected_from_finished_parts_with_that_program(web: Served) -> None:
    filled(web)
    now, waits, other = web.ask("GET", "/api/queue").json()["jobs"]
    assert (now["typical_s"], now["typical_of"]) == (2 * HOUR_S, 3)
    assert waits["starts_s"] == NOW_S + 1.5 * HOUR_S
    assert other["starts_s"] == NOW_S + 3.5 * HOUR_S


def test_without_finished_parts_nothing_is_expected(web: Served) -> None:
    filled(web, finished=0)
    now, waits, other = web.ask("GET", "/api/queue").json()["jobs"]
    assert [one["typical_s"] for one in (now, waits, other)] == [None, None, None]
    assert (waits["starts_s"], other["starts_s"]) == (None, None)


def test_a_job_that_takes_longer_than_expected_ends_at_once_not_before(web: Served) -> None:
    cell = FilledCell(web.config, maps=False)
    cell.part("done", NOW_S - DAY_S, [20.0, 1.5], hours=1.0)
    cell.part("now", NOW_S - 5 * HOUR_S, [20.0], "under way")
    cell.queued("next", NOW_S)
    cell.write()
    assert web.ask("GET", "/api/queue").json()["jobs"][1]["starts_s"] == NOW_S


def test_a_job_whose_file_no_longer_fits_says_why_and_breaks_nothing(web: Served) -> None:
    cell = FilledCell(web.config, maps=False)
    cell.queued("bad", NOW_S, text='[job]\nid = "bad"\n[part]\nid = "B"\naperture = 3\n')
    cell.queued("good", NOW_S)
    cell.write()
    bad, good = web.ask("GET", "/api/queue").json()["jobs"]
    assert bad["details"] is None
    assert "bad.toml:5: part.aperture" in bad["problem"]
    assert (good["problem"], good["details"]["max_passes"]) == ("", 4)


def test_an_empty_queue_and_no_journal(web: Served) -> None:
    assert web.ask("GET", "/api/queue").json() == {"jobs": [], "ended": [], "ended_total": 0}


def test_programs_that_take_turns_are_distinguished_by_all_of_them(web: Served) -> None:
    """The expected time is that of jobs with the same programs in the same order."""
    cell = FilledCell(web.config, maps=False)
    for number, order in enumerate(("ab", "ab", "ba")):
        cell.part(f"done-{number}", NOW_S - (9 - number) * DAY_S, [20.0, 1.5], hours=2.0 + number)
        cell.rows.append(("UPDATE queue SET files = ? WHERE name = ?", (programs_of(order), f"done-{number}")))
    both = '[job]\nid = "{0}"\n[part]\nid = "part-{0}"\n[program]\npath = ["a.rnc", "b.rnc"]\n'
    cell.queued("both", NOW_S, text=both.format("both"), files=programs_of("ab"))
    cell.queued("one", NOW_S, text=both.format("one"), files=programs_of("a"))
    cell.write()
    first, second = web.ask("GET", "/api/queue").json()["jobs"]
    assert (first["typical_s"], first["typical_of"]) == (2.5 * HOUR_S, 2)
    assert first["details"]["program"] == "a.rnc, b.rnc"
    assert len(first["details"]["program_sha256"]) == 64
    assert second["typical_of"] == 0


def programs_of(names: str) -> str:
    return json.dumps({"program.path": [{"file": f"{name}.rnc", "sha256": name * 64} for name in names]})
