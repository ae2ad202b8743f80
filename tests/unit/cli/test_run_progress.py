"""What a person reads on the terminal while a job runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.cli.run import progress


def test_a_start_that_waits_says_for_what(capsys: pytest.CaptureFixture[str]) -> None:
    with progress([("left", Path("cell.toml"))]) as (show,):
        show("state_changed", None, {"state": "starting", "reason": ""})
        show("state_changed", None, {"state": "starting", "reason": "robot still serves its last client"})
        show("state_changed", None, {"state": "polishing", "reason": ""})
    said = [line for line in capsys.readouterr().err.splitlines() if "robot" in line]
    assert said == ["left: starting: robot still serves its last client"]
