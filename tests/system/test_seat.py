"""The seat of a part on a simulated cell: checked before contact, and nothing is polished where it is wrong."""

from __future__ import annotations

import contextlib
import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from polishd.daemon.socket import client
from tests.system.agreement import require_agreement
from tests.system.cell_rig import ONE_PASS, Daemon, account, events, summary, with_keys, write_small
from tests.system.sim_rig import wait_for

pytestmark = pytest.mark.system


@contextlib.contextmanager
def seated(out: Path, speed: float = 20.0, **seat: Any) -> Iterator[DemoFiles]:
    """Run a small cell that checks its part's seat, with the true seat of the simulated part."""
    files = write_small(out, touch_off=True, **ONE_PASS)
    files.sim.write_text(with_keys(files.sim.read_text(), {"plant": seat}))
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


def require_only_touched(files: DemoFiles) -> dict[str, Any]:
    """Require from the plant's record: no contact in motion, with spin or above 1 N; nothing removed. Return it."""
    record = account(files)
    assert not any(any(program["contact_s"]) for program in record["programs"])
    assert all(stand["most_n"] <= 1.0 and stand["most_rpm"] == 0.0 for stand in record["stands"]), record["stands"]
    assert not events(files, "spindle_ramping", "spindle_at_speed")
    assert record["rms_nm"] == pytest.approx(events(files, "boot")[0]["true_rms_nm"], abs=1e-9)
    return record


@pytest.mark.full
@pytest.mark.parametrize(
    ("seat", "places", "said"),
    [
        ({"seat_height_mm": 0.5}, 3, "0.500 mm too high"),
        ({"seat_height_mm": -0.2, "seat_tilt_deg": [0.6, 0.0]}, 3, "0.200 mm too low, tilted by +0."),
        ({"seat_height_mm": -0.5}, 1, "no part was found at x 0.0, y 13.5 mm"),
        ({"part_missing": True}, 1, "no part was found"),
    ],
)
def test_a_part_that_does_not_sit_right_is_not_polished(
    tmp_path: Path, seat: dict[str, Any], places: int, said: str
) -> None:
    with seated(tmp_path / "cell", **seat) as files:
        with Daemon(files, "--no-hold") as daemon:
            assert daemon.wait() == 11, daemon.output.read_text()
        wait_for((files.sim_dir / "dwell_account.json").exists, "the account")
        assert len(events(files, "engage")) == places
    record = require_only_touched(files)
    assert len(record["stands"]) == places or "no part" in said, "a part that is too low may be touched, or not"
    end = summary(files)
    assert (end["outcome"], end["tool_off"], end["robot_at_rest"]) == ("failed", "yes", "yes")
    (cause,) = end["causes"]
    assert cause["kind"] == "WrongSeat"
    assert said in cause["error"]
    assert end["cycles"][0]["how"] is None, "no pass was begun"


@pytest.mark.full
def test_a_part_that_is_seated_anew_is_polished(tmp_path: Path) -> None:
    """The operator gets a notification, reseats the part and resumes: it is measured, checked and polished."""
    with seated(tmp_path / "cell", seat_height_mm=0.2) as files:
        cell = files.cell.read_text()
        files.cell.write_text(with_keys(cell, {"touch_off": {"max_offset_mm": 0.1}}))
        with Daemon(files) as daemon:
            held = daemon.wait_for_state("held")
            assert "0.200 mm too high" in held["reason"]
            assert held["phase"] == "touch_off"
            require_only_touched(files)
            assert daemon.end() == 11
        files.cell.write_text(cell)  # the limit is what this person mends
        with Daemon(files) as daemon:
            daemon.wait_for_state("held")
            client.request(files.state_dir, "resume")
            assert daemon.wait() == 0, daemon.output.read_text()
        engaged = events(files, "engage")
        require_agreement(files)
    kept = json.loads((files.run_dir / "cycle-00/touch_off.json").read_text())
    assert kept["seat"]["height_mm"] == pytest.approx(0.2, abs=0.005)
    end = summary(files)
    assert end["outcome"] == "in_tolerance"
    assert end["phase_times_s"]["touch_off"] > 1.0
    passes = [cycle for cycle in end["cycles"] if cycle["how"] == "done"]
    assert len(engaged) == 3 + 3 + len(passes), "proved again after the restart, and once for all passes from there on"


@pytest.mark.full
@pytest.mark.parametrize("order", ["hold", "estop", "kill", "term"])
def test_every_way_out_of_a_touch_off_lifts_the_tool(tmp_path: Path, order: str) -> None:
    with seated(tmp_path / "cell", speed=2.0) as files, Daemon(files) as daemon:
        wait_for(lambda: events(files, "force_on"), "the tool to touch")
        if order == "kill":
            daemon.process.send_signal(signal.SIGKILL)
        elif order == "term":
            assert daemon.end() == 1
        else:
            client.request(files.state_dir, order)
        wait_for(lambda: events(files, "retracted"), "the lift")
        log = [event["event"] for event in events(files)]
        assert "spindle_ramping" not in log
        assert log.index("force_zero") < log.index("tool_lifted")


@pytest.mark.full
def test_a_part_that_is_warm_of_its_pass_is_measured_until_it_has_settled(tmp_path: Path) -> None:
    files = write_small(tmp_path / "cell", **ONE_PASS)
    cell = with_keys(files.cell.read_text(), {"part_handling": {"settle.wait_s": 0.5, "settle.max_maps": 100}})
    files.cell.write_text(cell)
    files.profile.write_text(with_keys(files.profile.read_text(), {"repeatability": {"rms_nm": 0.3}}))
    files.sim.write_text(with_keys(files.sim.read_text(), {"hidden_truth": {"thermal_nm": 20.0, "thermal_s": 40.0}}))
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", "20"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"), Daemon(files) as daemon:
        assert daemon.wait() == 0, daemon.output.read_text()
        measured = events(files, "measured")
    end = summary(files)
    assert end["cycles"][-1]["rms_nm"] == pytest.approx(measured[-1]["true_rms_nm"], abs=0.5)
    kept = json.loads((files.run_dir / f"cycle-{len(end['cycles']) - 1:02d}/settling.json").read_text())
    assert kept["settled"]
    assert kept["change_nm"][-1] <= kept["limit_nm"] < kept["change_nm"][0]
    assert len(measured) > 2 * len(end["cycles"]), "after the pass two maps were not enough"
    assert end["phase_times_s"]["settle"] > 1.0
