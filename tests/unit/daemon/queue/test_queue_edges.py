"""The queue of jobs, row by row: the next job, the last one, and the values of each."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from polishd.config.job_file import JobFile
from polishd.daemon.journal.journal import Journal
from polishd.daemon.queue.queue import BY_A_PERSON, JobResult, NewJob, Queue, judge
from polishd.model.errors import ConfigError, LinkError, RemovalCheckStop
from polishd.model.states import Outcome
from tests.unit.daemon.queue.test_queue import job
from tests.unit.daemon.queue.test_queue_verdicts import ACCEPTED

REJECTED = JobResult("rejected", "the job has used all its passes", "cycles_used")


class Worked:
    """A queue beside its journal, as a daemon has it."""

    def __init__(self, journal: Journal) -> None:
        self.journal, self.queue = journal, Queue(journal.store)

    def begin(self, name: str) -> int:
        entry = self.queue.next()
        assert entry is not None
        assert entry.name == name
        number = self.journal.of_job(name, entry.part_id, {}).number
        self.queue.begin(entry, number)
        return number

    def end(self, verdict: JobResult = ACCEPTED) -> None:
        entry = self.queue.under_way()
        assert entry is not None
        self.queue.end(entry, verdict)


@pytest.fixture
def worked(tmp_path: Path) -> Worked:
    return Worked(Journal.of_cell(tmp_path))


@pytest.fixture(autouse=True)
def closed(worked: Worked) -> object:
    yield
    worked.journal.close()


def test_of_an_empty_queue_nothing_is_next_under_way_or_worked(worked: Worked) -> None:
    queue = worked.queue
    assert (queue.next(), queue.under_way(), queue.last_ended(), queue.to_do(), queue.entries()) == (
        None,
        None,
        None,
        [],
        [],
    )


def test_a_job_from_its_place_to_its_end(worked: Worked) -> None:
    queue, begun_s = worked.queue, time.time()
    files = {"part.form": {"file": "a.csv", "sha256": "aa"}}
    queue.add([NewJob("a", "P-7", JobFile(Path("/jobs/a.toml"), "# a"), files), job("b")])
    assert (entry := queue.next()) is not None
    assert (entry.files, entry.part_id, entry.job, entry.begun_s, entry.ended_s) == (files, "P-7", None, None, None)
    assert begun_s <= entry.added_s <= time.time()
    assert [one.state for one in queue.to_do()] == ["waiting", "waiting"]
    number = worked.begin("a")
    assert (under_way := queue.under_way()) is not None
    assert (under_way.name, under_way.job, under_way.state) == ("a", number, "under way")
    assert queue.holds(entry)
    assert (following := queue.next()) is not None
    assert following.name == "b"
    worked.end(REJECTED)
    assert not queue.holds(entry)
    assert queue.under_way() is None
    ended = queue.last_ended()
    assert ended is not None
    facts = ended.facts()
    assert (facts["state"], facts["verdict"], facts["reason"], facts["fault"]) == (
        "rejected",
        "rejected",
        "the job has used all its passes",
        "cycles_used",
    )
    assert begun_s <= facts["begun_s"] <= facts["ended_s"] <= time.time()
    assert not {"id", "content", "job"} & set(facts)
    assert (facts["name"], facts["path"]) == ("a", "/jobs/a.toml")


def test_all_there_ever_were_stand_in_the_order_in_which_they_ended_and_then_in_their_own(worked: Worked) -> None:
    worked.queue.add([job(name) for name in "abcde"])
    worked.begin("a")
    worked.end()
    worked.queue.remove_waiting("d")
    worked.begin("b")
    worked.queue.move("e", "first")
    assert [(one.name, one.state) for one in worked.queue.entries()] == [
        ("a", "accepted"),
        ("d", "removed"),
        ("b", "under way"),
        ("e", "waiting"),
        ("c", "waiting"),
    ]
    assert (last := worked.queue.last_ended()) is not None
    assert last.name == "a", "one that was taken out was never worked"


def test_the_job_that_ended_last_counts_and_not_the_one_that_was_added_last(worked: Worked) -> None:
    worked.queue.add([job("a"), job("b")])
    worked.queue.move("b", "first")
    worked.begin("b")
    worked.end()
    worked.begin("a")
    worked.end(REJECTED)
    assert (last := worked.queue.last_ended()) is not None
    assert (last.name, last.fault) == ("a", "cycles_used")


def test_one_that_could_not_begin_has_begun_and_ended_at_once_and_counts_as_worked(worked: Worked) -> None:
    worked.queue.add([job("a"), job("b")])
    (entry, _) = worked.queue.to_do()
    worked.queue.end(entry, JobResult("set aside", "RemovalCheckStop: x", "RemovalCheckStop"))
    assert (last := worked.queue.last_ended()) is not None
    assert (last.name, last.state) == ("a", "set aside")
    assert last.begun_s is not None
    assert [one.name for one in worked.queue.to_do()] == ["b"]


def test_the_end_of_a_job_leaves_when_it_began(worked: Worked) -> None:
    worked.queue.add([job("a")])
    worked.begin("a")
    worked.journal.store.write(("UPDATE queue SET begun = 5.0", ()))
    entry = worked.queue.entries()[0]
    worked.queue.end(entry, ACCEPTED, ("UPDATE job SET detail = ?", ("together",)))
    assert (last := worked.queue.last_ended()) is not None
    assert last.begun_s == 5.0
    assert worked.journal.store.read("SELECT detail FROM job") == [("together",)]


def test_the_last_job_is_the_one_that_ended_last_whatever_the_clock_says(worked: Worked) -> None:
    worked.queue.add([job("a"), job("b"), job("c")])
    for name in "ab":
        worked.begin(name)
        worked.end()
        if name == "a":  # the clock was ten hours fast, and is set back
            worked.journal.store.write(("UPDATE queue SET ended = ended + 36000 WHERE name = 'a'", ()))
    assert (last := worked.queue.last_ended()) is not None
    assert last.name == "b"
    assert [one.name for one in worked.queue.entries()] == ["a", "b", "c"]


def test_places_of_jobs_that_are_over_are_not_given_again(worked: Worked) -> None:
    worked.queue.add([job("a"), job("b")])
    worked.begin("a")
    worked.end()
    worked.queue.add([job("c")])
    worked.queue.move("c", "before", "b")
    assert [one.name for one in worked.queue.to_do()] == ["c", "b"]
    places = worked.journal.store.read("SELECT place FROM queue")
    assert len(set(places)) == 3


@pytest.mark.parametrize(("reason", "said"), [("", BY_A_PERSON), ("cracked", "cracked")])
def test_taking_out_the_one_under_way_ends_its_job_too(worked: Worked, reason: str, said: str) -> None:
    worked.queue.add([job("a"), job("b")])
    number = worked.begin("a")
    worked.queue.remove("b", reason)
    worked.queue.remove("a", reason)
    taken = {one.name: (one.state, one.reason) for one in worked.queue.entries()}
    assert taken == {"a": ("set aside", said), "b": ("removed", reason)}
    assert [one.fault for one in worked.queue.entries()] == ["", ""], "two in a row are no reason to stop"
    rows = worked.journal.store.read("SELECT outcome, detail, ended IS NULL FROM job WHERE id = ?", (number,))
    assert rows == [("set aside", reason, 0)]


def test_a_name_twice_in_one_order_adds_none_and_says_where(worked: Worked) -> None:
    with pytest.raises(ConfigError, match=r"/jobs/a\.toml: job\.id: 'a' is named twice already") as refused:
        worked.queue.add([job("a"), job("b"), job("a")])
    assert len(str(refused.value).splitlines()) == 1
    assert worked.queue.to_do() == []


def test_two_of_the_same_fault_stop_the_queue_and_two_different_do_not() -> None:
    def stops(previous: str, tool: str = "") -> str:
        verdict = judge(Outcome.CYCLES_USED, torn=False, previous=previous, tool=tool)
        assert verdict is not None
        assert (verdict.how, verdict.fault, verdict.reason) == (
            "rejected",
            "cycles_used",
            "the job has used all its passes",
        )
        return verdict.stops

    assert stops("") == stops("RemovalCheckStop") == ""
    assert stops("cycles_used") == "two parts in a row ended with the same fault, cycles_used"
    assert stops("", "its rate drifts") == stops("cycles_used", "its rate drifts") == "its rate drifts"


def test_an_accepted_part_is_no_fault_whatever_was_before_but_a_worn_tool_stops_all_the_same() -> None:
    verdict = judge(Outcome.IN_TOLERANCE, torn=False, previous="")
    assert verdict == JobResult("accepted", "the part is in tolerance", "", "")
    worn = judge(Outcome.IN_TOLERANCE, torn=False, previous="", tool="worn")
    assert worn is not None
    assert (worn.how, worn.stops) == ("accepted", "worn")


def test_an_error_is_reported_with_its_name_and_what_stops_by_its_row_says_that() -> None:
    verdict = judge(RemovalCheckStop("flipped"), torn=False, previous="RemovalCheckStop", tool="worn")
    assert verdict is not None
    assert (verdict.reason, verdict.fault) == ("RemovalCheckStop: flipped", "RemovalCheckStop")
    assert verdict.stops.startswith("instrument or alignment is wrong")
    torn = judge(LinkError("gone"), torn=True, previous="")
    assert torn is not None
    assert (torn.how, torn.reason, torn.stops) == ("set aside", "LinkError: gone", "")
    assert judge(LinkError("gone"), torn=False, previous="LinkError", tool="worn") is None


def test_of_two_that_ended_in_the_same_moment_the_one_that_was_added_later_counts(
    worked: Worked, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of times that a clock was set back to, too."""
    worked.queue.add([job("a"), job("b")])
    monkeypatch.setattr(time, "time", lambda: 5.0)
    for name in "ab":
        worked.begin(name)
        worked.end()
    last = worked.queue.last_ended()
    assert last is not None
    assert last.name == "b"


def test_a_queue_at_rest_is_closed_again(tmp_path: Path) -> None:
    with Queue.at_rest(tmp_path / "other") as queue:
        queue.add([job("a")])
        thread = queue._store._thread
        assert thread.is_alive()
    assert not thread.is_alive()
    with Queue.at_rest(tmp_path / "other") as queue:
        assert [one.name for one in queue.to_do()] == ["a"]
