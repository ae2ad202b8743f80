"""What is kept for those who find no daemon: of any ending, on any disk, in any state of its file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from polishd.daemon.endings import RECORD_NAME, gone, keep_ending, keeping, last_ending, standing, to_do
from polishd.model.events import PlanWritten, StateChanged

KILLED = "the daemon was killed, or its machine went down, while polishing"
NAMES = ("actuator", "robot")
POLISHING = standing("polishing", "", gone(NAMES))


def test_where_no_daemon_ever_ran(tmp_path: Path) -> None:
    facts = last_ending(tmp_path)
    assert (facts["state"], facts["reason"]) == ("unknown", f"no daemon has left word in {tmp_path}")
    assert (facts["tool_off"], facts["robot_at_rest"], facts["unsafe"]) == ("not asked", "not asked", [])


@pytest.mark.parametrize("content", ["", "{", "3", '{"state": "held"}', '{"state": "idle", "reason": "", "x": 1}'])
def test_a_word_that_nobody_can_read_says_so(tmp_path: Path, content: str) -> None:
    (tmp_path / RECORD_NAME).write_text(content)
    facts = last_ending(tmp_path)
    assert facts["state"] == "unknown"
    assert f"{tmp_path / RECORD_NAME} cannot be read: " in facts["reason"]


def test_one_that_is_no_file_says_so(tmp_path: Path) -> None:
    (tmp_path / RECORD_NAME).mkdir()
    assert "cannot be read: " in last_ending(tmp_path)["reason"]


def test_a_daemon_that_is_killed_while_it_polishes_left_word_of_it(tmp_path: Path) -> None:
    keeping(tmp_path, lambda: tmp_path / "run", queue=True)(POLISHING)
    facts = last_ending(tmp_path)
    assert (facts["state"], facts["reason"], facts["run_dir"]) == ("killed", KILLED, str(tmp_path / "run"))
    assert (facts["tool_off"], facts["robot_at_rest"]) == ("not confirmed", "not confirmed")
    assert facts["unsafe"] == ["actuator: no daemon lived to ask it", "robot: no daemon lived to ask it"]
    assert facts["next"] == to_do("killed", queue=True) != to_do("killed", queue=False)


def test_with_the_reason_why_it_was_held(tmp_path: Path) -> None:
    keeping(tmp_path, lambda: None)(standing("held", "LinkError: gone", ()))
    facts = last_ending(tmp_path)
    assert facts["reason"].endswith("while held: LinkError: gone")
    assert (facts["tool_off"], facts["run_dir"], facts["queue"]) == ("yes", "", False)
    assert facts["next"] == to_do("killed", queue=False)


def test_an_ending_is_told_as_it_was(tmp_path: Path) -> None:
    keep_ending(tmp_path, {"state": "failed", "reason": "LinkError: gone", "exit": 5})
    facts = last_ending(tmp_path)
    assert (facts["state"], facts["reason"], facts["exit"]) == ("failed", "LinkError: gone", 5)
    assert facts["at"].endswith("+00:00")


def test_the_end_itself_and_other_events_leave_it_as_it_is(tmp_path: Path) -> None:
    """The end is kept by whoever knows all of it."""
    keep = keeping(tmp_path, lambda: None)
    keep(POLISHING)
    before = (tmp_path / RECORD_NAME).read_bytes()
    keep(standing("finished", "", ()))
    keep(PlanWritten(run_dir="x"))
    assert (tmp_path / RECORD_NAME).read_bytes() == before


def test_a_disk_that_takes_no_more_keeps_nobody_from_the_end_and_no_older_word_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    keep_ending(tmp_path, {"state": "held", "reason": "", "unsafe": []})

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("polishd.daemon.endings.write_atomic", full)
    keep_ending(tmp_path, {"state": "failed", "reason": "x"})
    assert f"{tmp_path / RECORD_NAME} cannot be written" in caplog.text
    assert last_ending(tmp_path)["state"] == "unknown", "it would tell what is no longer so"
    keep_ending(tmp_path, {"state": "failed", "reason": "x"})


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
    told: StateChanged = standing("held", "why", unsafe)
    assert told.standing is not None
    assert (told.state, told.reason) == ("held", "why")
    assert (told.standing.tool_off, told.standing.robot_at_rest) == (tool_off, at_rest)
    assert list(told.standing.unsafe) == list(unsafe or ())
    assert told.standing.next == to_do("held", queue=False)
    json.dumps(dict(told.data))
