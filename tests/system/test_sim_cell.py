"""The simulated cell as processes: start, wires, one whole pass in contact, and its end."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from polishd.config.simulator import load_simulator
from polishd.sim_backends.common import framing as f
from polishd.sim_backends.common import metropro
from polishd.sim_backends.common.framing import body, line
from tests.system.sim_rig import ROOT, SMALL, Cell, alive, cell, end_pid, wait_for
from tests.time_limits import SOON_S
from tests.unit.sim_backends.vectors import vectors

pytestmark = pytest.mark.system

DEVICES = {"supervisor", "plant", "robot", "actuator", "spindle", "interferometer"}
RASTER = [b"G21 G90 G94", b"G0 X-10 Y0 Z5 A15 C0", b"G1 Z0 F600"]
RASTER += [f"G1 X{x} F{600 + 60 * (x % 4)}".encode() for x in range(-9, 11)] + [b"G0 Z30", b"M2"]
TOUCH, LEAVE = 3, len(RASTER) - 2


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """Run one cell for all tests that do not change it."""
    with cell(tmp_path_factory.mktemp("cell"), SMALL, "--seed", "5", "--speed", "20") as running:
        yield running


@pytest.mark.full
def test_the_shipped_example_is_valid() -> None:
    assert load_simulator(ROOT / "examples" / "sim.toml").plant.part_id == "DEMO-100"


@pytest.mark.full
def test_ready_means_that_everything_is_there(shared: Cell) -> None:
    assert set(shared.pids) == DEVICES
    assert all(alive(pid) for pid in shared.pids.values())
    assert json.loads((shared.state / "endpoints.json").read_text()) == shared.endpoints
    assert shared.endpoints["actuator"] == f"serial:{shared.state}/actuator?baud=115200"
    assert (shared.state / "actuator").is_symlink()
    assert (shared.state / "spindle").is_symlink()
    assert shared.maps.is_dir()
    assert shared.endpoints["robot"].startswith("tcp://127.0.0.1:")


@pytest.mark.full
def test_the_actuator_answers_the_documented_vectors(shared: Cell) -> None:
    expected = {name: bytes.fromhex(value) for name, value in vectors("voice_coil_modbus").items()}
    coil = shared.coil()
    try:
        coil.line.write(expected["write_setpoint"])
        assert coil.line.read(8) == expected["write_setpoint"]
        assert coil.inputs()[0] == 0
        identity = coil.ask(struct.pack(">BHH", 4, 100, 30), 62)[2:]
        assert identity[:16].rstrip(b"\0") == b"polishd"
        assert struct.unpack(">I", identity[-4:]) == (1,)
    finally:
        coil.close()


@pytest.mark.full
def test_the_line_is_as_slow_as_its_baud_rate(shared: Cell) -> None:
    coil = shared.coil()
    try:
        begin = time.monotonic()
        for _ in range(20):
            coil.ask(struct.pack(">BHH", 4, 100, 30), 62)
        assert time.monotonic() - begin > 20 * (8 + 65) * 10 / 115200
    finally:
        coil.close()


@pytest.mark.full
def test_the_spindle_runs_while_it_is_commanded(shared: Cell) -> None:
    spindle = shared.spindle()
    try:
        spindle.write(0x1017, 100, 2)
        wait_for(lambda: spindle.pump() or spindle.seen.get("705") == "7f", "heartbeat")
        spindle.send("605#4018100400000000")
        wait_for(lambda: spindle.pump() or spindle.seen.get("585") == "43181004b40f0000", "identity")
        spindle.write(0x6007, 3, 2)
        spindle.write(0x1016, 0x45 << 16 | 500, 4, sub=1)

        def is_at_speed() -> bool:
            spindle.spin(1000)  # also after a silence of this test of 0.5 s on a busy machine
            return abs(spindle.rpm() - 1000.0) < 20.0

        wait_for(is_at_speed, "1000 rpm")
        wait_for(lambda: abs(spindle.rpm()) < 1.0, "the drive to notice the silence")
    finally:
        spindle.write(0x1016, 0, 4, sub=1)
        spindle.close()


@pytest.mark.full
def test_a_client_library_talks_to_the_spindle(shared: Cell) -> None:
    can = pytest.importorskip("can")
    bus = can.Bus(interface="slcan", channel=str(shared.state / "spindle"), bitrate=500000, sleep_after_open=0)
    try:
        message = can.Message(arbitration_id=0x605, is_extended_id=False, data=bytes.fromhex("4018100400000000"))
        bus.send(message)

        def answered() -> bool:
            got = bus.recv(0.1)
            return got is not None and got.arbitration_id == 0x585 and got.data.hex() == "43181004b40f0000"

        wait_for(answered, "serial number")
    finally:
        bus.shutdown()


@pytest.mark.full
def test_a_pass_in_contact_is_booked_block_by_block_and_measured(shared: Cell) -> None:
    robot = shared.robot()
    coil = shared.coil()
    spindle = shared.spindle()
    try:
        truth = np.load(shared.state / "truth.npz") if (shared.state / "truth.npz").exists() else None
        assert truth is None
        robot.load(RASTER)
        robot.resume(until=TOUCH)
        robot.until(lambda: robot.status["executed"] == TOUCH, "the approach")

        def is_at_speed() -> bool:
            spindle.spin(1000)
            return abs(spindle.rpm() - 1000.0) < 20.0

        wait_for(is_at_speed, "1000 rpm")
        coil.press(12.0, lambda: (spindle.spin(1000), robot.say(f.PING, {}), robot.pump()))
        robot.resume(until=LEAVE)

        def passed() -> bool:
            coil.write(3, 2)
            spindle.spin(1000)
            return robot.status["detail"] == "until" and robot.status["executed"] == LEAVE

        robot.until(passed, "the pass")
        (shared.maps / "measure.request").write_text("{}")
        coil.write(0, 0)
        robot.until(lambda: coil.inputs()[0] == 0, "lifted")
        robot.resume()
        robot.state("done")
        seen = wait_for(lambda: list(shared.maps.glob("*.dat")), "a map")
        assert not (shared.maps / "measure.request").exists()
    finally:
        robot.close()
        coil.close()
        spindle.close()
    check_account(shared, robot.executed)
    check_map(shared, seen[0])
    check_log(shared)


def check_account(shared: Cell, executed: list[tuple[int, float, float]]) -> None:
    account = shared.account()
    (book,) = account["programs"]
    spans = np.array([end - start for _, start, end in executed])
    contact = np.array(book["contact_s"])
    assert (book["sha256"], book["loads"]) == ("ab" * 32, 1)
    assert np.allclose(contact[TOUCH:LEAVE], spans[TOUCH:LEAVE], atol=1e-6)
    assert not contact[:TOUCH].any()
    assert not contact[LEAVE:].any()
    assert {round(stand["x_mm"]) for stand in account["stands"]} == {-10, 10}


def check_map(shared: Cell, path: Path) -> None:
    data = metropro.read(path)
    truth = np.load(shared.state / "truth.npz")
    pad = int(truth["pad"])
    error = data.height_nm - np.where(truth["valid"], truth["height_nm"][pad:-pad, pad:-pad], np.nan)
    assert np.array_equal(np.isnan(data.height_nm), ~truth["valid"])
    assert np.nanstd(error) == pytest.approx(0.3, rel=0.05)
    assert data.part == "DEMO-100"
    assert data.pitch_mm == pytest.approx(0.5)
    assert abs(data.taken_s - time.time()) < 60
    worn = truth["start_nm"] - truth["height_nm"]
    row, _ = np.unravel_index(np.argmax(worn), worn.shape)
    assert abs(row - worn.shape[0] // 2) <= 2
    # an even trench from end to end: which place of it is the deepest hangs on how long the tool stood at its ends
    trench = np.flatnonzero(worn[row] > worn.max() / 2)
    assert np.array_equal(trench, np.arange(trench[0], trench[-1] + 1))
    for end in (trench[0], trench[-1]):
        assert abs(abs(end - worn.shape[1] // 2) * 0.5 - 10.0) <= 1.5


def check_log(shared: Cell) -> None:
    names = (
        "program_loaded",
        "motion_started",
        "motion_stopped",
        "tool_landed",
        "force_zero",
        "tool_lifted",
        "measured",
    )
    wait_for(lambda: "map_dropped" in shared.events(), "the map in the log")
    assert shared.events(*names) == [
        "program_loaded",
        "motion_started",
        "motion_stopped",
        "tool_landed",
        "motion_started",
        "motion_stopped",
        "force_zero",
        "tool_lifted",
        *shared.events(*names)[8:],
    ]
    stamps = [entry["mono_s"] for entry in shared.log()]
    assert stamps == sorted(stamps)
    process = [entry["process_s"] for entry in shared.log()]
    assert process == sorted(process)


@pytest.mark.full
def test_silence_of_the_writer_holds_the_robot(shared: Cell) -> None:
    robot = shared.robot()
    try:
        robot.load([b"G21 G90", b"G0 Z30", b"G1 X0 F6", b"X10", b"M2"], "cd" * 32)
        robot.resume()
        robot.until(lambda: robot.status["detail"] == "watchdog", "hold", ping=False)
        assert robot.status["state"] == "held"
        robot.say(f.ABORT, {})
        robot.wait(f.ACK)
        assert robot.status["state"] == "idle"
    finally:
        robot.close()


@pytest.mark.full
def test_silence_makes_the_actuator_let_go(shared: Cell) -> None:
    coil = shared.coil()
    try:
        coil.write(2, 200)
        coil.write(0, 1)
        wait_for(lambda: coil.inputs()[4] == 1, "the watchdog bit")
        wait_for(lambda: coil.inputs()[0] == 4, "retracted")
        coil.write(0, 0)
        coil.write(2, 500)
        assert coil.inputs()[0] == 0
    finally:
        coil.close()


@pytest.mark.full
def test_other_protocols(tmp_path: Path) -> None:
    config = SMALL + '[actuator]\nkind = "serial"\n[spindle]\nkind = "socketcand"\n'
    with cell(tmp_path, config) as running:
        coil = running.coil()
        coil.line.write(line("8,ST?"))
        assert body(coil.line.readline().strip()).startswith("8,ST,0,")
        coil.close()
        host, port = running.endpoints["spindle"].removeprefix("socketcand://").split("/")[0].split(":")
        with socket.create_connection((host, int(port)), timeout=SOON_S) as bus:
            assert bus.recv(6) == b"< hi >"
            bus.sendall(b"< open can0 >< rawmode >< send 605 8 2b 17 10 00 64 00 00 00 >")
            bus.sendall(b"< send 605 8 40 18 10 04 00 00 00 00 >")
            got = b""
            while b"43181004" not in got.replace(b" ", b"") or not got.endswith(b">"):
                got += bus.recv(4096)
            assert b"43181004b40f0000" in got.replace(b" ", b"").lower()
            while b"frame 705" not in got:  # the heartbeat, which all clients of the bus receive
                got += bus.recv(4096)
            with socket.create_connection((host, int(port)), timeout=SOON_S) as newcomer:
                received, beats = b"", got.count(b"frame 705")
                while got.count(b"frame 705") < beats + 3:
                    got += bus.recv(4096)
                newcomer.sendall(b"< open can0 >")
                while not received.endswith(b"< ok >"):
                    received += newcomer.recv(4096)
            assert received == b"< hi >< ok >", "a client receives frames only in raw mode"


@pytest.mark.full
def test_modbus_tcp(tmp_path: Path) -> None:
    with cell(tmp_path, SMALL + '[actuator]\nkind = "modbus_tcp"\n') as running:
        host, port = running.endpoints["actuator"].removeprefix("tcp://").split(":")
        with socket.create_connection((host, int(port)), timeout=SOON_S) as line_:
            line_.sendall(struct.pack(">HHHB", 7, 0, 6, 1) + struct.pack(">BHH", 3, 2, 1))
            assert line_.recv(64) == struct.pack(">HHHB", 7, 0, 5, 1) + b"\x03\x02\x01\xf4"


@pytest.mark.full
def test_sigterm_ends_everything_and_leaves_the_account(tmp_path: Path) -> None:
    with cell(tmp_path) as running:
        pids = running.pids
        assert running.end() == 0
        assert not any(alive(pid) for pid in pids.values())
        assert running.account()["programs"] == []
        assert running.events()[-1] == "lost"


@pytest.mark.full
def test_no_process_outlives_a_killed_supervisor(tmp_path: Path) -> None:
    with cell(tmp_path) as running:
        pids = running.pids
        running.process.kill()
        for pid in pids.values():
            wait_for(lambda pid=pid: not alive(pid), f"{pid} to end")


@pytest.mark.full
def test_no_process_outlives_the_parent(tmp_path: Path) -> None:
    (tmp_path / "sim.toml").write_text(SMALL)
    command = [sys.executable, "-m", "polishd.sim_backends", str(tmp_path / "sim.toml")]
    script = f"import subprocess; p = subprocess.Popen({command!r}, stdout=-1); p.stdout.readline()"
    subprocess.run([sys.executable, "-c", script], check=True, cwd=ROOT, timeout=SOON_S)
    pids = json.loads((tmp_path / "sim" / "pids.json").read_text())
    for pid in pids.values():
        wait_for(lambda pid=pid: not alive(pid), f"{pid} to end")


@pytest.mark.full
def test_a_cell_that_cannot_start_says_why(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        (tmp_path / "sim.toml").write_text(f"[robot]\nport = {taken.getsockname()[1]}\n")
        run = [sys.executable, "-m", "polishd.sim_backends", str(tmp_path / "sim.toml")]
        done = subprocess.run(run, capture_output=True, text=True, check=False, cwd=ROOT, timeout=SOON_S)
    assert done.returncode == 1
    assert "READY" not in done.stdout
    assert "in use" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "sim" / "endpoints.json").exists()


@pytest.mark.full
def test_a_second_start_leaves_the_running_cell_alone(tmp_path: Path) -> None:
    with cell(tmp_path) as running:
        before = {path.name: path.lstat().st_ino for path in running.state.iterdir() if path.is_symlink()}
        run = [sys.executable, "-m", "polishd.sim_backends", str(running.toml)]
        done = subprocess.run(run, capture_output=True, text=True, check=False, cwd=ROOT, timeout=SOON_S)
        assert done.returncode == 3
        assert f"{running.state}: a simulated cell already runs in this folder" in done.stderr
        assert before == {path.name: path.lstat().st_ino for path in running.state.iterdir() if path.is_symlink()}
        assert len(running.events("boot")) == len(running.pids) - 1
        assert (running.state / "endpoints.json").exists()


@pytest.mark.full
def test_a_rebooted_robot_has_a_new_boot_id_the_old_port_and_the_old_place(tmp_path: Path) -> None:
    with cell(tmp_path) as running:
        robot = running.robot()
        robot.load([b"G21 G90", b"G0 X5 Y-3 Z30 A15 C40", b"M2"])
        robot.resume()
        robot.state("done")
        first = robot.status["boot_id"]
        end_pid(running.pids["robot"])
        robot.until(lambda: robot.closed, "the connection to break", ping=False)
        robot.close()
        running.boot("robot")
        robot = running.robot()
        robot.wait(f.WELCOME)
        assert robot.status["state"] == "idle"
        assert robot.status["boot_id"] != first
        robot.load([b"G21 G91", b"G1 X1 F600", b"M2"])
        robot.resume()
        robot.state("done")
        assert robot.executed[1][2] - robot.executed[1][1] == pytest.approx(0.115, abs=0.002)
        robot.close()


@pytest.mark.full
def test_an_actuator_that_loses_power_presses_no_more(tmp_path: Path) -> None:
    with cell(tmp_path) as running:
        robot = running.robot()
        robot.load([b"G21 G90", b"G0 X0 Y0 Z0 A15 C0", b"M2"])
        robot.resume()
        robot.state("done")
        coil = running.coil()
        coil.press(12.0)
        end_pid(running.pids["actuator"], signal.SIGKILL)
        coil.close()
        wait_for(lambda: "lost" in running.events("lost"), "the loss in the log")
        wait_for(lambda: not os.path.lexists(running.state / "actuator"), "its link to go with it")
        running.boot("actuator")
        coil = running.coil()
        assert coil.inputs()[0] == 0
        assert coil.ask(struct.pack(">BHH", 4, 128, 2), 6)[2:] == struct.pack(">I", 2)
        coil.close()
        robot.close()
        running.end()
        stood = running.account()["standstill_contact_s"]
        assert 0.0 < stood < 3.0
        assert os.path.realpath(running.state / "actuator").startswith("/dev/pts/")
