"""The queue: rows of the journal, in their order."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.config.cell import CellConfig, load_config
from polishd.config.job_file import JobFile
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal, over_row
from polishd.daemon.journal.store import Store
from polishd.daemon.queue.queue import JobResult, NewJob, Queue
from polishd.daemon.queue.requests import QueueRequests, new_job, require_unchanged
from polishd.model.errors import ConfigError
from polishd.model.states import Outcome
from polishd.plugin_loader import plugins_of


def job(name: str, part: str = "P-1") -> NewJob:
    return NewJob(name, part, JobFile(Path("/jobs") / f"{name}.toml", f"# {name}"), {})


@pytest.fixture
def queue(tmp_path: Path) -> Iterator[Queue]:
    with Queue.at_rest(tmp_path) as found:
        yield found


def names(queue: Queue) -> list[str]:
    return [entry.name for entry in queue.to_do()]


def test_jobs_wait_in_the_order_in_which_they_came_and_over_a_restart(tmp_path: Path) -> None:
    with Queue.at_rest(tmp_path) as queue:
        queue.add([job("a"), job("b")])
        queue.add([job("c")])
    with Queue.at_rest(tmp_path) as queue:
        assert names(queue) == ["a", "b", "c"]
        entry = queue.to_do()[1]
        assert (entry.file, entry.part_id, entry.state) == (job("b").file, "P-1", "waiting")


@pytest.mark.parametrize(
    ("place", "order"),
    [
        (("first",), "cabd"),
        (("last",), "abdc"),
        (("before", "a"), "cabd"),
        (("before", "b"), "acbd"),
        (("after", "d"), "abdc"),
        (("after", "a"), "acbd"),
    ],
)
def test_a_job_is_moved(queue: Queue, place: tuple[str, ...], order: str) -> None:
    queue.add([job(name) for name in "abcd"])
    queue.move("c", *place)
    assert "".join(names(queue)) == order
    queue.add([job("e")])
    assert "".join(names(queue)) == f"{order}e"


def test_who_begins_a_job_and_who_takes_it_out_in_the_same_moment_do_not_both_have_it(tmp_path: Path) -> None:
    with Journal.of_cell(tmp_path) as journal:
        desk, daemon = Queue(journal.store), Queue(journal.store)
        desk.add([job("a"), job("b")])
        first, second = daemon.to_do()
        desk.remove_waiting("a")
        with pytest.raises(ConfigError, match="'a' was removed from the queue"):
            daemon.begin(first, 1)
        daemon.begin(second, journal.of_job("b", "P-1", {}).number)
        with pytest.raises(ConfigError, match="'b' has just begun"):
            desk.remove_waiting("b")
        assert [entry.state for entry in desk.entries()] == ["removed", "under way"]


def test_the_job_under_way_comes_first_and_is_not_moved(tmp_path: Path) -> None:
    with Journal.of_cell(tmp_path) as journal:
        queue = Queue(journal.store)
        queue.add([job(name) for name in "abc"])
        queue.begin(queue.to_do()[0], journal.of_job("a", "P-1", {}).number)
        queue.move("c", "first")
        assert names(queue) == ["a", "c", "b"]
        assert (found := queue.under_way()) is not None
        assert found.state == "under way"
        for wrong in ("a", "x"):
            with pytest.raises(ConfigError, match=rf"no job '{wrong}' waits in the queue.*Waiting: 'b', 'c'"):
                queue.move(wrong, "last")


def test_a_job_that_begins_with_its_row_is_the_newest_of_the_journal(tmp_path: Path) -> None:
    with Journal.of_cell(tmp_path) as journal:
        queue = Queue(journal.store)
        journal.of_job("before", "P-0", {})
        queue.add([job("a"), job("b")])
        own = journal.of_job("a", "P-1", {}, queue.begin_row(queue.to_do()[0]))
        assert [entry.job for entry in Queue(journal.store).to_do()] == [own.number, None]


def test_a_job_under_way_that_is_not_continued_is_put_aside(tmp_path: Path) -> None:
    with Journal.of_cell(tmp_path) as journal:
        queue = Queue(journal.store)
        queue.add([job("a")])
        queue.begin(queue.to_do()[0], journal.of_job("a", "P-1", {}).number)
    with Queue.at_rest(tmp_path) as queue:
        queue.remove("a", "broken")
        assert [(entry.state, entry.reason) for entry in queue.entries()] == [("set aside", "broken")]
        queue.add([job("b")])
        queue.remove("b")
        assert [(entry.state, entry.reason) for entry in queue.entries()][-1] == ("removed", "")
    with Journal.open(tmp_path, job="a", part_id="P-1") as journal:
        assert not journal.resumed


def test_moving_says_what_is_no_place(queue: Queue) -> None:
    queue.add([job("a"), job("b")])
    with pytest.raises(ConfigError, match="'above' is not a position"):
        queue.move("a", "above", "b")
    with pytest.raises(ConfigError, match="no job 'a' waits"):
        queue.move("a", "before", "a")
    assert names(queue) == ["a", "b"]


def test_all_are_added_or_none(queue: Queue) -> None:
    queue.add([job("a")])
    with pytest.raises(ConfigError) as caught:
        queue.add([job("b"), job("a"), job("b")])
    assert str(caught.value).splitlines() == [
        "/jobs/a.toml: job.id: 'a' is in the queue already. Set another job.id",
        "/jobs/b.toml: job.id: 'b' is named twice already. Set another job.id",
    ]
    assert names(queue) == ["a"]


@pytest.mark.parametrize(("how", "again"), [("accepted", False), ("rejected", False), ("set aside", True)])
def test_a_job_that_is_done_is_not_done_again_but_one_put_aside_may(tmp_path: Path, how: str, again: bool) -> None:
    with Journal.of_cell(tmp_path) as cell:
        queue = Queue(cell.store)
        queue.add([job("a")])
        (entry,) = queue.to_do()
        journal = cell.of_job("a", "P-1", {})
        queue.begin(entry, journal.number)
        queue.end(entry, JobResult(how, "why", "MapError"), over_row(journal.number, how, "why"))  # type: ignore[arg-type]
        assert (queue.under_way(), names(queue)) == (None, [])
        assert (found := queue.last_ended()) is not None
        assert (found.state, found.reason, found.fault) == (how, "why", "MapError")
        if again:
            queue.add([job("a")])
        else:
            with pytest.raises(ConfigError, match=f"'a' is {how} already"):
                queue.add([job("a")])


def test_a_job_of_the_cells_own_that_is_under_way_or_done_is_no_other(tmp_path: Path) -> None:
    with Journal.open(tmp_path, job="demo", part_id="P-1") as journal:
        with pytest.raises(ConfigError, match="'demo' is under way already"):
            Queue(journal.store).add([job("demo")])
        journal.record_outcome(Outcome.IN_TOLERANCE)
        with pytest.raises(ConfigError, match="'demo' is in_tolerance already"):
            Queue(journal.store).add([job("demo")])


def test_what_was_taken_out_may_come_again(queue: Queue) -> None:
    queue.add([job("a"), job("b")])
    queue.remove("a", "a scratch")
    queue.add([job("a")])
    assert names(queue) == ["b", "a"]
    assert [(entry.name, entry.state, entry.reason) for entry in queue.entries()] == [
        ("a", "removed", "a scratch"),
        ("b", "waiting", ""),
        ("a", "waiting", ""),
    ]


def test_it_is_not_touched_while_a_daemon_has_the_cell(tmp_path: Path, queue: Queue) -> None:
    with pytest.raises(ConfigError, match="another polishd runs this cell"), Queue.at_rest(tmp_path):
        pass


# the desk


@pytest.fixture
def cell(tmp_path: Path, example: str) -> CellConfig:
    path = tmp_path / "cell.toml"
    path.write_text(example)
    (tmp_path / "program.rnc").write_text("M30\n")
    return load_config(path)


JOB = '[job]\nid = "a"\n[part]\nid = "P-7"\n[program]\npath = "lens.rnc"\n'


async def test_a_job_comes_over_the_desk(cell: CellConfig, tmp_path: Path, queue: Queue) -> None:
    (tmp_path / "lens.rnc").write_text("M30\n")
    came: list[None] = []
    desk = QueueRequests(cell, plugins_of(cell), queue, lambda: came.append(None))
    file = {"path": str(tmp_path / "a.toml"), "content": JOB}
    answer = await desk.add([file])
    assert (answer, len(came)) == ({"added": ["a"], "waiting": 1}, 1)
    ((found,),) = ((await desk.list())["jobs"],)
    assert (found["name"], found["part_id"], found["state"]) == ("a", "P-7", "waiting")
    assert set(found["files"]) == {"program.path"}
    with pytest.raises(ConfigError, match="'a' is in the queue already"):
        await desk.add([{**file, "content": JOB.replace('"a"', '"b"')}, file])
    assert names(queue) == ["a"], "all or none"
    for wrong in ("a.toml", {**file, "path": "a.toml"}, {**file, "more": ""}):
        with pytest.raises(ConfigError, match="absolute path"):
            await desk.add([wrong])
    with pytest.raises(ConfigError, match=r"a.toml:2: cell: belongs into the cell's file"):
        await desk.add([{**file, "content": "\n[cell]\n" + JOB}])
    assert (await desk.remove("a"))["jobs"][0]["state"] == "removed"


async def test_a_file_that_was_changed_meanwhile_is_noticed(cell: CellConfig, tmp_path: Path, queue: Queue) -> None:
    program = tmp_path / "lens.rnc"
    program.write_text("M30\n")
    hooks = plugins_of(cell)
    queue.add([new_job(cell, hooks, JobFile(tmp_path / "a.toml", JOB))])
    (entry,) = queue.to_do()
    assert require_unchanged(cell, hooks, entry).part.id == "P-7"
    program.write_text("M2\n")
    with pytest.raises(ConfigError) as caught:
        require_unchanged(cell, hooks, entry)
    assert str(caught.value).startswith(f"{tmp_path}/a.toml:6: program.path: {program} (sha256 ")
    assert str(caught.value).endswith("). Add the job again")
    program.unlink()
    with pytest.raises(ConfigError, match=r"lens.rnc: cannot be read"):
        require_unchanged(cell, hooks, entry)


def test_the_file_of_a_program_s_positions_counts_too(cell: CellConfig, tmp_path: Path, queue: Queue) -> None:
    text = JOB.replace("lens.rnc", "lens.src") + 'format = "krl"\n'
    positions = tmp_path / "lens.dat"
    (tmp_path / "lens.src").write_text("LIN XP1\n")
    positions.write_text("DECL E6POS XP1={X 0}\n")
    hooks = plugins_of(cell)
    queue.add([new_job(cell, hooks, JobFile(tmp_path / "a.toml", text))])
    (entry,) = queue.to_do()
    assert require_unchanged(cell, hooks, entry).part.id == "P-7"
    positions.write_text("DECL E6POS XP1={X 9}\n")
    with pytest.raises(
        ConfigError, match=r"lens.src \(sha256 \w+\) or the file that declares its positions has changed"
    ):
        require_unchanged(cell, hooks, entry)


def test_the_queue_is_rows_of_the_journal(tmp_path: Path) -> None:
    with Queue.at_rest(tmp_path) as queue:
        queue.add([job("a")])
    store = Store.open(tmp_path / JOURNAL_NAME)
    assert store.read("SELECT name, content FROM queue") == [("a", "# a")]
    store.close()
