"""The simulated LinuxCNC cell: its configuration, its samples, and the gate that holds motion when no client sends."""

from __future__ import annotations

import configparser
import hashlib
import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ConfigError
from polishd.sim_backends.common.hidden_truth import tool_axis
from polishd.sim_backends.linuxcnc import device
from polishd.sim_backends.linuxcnc import hal_gate as gate_module
from polishd.sim_backends.linuxcnc.device import (
    AXES,
    STILL_SAMPLES,
    LinuxCncConfig,
    LinuxCncProgram,
    Sampled,
    joints_of,
    pose_of,
)
from polishd.sim_backends.linuxcnc.hal_gate import Gate, HalWatchdog, address
from tests.time_limits import SOON_S

POSE = (1.0, -2.0, 60.0, 15.0, -90.0)


@pytest.fixture
def machine() -> LinuxCncConfig:
    return LinuxCncConfig(SimRobotSection(kind="linuxcnc", port=28999, z_mm=(-3.0, 130.0), watchdog_s=1.5), POSE, 950.0)


def test_the_configuration_has_five_joints_that_stand_where_the_robot_stood(machine: LinuxCncConfig) -> None:
    ini = configparser.ConfigParser()
    ini.read_string(machine.ini())
    for joint, axis in enumerate(AXES):
        section = ini[f"JOINT_{joint}"]
        assert float(section["HOME"]) == float(section["HOME_OFFSET"]) == POSE[joint]
        assert section["TYPE"] == ("ANGULAR" if axis in "AC" else "LINEAR")
        assert float(section["MAX_ACCELERATION"]) == float(ini[f"AXIS_{axis}"]["MAX_ACCELERATION"]) == 950.0
    assert (float(ini["AXIS_Z"]["MIN_LIMIT"]), float(ini["AXIS_Z"]["MAX_LIMIT"])) == (-3.0, 130.0)
    assert ini["KINS"]["JOINTS"] == "5"
    assert "linuxcncrsh" in ini["DISPLAY"]["DISPLAY"]


def test_a_table_has_the_joints_that_bring_the_tool_there_and_back() -> None:
    """The machine's spindle stands upright: the table turns the part so that the tool leans as the head would."""
    joints = joints_of("table", POSE)
    assert pose_of("table", joints) == pytest.approx(POSE)
    table = Rotation.from_euler("XZ", joints[3:], degrees=True)
    assert table.apply(POSE[:3]) == pytest.approx(joints[:3])
    lean = tool_axis(np.array([POSE[3]]), np.array([POSE[4]]))[0]
    assert table.apply(lean) == pytest.approx([0.0, 0.0, 1.0])
    assert joints_of("tool", POSE) == POSE == pose_of("tool", POSE)


def test_the_gate_stands_before_linuxcncrsh_and_holds_motion(machine: LinuxCncConfig, tmp_path: Path) -> None:
    machine.write(tmp_path / "machine")
    hal = (tmp_path / "machine" / "machine.hal").read_text()
    assert "hal_gate.py 127.0.0.1:28999 127.0.0.1:5007 1.5" in hal
    assert "polishd-gate.hold => motion.feed-hold" in hal
    assert (tmp_path / "machine" / "hal_gate.py").exists()
    assert (tmp_path / "machine" / "nc").is_dir()


def sample(x: float, line: int = 0, runs: int = 0, paused: int = 0, held: int = 0) -> bytes:
    return f"{x:.6f} 0.000000 0.000000 0.000000 0.000000 {line} {runs} {paused} {held} \n".encode()


def test_samples_become_rows_that_fill_the_time() -> None:
    """The wall's, that is; each is 5 ms of LinuxCNC's own, however late it comes."""
    sampled = Sampled((0.0,) * 5, 10.0)
    sampled.feed(sample(1.0, 1, 1) + sample(2.0, 1, 1) + b"overrun\n" + sample(3.0, 2, 1)[:9], 10.2)
    sampled.feed(sample(3.0, 2, 1)[9:], 10.3)
    rows = sampled.take_rows()
    assert rows[:, 1:4] == pytest.approx(np.array([[10.0, 10.1, 0.005], [10.1, 10.2, 0.005], [10.2, 10.3, 0.005]]))
    assert rows[:, 4] == pytest.approx([0.5, 1.5, 2.5]), "pose half-way"
    assert rows[:, 0].tolist() == [-1, -1, -1], "no program is known"
    assert sampled.take_rows().shape == (0, 9)


def test_it_moves_while_a_program_runs_and_until_it_stands() -> None:
    sampled = Sampled((0.0,) * 5, 0.0)
    sampled.feed(sample(0.0) * STILL_SAMPLES, 1.0)
    assert not sampled.moving
    sampled.feed(sample(0.0, 3, 1) * 9, 2.0)
    assert sampled.moving, "a dwell is no standstill"
    sampled.feed(sample(0.0, 3, 1, 1) * STILL_SAMPLES, 3.0)
    assert not sampled.moving, "a pause is"
    sampled.feed(sample(0.0, 3, 1), 4.0)
    sampled.feed(sample(0.0, 3, 1, 0, 1) * STILL_SAMPLES, 5.0)
    assert not sampled.moving, "and so is the gate's hold"
    sampled.feed(sample(0.1), 6.0)
    assert sampled.moving, "an operator jogs"


def test_a_dwell_is_a_rest_within_the_program_and_is_booked_with_the_move_before_it() -> None:
    sampled = Sampled((0.0,) * 5, 0.0, LinuxCncProgram("ab", 3, ()))
    sampled.feed(sample(1.0, 1, 1) + sample(2.0, 1, 1), 1.0)
    assert not sampled.rests
    sampled.feed(sample(2.0, 0, 1) * (STILL_SAMPLES - 1), 2.0)
    assert not sampled.rests, "a corner is none"
    sampled.feed(sample(2.0, 0, 1), 3.0)
    assert sampled.rests
    sampled.feed(sample(3.0, 3, 1), 4.0)
    assert not sampled.rests
    assert sampled.take_rows()[:, 0].tolist() == [0.0] * (2 + STILL_SAMPLES) + [2.0]
    sampled.feed(sample(3.0, 0, 0) + sample(3.5, 0, 0) + sample(3.5, 0, 0) * STILL_SAMPLES, 5.0)
    assert set(sampled.take_rows()[:, 0]) == {-1.0}, "no program runs"
    assert not sampled.rests
    assert not sampled.moving


def test_a_program_file_is_known_without_what_the_driver_put_between(tmp_path: Path) -> None:
    own = [b"G21", b"G1 X1", b"G1 X2", b"M2"]
    path = tmp_path / "p.ngc"
    path.write_bytes(b"\n".join([*own[:2], b"(MSG,polishd ab 2) M0", own[2], b"(MSG,polishd ab 4)", own[3], b""]))
    program = LinuxCncProgram.read(path)
    assert (program.sha256, program.blocks) == (hashlib.sha256(b"\n".join(own)).hexdigest(), 4)
    assert [program.block_at(line) for line in (0, 1, 2, 4, 6)] == [-1, 0, 1, 2, 3]


def test_the_watchdog_wakes_with_a_client_holds_without_and_lets_go_when_the_program_is_over() -> None:
    dog = HalWatchdog(silent_s=1.0)
    assert not dog.look(0.0, idle=False), "a program without a remote client is the operator's"
    assert not dog.look(9.0, idle=False)
    dog.client_s = 10.0
    assert not dog.look(10.5, idle=False)
    assert dog.look(11.1, idle=False)
    dog.client_s = 12.0
    assert dog.look(12.1, idle=False), "a client that is back moves nothing"
    assert not dog.look(12.2, idle=True)
    assert not dog.look(99.0, idle=True)


@pytest.fixture
def served() -> Iterator[tuple[Gate, socket.socket]]:
    server_side = socket.create_server(("127.0.0.1", 0))
    server_side.settimeout(SOON_S)
    gate = Gate(("127.0.0.1", 0), ("127.0.0.1", server_side.getsockname()[1]), HalWatchdog(1.0))
    yield gate, server_side
    gate.close()
    server_side.close()


def turn(gate: Gate, times: int = 5) -> None:
    for _ in range(times):
        gate.turn(0.02)


def test_the_gate_passes_bytes_both_ways_and_hears_clients_only(served: tuple[Gate, socket.socket]) -> None:
    gate, server_side = served
    with socket.create_connection(("127.0.0.1", gate.port), timeout=SOON_S) as client:
        turn(gate)
        behind, _ = server_side.accept()
        with behind:
            behind.settimeout(SOON_S)
            behind.sendall(b"unasked\r\n")
            turn(gate)
            assert client.recv(99) == b"unasked\r\n"
            assert gate.watchdog.client_s == float("-inf"), "a server that talks is no client that lives"
            client.sendall(b"get time\r\n")
            turn(gate)
            assert behind.recv(99) == b"get time\r\n"
            assert gate.watchdog.client_s > 0.0
            client.close()
            turn(gate)
            assert behind.recv(99) == b"", "and hangs up with it"


def test_the_gate_refuses_control_to_a_second_client_while_the_first_lives(
    served: tuple[Gate, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    """linuxcncrsh itself would let it take over without a report."""
    gate, server_side = served
    now_s = 100.0
    monkeypatch.setattr(gate_module.time, "monotonic", lambda: now_s)
    ends = []
    for _ in range(2):
        client = socket.create_connection(("127.0.0.1", gate.port), timeout=SOON_S)
        turn(gate)
        behind, _ = server_side.accept()
        behind.settimeout(0.2)
        ends += [client, behind]
    first, behind_first, second, behind_second = ends

    def asks(client: socket.socket, behind: socket.socket, request: bytes) -> bytes:
        """Return the state as linuxcncrsh reports it."""
        client.sendall(request)
        turn(gate)
        try:
            return behind.recv(999)
        except TimeoutError:
            return b""

    enable = b"set enable EMCTOO\r\n"
    assert asks(first, behind_first, enable) == enable
    assert asks(second, behind_second, b"get time\r\nSET  Enable EMC") == b"get time\r\n"
    assert asks(second, behind_second, b"TOO\r\nget time\r\n") == b"get time\r\n"
    assert second.recv(99) == b"SET ENABLE NAK\r\n"
    now_s += 0.9
    assert asks(first, behind_first, b"get time\r\n"), "which keeps it"
    now_s += 0.9
    assert asks(second, behind_second, enable) == b""
    now_s += 0.2
    assert asks(second, behind_second, enable) == enable, "the first was silent for as long as the watchdog allows"
    behind_second.sendall(b"SET ENABLE NAK\r\n")
    turn(gate)
    assert asks(first, behind_first, enable) == enable, "a wrong password gives no control"
    assert asks(first, behind_first, b"set enable off\r\n")
    assert asks(second, behind_second, enable) == enable
    second.close()
    turn(gate)
    assert asks(first, behind_first, enable) == enable, "and a client that is gone has none"
    for end in ends:
        end.close()


def test_the_gate_hangs_up_without_a_server_behind() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    gate = Gate(("127.0.0.1", 0), ("127.0.0.1", port), HalWatchdog(1.0))
    with socket.create_connection(("127.0.0.1", gate.port), timeout=SOON_S) as client:
        turn(gate)
        assert client.recv(1) == b""
    gate.close()


def test_addresses() -> None:
    assert address("0.0.0.0:5008") == ("0.0.0.0", 5008)


def test_linuxcnc_is_not_started_where_others_could_reach_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo"), (2, "eth0")])
    with pytest.raises(ConfigError, match=r"every interface.*eth0.*To do: unshare"):
        device.require_alone()
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo")])
    device.require_alone()
