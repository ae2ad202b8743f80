"""The simulated controller without I/O: its answers, its HOLD state, and its motion."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from polishd.sim_backends.fanuc_rmi import controller as c
from polishd.sim_backends.fanuc_rmi.controller import turns_of, wrist_of
from tests.fakes.fanuc_rmi import controller

CONFIGURATION = {"UToolNumber": 1, "UFrameNumber": 0, "Front": 1, "Up": 1, "Left": 0, "Flip": 0}


class Client:
    """A session with a separate clock."""

    def __init__(self, **limits: Any) -> None:
        self.said = list[dict[str, Any]]()
        self.controller = controller(**limits)
        self.controller.begin(lambda data: self.said.append(json.loads(data)))
        self.now_s = 100.0

    def ask(self, **message: Any) -> dict[str, Any]:
        """The answer to it."""
        self.controller.on_line(json.dumps(message).encode(), self.now_s)
        self.run(0.01)
        return self.said[-1]

    def start(self) -> None:
        """Initialize."""
        assert self.ask(Command="FRC_Initialize", GroupMask=1) == {
            "Command": "FRC_Initialize", "ErrorID": 0, "GroupMask": 1,
        }  # fmt: skip

    def move(self, x_mm: float, sequence: int, speed: float = 50.0, kind: str = "mmSec", end: str = "FINE") -> None:
        """Send one over the part."""
        position = {"X": x_mm, "Y": 0.0, "Z": 50.0, "W": 180.0, "P": 0.0, "R": 0.0}
        message = {"Instruction": "FRC_LinearMotion", "SequenceID": sequence, "Configuration": CONFIGURATION}
        rest = {"Position": position, "SpeedType": kind, "Speed": speed, "TermType": end, "TermValue": 100}
        self.controller.on_line(json.dumps({**message, **rest}).encode(), self.now_s)

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(max(round(seconds / 0.005), 1)):
            self.now_s += 0.005
            self.controller.tick(self.now_s)

    def answered(self) -> list[tuple[int, int]]:
        """Sequence numbers and errors of instructions."""
        return [(one["SequenceID"], one["ErrorID"]) for one in self.said if "Instruction" in one]


def test_the_first_port_names_the_session_and_refuses_a_second_client() -> None:
    found = controller()
    found.session_port = 16002
    line = b'{"Communication": "FRC_Connect"}\r\n'
    assert found.on_connect_line(line)["PortNumber"] == 16002
    assert found.begin(lambda _: None)
    assert not found.begin(lambda _: None)
    assert found.on_connect_line(line)["ErrorID"] == c.CONNECTED


def test_an_instruction_is_answered_when_it_has_been_executed() -> None:
    client = Client()
    client.start()
    client.move(10.0, 1)
    client.run(0.1)
    assert client.answered() == []
    client.run(0.3)
    assert client.answered() == [(1, 0)]
    assert client.controller.motion.pose[0] == pytest.approx(10.0)


@pytest.mark.parametrize(("end", "saves_s"), [("FINE", 0.0), ("CNT", 0.02)])
def test_fine_stops_at_each_target_and_cnt_moves_on(end: str, saves_s: float) -> None:
    client = Client(accel_mm_s2=500.0)
    client.start()
    for number in range(1, 6):
        client.move(5.0 * number, number, end=end)
    client.run(3.0)
    executed = client.controller.motion.executed
    took_s = executed[-1][2] - executed[0][1]
    assert took_s == pytest.approx(5 * (0.1 + 0.1) - 4 * (0.1 if saves_s else 0.0), abs=0.02)


def test_a_move_by_its_time_takes_that_time_between_others() -> None:
    client = Client()
    client.start()
    for number in range(1, 6):
        client.move(2.0 * number, number, 250, "mSec", "CNT")
    client.run(3.0)
    spans = [end - start for _, start, end in client.controller.motion.executed]
    assert spans[1:4] == pytest.approx([0.25] * 3, abs=0.002)


def test_a_wrong_sequence_number_holds_rmi_until_it_is_reset() -> None:
    client = Client()
    client.start()
    client.move(5.0, 1)
    client.move(10.0, 3)
    client.move(10.0, 2)
    client.run(1.0)
    assert client.answered() == [(3, c.BAD_SEQUENCE), (2, c.IN_HOLD), (1, 0)], "what it has is executed"
    assert client.ask(Command="FRC_Reset")["ErrorID"] == 0
    client.move(10.0, client.ask(Command="FRC_GetStatus")["NextSequenceID"])
    client.run(1.0)
    assert client.answered()[-1] == (2, 0)


def test_a_ninth_instruction_is_refused() -> None:
    client = Client()
    client.start()
    for number in range(1, 10):
        client.move(float(number), number)
    assert client.answered() == [(9, c.TOO_MANY)]


def test_pause_and_continue_keep_what_it_holds_and_abort_drops_it() -> None:
    client = Client()
    client.start()
    client.move(20.0, 1)
    client.run(0.2)
    assert client.ask(Command="FRC_Pause")["ErrorID"] == 0
    client.run(0.5)
    paused = client.controller.motion.pose[0]
    assert 5.0 < paused < 20.0
    assert client.ask(Command="FRC_GetStatus")["ProgramStatus"] == c.PAUSED
    assert client.ask(Command="FRC_Continue")["ErrorID"] == 0
    assert client.ask(Command="FRC_Continue")["ErrorID"] == c.NOT_PAUSED
    client.run(0.1)
    assert client.ask(Command="FRC_Abort") == {"Command": "FRC_Abort", "ErrorID": 0} or client.run(0.2) is None
    client.run(0.5)
    assert client.controller.motion.state != "running"
    assert client.answered() == []
    assert client.ask(Command="FRC_Abort")["ErrorID"] == c.NOT_RUNNING


def test_modes_that_forbid_motion_are_answered_by_their_errors() -> None:
    client = Client()
    client.controller.press("teach pendant", client.now_s)
    assert client.ask(Command="FRC_Initialize")["ErrorID"] == c.PENDANT_ON
    client.controller.press("teach pendant", client.now_s)
    client.controller.press("emergency stop", client.now_s)
    assert client.ask(Command="FRC_Initialize")["ErrorID"] == c.SERVO_OFF
    assert client.ask(Command="FRC_Reset")["ErrorID"] == c.NO_RESET
    assert client.ask(Command="FRC_ReadError")["ErrorData"].startswith("SRVO-001")
    client.controller.press("emergency stop", client.now_s)
    client.start()


@pytest.mark.parametrize(("name", "value"), [("mode", "T1"), ("remote", False)])
def test_it_starts_only_in_auto_and_remote_and_says_its_mode(name: str, value: object) -> None:
    client = Client()
    setattr(client.controller, name, value)
    assert client.ask(Command="FRC_GetExtStatus")["ControlMode"] == ("T1" if name == "mode" else "AUTO")
    assert client.ask(Command="FRC_Initialize")["ErrorID"] == c.CANNOT_RUN
    assert not client.controller.initialized


def test_frames_are_selected_read_back_and_refused_where_it_has_none() -> None:
    client = Client()
    assert client.ask(Command="FRC_SetUFrameUTool", UFrameNumber=3, UToolNumber=4)["ErrorID"] == 0
    read = client.ask(Command="FRC_GetUFrameUTool")
    assert (read["UFrameNumber"], read["UToolNumber"]) == (3, 4)
    assert client.ask(Command="FRC_SetUFrameUTool", UFrameNumber=30, UToolNumber=4)["ErrorID"] == c.BAD_FRAME
    assert client.ask(Command="FRC_SetUFrameUTool", UFrameNumber=3, UToolNumber=0)["ErrorID"] == c.BAD_TOOL


def test_an_emergency_stop_in_motion_is_pushed_and_stops_it() -> None:
    client = Client()
    client.start()
    client.move(50.0, 1)
    client.run(0.2)
    client.controller.press("emergency stop", client.now_s)
    assert client.said[-1] == {"Communication": "FRC_SystemFault", "SequenceID": 1}
    client.run(0.5)
    assert client.controller.motion.state == "held"
    assert client.answered() == []


def test_without_its_client_it_executes_what_it_holds_and_ends() -> None:
    client = Client()
    client.start()
    client.move(5.0, 1)
    client.move(10.0, 2)
    client.controller.end(client.now_s)
    client.run(1.0)
    assert client.controller.motion.pose[0] == pytest.approx(10.0)
    assert not client.controller.initialized


@pytest.mark.parametrize(
    ("changed", "error"),
    [
        ({"SpeedType": "mm/sec"}, c.BAD_SPEED_TYPE),
        ({"Speed": 0}, c.BAD_SPEED),
        ({"TermType": "STOP"}, c.BAD_TERM_TYPE),
        ({"Instruction": "FRC_Unknown"}, c.BAD_INSTRUCTION),
        ({"Configuration": {**CONFIGURATION, "UToolNumber": 3}}, c.BAD_FRAME),
        ({"Position": {"X": 1.0}}, c.BAD_VALUE),
    ],
)
def test_a_wrong_instruction_is_answered_at_once_by_its_error(changed: dict[str, Any], error: int) -> None:
    client = Client()
    client.start()
    position = {"X": 1.0, "Y": 0.0, "Z": 50.0, "W": 180.0, "P": 0.0, "R": 0.0}
    message = {
        "Instruction": "FRC_LinearMotion", "SequenceID": 1, "Configuration": CONFIGURATION, "Position": position,
        "SpeedType": "mmSec", "Speed": 10, "TermType": "FINE",
    }  # fmt: skip
    client.controller.on_line(json.dumps({**message, **changed}).encode(), client.now_s)
    assert client.answered() == [(1, error)]


@pytest.mark.parametrize(("a_deg", "c_deg"), [(0.0, 0.0), (15.0, 0.0), (15.0, 120.0), (30.0, -90.0), (80.0, 179.0)])
def test_orientations_of_the_plant_and_of_fanuc_are_the_same_axis(a_deg: float, c_deg: float) -> None:
    a, cc = wrist_of(*turns_of(a_deg, c_deg))
    assert a == pytest.approx(a_deg, abs=1e-6)
    assert math.cos(math.radians(cc - c_deg)) == pytest.approx(1.0) or a_deg == 0.0
