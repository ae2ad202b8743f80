"""The shop's queue never gives a part to two cells, with any cells, repeated requests, and lost answers.

A job's file at the shop: whole with the files that it names, wherever they lay.
"""

from __future__ import annotations

import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.config.job_file import JobFile
from polishd.model.errors import ConfigError
from polishd.shop import parts, server
from polishd.shop.database import Database
from polishd.shop.parts import AssignmentReply, NewPart, digests, part_of, read_part


@pytest.fixture
def shop(tmp_path: Path) -> Iterator[Database]:
    with Database.open(tmp_path / "state") as found:
        yield found


def add(shop: Database, *names: str) -> None:
    new = [NewPart(name, f"P-{name}", f'[job]\nid = "{name}"\n') for name in names]
    with shop.transaction() as sql:
        parts.add(sql, new, "ada", [{} for _ in new])


def claim(shop: Database, cell: str, request: str) -> Any:
    with shop.transaction() as sql:
        found = parts.claim(sql, cell, request)
    return None if found["part"] is None else found["part"]["job"]


def report(shop: Database, cell: str, journal: str = "J", **claims: str) -> AssignmentReply:
    with shop.transaction() as sql:
        return parts.report(sql, cell, journal, {key: {"state": state} for key, state in claims.items()})


def release(shop: Database, job: str, *, gone: bool = False) -> str:
    with shop.transaction() as sql:
        return parts.release(sql, job, "ada", "a chip", gone=gone)


def states(shop: Database) -> dict[str, str]:
    with shop.transaction() as sql:
        return {one["job"]: one["state"] for one in server.parts_view(sql)["parts"]}


def words(shop: Database) -> list[str]:
    with shop.transaction() as sql:
        return [one["what"] for one in server.decisions(sql)]


def test_a_part_that_was_added_before_release_1_0_is_given_with_the_present_key_names(shop: Database) -> None:
    part = NewPart("a", "P-a", '[job]\nid = "a"\naccept = "bound"\n[part]\nrim = "ring"\n')
    with shop.transaction() as sql:
        parts.add(sql, [part], "ada", [{}])
        content = parts.claim(sql, "north", "1")["part"]["content"]
    assert tomllib.loads(content) == {"job": {"id": "a", "accept_by": "bound"}, "part": {"free_edge": False}}


def test_parts_are_given_in_their_order_each_to_one_cell(shop: Database) -> None:
    add(shop, "a", "b")
    assert [claim(shop, "north", "1"), claim(shop, "south", "2"), claim(shop, "west", "3")] == ["a", "b", None]
    assert states(shop) == {"a": "claimed", "b": "claimed"}


def test_a_claim_whose_answer_was_lost_is_found_again_by_its_request(shop: Database) -> None:
    add(shop, "a", "b")
    assert [claim(shop, "north", "1") for _ in range(3)] == ["a", "a", "a"]
    with pytest.raises(ConfigError, match="another cell's"):
        claim(shop, "south", "1")
    assert claim(shop, "south", "2") == "b"
    assert claim(shop, "west", "3") is None
    add(shop, "c")
    assert claim(shop, "west", "3") == "c", "a request that found nothing may ask again"


def test_many_cells_in_several_processes_worth_of_connections_never_share_a_part(tmp_path: Path) -> None:
    with Database.open(tmp_path / "state") as first:
        add(first, *(f"j{number}" for number in range(40)))
    found: list[str] = []

    def ask(cell: str) -> None:
        with Database.open(tmp_path / "state") as own:
            found.extend(filter(None, [claim(own, cell, f"{cell}-{number}") for number in range(15)]))

    threads = [threading.Thread(target=ask, args=(f"cell{number}",)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == len(set(found)) == 40


def test_the_database_itself_refuses_a_second_claim(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    with pytest.raises(ConfigError, match="UNIQUE"), shop.transaction() as sql:
        sql.run("INSERT INTO claim (request, part, cell, given) SELECT '2', id, 'south', 0 FROM part")
    assert report(shop, "south").stands == []


def test_what_fails_leaves_nothing_behind(shop: Database) -> None:
    add(shop, "a")
    with pytest.raises(ConfigError, match="'a' is waiting in this shop already"):
        add(shop, "b", "a")
    new = [NewPart("c", "P-c", ""), NewPart("d", "P-c", "")]
    with pytest.raises(ConfigError, match="'P-c' is waiting as 'c' already"), shop.transaction() as sql:
        parts.add(sql, new, "ada", [{}, {}])
    assert states(shop) == {"a": "waiting"}


def test_a_part_from_its_claim_to_its_end(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    assert report(shop, "north").stands == ["1"]
    assert report(shop, "north", **{"1": "waiting"}).stands == ["1"]
    assert report(shop, "north", **{"1": "under way"}).stands == ["1"]
    assert states(shop) == {"a": "begun"}
    assert report(shop, "north", **{"1": "accepted"}) == AssignmentReply()
    assert states(shop) == {"a": "done"}
    assert report(shop, "north", **{"1": "accepted"}) == AssignmentReply(), "reported once more: nothing new"
    assert words(shop) == ["added", "claimed", "begun", "accepted"]
    with pytest.raises(ConfigError, match="'a' is done"):
        release(shop, "a")


def test_what_was_refused_is_for_another_cell(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    with shop.transaction() as sql:
        parts.refuse(sql, "north", "1", "it is too large")
        assert parts.claim(sql, "north", "1") == {"part": None, "over": True}
    assert claim(shop, "north", "2") is None
    with shop.transaction() as sql:
        assert server.parts_view(sql)["parts"][0]["not_for"] == "north: refused: it is too large"
    assert claim(shop, "south", "3") == "a"


def test_of_several_that_gave_it_back_the_last_one_alone_is_left_out_and_a_person_can_lift_that(shop: Database) -> None:
    add(shop, "a")
    for cell, request in (("north", "1"), ("south", "2"), ("north", "3")):
        assert claim(shop, cell, request) == "a"
        release(shop, "a")
        report(shop, cell, **{request: "unknown"})
    assert claim(shop, "north", "4") is None
    assert release(shop, "a") == "a waits, and any cell may have it"
    assert claim(shop, "north", "4") == "a"


def test_what_a_cell_has_taken_it_can_refuse_no_more(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    report(shop, "north", **{"1": "waiting"})
    with shop.transaction() as sql:
        parts.refuse(sql, "north", "1", "changed its mind")
    assert states(shop) == {"a": "claimed"}


def test_a_released_part_stays_with_its_cell_until_that_has_given_it_back(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    report(shop, "north", **{"1": "waiting"})
    assert "keeps it until it has" in release(shop, "a")
    assert claim(shop, "south", "2") is None
    assert report(shop, "north", **{"1": "waiting"}) == AssignmentReply(back=["1"])
    assert claim(shop, "south", "2") is None
    assert report(shop, "north", **{"1": "removed"}) == AssignmentReply()
    assert claim(shop, "north", "3") is None, "it was wanted for another one"
    assert claim(shop, "south", "2") == "a"


def test_what_begins_before_the_release_reaches_its_cell_goes_on(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    report(shop, "north", **{"1": "waiting"})
    release(shop, "a")
    assert report(shop, "north", **{"1": "under way"}) == AssignmentReply(stands=["1"])
    with pytest.raises(ConfigError, match="north has begun it"):
        release(shop, "a")
    assert report(shop, "north", **{"1": "accepted"}) == AssignmentReply()
    assert states(shop) == {"a": "done"}


def test_a_claim_that_never_reached_its_cell_is_given_back_by_asking_or_by_not_knowing_it(shop: Database) -> None:
    add(shop, "a", "b")
    claim(shop, "north", "1")
    claim(shop, "south", "2")
    release(shop, "a")
    release(shop, "b")
    with shop.transaction() as sql:
        assert parts.claim(sql, "north", "1") == {"part": None, "over": True}
    assert report(shop, "south", **{"2": "unknown"}) == AssignmentReply()
    assert states(shop) == {"a": "waiting", "b": "waiting"}


def test_a_cell_that_took_a_part_and_knows_nothing_of_it_keeps_it(shop: Database) -> None:
    """Its journal was moved aside: it may have begun it, and only a person can say that it has not."""
    add(shop, "a")
    claim(shop, "north", "1")
    report(shop, "north", "old", **{"1": "waiting"})
    release(shop, "a")
    report(shop, "north", "new", **{"1": "unknown"})
    assert states(shop) == {"a": "claimed"}
    assert claim(shop, "south", "2") is None


def test_a_cell_that_is_gone_learns_that_it_has_lost_its_part(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    report(shop, "north", **{"1": "under way"})
    assert "must not begin it any more" in release(shop, "a", gone=True)
    assert claim(shop, "south", "2") == "a"
    assert report(shop, "north", **{"1": "under way"}) == AssignmentReply(lost=["1"])
    assert report(shop, "north", **{"1": "under way"}) == AssignmentReply(lost=["1"])
    assert words(shop)[2:] == ["begun", "cell is gone", "gone", "claimed", "came back, and had begun it"]
    assert report(shop, "south", **{"2": "waiting"}) == AssignmentReply(stands=["2"])


def test_what_was_put_aside_waits_for_a_person(shop: Database) -> None:
    add(shop, "a", "b")
    claim(shop, "north", "1")
    claim(shop, "north", "2")
    report(shop, "north", **{"1": "set aside", "2": "removed"})
    assert states(shop) == {"a": "aside", "b": "aside"}
    assert claim(shop, "south", "3") is None
    assert release(shop, "a") == "a waits again"
    assert claim(shop, "south", "3") == "a"
    with shop.transaction() as sql:
        parts.remove(sql, "b", "ada", "broken")
        with pytest.raises(ConfigError, match="'a' is claimed: only what waits"):
            parts.remove(sql, "a", "ada", "")
    assert states(shop) == {"a": "claimed", "b": "removed"}
    with pytest.raises(ConfigError, match="no part 'z'"):
        release(shop, "z")


def test_a_cell_hears_nothing_of_claims_that_are_not_its_own(shop: Database) -> None:
    add(shop, "a")
    claim(shop, "north", "1")
    assert report(shop, "south", **{"1": "waiting"}) == AssignmentReply(lost=["1"])
    assert states(shop) == {"a": "claimed"}


def test_it_is_there_again_after_a_restart(tmp_path: Path) -> None:
    with Database.open(tmp_path / "state") as shop:
        add(shop, "a")
        claim(shop, "north", "1")
    with Database.open(tmp_path / "state") as shop:
        assert claim(shop, "north", "1") == "a"


def test_a_file_that_is_no_database_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "shop.sqlite").write_text("x" * 4096)
    with pytest.raises(ConfigError, match=r"shop\.sqlite: the shop's database cannot be used"):
        Database.open(tmp_path)


def test_a_database_of_another_format_is_left_alone(tmp_path: Path) -> None:
    with Database.open(tmp_path) as shop, shop.transaction() as sql:
        sql.run("PRAGMA user_version = 9")
    with pytest.raises(ConfigError, match="has format 9, this polishd writes 1"):
        Database.open(tmp_path)


JOB = """\
# the customer's lens
[job]
id = "lens"

[part]
id = "P-1"
form = "maps/nominal.dat"   # of the drawing

[program]
path = "a/lens.rnc"
dialects = ["b/lens.rnc", "a/lens.rnc"]
"""


def write(folder: Path) -> Path:
    for name, content in (("maps/nominal.dat", b"n"), ("a/lens.rnc", b"one"), ("b/lens.rnc", b"two")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    (folder / "lens.toml").write_text(JOB)
    return folder / "lens.toml"


def test_its_files_come_along_by_names_without_folders_and_its_words_stay(tmp_path: Path) -> None:
    part = read_part(write(tmp_path))
    assert (part.job, part.part_id) == ("lens", "P-1")
    assert sorted(part.files.values()) == [b"n", b"one", b"two"]
    assert not any("/" in name for name in part.files)
    assert "# the customer's lens" in part.content
    there = tmp_path / "elsewhere"
    there.mkdir()
    for name, content in part.files.items():
        (there / name).write_bytes(content)
    file = JobFile(there / "job.toml", part.content)
    named = dict(file.named(file.fragment()[0]))
    assert Path(named["program.path"]).read_bytes() == b"one"
    assert [Path(one).read_bytes() for one in named["program.dialects"]] == [b"two", b"one"]
    assert set(digests(part)) == set(part.files)
    assert part_of(part.content, part.files) == part


def test_a_file_that_is_missing_too_large_or_no_job_is_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path)
    (tmp_path / "maps" / "nominal.dat").unlink()
    with pytest.raises(ConfigError, match=r"part\.form: .*nominal\.dat: cannot be read"):
        read_part(path)
    write(tmp_path)
    monkeypatch.setattr(parts, "MOST_BYTES", 3)
    with pytest.raises(ConfigError, match="with it its files are more than"):
        read_part(path)
    path.write_text('[cell]\nname = "x"\n')
    with pytest.raises(ConfigError, match=r"(?s)belongs into the cell's file.*job\.id: is missing"):
        read_part(path)


def test_a_file_that_is_too_large_is_not_read_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "MOST_BYTES", 1000)
    job = tmp_path / "job.toml"
    job.write_text('[job]\nid = "lens"\n[part]\nid = "P-1"\n[program]\npath = "lens.rnc"\n')
    with (tmp_path / "lens.rnc").open("wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk; would not fit into memory
    with pytest.raises(ConfigError, match=r"job\.toml: program\.path: .*lens\.rnc: cannot be read: it is larger than"):
        read_part(job)
