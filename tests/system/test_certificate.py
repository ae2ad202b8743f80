"""The certificate of a part that a simulated cell polished, and of one whose pass was cut off."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.socket import client
from tests.system.cell_rig import Daemon, small_cell, summary
from tests.time_limits import SOON_S

pytestmark = pytest.mark.system


def polishd(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "polishd.cli.app", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, check=False)


def certified(run: Path, out: Path) -> dict[str, Any]:
    """Check that PDF and JSON twin are unchanged since they were issued, and return the twin."""
    made = polishd("certificate", "make", run, "--out", out)
    assert made.returncode == 0, made.stderr
    verified = polishd("certificate", "verify", out)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    twin: dict[str, Any] = json.loads(out.with_suffix(".json").read_text())
    return twin


@pytest.mark.full
def test_a_polished_part_is_certified_by_what_the_daemon_left(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=3, speed=40.0) as files, Daemon(files) as daemon:
        assert daemon.wait() == 0, daemon.output.read_text()
    twin, end = certified(files.cell, tmp_path / "c.pdf"), summary(files)
    assert twin["verdict"]["state"] == "in tolerance"
    assert twin["left_out"] == [], "all figures come out as the daemon had them"
    assert [one["rms_nm"] for one in twin["measurements"]] == [cycle["rms_nm"] for cycle in end["cycles"]]
    assert twin["after"]["rms_nm"] == end["cycles"][-1]["rms_nm"]
    assert 0 < twin["beyond_reach"]["after_nm"] < twin["after"]["rms_nm"]
    assert all(one["did"]["how"] == "done" and 11.0 < one["did"]["force_n"] < 13.0 for one in twin["passes"])
    assert twin["anomalies"] == []


@pytest.mark.full
def test_the_certificate_of_an_interrupted_pass_states_what_was_done(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=2) as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            assert daemon.end() == 1
        interim = certified(files.run_dir, tmp_path / "interim.pdf")
        assert (interim["verdict"]["state"], interim["verdict"]["final"]) == ("not known", False)
        with Daemon(files) as daemon:
            daemon.wait_for_state("held")
            assert client.request(files.state_dir, "resume")["state"] == "polishing"
            assert daemon.wait() == 0, daemon.output.read_text()
    twin = certified(files.run_dir, tmp_path / "c.pdf")
    torn, *whole = twin["passes"]
    assert (torn["number"], torn["did"]["how"]) == (None, "interrupted")
    assert 0 < torn["did"]["share"] < 1
    assert [one["number"] for one in whole] == list(range(1, len(whole) + 1))
    held, cut = twin["anomalies"]
    assert held["kind"] == "hold"
    assert "resume was ordered" in held["done"]
    assert cut["kind"] == "pass interrupted"
    assert "no block of it was repeated" in cut["done"]
