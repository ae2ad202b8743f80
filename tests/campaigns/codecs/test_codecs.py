"""Of malformed, doubled and late replies none is taken for a value, and nothing is left behind, driver by driver.

The driver's whole link runs, with its queue, time limits and reopening: on a virtual clock, and on real wires.
"""

from __future__ import annotations

import gc
import re
from pathlib import Path

import pytest

from polishd.drivers.plc_robot.hses import Hses, answer_of
from tests.campaigns import result_files
from tests.campaigns.codecs import hses, lines
from tests.campaigns.codecs import results as results_module
from tests.campaigns.codecs.driver_cases import TALKS, campaign
from tests.campaigns.codecs.faulty_peer import Talk, require_none_taken
from tests.campaigns.codecs.results import BEGIN, COUNTS, DRIVERS, END, PAGE, Results, bad, text
from tests.selection import kind


@pytest.mark.one_of_each
@pytest.mark.parametrize("make", TALKS, ids=lambda one: one.name)
def test_no_reply_is_taken_for_a_value_that_is_none(monkeypatch: pytest.MonkeyPatch, make: type[Talk]) -> None:
    require_none_taken(*campaign(monkeypatch, make, 2_000))


class TakesAnyDigits(lines.OwnLines):
    """Takes any digits for its answer."""

    async def ask(self) -> int:
        return await self._lines.read("?", digits)


def digits(answer: str) -> int:
    if (found := re.search(r"\d+", answer, re.ASCII)) is None:
        raise ValueError("no digits")
    return int(found[0])


def test_what_is_taken_for_a_value_that_it_is_not_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    peer, outcomes = campaign(monkeypatch, TakesAnyDigits, 500)
    assert 0 < outcomes["taken"] < outcomes["value"]
    with pytest.raises(AssertionError, match="is not the answer to this request"):
        require_none_taken(peer, outcomes)


def test_a_datagram_of_another_number_that_is_taken_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def received_without_check(link: Hses, datagram: bytes) -> None:
        if (answer := answer_of(datagram)) is not None:
            link._asked.setdefault(answer.number, 0.0)
            checked(link, datagram)

    checked = Hses.received
    monkeypatch.setattr(Hses, "received", received_without_check)
    peer, outcomes = campaign(monkeypatch, hses.Controller, 1_000)
    assert 0 < outcomes["taken"] < outcomes["value"], peer.talk.taken


def test_seeds_add_up_and_older_lines_go_once_there_are_as_many_replies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results, counted = (
        Results(tmp_path / "replies.jsonl"),
        {**dict.fromkeys(COUNTS, 0), "broken": 10, "late": 2, "values": 7},
    )
    monkeypatch.setattr(results_module.result_files, "sources", lambda names: "before")
    results.add("monitor", counted)
    results.add("monitor", counted)
    monkeypatch.undo()
    results.add("monitor", {**counted, "taken": 1})
    assert [(row["seeds"], row["broken"]) for row in results.rows()] == [(2, 20), (1, 10)]
    assert "| monitor | 10 | 0 | 2 | **1** |" in text(results)
    results.add("monitor", counted)
    [row] = Results(tmp_path / "replies.jsonl").rows()
    assert (row["seeds"], row["broken"], row["late"], row["taken"], row["values"]) == (2, 20, 4, 1, 14)


@pytest.mark.parametrize("name", kind("PLC robot, ADS"))
def test_a_seed_is_counted_for_the_page(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    counted = DRIVERS[name].run(monkeypatch, 1_000, 3)
    assert bad(counted) >= 1_000
    assert counted["taken"] == 0
    assert counted["values"] > 0


def test_the_page_is_written_of_what_is_kept() -> None:
    assert result_files.written(PAGE, BEGIN, END) == text(Results())


def left_behind() -> tuple[int, int]:
    """(objects alive, open descriptors)."""
    gc.collect()
    return len(gc.get_objects()), len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("make", TALKS, ids=lambda one: one.name)
def test_of_a_million_replies_none_is_taken(monkeypatch: pytest.MonkeyPatch, make: type[Talk]) -> None:
    campaign(monkeypatch, make, 10_000)
    objects, descriptors = left_behind()
    require_none_taken(*campaign(monkeypatch, make, 1_000_000))
    after = left_behind()
    assert after[0] - objects < 1_000
    assert after[1] == descriptors
