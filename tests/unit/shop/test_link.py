"""A cell's side of the shop: its reports, its requests for parts, and its work without the shop."""

from __future__ import annotations

import json
import threading
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.daemon.queue.queue import JobResult, Queue
from polishd.daemon.runtime.events import Event
from polishd.model import events
from polishd.model.errors import ConfigError, LinkError, NoDaemon, PolishdError, TokenRefused
from polishd.plugin_loader import plugins_of
from polishd.shop import link as module
from polishd.shop.database import Database
from polishd.shop.link import ShopClient, ShopLink
from polishd.shop.server import application, cells_of
from polishd.web.http.users import Role
from tests.unit.shop.test_server import write_shop

SECTION = '\n[shop]\nurl = "http://127.0.0.1:9"\ntoken = "file:shop.token"\n'
OFFER = {
    "recipe": "r1", "cell": "south", "job": "disc", "of_cycle": 0, "at_s": 50.0, "rate": 0.9, "sigma": 0.01,
}  # fmt: skip


class Office:
    """A shop with fixed answers that records its requests."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.away = False
        self.refuses = ""
        self.parts: list[str] = []
        self.word: dict[str, list[Any]] = {"stands": [], "back": [], "lost": [], "offers": []}
        self.given: dict[str, dict[str, Any]] = {}
        self.answers_are_lost = False

    def ask(self, path: str, said: Mapping[str, Any]) -> dict[str, Any]:
        verb = path.rpartition("/")[2]
        if self.away:
            raise LinkError("no answer")
        if self.refuses:
            raise ConfigError(self.refuses)
        self.asked.append((verb, dict(said)))
        if verb == "report":
            return {"ok": True, "upto": said["last"], **self.word}
        if verb == "claim":
            request = said["request"]
            if request not in self.given and self.parts:
                name = self.parts.pop(0)
                content = f'[job]\nid = "{name}"\n[part]\nid = "P-{name}"\n'
                self.given[request] = {"job": name, "part_id": f"P-{name}", "content": content, "files": {}}
            if self.answers_are_lost:
                raise LinkError("the answer is lost")
            return {"ok": True, "part": self.given.get(request)}
        return {"ok": True}

    def of(self, verb: str) -> list[dict[str, Any]]:
        return [said for asked, said in self.asked if asked == verb]


class Desk:
    """A daemon that works a queue, or none."""

    def __init__(self, config: CellConfig) -> None:
        self._config = config
        self.up, self.state = True, "idle"
        self.asked: list[tuple[str, dict[str, Any]]] = []
        self.refuses: tuple[str, int] | None = None
        self.silent = ""

    def __call__(self, _state_dir: Path, verb: str, args: Mapping[str, Any]) -> dict[str, Any]:
        if not self.up:
            raise NoDaemon("none")
        if verb == self.silent:
            raise LinkError("the daemon did not answer")
        if verb == "status":
            return {"ok": True, "state": self.state, "waiting": len(self.waiting())}
        self.asked.append((verb, dict(args)))
        if verb == "queue_add":
            if self.refuses:
                return {"ok": False, "error": self.refuses[0], "exit_code": self.refuses[1]}
            with Queue.at_rest(self._config.state_dir) as queue:
                from polishd.config.job_file import JobFile
                from polishd.daemon.queue.queue import NewJob

                (job,) = args["files"]
                name = json.loads(job["content"].split("id = ")[1].split("\n")[0])
                queue.add([NewJob(name, f"P-{name}", JobFile(Path(job["path"]), job["content"]), {}, args["claim"])])
        return {"ok": True}

    def waiting(self) -> list[str]:
        with Queue.at_rest(self._config.state_dir) as queue:
            return [entry.name for entry in queue.waiting()]


class Rig:
    def __init__(self, config: CellConfig, monkeypatch: pytest.MonkeyPatch) -> None:
        self.config, self.office, self.desk = config, Office(), Desk(config)
        monkeypatch.setattr(ShopClient, "request", lambda _, path, body: self.office.ask(path, body))
        monkeypatch.setattr(module.client, "request", self.desk)
        monkeypatch.setattr(module, "check_jobs", lambda *_: [])
        self.link = self.again()

    def again(self) -> ShopLink:
        """Return a new link, as after a kill."""
        assert self.config.shop is not None
        self.link = ShopLink(self.config, plugins_of(self.config), self.config.shop)
        return self.link

    def happens(self, *happened: Event) -> None:
        with Journal.of_cell(self.config.state_dir) as journal:
            for event in happened:
                journal.record_event(event)


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rig:
    files = write_demo(tmp_path / "demo", None, 2.0, 4, None)
    files.cell.write_text(files.cell.read_text() + SECTION)
    token = files.cell.parent / "shop.token"
    token.write_text("secret\n")
    token.chmod(0o600)
    config = load_config(files.cell)
    config.state_dir.mkdir()
    return Rig(config, monkeypatch)


HELD = events.CellHeld(error="a scratch", kind="SafetyStop")


def test_what_the_journal_says_is_reported_by_its_own_numbers_and_progress_is_left_out(rig: Rig) -> None:
    assert rig.link.turn() is False
    assert rig.office.asked == [], "the cell has no journal yet"
    rig.happens(HELD, events.PassProgressed(block=3), HELD)
    rig.desk.state = "held"
    rig.link.turn()
    rig.happens(HELD)
    rig.link.turn()
    first, second = rig.office.of("report")
    assert [(one["first"], one["last"], [row[0] for row in one["events"]]) for one in (first, second)] == [
        (1, 3, [1, 3]),
        (4, 4, [4]),
    ]
    assert (first["before"], second["before"]) == ("", first["tail"])
    assert first["now"]["state"] == "held"


def test_a_long_journal_is_reported_in_pieces(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_EVENTS", 2)
    rig.happens(*[HELD] * 5)
    rig.desk.up = False
    assert [rig.link.turn() for _ in range(3)] == [True, True, False]
    assert [(one["first"], one["last"]) for one in rig.office.of("report")] == [(1, 2), (3, 4), (5, 5)]


def test_nothing_is_lost_while_the_shop_is_away(rig: Rig) -> None:
    rig.happens(HELD)
    rig.office.away = True
    with pytest.raises(LinkError):
        rig.link.turn()
    rig.happens(HELD)
    rig.office.away = False
    rig.link.turn()
    (report,) = rig.office.of("report")
    assert (report["first"], report["last"]) == (1, 2)


def test_a_part_is_asked_for_where_none_waits_and_added_by_its_claim(rig: Rig) -> None:
    rig.happens(HELD)
    rig.office.parts = ["lens", "disc"]
    assert rig.link.turn() is True, "the shop must get this at once"
    assert rig.desk.waiting() == ["lens"]
    rig.link.turn()
    assert len(rig.office.of("claim")) == 1, "one waits"
    (request,) = rig.office.given
    assert rig.office.of("report")[-1]["claims"] == {request: {"state": "waiting", "reason": ""}}


@pytest.mark.parametrize("state", ["held", "starting", "finished"])
def test_a_cell_that_does_not_work_asks_for_nothing(rig: Rig, state: str) -> None:
    rig.happens(HELD)
    rig.office.parts = ["lens"]
    rig.desk.state = state
    rig.link.turn()
    rig.desk.up = False
    rig.link.turn()
    assert rig.office.of("claim") == []


def test_an_answer_that_was_lost_is_asked_for_again_by_the_same_request(rig: Rig) -> None:
    rig.happens(HELD)
    rig.office.parts, rig.office.answers_are_lost = ["lens", "disc"], True
    with pytest.raises(LinkError):
        rig.link.turn()
    rig.office.answers_are_lost = False
    rig.again().turn()
    assert len({said["request"] for said in rig.office.of("claim")}) == 1
    assert rig.desk.waiting() == ["lens"]


@pytest.mark.full
def test_what_was_added_just_before_a_kill_is_not_asked_for_again(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.happens(HELD)
    rig.office.parts = ["lens", "disc"]
    with monkeypatch.context() as killed:
        killed.setattr(ShopLink, "_clear_request", lambda _: (_ for _ in ()).throw(RuntimeError("killed")))
        with pytest.raises(RuntimeError, match="killed"):
            rig.link.turn()
    with Queue.at_rest(rig.config.state_dir) as queue:
        queue.remove_waiting("lens")
    rig.again().turn()
    assert len(rig.office.of("claim")) == 1
    assert rig.office.parts == ["disc"]


def test_a_part_that_this_cell_cannot_work_is_refused_with_the_reason(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def judged(*_: Any) -> list[Any]:
        raise PolishdError("it does not reach the rim")

    monkeypatch.setattr(module, "check_jobs", judged)
    rig.happens(HELD)
    rig.office.parts = ["lens"]
    rig.link.turn()
    (said,) = rig.office.of("refuse")
    assert said["why"] == "it does not reach the rim"
    assert rig.desk.waiting() == []


def test_it_is_refused_only_where_it_is_sure_that_the_daemon_has_not_taken_it(rig: Rig) -> None:
    rig.happens(HELD)
    rig.office.parts = ["lens"]
    rig.desk.silent = "queue_add"
    with pytest.raises(LinkError):
        rig.link.turn()
    rig.desk.silent, rig.desk.refuses = "", ("queue_add failed inside the daemon", 1)
    with pytest.raises(LinkError):
        rig.link.turn()
    assert rig.office.of("refuse") == []
    rig.desk.refuses = ("job.id: 'lens' is done already", ConfigError.exit_code)
    rig.link.turn()
    assert [said["why"] for said in rig.office.of("refuse")] == ["job.id: 'lens' is done already"]


def test_the_daemon_hears_the_shops_word_and_what_others_have_learned(rig: Rig) -> None:
    rig.happens(HELD)
    rig.office.word = {"stands": ["a"], "back": ["b"], "lost": ["c"], "offers": [OFFER]}
    rig.link.turn()
    assert rig.desk.asked[0] == ("shop_assignments", {"stands": ["a"], "back": ["b"], "lost": ["c"]})
    assert rig.desk.asked[1] == ("shop_rates", {"offers": [OFFER]})
    rig.happens(events.ShopRateReceived(**OFFER))  # type: ignore[arg-type]
    rig.link.turn()
    assert [verb for verb, _ in rig.desk.asked].count("shop_rates") == 1, "it was offered"
    claims = rig.office.of("report")[-1]["claims"]
    assert claims == {"a": {"state": "unknown"}, "b": {"state": "unknown"}}, "its queue has none of them"


def test_it_goes_on_whatever_the_shop_says_and_tells_it_once(rig: Rig, caplog: pytest.LogCaptureFixture) -> None:
    rig.happens(HELD)
    rig.office.refuses = "the token is not valid"
    turns, stop = [0], threading.Event()

    class Pauses(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            turns[0] += 1
            rig.office.refuses = "" if turns[0] > 3 else rig.office.refuses
            return turns[0] > 4 or stop.is_set()

    rig.link.run(Pauses())
    said = [record.message for record in caplog.records]
    assert len([one for one in said if "goes on with what it has" in one]) == 1
    assert len([one for one in said if "answers again" in one]) == 1
    assert not any("secret" in one for one in said)
    assert len(rig.office.of("report")) == 1


@pytest.mark.full
def test_a_token_that_is_refused_is_not_tried_again_until_there_is_another_one(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The shop is the real one; the cell reports the time in between once the token is good again."""
    file = rig.config.base_dir / "shop.token"
    monkeypatch.undo()
    monkeypatch.setattr(module.client, "request", rig.desk)
    (rig.config.base_dir / "shop").mkdir()
    shop = write_shop(rig.config.base_dir / "shop")
    asked: list[int] = []
    with Database.open(shop.state_dir) as database:
        client = TestClient(application(shop, database), base_url="http://127.0.0.1:8760")

        def post(_wire: ShopClient, path: str, body: bytes, token: str) -> tuple[int, bytes]:
            found = client.post(path, content=body, headers={"Authorization": f"Bearer {token}"})
            asked.append(found.status_code)
            return found.status_code, found.content

        monkeypatch.setattr(ShopClient, "_post", post)
        file.write_text(cells_of(shop).add("north", Role.WATCH))

        class Days(threading.Event):
            """Pauses that take no time: after some of them things happen."""

            pauses = 0

            def wait(self, timeout: float | None = None) -> bool:
                assert timeout is None or timeout <= module.LONGEST_PAUSE_S
                self.pauses += 1
                if self.pauses == 3:
                    assert set(asked) == {200}
                    cells_of(shop).remove("north")
                    asked.clear()
                elif self.pauses == 40:
                    assert asked == [401], "it was asked once"
                    rig.happens(HELD)
                    file.write_text(cells_of(shop).add("north", Role.WATCH))
                return self.pauses > 44

        rig.happens(HELD)
        rig.again().run(Days())
        with database.transaction() as sql:
            assert [row["seq"] for row in sql.rows("SELECT seq FROM event ORDER BY seq")] == [1, 2]
    assert asked[1:]
    assert set(asked[1:]) == {200}
    (refused, again) = [record.message for record in caplog.records if record.levelname == "WARNING"]
    assert "does not take this cell's token" in refused
    assert f"--add-cell NAME, and write it into {file}" in refused
    assert "the shop answers again" in again


def test_a_token_that_is_refused_is_tried_again_after_a_while(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A shop whose file of tokens was away for a while has the old one again."""
    monkeypatch.setattr(module, "REFUSED_S", 0.0)
    monkeypatch.setattr(ShopClient, "has_new_token", lambda _: False)
    answers = [TokenRefused("no"), None]

    def ask(_wire: ShopClient, path: str, said: Mapping[str, Any]) -> dict[str, Any]:
        if (error := answers.pop(0)) is not None:
            raise error
        return rig.office.ask(path, said)

    monkeypatch.setattr(ShopClient, "request", ask)
    stop = threading.Event()
    monkeypatch.setattr(ShopLink, "_apply_reply", lambda *_: stop.set())
    rig.happens(HELD)
    rig.desk.state = "held"
    rig.link.run(stop)
    assert len(rig.office.of("report")) == 1


def test_what_this_cell_has_learned_itself_needs_no_offer(rig: Rig) -> None:
    with Journal.of_cell(rig.config.state_dir) as journal:
        own = journal.of_job("own", "P-1", {})
        own.record_event(HELD)
        own.begin_pass(0, "ab", "boot", 10, facts={"taught": {"recipe": "r1"}, "measured": float("nan")})
    rig.office.word["offers"] = [OFFER, {**OFFER, "recipe": "r2"}]
    rig.link.turn()
    (said,) = [args for verb, args in rig.desk.asked if verb == "shop_rates"]
    assert [one["recipe"] for one in said["offers"]] == ["r2"]


def test_a_daemon_that_hangs_keeps_nothing_from_the_shop(rig: Rig) -> None:
    rig.happens(HELD)
    rig.desk.silent = "status"
    rig.link.turn()
    (report,) = rig.office.of("report")
    assert (report["last"], report["now"]["state"]) == (1, "does not answer")


def test_two_links_of_one_cell_are_refused(rig: Rig) -> None:
    from polishd.daemon.runtime.exit_record import locked

    with locked(rig.config.state_dir / "shop"), pytest.raises(ConfigError, match="another polishd"):
        rig.link.run(threading.Event())


def test_without_a_token_it_does_not_begin(rig: Rig) -> None:
    (rig.config.base_dir / "shop.token").unlink()
    with pytest.raises(ConfigError, match=r"shop\.token"):
        rig.again()


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("url", "wrong"),
    [
        ("http://192.0.2.1:8760", "needs TLS"),
        ("ftp://127.0.0.1", "not"),
        ("https://shop.example/path", "not"),
        ("https://ada:secret@shop.example", "not"),
        ("https://[::1", "not"),
    ],
)
def test_an_address_by_which_a_token_would_go_astray_is_refused(rig: Rig, url: str, wrong: str) -> None:
    path = rig.config.path
    path.write_text(path.read_text().replace("http://127.0.0.1:9", url))
    with pytest.raises(ConfigError, match=rf"shop\.url: .*{wrong}"):
        load_config(path)


def test_a_journal_of_an_earlier_format_says_what_to_do(rig: Rig) -> None:
    rig.desk.up = False
    (rig.config.state_dir / JOURNAL_NAME).touch()
    with pytest.raises(ConfigError, match=r"no such table: .*\. Run polishd run"):
        rig.link.turn()


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"upto": "x"}, "upto is 'x'"),
        ({"upto": None}, "upto is None"),
        ({"stands": 3}, "TypeError"),
        ({"stands": [3]}, "stands is 3"),
        ({"offers": [{}]}, "KeyError: 'recipe'"),
        ({"offers": [{**OFFER, "tool": []}]}, "unhashable"),
        ({"offers": [{**OFFER, "at_s": "5"}]}, "at_s of an offer"),
    ],
)
def test_a_report_that_is_answered_wrongly_ends_no_link(rig: Rig, change: dict[str, Any], names: str) -> None:
    rig.happens(HELD)
    rig.office.word = {**rig.office.word, **change}
    with pytest.raises(LinkError, match=rf"its answer to report cannot be used: .*{names}"):
        rig.link.turn()
    assert rig.desk.asked == []


@pytest.mark.parametrize(
    ("change", "names"),
    [
        ({"job": 3}, "job is 3"),
        ({"content": None}, "content is None"),
        ({"files": ["a"]}, "AttributeError"),
        ({"files": {"..": "ab"}}, "is not the name of a file"),
        ({"files": {"a/b": "ab"}}, "is not the name of a file"),
    ],
)
def test_a_part_that_cannot_be_one_ends_no_link(rig: Rig, change: dict[str, Any], names: str) -> None:
    rig.happens(HELD)
    part = {"job": "lens", "part_id": "P", "content": "", "files": {}, **change}
    rig.office.given = defaultdict(lambda: part)
    rig.office.parts = []
    real = rig.office.ask
    rig.office.ask = lambda path, said: {"part": part} if path.endswith("claim") else real(path, said)  # type: ignore[method-assign]
    with pytest.raises(LinkError, match=rf"its answer to claim cannot be used: .*{names}"):
        rig.link.turn()
    assert rig.desk.waiting() == []


def test_a_disk_that_refuses_a_jobs_files_ends_no_link(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.happens(HELD)
    rig.office.parts = ["lens"]
    (rig.config.state_dir / "shop").mkdir()
    (rig.config.state_dir / "shop" / "jobs").write_text("in the way")
    with pytest.raises(LinkError, match="the files of job 'lens' cannot be written"):
        rig.link.turn()


@pytest.mark.full
def test_the_files_of_a_job_are_removed_after_its_end_and_no_others(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETENTION_S", -60.0)
    rig.happens(HELD)
    rig.office.parts = ["lens", "disc"]
    folder = rig.config.state_dir / "shop" / "jobs"

    def kept() -> list[str]:
        rig.link.turn()
        return sorted((path / "job.toml").read_text().split('"')[1] for path in folder.iterdir())

    def open_claims(*names: str) -> None:
        rig.office.word["stands"] = [request for request, part in rig.office.given.items() if part["job"] in names]

    def begin(name: str, number: int) -> None:
        with Queue.at_rest(rig.config.state_dir) as queue:
            (entry,) = [one for one in queue.to_do() if one.name == name]
            queue.begin(entry, number)

    def end(name: str) -> None:
        with Queue.at_rest(rig.config.state_dir) as queue:
            (entry,) = [one for one in queue.to_do() if one.name == name]
            queue.end(entry, JobResult("accepted", "", ""))

    rig.link.turn()
    open_claims("lens")
    with Journal.of_cell(rig.config.state_dir) as journal:
        journal.of_job("lens", "P-lens", {})
    begin("lens", 1)
    assert kept() == ["disc", "lens"], "it is under way"
    open_claims("lens", "disc")
    end("lens")
    assert kept() == ["disc", "lens"], "it is the last job, and the shop does not know its end"
    with Journal.of_cell(rig.config.state_dir) as journal:
        journal.of_job("disc", "P-disc", {})
    begin("disc", 2)
    assert kept() == ["disc", "lens"], "the shop does not know its end"
    open_claims("disc")
    with monkeypatch.context() as soon:
        soon.setattr(module, "RETENTION_S", 3600.0)
        assert kept() == ["disc", "lens"], "its run folder may still be written"
    assert kept() == ["disc"]


def test_a_process_without_free_files_ends_no_link(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def request(*_: Any, **__: Any) -> dict[str, Any]:
        raise OSError(24, "too many open files")

    monkeypatch.setattr(module.client, "request", request)
    rig.happens(HELD)
    rig.link.turn()
    (report,) = rig.office.of("report")
    assert "too many open files" in report["now"]["reason"]


def test_the_files_of_a_refused_part_are_removed(rig: Rig) -> None:
    rig.happens(HELD)
    rig.office.parts, rig.desk.refuses = ["lens"], ("job.id: 'lens' is done already", ConfigError.exit_code)
    rig.link.turn()
    assert list((rig.config.state_dir / "shop" / "jobs").iterdir()) == []
