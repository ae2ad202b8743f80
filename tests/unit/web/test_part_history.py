"""Parts over months: filter, order, pages, weeks and one part, also of damaged journals and foreign run folders."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.config.cell import CellConfig
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.model.states import Outcome
from polishd.web import part_history
from polishd.web.http.users import Role
from polishd.web.part_history import PartFilter, PartHistory, week_of
from polishd.web.run_files import RunFiles
from tests.unit.web.filled_journal import DAY_S, NOW_S, FilledCell, shop_cell, with_run_folder
from tests.unit.web.page_server import Served, served


@pytest.fixture
def web(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        yield found


def three(config: CellConfig) -> None:
    cell = FilledCell(config, maps=False)
    cell.part("a", NOW_S - 20 * DAY_S, [20.0, 4.0, 1.5], hours=3.0)
    cell.part("b", NOW_S - 10 * DAY_S, [16.0, 8.0], "rejected", hours=1.0)
    cell.part("c", NOW_S - DAY_S, [], "set aside", hours=0.5)
    cell.part("d", NOW_S - 600, [12.0], "under way")
    cell.write()


def names(answer: Any) -> list[str]:
    assert answer.status_code == 200, answer.text
    return [one["job"] for one in answer.json()["parts"]]


def test_a_row_has_what_the_journal_has(web: Served) -> None:
    three(web.config)
    found = web.ask("GET", "/api/history?sort=number").json()
    assert (found["total"], found["matched"]) == (4, 4)
    first, second, third, last = found["parts"]
    assert (first["part"], first["result"], first["passes"], first["hours"]) == ("part-a", "accepted", 2, 3.0)
    assert (first["first_rms_nm"], first["last_rms_nm"], first["met"], first["gain"]) == (20.0, 1.5, True, 0.8)
    assert (second["result"], second["met"], second["worst"]["value"]) == ("rejected", False, 8.0)
    assert second["reason"] == "the job has used all its passes"
    assert (third["first_rms_nm"], third["met"], third["worst"]) == (None, None, None)
    assert (last["result"], last["hours"]) == ("under way", None)


@pytest.mark.parametrize(
    ("query", "expected"),
    [
        ("", ["d", "c", "b", "a"]),
        ("sort=part", ["a", "b", "c", "d"]),
        ("sort=-last", ["d", "b", "a", "c"]),
        ("sort=last", ["a", "b", "d", "c"]),
        ("sort=hours", ["c", "b", "a", "d"]),
        ("text=PART-B", ["b"]),
        ("result=accepted", ["a"]),
        (f"since={int(NOW_S - 12 * DAY_S)}&until={int(NOW_S - 5 * DAY_S)}", ["b"]),
        ("limit=2&offset=1", ["c", "b"]),
        ("offset=9", []),
    ],
)
def test_filter_order_and_pages(web: Served, query: str, expected: list[str]) -> None:
    """A part without the figure by which the table is ordered is last, in both directions."""
    three(web.config)
    assert names(web.ask("GET", f"/api/history?{query}")) == expected


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("sort=color", "sort is 'color'. Use one of number, part, date"),
        ("result=good", "result must be one of accepted, rejected"),
        ("limit=201", "limit must be a whole number from 0 to 200"),
        ("offset=-1", "offset must be a whole number"),
        ("since=now", "since must be a whole number"),
        (f"text={'x' * 201}", "text has 201 characters; at most 200"),
    ],
)
def test_a_wrong_query_is_refused_with_what_it_must_be(web: Served, query: str, said: str) -> None:
    answer = web.ask("GET", f"/api/history?{query}")
    assert answer.status_code == 400
    assert answer.json()["error"].startswith(said)


def test_each_ended_job_is_read_once_and_one_under_way_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    read = part_history.read_history

    def counted(state_dir: Path, after: int = 0) -> Any:
        asked.append(after)
        return read(state_dir, after)

    monkeypatch.setattr(part_history, "read_history", counted)
    history = PartHistory(tmp_path)
    assert history.page(PartFilter())["total"] == 0, "there is no journal yet"
    with Journal.open(tmp_path, job="a", part_id="A") as journal:
        assert [one.result for one in history.rows()] == ["under way"]
        journal.record_outcome(Outcome.IN_TOLERANCE)
        assert [one.result for one in history.rows()] == ["accepted"]
        assert [one.result for one in history.rows()] == ["accepted"]
    assert asked == [0, 0, 1]


def test_another_journal_in_its_place_is_read_anew(tmp_path: Path) -> None:
    history = PartHistory(tmp_path)
    for name in ("a", "b"):
        with Journal.open(tmp_path, job=name, part_id="P") as journal:
            journal.record_outcome(Outcome.STALLED)
        assert [(one.job, one.result) for one in history.rows()] == [(name, "set aside")]
        for file in tmp_path.glob("journal*"):
            file.unlink()


def test_weeks_have_medians_of_the_parts_that_ended_in_them(web: Served) -> None:
    cell = FilledCell(web.config, maps=False)
    monday = week_of(NOW_S)
    for name, hours, after in (("a", 1.0, 5.0), ("b", 2.0, 4.0), ("c", 6.0, 2.0)):
        cell.part(name, monday + DAY_S, [20.0, after], hours=hours)
    cell.part("d", monday - 3 * DAY_S, [20.0], "rejected")
    cell.part("e", monday + DAY_S, [20.0], "under way")
    cell.write()
    before, week = web.ask("GET", "/api/history/weeks").json()["weeks"]
    assert (before["parts"], before["accepted"], before["gain"], before["over_predicted"]) == (1, 0, None, None)
    assert (week["at_s"], week["parts"], week["accepted"]) == (monday, 3, 3)
    assert week["hours"] == [1.5, 2.0, 4.0]
    assert week["gain"][1] == pytest.approx(0.8)
    assert web.ask("GET", "/api/history/weeks?text=part-a").json()["weeks"][-1]["hours"] == [1.0, 1.0, 1.0]


def test_weeks_begin_on_monday_of_local_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    try:
        assert time.strftime("%a %H:%M", time.localtime(week_of(NOW_S))) == "Mon 00:00"
        assert 0 <= NOW_S - week_of(NOW_S) < 7 * DAY_S
    finally:
        monkeypatch.undo()
        time.tzset()


# one part


def test_a_part_has_its_passes_with_figures_approvals_and_files(web: Served) -> None:
    shop_cell(web.config, parts=2)
    with_run_folder(web.config, "lens-0001")
    found = web.ask("GET", "/api/jobs/3").json()
    assert (found["job"], found["result"]) == ("lens-2001", "under way")
    (first, second) = found["cycles"]
    assert first["run"]["plan_figures"]["removal_mean_nm"] == pytest.approx(3.2 * 18.4)
    assert (first["run"]["program_sha256"], second["run"]) == (f"{3:032x}{0:032x}", None)
    assert [one["by"] for one in found["approvals"]] == ["anna (web)"]
    assert found["files"]["present"] is False
    assert web.ask("GET", "/api/jobs/1").json()["files"]["present"] is True


@pytest.mark.one_of_each
@pytest.mark.parametrize("path", ["jobs/9", "jobs/9/cycles", "jobs/9/files/report.html"])
def test_an_unknown_job_is_named(web: Served, path: str) -> None:
    three(web.config)
    answer = web.ask("GET", f"/api/{path}")
    assert (answer.status_code, answer.json()["error"]) == (404, "there is no job 9 in this cell's journal")


def test_a_damaged_row_is_named_and_the_others_are_shown_again_without_it(web: Served) -> None:
    three(web.config)
    path = web.config.state_dir / JOURNAL_NAME
    content = path.read_bytes()
    path.write_bytes(content.replace(b'"rms_nm": 20.0', b'"rms_nm"x 20.0'))
    answer = web.ask("GET", "/api/history")
    assert (answer.status_code, "of map does not match its checksum" in answer.json()["error"]) == (503, True)
    path.write_bytes(content)
    assert len(names(web.ask("GET", "/api/history"))) == 4


# files of the run folder

CERTIFICATE = {
    "schema": "polishd-certificate-1",
    "number": "a-20261129",
    "issued": "2026-11-29T00:00:00Z",
    "verdict": {"words": "in tolerance"},
    "seal": {"signature": {"key_id": "ab12"}},
}


@pytest.fixture
def folder(web: Served) -> Path:
    three(web.config)
    folder = with_run_folder(web.config, "a")
    (folder / "summary.json").write_text("{}")
    (folder / "report.html").write_text("<p>report</p>")
    (folder / "pictures" / "heights.png").write_bytes(b"\x89PNG")
    (folder / "LENS A.json").write_text(json.dumps(CERTIFICATE))
    (folder / "LENS A.pdf").write_bytes(b"%PDF-1.7")
    return folder


def test_pictures_report_and_certificates_are_delivered(web: Served, folder: Path) -> None:
    files = web.ask("GET", "/api/jobs/1").json()["files"]
    assert (files["pictures"], files["report"]) == (["heights.png"], "report.html")
    (certificate,) = files["certificates"]
    assert (certificate["pdf"], certificate["verdict"], certificate["signed"]) == ("LENS A.pdf", "in tolerance", "ab12")
    for name, kind, how in (
        ("heights.png", "image/png", "inline"),
        ("report.html", "text/html; charset=utf-8", "attachment"),
        ("LENS%20A.pdf", "application/pdf", "attachment"),
        ("LENS%20A.json", "application/json", "attachment"),
    ):
        answer = web.ask("GET", f"/api/jobs/1/files/{name}", Role.WATCH)
        assert (answer.status_code, answer.headers["content-type"]) == (200, kind)
        assert answer.headers["content-disposition"] == f"{how}; filename*=UTF-8''{name}"
        assert "script-src 'self'" in answer.headers["content-security-policy"]


@pytest.mark.parametrize(
    "name", ["summary.json", "journal.sqlite", "..%2fcell.toml", "%2e%2e", "pictures%2fheights.png", "nothing.png"]
)
def test_no_other_file_is_delivered(web: Served, folder: Path, name: str) -> None:
    (folder / "journal.sqlite").write_bytes(b"x")
    assert web.ask("GET", f"/api/jobs/1/files/{name}").status_code == 404


def test_links_out_of_the_run_folder_are_not_followed(web: Served, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(b"secret")
    (tmp_path / "secret.pdf").write_bytes(b"secret")
    (folder / "pictures" / "link.png").symlink_to(tmp_path / "secret.png")
    (folder / "LENS A.pdf").unlink()
    (folder / "LENS A.pdf").symlink_to(tmp_path / "secret.pdf")
    os.mkfifo(folder / "pictures" / "pipe.png")
    for name in ("link.png", "LENS%20A.pdf", "pipe.png"):
        assert web.ask("GET", f"/api/jobs/1/files/{name}").status_code == 404
    files = web.ask("GET", "/api/jobs/1").json()["files"]
    assert (files["pictures"], files["certificates"]) == (["heights.png"], [])


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "content",
    ["", "[", "[]", "{}", '{"schema": 7}', json.dumps({**CERTIFICATE, "seal": 3}), "[" * 100_000, '"\ud800"'],
)
def test_a_damaged_certificate_is_none_and_breaks_nothing(web: Served, folder: Path, content: str) -> None:
    (folder / "LENS A.json").write_bytes(content.encode(errors="surrogatepass"))
    answer = web.ask("GET", "/api/jobs/1")
    assert (answer.status_code, answer.json()["files"]["certificates"]) == (200, [])
    assert web.ask("GET", "/api/jobs/1/files/LENS%20A.pdf").status_code == 404


def test_a_run_folder_that_is_a_file_has_nothing(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("")
    found = RunFiles(tmp_path / "run").facts()
    assert (found["present"], found["pictures"], found["certificates"], found["report"]) == (False, [], [], None)
