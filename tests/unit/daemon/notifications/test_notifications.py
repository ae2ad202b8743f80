"""Notifications of a cell: sent at once, later, or never, without an effect on the cell."""

from __future__ import annotations

import json
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon import app
from polishd.daemon.notifications import notifications, sender
from polishd.daemon.notifications.notifications import Notifications, try_out
from polishd.daemon.notifications.sender import NotificationSender, Notifier, outbox_path
from polishd.model.errors import LinkError, StaleMap
from polishd.model.events import (
    DaemonFailed,
    Event,
    MapMeasured,
    NotificationFailed,
    PassProgressed,
    RunFolderCompleted,
    StateChanged,
)
from polishd.model.notification import Notification
from polishd.model.states import NOT_ASKED, CellSafety, Severity
from polishd.model.surface import SurfaceStats
from polishd.plugins.notifications import polishd_notifiers
from tests.fakes.receivers import mail_server, web_server
from tests.time_limits import SOON_S, within
from tests.unit.daemon.small_job import run_cell
from tests.unit.daemon.test_app import Site

SECRET = "hunter2-and-more"
KINDS = {kind.name: kind for kind in polishd_notifiers()}
SAFE = CellSafety(tool_off="yes", robot_at_rest="yes", unsafe=(), next="polishd resume CELL.toml goes on")
KNOWN = {"job": "small", "part": "P-1", "run_dir": "before"}
HELD = StateChanged(state="held", reason="LinkError: cut", standing=SAFE)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    (tmp_path / "secret").write_text(SECRET)
    (tmp_path / "secret").chmod(0o600)
    for limit in ("SEND_TO_THE_END_S", "END_S"):
        monkeypatch.setattr(notifications, limit, SOON_S)
    return Site(tmp_path, monkeypatch)


@pytest.fixture
def notified_by(site: Site, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """``notified_by(notifier, ...)``: the notifiers of the site's config."""

    def wanted(*notifiers: Notifier) -> None:
        monkeypatch.setattr(app, "build_notifiers", lambda config, hooks: notifiers)

    return wanted


def notifier(send: Callable[[Notification], None], name: str = "pager", least: Severity = Severity.WARNING) -> Notifier:
    return Notifier(name, "own", least, 1800.0, send)


def real(kind: str, site: Site, **keys: Any) -> Notifier:
    send = KINDS[kind].build(KINDS[kind].options(**keys), site.config.base_dir)
    return Notifier(kind, kind, Severity.INFO, 1800.0, send)


def mail(site: Site, port: int) -> Notifier:
    keys = {"host": "127.0.0.1", "security": "none", "user": "cell", "password": "file:secret"}
    return real("email", site, port=port, sender="cell@example.org", to=["ada@example.org"], **keys)


def fails_in_a_pass(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot's link is cut while the tool presses."""
    build = site.build

    def built(config: Any, hooks: Any) -> Any:
        cell = build(config, hooks)
        assert site.bench is not None
        robot = site.bench.fake.robot
        cut = {"send": LinkError("robot: the wire is cut")}
        robot.acts.before["send"] = lambda: robot.acts.fails.update(cut if robot.done > 5 else {})
        return cell

    monkeypatch.setattr(app, "build_cell", built)


def journalled(site: Site, name: str) -> list[dict[str, Any]]:
    """The data of the journal's events of that name."""
    connection = sqlite3.connect(site.config.state_dir / "journal.sqlite")
    rows = connection.execute("SELECT data FROM event WHERE name = ? ORDER BY id", (name,)).fetchall()
    connection.close()
    return [json.loads(data) for (data,) in rows]


def waiting(site: Site, name: str) -> list[str]:
    """What is kept for the next start."""
    kept = json.loads(outbox_path(site.config.state_dir, name).read_text())
    return [one["what"] for one in kept["waiting"]]


# a cell and its people


@pytest.mark.full
async def test_a_pass_that_fails_is_notified_by_mail_webhook_and_command_in_the_words_of_status(
    site: Site, notified_by: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    fails_in_a_pass(site, monkeypatch)
    with mail_server() as server, web_server() as hook:
        command = real("command", site, argv=["sh", "-c", "cat > received"])
        notified_by(mail(site, server.port), real("webhook", site, url=hook.url, token="file:secret"), command)
        summary = await run_cell(site.config, site.hooks)
    assert summary["outcome"] == "failed"
    posted = json.loads(hook.posted[0][2])
    assert posted["what"] == f"failed: {summary['reason']}"
    assert posted["now"] == "the daemon has ended; tool off the part: yes; robot at rest: yes"
    assert posted["todo"] == summary["next"].replace("CELL.toml", str(site.path))
    found = {key: posted[key] for key in ("severity", "cell", "job", "part", "run_dir")}
    assert found == {
        "severity": "alarm", "cell": "bench", "job": "small", "part": "P-1", "run_dir": summary["run_dir"]
    }  # fmt: skip
    assert json.loads((site.config.base_dir / "received").read_text()) == posted
    (_, received), *_ = server.taken
    assert " ".join(received["Subject"].split()) == posted["title"]
    assert len(hook.posted) == len(server.taken) == 1, "held is not failed, and the end is sent once"
    assert server.logins == [f"\0cell\0{SECRET}"]
    for path in site.config.base_dir.rglob("*"):
        if path.is_file() and path.name != "secret":
            assert SECRET.encode() not in path.read_bytes(), path


async def test_what_could_not_be_sent_at_the_end_is_sent_at_the_next_start(site: Site, notified_by: Any) -> None:
    def refuse() -> Any:
        raise StaleMap("late")

    site.measure = refuse
    with mail_server() as server:
        port = server.port
    notified_by(mail(site, port))
    await run_cell(site.config, site.hooks, holds=False)
    assert waiting(site, "email") == ["failed: StaleMap: late"]
    (failed,) = journalled(site, "notification_failed")
    assert (failed["notifier"], failed["waiting"]) == ("email", 1)
    assert "refused" in failed["error"]
    log = (site.config.state_dir / "polishd.log").read_text()
    assert "'email': 1 notifications wait for the next start in " in log
    assert SECRET not in log
    site.measure = None
    with mail_server(port) as server:
        await run_cell(site.config, site.hooks, holds=False)
        subjects = [received["Subject"] for _, received in server.taken]
    assert subjects[0] == "bench: alarm: failed: StaleMap: late"
    assert waiting(site, "email") == []


@pytest.mark.full
async def test_a_mail_server_that_hangs_does_not_hold_up_the_end(
    site: Site, notified_by: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notifications, "SEND_TO_THE_END_S", 0.5)
    monkeypatch.setattr(notifications, "END_S", 1.0)
    with mail_server() as server:
        server.silent.set()
        notified_by(mail(site, server.port))
        summary = await run_cell(site.config, site.hooks)
        assert server.asked.acquire(timeout=SOON_S)
        assert waiting(site, "email") == ["in_tolerance"]
    assert summary["outcome"] == "in_tolerance"


async def test_a_broken_notifier_takes_nothing_down(site: Site, notified_by: Any) -> None:
    def breaks(_: Notification) -> None:
        raise SystemExit("who wrote this")

    received: list[Notification] = []
    notified_by(notifier(breaks, "broken", Severity.INFO), notifier(received.append, "sound", Severity.INFO))
    summary = await run_cell(site.config, site.hooks)
    assert summary["outcome"] == "in_tolerance"
    assert (
        {"run_folder_completed"} <= {one.event for one in received} <= {"run_folder_completed", "notification_failed"}
    )
    assert [one["error"] for one in journalled(site, "notification_failed")] == ["SystemExit: who wrote this"]


@pytest.mark.full
async def test_what_waits_for_a_notifier_that_is_gone_is_reported(
    site: Site, notified_by: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(_: Notification) -> None:
        raise OSError("down")

    monkeypatch.setattr(sender, "FIRST_PAUSE_S", 1e6)
    notified_by(notifier(breaks, "old", Severity.INFO))
    await run_cell(site.config, site.hooks)
    notified_by(notifier(lambda _: None, "new", Severity.INFO))
    await run_cell(site.config, site.hooks)
    log = (site.config.state_dir / "polishd.log").read_text()
    assert "old.json: 1 notifications wait for a notifier that is not in the config any more" in log
    assert waiting(site, "old") == ["in_tolerance"]


@pytest.mark.full
async def test_who_wants_nothing_has_no_folder(site: Site, notified_by: Any) -> None:
    notified_by()
    await run_cell(site.config, site.hooks)
    assert not (site.config.state_dir / "notify").exists()


# a sender


class People:
    """Receivers that fail until ``deaf`` is cleared."""

    def __init__(self) -> None:
        self.received: list[Notification] = []
        self.failures: list[NotificationFailed] = []
        self.deaf = True
        self.called = threading.Semaphore(0)
        self.failed = threading.Semaphore(0)
        self.came = threading.Semaphore(0)

    def receive(self, notification: Notification) -> None:
        self.called.release()
        if self.deaf:
            raise OSError("no answer")
        self.received.append(notification)
        self.came.release()

    def fail(self, event: NotificationFailed) -> None:
        self.failures.append(event)
        self.failed.release()


@pytest.fixture
def people() -> People:
    return People()


@pytest.fixture
def notification(tmp_path: Path, site: Site) -> Notification:
    """Return the notification of a cell that is held."""
    taken: list[Notification] = []
    teller = Notifications(site.config, KNOWN)
    teller._senders = (type("Ear", (), {"take": taken.append, "notifier": notifier(taken.append)}),)  # type: ignore[assignment]
    teller.on_event(HELD)
    return taken[0]


@pytest.fixture
def sending(tmp_path: Path, people: People) -> Iterator[NotificationSender]:
    """Start a sender to those people."""
    found = NotificationSender(notifier(people.receive), tmp_path, people.fail)
    found.start()
    yield found
    found.end(time.monotonic())
    found.join(SOON_S)


def test_one_that_fails_is_tried_again_and_reported_once(
    sending: NotificationSender, people: People, notification: Notification, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sender, "FIRST_PAUSE_S", 0.01)
    sending.take(notification)
    for _ in range(4):
        assert people.called.acquire(timeout=SOON_S)
    people.deaf = False
    assert people.came.acquire(timeout=SOON_S)
    assert people.received == [notification]
    assert [(one.error, one.waiting) for one in people.failures] == [("OSError: no answer", 1)]


def test_what_is_less_severe_than_wanted_is_not_sent(
    tmp_path: Path, people: People, notification: Notification
) -> None:
    people.deaf = False
    sending = NotificationSender(notifier(people.receive, least=Severity.ALARM), tmp_path, people.fail)
    sending.start()
    sending.take(notification)
    sending.end(time.monotonic() + SOON_S)
    sending.join(SOON_S)
    assert people.received == []


def test_the_end_is_one_more_chance_for_all_that_waits(
    tmp_path: Path,
    sending: NotificationSender,
    people: People,
    notification: Notification,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever the pause after a failure."""
    monkeypatch.setattr(sender, "FIRST_PAUSE_S", 1e6)
    monkeypatch.setattr(sender, "LONGEST_PAUSE_S", 1e6)
    sending.take(notification)
    assert people.failed.acquire(timeout=SOON_S)
    people.deaf = False
    sending.end(time.monotonic() + SOON_S)
    sending.join(SOON_S)
    assert people.received == [notification]
    assert json.loads(outbox_path(tmp_path, "pager").read_text())["waiting"] == []


def test_the_end_is_no_second_chance(sending: NotificationSender, people: People, notification: Notification) -> None:
    """The end does not use its whole time limit for a notifier that fails."""
    sending.take(notification)
    assert people.failed.acquire(timeout=SOON_S)
    sending.end(time.monotonic() + SOON_S)
    with within(5.0):
        sending.join(SOON_S)
    assert people.called.acquire(timeout=SOON_S)
    assert people.called.acquire(timeout=SOON_S)
    assert not people.called.acquire(blocking=False)


def test_one_that_never_comes_back_is_reported_and_not_called_again_until_it_does(
    tmp_path: Path, people: People, notification: Notification, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sender, "SEND_S", 0.05)
    back = threading.Event()

    def hangs(one: Notification) -> None:
        assert back.wait(SOON_S)
        people.receive(one)

    people.deaf = False
    sending = NotificationSender(notifier(hangs), tmp_path, people.fail)
    sending.start()
    sending.take(notification)
    assert people.failed.acquire(timeout=SOON_S)
    back.set()
    assert people.came.acquire(timeout=SOON_S)
    sending.end(time.monotonic() + SOON_S)
    sending.join(SOON_S)
    assert people.received == [notification], "it was sent, if late"
    assert [one.error for one in people.failures] == [sender.HUNG]


def test_the_end_does_not_wait_for_one_that_hangs(
    tmp_path: Path, people: People, notification: Notification, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sender, "SEND_S", 0.05)
    back = threading.Event()
    sending = NotificationSender(notifier(lambda _: back.wait(SOON_S) and None), tmp_path, people.fail)
    sending.start()
    sending.take(notification)
    assert people.failed.acquire(timeout=SOON_S)
    with within(20.0):
        sending.end(time.monotonic() + SOON_S)
        sending.join(SOON_S)
    back.set()
    assert [one["id"] for one in json.loads(outbox_path(tmp_path, "pager").read_text())["waiting"]] == [notification.id]


def test_what_cannot_be_read_is_logged_and_the_sender_works(
    tmp_path: Path, people: People, notification: Notification, caplog: pytest.LogCaptureFixture
) -> None:
    path = outbox_path(tmp_path, "pager")
    path.parent.mkdir()
    path.write_text('{"waiting": [')
    people.deaf = False
    sending = NotificationSender(notifier(people.receive), tmp_path, people.fail)
    sending.start()
    sending.take(notification)
    assert people.came.acquire(timeout=SOON_S)
    sending.end(time.monotonic() + SOON_S)
    sending.join(SOON_S)
    assert "pager.json cannot be read" in caplog.text


def test_a_folder_that_takes_nothing_is_logged_and_the_sender_works(
    tmp_path: Path, people: People, notification: Notification, caplog: pytest.LogCaptureFixture
) -> None:
    outbox_path(tmp_path, "pager").parent.write_text("in the way")
    people.deaf = False
    sending = NotificationSender(notifier(people.receive), tmp_path, people.fail)
    sending.start()
    sending.take(notification)
    assert people.came.acquire(timeout=SOON_S)
    sending.end(time.monotonic() + SOON_S)
    sending.join(SOON_S)
    assert "cannot be written" in caplog.text


def test_what_is_given_up_is_in_the_log_with_all_its_words(
    tmp_path: Path, people: People, notification: Notification, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    monkeypatch.setattr(sender, "KEPT_S", -1e6)
    sending = NotificationSender(notifier(people.receive), tmp_path, people.fail)
    sending.start()
    sending.take(notification)
    assert people.failed.acquire(timeout=SOON_S)
    sending.end(time.monotonic() + SOON_S)
    sending.join(SOON_S)
    assert [one.given_up for one in people.failures] == [1]
    assert notification.text in caplog.text


# events


async def test_two_broken_notifiers_report_each_other_once(site: Site, people: People) -> None:
    """A failed notifier does not report its failure; no endless chain of failures."""
    teller = Notifications(site.config, KNOWN)
    failed = threading.Semaphore(0)

    def on_failure(event: Event) -> None:
        people.failures.append(event)  # type: ignore[arg-type]
        teller.on_event(event)  # as the bus does
        failed.release()

    site.config.state_dir.mkdir()
    teller.start([notifier(people.receive, name) for name in ("a", "b")], on_failure)
    teller.on_event(HELD)
    for _ in range(2):
        assert failed.acquire(timeout=SOON_S)
    await teller.close()
    kept = {name: waiting(site, name) for name in ("a", "b")}
    assert [len(found) for found in kept.values()] == [2, 2]
    assert kept["a"][1].startswith("notifications by 'b' fail")
    assert len(people.failures) <= 4, "once, and once more at the end"


def test_what_is_known_of_the_job_is_what_events_said_last(site: Site) -> None:
    taken: list[Notification] = []
    teller = Notifications(site.config, KNOWN)
    teller._senders = (type("Ear", (), {"take": taken.append, "notifier": notifier(taken.append)}),)  # type: ignore[assignment]
    teller.on_event(HELD)
    teller.on_event(
        MapMeasured(stats=SurfaceStats(rms_nm=1, pv_nm=2, lsf_rms_nm=1), spikes=0, notes=(), run_dir="after")
    )
    teller.on_event(HELD)
    assert [one.run_dir for one in taken] == ["before", "after"]
    assert taken[0].todo == f"polishd resume {site.path} goes on"


DEAF = CellSafety(tool_off="not confirmed", robot_at_rest="yes", unsafe=("actuator: deaf",), next="look")


@pytest.mark.parametrize(
    ("event", "severity"),
    [
        (PassProgressed(block=1), None),
        (StateChanged(state="polishing", reason="", standing=NOT_ASKED), None),
        (HELD, "warning"),
        (StateChanged(state="held", reason="cut", standing=DEAF), "alarm"),
        (DaemonFailed(error="force", kind="SafetyStop", standing=SAFE), "alarm"),
        (RunFolderCompleted(run_dir="r", outcome="in_tolerance", standing=SAFE), "info"),
        (RunFolderCompleted(run_dir="r", outcome="stopped", standing=SAFE), "info"),
        (RunFolderCompleted(run_dir="r", outcome="in_tolerance", standing=DEAF), "alarm"),
        (RunFolderCompleted(run_dir="r", outcome="diverged", standing=SAFE), "warning"),
        (RunFolderCompleted(run_dir="r", outcome="failed", standing=SAFE), None),
        (RunFolderCompleted(run_dir="r", outcome="in_tolerance"), None),
        (NotificationFailed(notifier="mail", error="no", waiting=1), "warning"),
    ],
)
def test_whom_an_event_concerns(event: Event, severity: str | None) -> None:
    found = event.concern()
    assert (found.severity if found else None) == severity
    if severity == "alarm" and event.data["unsafe"]:
        assert found is not None
        assert "actuator did not confirm: deaf; the tool may press on the part: switch the actuator off" in found.now


# a test


async def test_trying_it_out_tells_how_each_went(site: Site, people: People, monkeypatch: pytest.MonkeyPatch) -> None:
    back, received = threading.Event(), list[Notification]()

    def hangs(_: Notification) -> None:
        assert back.wait(SOON_S)

    monkeypatch.setattr(sender.Attempt, "left_s", lambda attempt: 0.05 if attempt._send is hangs else SOON_S)
    notifiers = [notifier(received.append), notifier(people.receive, "deaf"), notifier(hangs, "hung")]
    found = try_out(site.config, notifiers)
    back.set()
    assert [one["error"] for one in found] == ["", "OSError: no answer", sender.HUNG]
    assert received[0].severity is Severity.INFO, "below the limit of the notifier"
    assert "test" in received[0].title
