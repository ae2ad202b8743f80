"""One daemon per state folder.

Lock of a state folder, with any earlier content of its file, and with disk errors.

Record of the end for clients without a daemon: of any end, on any disk, in any state of its file.
"""

from __future__ import annotations

import errno
import fcntl
import itertools
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.journal.journal import Journal
from polishd.daemon.runtime.events import causes, killed_safety, record_exit, recording_exit, safety_of, utc_now
from polishd.daemon.runtime.exit_record import LOCK_NAME, RECORD_NAME, for_cell, last_ending, locked, next_action
from polishd.model.errors import ConfigError, SafetyStop
from polishd.model.events import CellHeld, DaemonFailed, Event, PlanWritten, StateChanged
from polishd.model.states import Outcome
from tests.unit.daemon.small_job import open_journal

HOLDER = """
import sys
from pathlib import Path
from polishd.daemon.runtime.exit_record import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def holder(state_dir: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", HOLDER, str(state_dir)]
    process = subprocess.Popen(command, stdin=-1, stdout=-1, text=True, env=environment)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_second_daemon_is_refused_by_pid_and_crash_frees(tmp_path: Path) -> None:
    with holder(tmp_path / "state") as process:
        with pytest.raises(ConfigError, match=rf"another polishd runs this cell \(pid {process.pid}\)"):
            locked(tmp_path / "state").__enter__()
        process.send_signal(signal.SIGKILL)
        process.wait()
        with locked(tmp_path / "state"):
            assert (tmp_path / "state" / "lock").read_text() == f"{os.getpid()}\n"


def test_lock_is_given_back_and_its_folder_private(tmp_path: Path) -> None:
    state = tmp_path / "deep" / "state"
    for _ in range(2):
        with locked(state), pytest.raises(ConfigError, match="Stop it first"), locked(state):
            pytest.fail("two daemons")
    assert state.stat().st_mode & 0o777 == 0o700
    assert (state / "lock").read_text() == ""


def test_refused_daemon_does_not_take_the_name_away(tmp_path: Path) -> None:
    with locked(tmp_path):
        for _ in range(2):
            with pytest.raises(ConfigError, match=f"pid {os.getpid()}"):
                locked(tmp_path).__enter__()


def test_unusable_folder_is_a_config_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="the state folder cannot be used"):
        locked(tmp_path / "file").__enter__()


def test_whatever_it_held_before_it_holds_the_pid_alone(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_text("999999999 and more\n")
    with locked(tmp_path):
        assert (tmp_path / LOCK_NAME).read_text() == f"{os.getpid()}\n"
    assert (tmp_path / LOCK_NAME).read_text() == ""


def test_it_is_its_owners_alone(tmp_path: Path) -> None:
    with locked(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b" / LOCK_NAME).stat().st_mode & 0o777 == 0o600


def test_one_that_says_nothing_of_itself_is_refused_all_the_same(tmp_path: Path) -> None:
    handle = os.open(tmp_path / LOCK_NAME, os.O_RDWR | os.O_CREAT)
    fcntl.flock(handle, fcntl.LOCK_EX)
    said = f"{tmp_path}: another polishd runs this cell (pid unknown). Stop it first (polishd stop)"
    with pytest.raises(ConfigError, match=re.escape(said)):
        locked(tmp_path).__enter__()
    os.close(handle)
    with locked(tmp_path):
        pass


@pytest.mark.parametrize("call", ["ftruncate", "pwrite"])
def test_a_disk_that_takes_no_pid_is_reported_and_nothing_stays_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, call, full)
    said = f"{tmp_path}: the state folder cannot be used: No space left on device. Repair it, or set cell.state_dir"
    with pytest.raises(ConfigError, match=re.escape(said)):
        locked(tmp_path).__enter__()
    monkeypatch.undo()
    with locked(tmp_path):
        pass


def test_what_ends_the_work_comes_out_as_itself_and_frees_it(tmp_path: Path) -> None:
    with pytest.raises(KeyError), locked(tmp_path):
        raise KeyError
    with locked(tmp_path):
        pass


def test_the_place_that_is_wrong_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(
        ConfigError, match=re.escape(f"{tmp_path / 'file' / 'state'}: the state folder cannot be used: ")
    ):
        locked(tmp_path / "file" / "state").__enter__()


def test_a_lock_file_with_unreadable_content_is_held_all_the_same(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_bytes(b"\xff\xfe\n")
    handle = os.open(tmp_path / LOCK_NAME, os.O_RDWR)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with pytest.raises(ConfigError, match="another polishd runs this cell"):
        locked(tmp_path).__enter__()
    os.close(handle)


KILLED = "the daemon was killed, or its computer stopped, while polishing"
NAMES = ("actuator", "robot")


def polishing() -> StateChanged:
    return safety_of("polishing", "", killed_safety(NAMES))


def test_where_no_daemon_ever_ran(tmp_path: Path) -> None:
    facts = last_ending(tmp_path)
    assert (facts["state"], facts["reason"]) == ("unknown", f"no daemon has left a record in {tmp_path}")
    assert (facts["tool_off"], facts["robot_at_rest"], facts["unsafe"]) == ("not asked", "not asked", [])


@pytest.mark.parametrize("content", ["", "{", "3", '{"state": "held"}', '{"state": "idle", "reason": "", "x": 1}'])
def test_an_unreadable_exit_record_says_so(tmp_path: Path, content: str) -> None:
    (tmp_path / RECORD_NAME).write_text(content)
    facts = last_ending(tmp_path)
    assert facts["state"] == "unknown"
    assert f"{tmp_path / RECORD_NAME} cannot be read: " in facts["reason"]


def test_one_that_is_no_file_says_so(tmp_path: Path) -> None:
    (tmp_path / RECORD_NAME).mkdir()
    assert "cannot be read: " in last_ending(tmp_path)["reason"]


def test_a_daemon_that_is_killed_while_it_polishes_left_word_of_it(tmp_path: Path) -> None:
    recording_exit(tmp_path, lambda: tmp_path / "run", queue=True)(polishing())
    facts = last_ending(tmp_path)
    assert (facts["state"], facts["reason"], facts["run_dir"]) == ("killed", KILLED, str(tmp_path / "run"))
    assert (facts["tool_off"], facts["robot_at_rest"]) == ("not confirmed", "not confirmed")
    assert facts["unsafe"] == [
        "actuator: state unknown, because the daemon was killed",
        "robot: state unknown, because the daemon was killed",
    ]
    assert facts["next"] == next_action("killed", queue=True) != next_action("killed", queue=False)


def test_with_the_reason_why_it_was_held(tmp_path: Path) -> None:
    recording_exit(tmp_path, lambda: None)(safety_of("held", "LinkError: gone", ()))
    facts = last_ending(tmp_path)
    assert facts["reason"].endswith("while held: LinkError: gone")
    assert (facts["tool_off"], facts["run_dir"], facts["queue"]) == ("yes", "", False)
    assert facts["next"] == next_action("killed", queue=False)


def test_the_time_of_an_end_is_in_utc_and_to_the_second() -> None:
    before = datetime.now(UTC).replace(microsecond=0)
    at = datetime.fromisoformat(utc_now())
    assert before <= at <= datetime.now(UTC)
    assert at.microsecond == 0
    assert at.tzinfo is UTC


def test_an_ending_is_reported_as_it_was(tmp_path: Path) -> None:
    record_exit(tmp_path, {"state": "failed", "reason": "LinkError: gone", "exit": 5})
    facts = last_ending(tmp_path)
    assert (facts["state"], facts["reason"], facts["exit"]) == ("failed", "LinkError: gone", 5)
    assert facts["at"].endswith("+00:00")


def test_the_end_itself_and_other_events_leave_it_as_it_is(tmp_path: Path) -> None:
    """The caller that knows all facts records the end."""
    keep = recording_exit(tmp_path, lambda: None)
    keep(polishing())
    before = (tmp_path / RECORD_NAME).read_bytes()
    keep(safety_of("finished", "", ()))
    keep(PlanWritten(run_dir="x"))
    assert (tmp_path / RECORD_NAME).read_bytes() == before


def test_a_full_disk_does_not_prevent_the_end_and_no_older_record_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    record_exit(tmp_path, {"state": "held", "reason": "", "unsafe": []})

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("polishd.daemon.runtime.events.write_atomic", full)
    record_exit(tmp_path, {"state": "failed", "reason": "x"})
    assert f"{tmp_path / RECORD_NAME} cannot be written" in caplog.text
    assert last_ending(tmp_path)["state"] == "unknown", "an older record would be out of date"
    record_exit(tmp_path, {"state": "failed", "reason": "x"})


@pytest.mark.parametrize(
    ("unsafe", "tool_off", "at_rest"),
    [
        (None, "not asked", "not asked"),
        ((), "yes", "yes"),
        (("actuator: gone",), "not confirmed", "yes"),
        (("robot.left: gone: twice",), "yes", "not confirmed"),
        (("spindle: gone",), "yes", "yes"),
    ],
)
def test_how_a_cell_stands(unsafe: tuple[str, ...] | None, tool_off: str, at_rest: str) -> None:
    event: StateChanged = safety_of("held", "why", unsafe)
    assert event.standing is not None
    assert (event.state, event.reason) == ("held", "why")
    assert (event.standing.tool_off, event.standing.robot_at_rest) == (tool_off, at_rest)
    assert list(event.standing.unsafe) == list(unsafe or ())
    assert event.standing.next == next_action("held", queue=False)
    json.dumps(dict(event.data))


# causes

HOT, GONE = CellHeld(error="hot", kind="DeviceFault"), CellHeld(error="gone", kind="LinkError")


@pytest.fixture
def journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Journal]:
    """In which an event is recorded each second, from 2001-09-09 01:46:40 on."""
    seconds = itertools.count(1_000_000_000)
    with open_journal(tmp_path) as found:
        monkeypatch.setattr("polishd.daemon.journal.journal.time.time", lambda: next(seconds) + 0.25)
        yield found


def causes_after(journal: Journal, *events: Event) -> list[str]:
    for event in events:
        journal.record_event(event)
    return [str(cause) for cause in causes(journal, None)]


def test_what_held_a_job_stands_in_the_order_of_time(journal: Journal) -> None:
    assert causes_after(journal) == []
    assert causes_after(journal, HOT, PlanWritten(run_dir="x"), GONE, HOT) == [
        "2001-09-09T01:46:40+00:00 held: DeviceFault: hot",
        "2001-09-09T01:46:42+00:00 held: LinkError: gone",
        "2001-09-09T01:46:43+00:00 held: DeviceFault: hot",
    ]


def test_held_over_it_and_then_stopped_is_one_cause_from_when_it_was_held(journal: Journal) -> None:
    (cause,) = causes_after(journal, HOT, DaemonFailed(error="hot", kind="DeviceFault"))
    assert cause == "2001-09-09T01:46:40+00:00 ended: DeviceFault: hot"


@pytest.mark.parametrize(("error", "kind"), [("hot", "LinkError"), ("cold", "DeviceFault")])
def test_another_end_is_another_cause(journal: Journal, error: str, kind: str) -> None:
    assert causes_after(journal, HOT, DaemonFailed(error=error, kind=kind)) == [
        "2001-09-09T01:46:40+00:00 held: DeviceFault: hot",
        f"2001-09-09T01:46:41+00:00 ended: {kind}: {error}",
    ]


def test_an_end_without_a_hold_is_a_cause_and_so_is_a_hold_after_it(journal: Journal) -> None:
    failed = DaemonFailed(error="hot", kind="DeviceFault")
    assert [cause.split()[1] for cause in causes_after(journal, failed, HOT)] == ["ended:", "held:"]


def test_of_a_lost_journal_the_failure_is_all_that_is_known(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost() -> None:
        raise SafetyStop("journal lost")

    monkeypatch.setattr(journal, "errors", lost)
    assert causes(journal, None) == ()
    (cause,) = causes(journal, SafetyStop("journal lost"))
    assert (cause.kind, cause.error, cause.ended) == ("SafetyStop", "journal lost", True)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", cause.at)


def test_words_for_people_name_their_own_cell() -> None:
    assert for_cell("polishd run CELL.toml", Path("/my cells/a.toml")) == "polishd run '/my cells/a.toml'"
    assert "polishd run CELL.toml --queue starts" in next_action("failed", queue=True)
    assert next_action("no such state", queue=True) == ""


@pytest.mark.parametrize("state", ["idle", "changing", "held", "killed", "failed", "stopped", *Outcome])
def test_each_state_comes_with_what_to_do(state: str) -> None:
    assert next_action(state, queue=False)


def test_its_word_lies_in_the_state_folder_under_a_name_that_stays(tmp_path: Path) -> None:
    record_exit(tmp_path, {"state": "failed", "reason": "x"})
    assert [path.name for path in tmp_path.iterdir()] == ["ending.json"]
