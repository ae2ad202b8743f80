"""The daemon against the simulated cell: cycles, commands, and every way to leave contact."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import (
    DemoFiles,
    measure_artefact,
    simulated_cell,
    with_values,
    write_demo,
)
from polishd.config.cell import load_config
from polishd.daemon.socket import client
from polishd.daemon.socket.client import SOCKET_NAME
from tests.system.agreement import require_agreement
from tests.system.cell_rig import ONE_PASS, Daemon, account, events, small_cell, summary, with_keys, write_small
from tests.system.sim_rig import wait_for
from tests.time_limits import SOON_S

pytestmark = pytest.mark.system


def polishd(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "polishd.cli.app", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, check=False)


def require_nothing_twice(files: DemoFiles) -> None:
    """Require that each program was loaded once and each block was in contact as the journal records."""
    programs = account(files)["programs"]
    assert len({program["sha256"] for program in programs}) == len(programs)
    assert all(program["loads"] == 1 for program in programs)
    require_agreement(files)


def require_safe_order(log: list[dict[str, Any]]) -> None:
    """Require the safe order when contact was last left: force off, tool lifted, and then motion stopped."""
    last = {event["event"]: k for k, event in enumerate(log)}
    assert last["force_zero"] < last["tool_lifted"] < last["motion_stopped"], log[-12:]


def test_a_whole_job_is_polished_and_left_for_people_to_see(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=3, speed=40.0, report=True) as files:
        with Daemon(files) as daemon:
            assert daemon.wait() == 0, daemon.output.read_text()
        require_nothing_twice(files)
        measured = events(files, "measured")
    end = summary(files)
    assert end["outcome"] == "in_tolerance"
    first, *_, last = end["cycles"]
    assert first["rms_nm"] > 10.0
    assert last["rms_nm"] <= 2.0
    assert last["predicted_rms_nm"] is last["dwell_s"] is last["executed_s"] is None
    assert first["executed_s"] == pytest.approx(first["dwell_s"], rel=0.2)
    assert measured[-1]["true_rms_nm"] == pytest.approx(last["rms_nm"], abs=0.2), "the map shows what the plant has"
    run = files.run_dir
    for name in ("report.html", "journal.sqlite", "cycle-00/map.dat", "cycle-00/program.rnc", "cycle-00/dwell.csv"):
        assert (run / name).stat().st_size > 0
    certificate = json.loads((run / "cycle-00/certificate.json").read_text())
    assert certificate["kkt_residual"] <= 1e-4
    assert 0.0 <= certificate["gap"] <= 1e-4, "it proves itself, and no other solver is asked"
    assert certificate["cross_check"] is None
    page = re.sub(r"base64,[\w+/=]+", "", (run / "report.html").read_text())  # four letters come up in pictures, too
    assert "http" not in page.replace("http://www.w3.org", "")


@pytest.mark.full
def test_what_was_learned_predicts_the_time_that_is_delivered(tmp_path: Path) -> None:
    """Acceleration and overhead are unknown: after one pass the total is predicted to 1 %, each block to 5 ms."""
    cell = small_cell(tmp_path / "cell", seed=5, speed=40.0, tolerance_nm=0.01, max_cycles=2)
    with cell as files, Daemon(files) as daemon:
        assert daemon.wait() == 1, daemon.output.read_text()
    expected, executed = [], []
    for cycle in (0, 1):
        folder = files.run_dir / f"cycle-{cycle:02d}"
        with np.load(folder / "plan.npz") as plan:
            expected.append(plan["expected_s"])
        rows = np.genfromtxt(folder / "executed.csv", delimiter=",", names=True)
        executed.append(rows["end_s"] - rows["start_s"])
    assert abs(executed[0].sum() / expected[0].sum() - 1) > 0.02, "the first pass cannot know the overhead"
    assert executed[1].sum() == pytest.approx(expected[1].sum(), rel=0.01)
    assert np.sqrt(np.mean((executed[1] - expected[1]) ** 2)) < 5e-3


@pytest.mark.full
def test_sigterm_in_contact_lifts_before_motion_stops_and_resume_measures_first(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=2) as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            assert daemon.end() == 1
        require_safe_order(events(files))
        before = len(events(files))
        with Daemon(files) as daemon:
            held = daemon.wait_for_state("held")
            assert "interrupted" in held["reason"]
            assert "uncertain" in held["reason"]
            assert not [e for e in events(files)[before:] if e["event"] in ("motion_started", "force_on")]
            maps = len(events(files, "map_dropped"))
            assert client.request(files.state_dir, "resume")["state"] == "polishing"
            moved = wait_for(lambda: [e for e in events(files)[before:] if e["event"] == "motion_started"], "motion")
            measured = [e for e in events(files, "map_dropped")[maps:] if e["mono_s"] < moved[0]["mono_s"]]
            assert measured, "a new measurement comes before motion"
            assert daemon.wait() == 0, daemon.output.read_text()
        require_nothing_twice(files)
    assert summary(files)["outcome"] == "in_tolerance"


@contextlib.contextmanager
def quick_watchdogs_cell(out: Path) -> Iterator[DemoFiles]:
    """The robot's watchdog stops motion before a pass is over, and after the actuator's has lifted the tool."""
    files = write_small(out, **ONE_PASS)
    robot = {"robot": {"silence_s": 2.0, "watchdog_s": 5.0}}
    actuator = {"actuator": {"silence_s": 1.0, "watchdog_ms": 2000, "retract_s": 2.0}}
    files.cell.write_text(with_keys(files.cell.read_text(), {**robot, **actuator}))
    options = ["--state", str(files.sim_dir), "--seed", "4", "--speed", "10"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


@pytest.mark.full
def test_kill_9_leaves_the_tool_lifted_by_watchdogs_and_comes_up_held(tmp_path: Path) -> None:
    with quick_watchdogs_cell(tmp_path / "cell") as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact(20)
            daemon.end(signal.SIGKILL)
        wait_for(lambda: {"watchdog"} & {e.get("detail") for e in events(files, "motion_stopped")}, "robot's watchdog")
        wait_for(lambda: {"spindle"} & {e["device"] for e in events(files, "watchdog")}, "spindle's watchdog")
        require_safe_order(events(files))
        status = polishd("status", files.cell, "--json")
        answer = json.loads(status.stdout)
        assert (status.returncode, answer["state"], answer["tool_off"]) == (5, "killed", "not confirmed")
        assert "while polishing" in answer["reason"]
        with Daemon(files) as daemon:
            assert "uncertain" in daemon.wait_for_state("held")["reason"]
            assert client.request(files.state_dir, "resume")["ok"]
            assert daemon.wait() == 0, daemon.output.read_text()
        require_nothing_twice(files)


@pytest.mark.full
def test_a_job_goes_on_with_what_it_was_begun_with_and_needs_no_run_folder(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=2, report=True) as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            assert daemon.end() == 1
        config = load_config(files.cell)
        cell, program = files.cell.read_text(), config.program_path.read_bytes()
        files.cell.write_text(with_values(cell, {"part": {"edge_mm": config.part.edge_mm + 1}}))
        config.program_path.write_bytes(program.replace(b"M2", b"(another one)\nM2"))
        refused = polishd("run", files.cell)
        assert refused.returncode == 3
        said = refused.stderr.replace("\n", " ")
        assert f"part.edge_mm: is {config.part.edge_mm + 1}, the job 'demo' began with {config.part.edge_mm}" in said
        assert "program.path: is program.rnc (sha256 " in said
        assert "Restore them, or set a new job.id" in said
        files.cell.write_text(cell)
        config.program_path.write_bytes(program)
        shutil.rmtree(files.run_dir)
        with Daemon(files) as daemon:
            assert "interrupted" in daemon.wait_for_state("held")["reason"]
            assert client.request(files.state_dir, "resume")["ok"]
            assert daemon.wait() == 0, daemon.output.read_text()
        require_nothing_twice(files)
    assert summary(files)["outcome"] == "in_tolerance"
    assert (files.run_dir / "cycle-00" / "surface.npz").stat().st_size > 0, "made anew"
    assert (files.run_dir / "report.html").stat().st_size > 0


@pytest.mark.full
def test_a_late_map_holds_until_it_comes(tmp_path: Path) -> None:
    """The instrument is silent for longer than the map's time limit; the operator restarts it and resumes."""
    files = write_small(tmp_path / "cell", **ONE_PASS)
    files.cell.write_text(with_values(files.cell.read_text(), {"metrology": {"timeout_s": 8.0}}))
    options = ["--state", str(files.sim_dir), "--seed", "3", "--speed", "80"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        instrument = json.loads((files.sim_dir / "pids.json").read_text())["interferometer"]
        os.kill(instrument, signal.SIGSTOP)
        try:
            with Daemon(files) as daemon:
                held = daemon.wait_for_state("held")
                assert "no map of part" in held["reason"]
                assert "polishd resume CELL.toml" in held["next"]
                assert not events(files, "motion_started", "force_on")
                os.kill(instrument, signal.SIGCONT)
                assert polishd("resume", files.cell).returncode == 0
                assert daemon.wait() == 0, daemon.output.read_text()
        finally:
            os.kill(instrument, signal.SIGCONT)
    end = summary(files)
    assert (end["outcome"], end["tool_off"], end["robot_at_rest"]) == ("in_tolerance", "yes", "yes")
    assert [(cause["kind"], cause["ended"]) for cause in end["causes"]] == [("SurfaceError", False)]


@pytest.mark.full
def test_a_late_map_without_an_operator_ends_with_its_own_code(tmp_path: Path) -> None:
    files = write_small(tmp_path / "cell")
    files.cell.write_text(with_values(files.cell.read_text(), {"metrology": {"timeout_s": 1.0}}))
    options = ["--state", str(files.sim_dir), "--seed", "3", "--speed", "40"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        os.kill(json.loads((files.sim_dir / "pids.json").read_text())["interferometer"], signal.SIGSTOP)
        said = polishd("run", files.cell, "--no-hold")
    assert said.returncode == 8
    words = said.stderr.splitlines()[-5:]
    assert "ended: SurfaceError" in words[0]
    assert "resume" not in words[0]
    assert words[1:4] == ["tool off the part: yes", "robot at rest: yes", f"run folder: {files.run_dir}"]
    assert f"correct the cause, then: polishd run {files.cell} " in words[4]


@pytest.mark.full
def test_orders_over_the_socket(tmp_path: Path) -> None:
    # so slow that the pass is not over before the orders come
    with small_cell(tmp_path / "cell", seed=5, speed=2.0) as files, Daemon(files) as daemon:
        daemon.wait_in_contact(20)
        assert polishd("hold", files.cell).returncode == 0
        assert stat.S_IMODE((files.state_dir / SOCKET_NAME).stat().st_mode) == 0o600
        second = polishd("run", files.cell)
        assert second.returncode == 3
        assert "another polishd runs this cell" in second.stderr
        require_safe_order(events(files))
        status = json.loads(polishd("status", files.cell, "--json").stdout)
        assert status["state"] == "held"
        assert status["cycles"][0]["rms_nm"] > 10.0
        uncertain = ", ".join(f"{first} to {last}" for first, last in status["cycles"][0]["uncertain"])
        assert f"uncertain: blocks {uncertain}." in status["reason"]
        require_nothing_twice(files)
        assert polishd("resume", files.cell).returncode == 0
        assert polishd("stop", files.cell).returncode == 0
        assert daemon.wait() == 1


@pytest.mark.full
@pytest.mark.parametrize("device", ["robot", "actuator", "spindle"])
def test_a_device_that_dies_in_contact_ends_the_pass_safely(tmp_path: Path, device: str) -> None:
    with small_cell(tmp_path / "cell", seed=6) as files, Daemon(files) as daemon:
        daemon.wait_in_contact(60)
        pids = json.loads((files.sim_dir / "pids.json").read_text())
        signal_number = signal.SIGSTOP if device != "robot" else signal.SIGKILL
        subprocess.run(["kill", f"-{int(signal_number)}", str(pids[device])], check=True)
        try:
            code = daemon.wait()
        finally:
            subprocess.run(["kill", "-CONT", str(pids[device])], check=False)
        assert code in (5, 7), daemon.output.read_text()
        wait_for(lambda: events(files, "tool_landed", "tool_lifted")[-1]["event"] == "tool_lifted", "the tool lifted")


@pytest.mark.full
def test_a_device_that_is_not_there_is_named(tmp_path: Path) -> None:
    files = write_small(tmp_path / "cell")
    answer = polishd("run", files.cell)
    assert answer.returncode == 5
    assert "actuator" in answer.stderr
    assert "tool off the part: not asked" in answer.stderr
    assert "correct the cause, then: polishd run" in answer.stderr.splitlines()[-1]
    assert not files.run_dir.joinpath("cycle-00").exists()


@pytest.mark.full
def test_an_instrument_that_was_turned_over_is_stopped_by_the_gate_with_a_picture(tmp_path: Path) -> None:
    """The instrument was turned over after its profile was commissioned. The first pass shows it."""
    files = write_small(tmp_path / "cell", report=True)
    files.sim.write_text(with_values(files.sim.read_text(), {"interferometer.faults": {"mirror": True}}))
    options = ["--state", str(files.sim_dir), "--seed", "3", "--speed", "40"]
    with simulated_cell(files.sim, options, tmp_path / "log"):
        with Daemon(files) as daemon:
            held = daemon.wait_for_state("held")
            assert "RemovalCheckStop: the measured removal looks like" in held["reason"]
            assert polishd("stop", files.cell).returncode == 0
            assert daemon.wait() == 10, daemon.output.read_text()
        require_safe_order(events(files))
    assert len(events(files, "map_dropped")) == 2, "one pass, and no more"
    picture = files.run_dir / "cycle-01" / "gate.png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert str(picture) in daemon.output.read_text().replace("\n", "")
    assert json.loads((picture.parent / "gate.json").read_text())["best"]["name"] == "flipped left-right"
    assert summary(files)["outcome"] == "failed"


@pytest.mark.full
@pytest.mark.parametrize(
    ("fault", "mends"),
    [
        ({"mirror": True}, "mirror = true"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ({"rotation_deg": 90}, "rotation_deg = 270"),
                ({"factor": 2.0}, "factor = 0.5"),
                ({"sign": -1}, "sign = -1"),
            )
        ),
    ],
)
def test_a_wrong_profile_is_not_commissioned_and_does_not_run(
    tmp_path: Path, fault: dict[str, Any], mends: str
) -> None:
    files = write_demo(tmp_path / "cell", None, 2.0, 4, None)
    files.sim.write_text(with_values(files.sim.read_text(), {"interferometer.faults": fault}))
    before = files.profile.read_bytes()
    measure_artefact(files.sim, files.artefact)
    said = polishd("map", "commission", files.profile, files.artefact)
    assert (said.returncode, files.profile.read_bytes()) == (8, before)
    assert mends in said.stderr.replace("\n", " ")
    for queue in ((), ("--queue", "--until-empty")):
        refused = polishd("run", files.cell, *queue)
        assert refused.returncode == 3
        assert "never commissioned" in refused.stderr
        assert not files.state_dir.exists(), "nothing was opened"
