"""The simulated interferometer and its folder, and the effect of faults on the wires."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from polishd.sim_backends.common import framing as f
from polishd.sim_backends.common import metropro
from tests.system.sim_rig import SMALL, Cell, RobotClient, announced, cell, wait_for
from tests.time_limits import SOON_S

pytestmark = pytest.mark.system


def ask(running: Cell) -> None:
    (running.maps / "measure.request").write_text("{}")


def dats(running: Cell) -> list[Path]:
    return sorted(running.maps.glob("*.dat"), key=lambda path: path.name.split("-")[1:])


@pytest.mark.full
def test_it_waits_until_the_tool_is_away(tmp_path: Path) -> None:
    with cell(tmp_path) as running:
        coil = running.coil()
        coil.write(0, 1)
        ask(running)
        wait_for(lambda: "map_requested" in running.events(), "the request to be taken")
        for _ in range(20):
            coil.write(3, 1)
        assert "measured" not in running.events()
        coil.write(0, 0)
        wait_for(lambda: dats(running), "a map")
        order = wait_for(
            lambda: len(events := running.events("retracted", "measured", "map_dropped")) == 3 and events, "log"
        )
        assert order == ["retracted", "measured", "map_dropped"]
        coil.close()


@pytest.mark.full
def test_a_part_from_a_measured_map(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    height = rng.normal(0.0, 20.0, (60, 70))
    height[20:24, 30:33] = np.nan
    source = tmp_path / "start.dat"
    source.write_bytes(metropro.pack(metropro.DatMap(height, 0.4)))
    with cell(tmp_path, SMALL, "--surface", str(source)) as running:
        ask(running)
        (path,) = wait_for(lambda: dats(running), "a map")
        seen = metropro.read(path)
        assert np.array_equal(np.isnan(seen.height_nm), np.isnan(height))
        assert seen.pitch_mm == pytest.approx(0.4)
        difference = seen.height_nm - height
        assert np.nanstd(difference) == pytest.approx(0.3, rel=0.1)


@pytest.mark.full
def test_a_nasty_instrument(tmp_path: Path) -> None:
    faults = "[interferometer]\nwrite_s = 0.3\ntemporary_suffix = ''\n[interferometer.faults]\n"
    faults += "preallocate = true\nduplicate_first = true\nwrong_part_first = true\n"
    with cell(tmp_path, SMALL + faults) as running:
        ask(running)
        first = wait_for(lambda: dats(running), "a file")[0]
        size = wait_for(lambda: first.stat().st_size, "its full length")
        wait_for(lambda: "map_dropped" in running.events(), "the map")
        assert first.stat().st_size == size
        assert [metropro.read(path).part for path in dats(running)] == ["OTHER-7", "DEMO-100"]
        ask(running)
        wait_for(lambda: running.events("map_dropped") == ["map_dropped"] * 2, "the second map")
        contents = [path.read_bytes() for path in dats(running)]
        assert len(contents) == 5
        assert contents[3] == contents[1]
        assert len(set(contents)) == 4


@pytest.mark.full
def test_faults_of_a_cell_that_runs_are_those_that_its_file_says_now(tmp_path: Path) -> None:
    with cell(tmp_path) as running:
        robot = running.robot()
        robot.until(lambda: robot.status.get("boot_id"), "its status", ping=False)
        quiet = running.toml.read_text()
        os.kill(running.pids["robot"], signal.SIGURG)
        robot.until(lambda: robot.closed, "the cut", ping=False)
        robot = running.robot()
        faults = '[[fault]]\ndevice = "robot"\nwhat = "unplug"\nevery_s = 0.1\n'
        faults += "[interferometer.faults]\nwrong_part_first = true\n"
        running.toml.write_text(quiet + faults)
        for device in ("robot", "interferometer"):
            os.kill(running.pids[device], signal.SIGHUP)
        robot.until(lambda: robot.closed, "the cut", ping=False)
        ask(running)
        wait_for(lambda: "map_dropped" in running.events(), "the map")
        assert [metropro.read(path).part for path in dats(running)] == ["OTHER-7", "DEMO-100"]
        running.toml.write_text(quiet)
        os.kill(running.pids["robot"], signal.SIGHUP)
        wait_for(lambda: running.events("button").count("button") == 4, "the fourth press of a button")
        again = running.robot()
        cuts = running.events("wire_cut").count("wire_cut")
        for _ in range(20):  # four times as long as it took
            again.pump()
        assert not again.closed
        assert running.events("wire_cut").count("wire_cut") == cuts


@pytest.mark.full
def test_an_unreadable_surface_starts_nothing(tmp_path: Path) -> None:
    import subprocess
    import sys

    bad = tmp_path / "bad.dat"
    bad.write_bytes(b"nonsense")
    (tmp_path / "sim.toml").write_text(SMALL)
    run = [sys.executable, "-m", "polishd.sim_backends", str(tmp_path / "sim.toml"), "--surface", str(bad)]
    done = subprocess.run(run, capture_output=True, text=True, check=False, timeout=SOON_S)
    assert done.returncode == 8
    assert "bad.dat" in done.stderr


@pytest.mark.full
def test_blocks_arrive_once_and_in_order_through_a_bad_line(tmp_path: Path) -> None:
    """Damage, loss and disconnects on the robot's side; the writer requests the status and sends again from there."""
    robot = '\n[[fault]]\ndevice = "robot"\n'
    faults = f'{robot}what = "garble"\nrate = 0.02\n{robot}what = "drop"\nrate = 0.02\n'
    faults += f'{robot}what = "unplug"\nevery_s = 0.3\n'
    lines = [b"G21 G90 G94", b"G0 X0 Y0 Z30 A15 C0", *[f"G1 X{k / 100:.2f} F3000".encode() for k in range(1, 1500)]]
    with cell(tmp_path, SMALL + faults, "--speed", "20") as running:
        robot = running.robot()
        robot.say(f.LOAD, announced(lines))
        done: list[tuple[int, float, float]] = []
        reconnects = 0

        def finished() -> bool:
            nonlocal robot, reconnects
            try:
                robot.pump()
                robot.say(f.PING, {})
                state = robot.status.get("state")
                accepted = robot.status.get("accepted", 0)
                if state and robot.status["program_sha256"] and accepted < len(lines):
                    robot.socket.sendall(f.pack_blocks(accepted, lines[accepted : accepted + 200]))
                if state == "held" and accepted > 1000:
                    robot.say(f.RESUME, {"until": None, "stops": robot.status["stops"]})
                if state == "idle":
                    robot.say(f.LOAD, announced(lines))
            except OSError:
                robot.closed = True
            expected = len(done)
            for block in robot.executed:
                if block[0] == expected:
                    done.append(block)
                    expected += 1
            robot.executed.clear()
            if robot.closed:
                robot.close()
                robot = running.robot(executed_from=len(done), lease=robot.lease)
                reconnects += 1
            return len(done) == len(lines)

        try:
            wait_for(finished, "the whole program")
        finally:
            robot.close()
        assert reconnects >= 1
        assert [seq for seq, _, _ in done] == list(range(len(lines)))
        running.end()
        assert set(running.events("program_loaded")) == {"program_loaded"}


@pytest.mark.full
def test_a_device_may_lose_power_by_itself(tmp_path: Path) -> None:
    with cell(tmp_path, SMALL + '[[fault]]\ndevice = "robot"\nwhat = "reboot"\nat_s = 3.0\n') as running:
        robot = running.robot()
        first = robot.until(lambda: robot.status.get("boot_id"), "a boot id", ping=False)
        robot.until(lambda: robot.closed, "the power cut", ping=False)
        wait_for(lambda: running.events("boot", "reboot", "lost").count("boot") == 6, "the boot in the log")
        again = wait_for(lambda: connected(running), "its port")
        assert again.until(lambda: again.status.get("boot_id"), "a boot id") != first
        assert running.pids["robot"] in children_of(running.pids["supervisor"])


def connected(running: Cell) -> RobotClient | None:
    """Wait until the robot listens again and return a connection."""
    try:
        return running.robot()
    except ConnectionError:
        return None


def children_of(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
