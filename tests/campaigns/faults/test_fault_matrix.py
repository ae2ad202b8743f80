"""One of the faults of ``make faults``, two losses, how results are kept, and their page."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import pytest

from tests.campaigns import result_files
from tests.campaigns.faults import kept as keeping
from tests.campaigns.faults.__main__ import main
from tests.campaigns.faults.judge import Finding, measure
from tests.campaigns.faults.kept import CASES, Kept
from tests.campaigns.faults.losses import Loss, lose
from tests.campaigns.faults.page import BEGIN, END, PAGE, text

BY_TIME = ("force off ", "noticed after ")
"""What a busy machine may be guilty of."""
HANGS = Finding("robot link", "hangs", "LinkError: silent", 1.0, 1.0, 0.02, "contact left, exit code 5", [], 0.4)
LOSS = Loss("RTDE", "hang", "LinkError: silent", 1.0, 1.01, 0.02, [])


def but_by_time(wrong: list[str]) -> list[str]:
    return [one for one in wrong if not one.startswith(BY_TIME)]


@pytest.mark.system
@pytest.mark.full
@pytest.mark.timeout(200)
def test_a_device_that_hangs_in_contact_is_noticed_and_the_tool_taken_off(tmp_path: Path) -> None:
    finding = measure("actuator, Modbus RTU", "hangs", tmp_path / "cell")
    assert but_by_time(finding.wrong) == []
    assert "no answer within 1 s" in finding.noticed
    assert str(tmp_path) not in finding.noticed
    assert finding.outcome == "contact left, exit code 5"


@pytest.mark.system
@pytest.mark.full
@pytest.mark.timeout(300)
def test_a_link_is_lost_by_silence_and_by_the_plug_in_one_cell(tmp_path: Path) -> None:
    found = list(lose("robot link", 0, 2, tmp_path))
    assert [one.how for one in found] == ["hang", "unplug"]
    for one in found:
        assert but_by_time(one.wrong) == []
        assert one.detection_s is not None
        assert one.force_off_s is not None


def test_what_was_never_measured_comes_first_and_then_what_is_of_other_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert Kept(tmp_path).left() == CASES
    monkeypatch.setattr(keeping, "of_case", lambda link: "before")
    Kept(tmp_path).add(HANGS)
    monkeypatch.undo()
    case = ("robot link", "hangs")
    others = [one for one in CASES if one != case]
    assert Kept(tmp_path).left() == [*others, case]
    assert Kept(tmp_path).left(new=True) == others
    Kept(tmp_path, cells=3).add(replace(HANGS, detection_s=0.5))
    [row] = Kept(tmp_path).cases()
    assert (row["detection_s"], row["cells"], row["of"]) == (0.5, 3, keeping.of_case("robot link"))
    assert Kept(tmp_path).left() == others
    assert Kept(tmp_path).left(again=True) == [*others, case]


def test_losses_add_up_and_take_the_place_of_older_ones_once_they_are_as_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keeping, "of_case", lambda link: "before")
    kept = Kept(tmp_path)
    kept.add_loss(LOSS)
    kept.add_loss(replace(LOSS, how="unplug", detection_s=None, wrong=["nobody noticed"]))
    monkeypatch.undo()
    assert Kept(tmp_path).lost("RTDE") == 0
    kept.add_loss(LOSS)
    assert [row["of"] for row in kept.losses()] == ["before", keeping.of_case("RTDE")]
    assert "| RTDE | unplugged | 1 | 1 never |" in text(kept)
    assert "**1 wrong: nobody noticed**" in text(kept)
    kept.add_loss(replace(LOSS, detection_s=0.2, force_off_s=0.04))
    [row] = Kept(tmp_path).losses()
    assert row["hangs"] == [[1.01, 0.02], [0.2, 0.04]]
    assert Kept(tmp_path).lost("RTDE") == 2
    assert "never" not in text(kept)


def test_all_work_is_done_side_by_side_and_none_is_begun_after_its_time() -> None:
    work = [lambda: 1, lambda: 0, lambda: 1]
    assert result_files.side_by_side(work, 2, math.inf) == 2
    assert result_files.side_by_side(work, 2, time.monotonic()) == 0


def test_a_sitting_of_no_time_measures_nothing_and_says_what_is_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = PAGE.read_text()
    monkeypatch.setattr("sys.argv", ["faults", "--minutes", "0"])
    assert main() == 0
    assert f"{len(Kept().left(new=True))} cases were never measured" in capsys.readouterr().out
    assert PAGE.read_text() == before


def test_the_page_is_written_of_what_is_kept() -> None:
    assert result_files.written(PAGE, BEGIN, END) == text(Kept())
