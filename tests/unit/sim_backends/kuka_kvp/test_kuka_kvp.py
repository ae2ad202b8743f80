"""The simulated KUKA controller: KRL, the advance run, blends, override, stops and the shipped watchdog."""

from __future__ import annotations

import struct
from collections.abc import Callable
from itertools import pairwise

import pytest

from polishd.config.simulator_devices import SimRobotSection
from polishd.config.simulator_faults import FaultSection
from polishd.model.errors import ProgramError
from polishd.sim_backends.kuka_kvp.controller import KukaController, from_abc, kuka_path, to_abc
from polishd.sim_backends.kuka_kvp.device import INSTALLED, MODULES, KvpClient
from polishd.sim_backends.kuka_kvp.krl import compiled, read_krl, shown
from tests.unit.sim_backends.vectors import vectors

FRAME_S = 0.012
OVERHEAD_S = 0.0
ACCEL_MM_S2 = 800.0


def machine(overhead_s: float = OVERHEAD_S) -> KukaController:
    """At (0, 0, 60), pointing down, on a clock that the test advances."""
    found = KukaController(
        SimRobotSection(), kuka_path((0.0, 0.0, 60.0, 0.0, 0.0), overhead_s), FRAME_S, ACCEL_MM_S2, 1.0, 0.0
    )
    found.boot(*(read_krl((MODULES / name).read_text()) for name in INSTALLED))
    return found


def started(body: str, **more: float) -> KukaController:
    found = machine(**more)
    select(found, f"DEF P( )\nINT N\nINT M\nPTP $AXIS_ACT\nWAIT SEC 0\n{body}\nEND\n")
    assert found.start()
    return found


def select(found: KukaController, text: str, data: str = "") -> None:
    for _ in found.selecting("P", text, data):
        pass


def lin(x: float, more: str = "") -> str:
    return f"LIN {{X {x}, Y 0, Z 60, A 0, B 0, C 180}}{more}"


def run(found: KukaController, until: Callable[[], bool], longest_s: float = 60.0) -> float:
    """Frames until that; the time that they took on the controller's clock."""
    begin_s = found.time_s
    while not until():
        found.frame()
        assert found.time_s - begin_s < longest_s
    return found.time_s - begin_s


def to_end(found: KukaController) -> float:
    return run(found, lambda: found.state == "#P_END")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3", 7),
        ("7 / 2", 3),
        ("7.0 / 2", 3.5),
        ("-(2 - 5)", 3),
        ("1 <> 2 AND NOT FALSE", True),
        ("TRUE EXOR TRUE", False),
        ("#P_active", "#P_ACTIVE"),
        ('"STOP 1"', "STOP 1"),
        ("{X 1, Y -2.5}", {"X": 1, "Y": -2.5}),
        ("$TIMER[3 + 1]", 4),
    ],
)
def test_expressions_have_their_value(text: str, value: object) -> None:
    assert compiled(text)({"$TIMER[4]": 4}.__getitem__) == value


@pytest.mark.parametrize(("value", "text"), [(True, "TRUE"), (12.5, "12.5"), ("#T1", "#T1"), ("a", '"a"'), (3, "3")])
def test_values_are_answered_as_krl_text(value: object, text: str) -> None:
    assert shown(value) == text


@pytest.mark.parametrize(
    ("text", "line", "why"),
    [
        ("DEF P( )\nLIN {X 1\nEND\n", 2, "} is missing"),
        ("DEF P( )\n?what\nEND\n", 2, "syntax error"),
        ("DEF P( )\nIF TRUE THEN\nEND\n", 3, "syntax error at 'END'"),
        ("DEF P( )\nLIN XP1\n", 2, "END is missing"),
        ("DEF P( )\nTRIGGER WHEN DISTANCE=0 DELAY=0 DO MARK( )\nEND\n", 2, "an assignment only"),
        ("N=1\nX\n", 2, "outside of a routine"),
    ],
)
def test_what_it_does_not_read_is_refused_with_its_line(text: str, line: int, why: str) -> None:
    with pytest.raises(ProgramError) as refused:
        read_krl(text)
    assert why in str(refused.value.args[0])
    assert refused.value.args[1] == line


def test_orientations_turn_about_z_then_y_then_x() -> None:
    assert to_abc(from_abc(30.0, -20.0, 170.0)) == pytest.approx((30.0, -20.0, 170.0))


def test_an_exact_stop_takes_a_ramp_more_than_a_blend() -> None:
    steps = [lin(float(at)) for at in range(1, 11)]
    stops = to_end(started("$VEL.CP=0.02\n" + "\n".join(steps)))
    blends = to_end(started("$VEL.CP=0.02\n$APO.CDIS=0.5\n" + "\n".join(step + " C_DIS" for step in steps)))
    # each 1 mm at 20 mm/s is 50 ms, and from rest to rest 25 ms more
    assert stops == pytest.approx(10 * 0.075, abs=0.15)
    assert blends == pytest.approx(10 * 0.050 + 0.025, abs=0.05)


def test_the_speed_of_each_block_sets_its_time_through_blends() -> None:
    body = ["$APO.CDIS=1"]
    for at in range(1, 9):
        body += [f"$VEL.CP={0.01 if at % 2 else 0.02}", f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO N={at}"]
        body.append(lin(2.0 * at, " C_DIS"))
    found = started("\n".join(body))
    began = []
    for block in range(1, 9):
        run(found, lambda block=block: found.values["N"] == block)
        began.append(found.time_s)
    took = [b - a for a, b in pairwise(began[2:])]
    # 2 mm at 10 and at 20 mm/s in turn, less what the corner between two speeds takes
    assert took[0::2] == pytest.approx([0.2] * 3, abs=0.02)
    assert took[1::2] == pytest.approx([0.1] * 2, abs=0.02)


def test_an_assignment_runs_ahead_of_the_motion_and_a_trigger_does_not() -> None:
    body = ["$VEL.CP=0.02"]
    for at in range(1, 6):
        body += [f"M={at}", f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO N={at}", lin(float(at))]
    found = started("\n".join(body))
    run(found, lambda: found.values["N"] == 1)
    assert found.values["M"] >= 4  # three moves are queued behind the one in motion
    assert found.path.pose.xyz_mm[0] < 0.1
    run(found, lambda: found.values["N"] == 3)
    assert found.path.pose.xyz_mm[0] == pytest.approx(2.0, abs=0.25)  # one cycle of 12 ms later


def test_a_wait_stops_the_advance_run_and_the_blend() -> None:
    found = started(f"$VEL.CP=0.02\n$APO.CDIS=1\n{lin(1.0, ' C_DIS')}\nWAIT SEC 0.5\nN=1\n{lin(2.0)}")
    run(found, lambda: found.waits)
    assert found.path.pose.xyz_mm[0] == pytest.approx(1.0)
    assert found.values["N"] == 0
    assert run(found, lambda: not found.waits) == pytest.approx(0.5, abs=2 * FRAME_S)


def test_the_override_slows_moves_and_no_waits() -> None:
    body = f"$VEL.CP=0.02\n{lin(10.0)}"
    full = to_end(started(body))
    slow = started(body)
    slow.program_override = 50
    assert to_end(slow) == pytest.approx(2.0 * full, rel=0.1)
    waits = started("WAIT SEC 1")
    waits.program_override = 50
    assert to_end(waits) == pytest.approx(1.0, abs=4 * FRAME_S)


def test_a_fault_of_the_script_is_an_override_or_a_standstill_that_is_not_reported() -> None:
    found = started(f"$VEL.CP=0.02\n{lin(40.0)}")
    run(found, lambda: found.moves)
    found.override.suffer(FaultSection(device="robot", what="override", percent=50.0, at_s=0.0), True)
    assert found.read("$OV_PRO") == 50
    stands = FaultSection(device="robot", what="stand", at_s=0.0)
    found.override.suffer(stands, True)
    found.frame()
    assert (found.moves, found.state, found.read("$OV_PRO")) == (False, "#P_ACTIVE", 50)


def test_a_standstill_in_a_wait_is_as_planned_until_the_wait_would_end() -> None:
    found = started(f"{lin(2.0)}\nWAIT SEC 0.24\n{lin(4.0)}")
    run(found, lambda: found.waits)
    began_s = found.time_s
    found.override.suffer(FaultSection(device="robot", what="stand", at_s=0.0), True)
    run(found, lambda: found.shares[-1:] and found.shares[-1][1] == 0.0)
    assert found.time_s - began_s == pytest.approx(0.24, abs=1.5 * FRAME_S)


def test_a_stop_brakes_on_the_path_and_a_start_continues() -> None:
    found = started(f"$VEL.CP=0.02\n{lin(10.0)}\nN=7")
    run(found, lambda: found.path.pose.xyz_mm[0] > 3.0)
    assert found.stop()
    assert not found.cancel()  # it still brakes
    run(found, lambda: not found.moves)
    stood = found.path.pose.xyz_mm[0]
    assert 3.0 < stood < 6.0
    for _ in range(20):
        found.frame()
    assert found.path.pose.xyz_mm[0] == stood
    assert (found.state, found.active) == ("#P_STOP", False)
    assert found.start()
    to_end(found)
    assert found.path.pose.xyz_mm[0] == pytest.approx(10.0)
    assert found.values["N"] == 7


@pytest.mark.parametrize("stops", [KukaController.emergency_stop, KukaController.turn_to_manual])
def test_emergency_stop_and_manual_mode_stop_and_refuse_a_start(stops: Callable[[KukaController], None]) -> None:
    found = started(f"$VEL.CP=0.02\n{lin(10.0)}")
    run(found, lambda: found.moves)
    stops(found)
    run(found, lambda: not found.moves)
    assert (found.state, found.read("$PERI_RDY")) == ("#P_STOP", False)
    assert not found.start()
    found.turn_to_automatic()
    assert found.start()


def test_a_program_that_leaves_the_range_is_stopped() -> None:
    found = started(f"$VEL.CP=0.1\n{lin(300.0)}")
    run(found, lambda: found.stop_message)
    assert found.state == "#P_STOP"


def test_an_error_of_the_program_stops_it_with_a_message() -> None:
    said: list[tuple[int, str]] = []
    found = machine()
    found.complain = lambda line, text: said.append((line, text))
    select(found, "DEF P( )\n$VEL.CP=0\nLIN {X 1,Y 0,Z 60,A 0,B 0,C 180}\nEND\n")
    found.start()
    found.frame()
    assert said == [(3, "$VEL.CP and $ACC.CP must be above 0")]
    assert (found.state, found.stop_message) == ("#P_STOP", True)


def data_list(x: float) -> str:
    pose = f"X {x},Y 0.0,Z 60.0,A 0.0,B 0.0,C 180.0,S 2,T 35,E1 0.0"
    frame = '{TOOL_NO 1,BASE_NO 1,IPO_FRAME #BASE,POINT2[] " "}'
    return f"&ACCESS RV\nDEFDAT P PUBLIC\nDECL E6POS XP1={{{pose}}}\nDECL FDAT FP1={frame}\nENDDAT\n"


def test_a_module_takes_its_positions_from_its_data_list_and_from_no_earlier_one() -> None:
    found, text = machine(), "DEF P( )\nFDAT_ACT=FP1\nBAS (#CP_PARAMS,0.05)\nLIN XP1\nEND\n"
    for x in (4.0, 6.0):
        select(found, text, data_list(x))
        assert found.start()
        to_end(found)
        assert found.path.pose.xyz_mm[0] == pytest.approx(x)
    assert found.cancel()
    with pytest.raises(ProgramError, match="XP1 is not declared"):
        found.read("XP1")


@pytest.mark.parametrize(
    ("text", "data", "why"),
    [
        ("LIN XP2", data_list(1.0), "XP2 is not declared"),
        ("LIN XP1", "", "XP1 is not declared"),
        ("N=1", "", "N is not declared"),
        ("LIN XP1", data_list(1.0).replace("DEFDAT P", "DEFDAT Q"), "the data list is that of Q"),
    ],
)
def test_a_name_without_a_declaration_is_refused_when_the_module_is_selected(text: str, data: str, why: str) -> None:
    found = machine()
    with pytest.raises(ProgramError, match=why):
        select(found, f"DEF P( )\n{text}\nEND\n", data)
    assert found.state == "#P_FREE"


# The shipped watchdog, as the submit interpreter runs it.

ENDLESS = "POLISHD_TOKEN=5\n" + "\n".join(lin(float(at % 2)) for at in range(400))


def beating(found: KukaController, frames: int, every: int) -> None:
    for at in range(frames):
        if every and at % every == 0:
            found.write("POLISHD_BEAT", int(found.values["POLISHD_BEAT"]) + 1)
        found.frame()


def test_without_heartbeats_the_watchdog_stops_the_motion_and_later_gives_the_override_back() -> None:
    found = started(f"POLISHD_LIMIT=500\n$VEL.CP=0.005\n{ENDLESS}")
    beating(found, 200, every=10)
    assert found.state == "#P_ACTIVE"
    assert run(found, lambda: found.state == "#P_STOP") == pytest.approx(0.5, abs=0.15)
    run(found, lambda: not found.moves)
    assert found.program_override == 0
    assert found.cancel()
    beating(found, 2, every=0)
    assert (found.program_override, found.values["POLISHD_TRIPPED"]) == (100, False)


FULL_MS = 1_000_000_000


def test_the_timer_starts_again_in_a_program_and_neither_its_time_nor_the_limit_notices() -> None:
    found = started(f"POLISHD_LIMIT=500\nPOLISHD_PHASE=2\n$VEL.CP=0.005\n{ENDLESS}")
    found.write("$TIMER[16]", FULL_MS - 300)
    beating(found, 10, every=1)  # the watchdog has read it
    ran_ms, began_s = found.values["POLISHD_RUN"], found.time_s
    assert run(found, lambda: found.state == "#P_STOP") == pytest.approx(0.5, abs=0.05)
    assert 0 < found.values["POLISHD_CLOCK"] < 500
    assert found.values["POLISHD_RUN"] - ran_ms == pytest.approx((found.time_s - began_s) * 1e3, abs=2e3 * FRAME_S)


def test_with_heartbeats_a_program_runs_on_when_the_timer_starts_again() -> None:
    found = started(f"POLISHD_LIMIT=500\n$VEL.CP=0.005\n{ENDLESS}")
    found.write("$TIMER[16]", FULL_MS - 300)
    beating(found, 200, every=10)
    assert (found.state, found.values["POLISHD_TRIPPED"]) == ("#P_ACTIVE", False)
    assert 0 < found.values["POLISHD_CLOCK"] < 200 * FRAME_S * 1e3


@pytest.mark.parametrize("timer_ms", [2**31 - 20, -(2**31), -5])
def test_a_timer_that_ran_over_while_the_submit_interpreter_stood_is_no_error(timer_ms: int) -> None:
    found = started("POLISHD_TOKEN=5\nPOLISHD_LIMIT=600000\nPOLISHD_PHASE=2\nWAIT SEC 60")
    found.write("$TIMER[16]", FULL_MS - 1)
    beating(found, 3, every=1)
    found.write("$TIMER[16]", timer_ms)
    beating(found, 20, every=5)
    assert found.read("$PRO_STATE0") == "#P_ACTIVE"
    assert 0 < found.values["POLISHD_CLOCK"] < 20 * FRAME_S * 1e3


def test_without_heartbeats_for_weeks_no_sum_leaves_the_range_of_int() -> None:
    found = machine()
    for _ in range(5):
        found.write("$TIMER[16]", FULL_MS - 1)
        beating(found, 5, every=0)
    assert found.read("$PRO_STATE0") == "#P_ACTIVE"
    assert found.values["POLISHD_QUIET"] < 2 * 600_000


def test_a_timer_has_32_bits_and_a_sum_beyond_int_is_an_error() -> None:
    said: list[str] = []
    found = started("N=2147483647\nWAIT SEC 0.1\nN=N+1")
    found.complain = lambda _line, text: said.append(text)
    found.write("$TIMER[3]", 2**31 - 5)
    found.write("$TIMER_STOP[3]", False)
    run(found, lambda: found.stop_message)
    assert found.read("$TIMER[3]") < -(2**31) + 200
    assert said == ["2147483648 is beyond INT"]


def test_the_watchdog_leaves_other_programs_alone() -> None:
    found = started(f"POLISHD_LIMIT=500\n$VEL.CP=0.005\n{ENDLESS}".replace("POLISHD_TOKEN=5", "POLISHD_TOKEN=0"))
    beating(found, 200, every=0)
    assert found.state == "#P_ACTIVE"


def test_the_watchdog_reports_when_each_block_began_in_the_programs_running_time() -> None:
    blocks = [f"TRIGGER WHEN DISTANCE=0 DELAY=0 DO POLISHD_BLOCK={at}\n{lin(float(at))}" for at in (1, 2)]
    body = ["POLISHD_TOKEN=5", "POLISHD_LIMIT=60000", "$VEL.CP=0.02", "POLISHD_PHASE=2", *blocks]
    body += ["WAIT SEC 0", "POLISHD_BLOCK=5", "POLISHD_PHASE=1", "WAIT FOR N==1", "POLISHD_PHASE=2", "WAIT SEC 0.24"]
    body += ["WAIT SEC 0", "POLISHD_BLOCK=6", "WAIT SEC 1"]
    found = started("\n".join(body))
    run(found, lambda: found.values["POLISHD_BLOCK"] == 5)
    beating(found, 100, every=0)
    found.write("N", 1)
    run(found, lambda: found.values["POLISHD_SEEN"] == 6)
    began = [found.read(f"POLISHD_BEGINS[{at + 1}]") / 1e3 for at in (1, 2, 3, 4, 5, 6)]
    assert began[1] - began[0] == pytest.approx(0.05 + 0.02 / 0.8, abs=FRAME_S)
    assert began[2] == began[3] == began[4]  # two that it did not see
    assert began[5] - began[4] == pytest.approx(0.24, abs=0.1 * FRAME_S)


def test_the_watchdog_keeps_the_begins_of_the_last_blocks_and_starts_anew_with_a_program() -> None:
    found = started("POLISHD_TOKEN=5\nPOLISHD_PHASE=2\nPOLISHD_BLOCK=100\nWAIT SEC 0.24\nPOLISHD_BLOCK=150\nWAIT SEC 1")
    run(found, lambda: found.values["POLISHD_SEEN"] == 150)
    began = [found.read(f"POLISHD_BEGINS[{at % 64 + 1}]") for at in range(100, 151)]
    assert began[0] == 0
    assert len(set(began[1:])) == 1
    assert began[1] / 1e3 == pytest.approx(0.24, abs=0.1 * FRAME_S)
    found.write("POLISHD_TOKEN", 0)
    found.write("POLISHD_BLOCK", 0)
    beating(found, 2, every=0)
    assert (found.values["POLISHD_SEEN"], found.values["POLISHD_RUN"]) == (0, 0)


def test_a_while_runs_at_once_and_a_loop_once_in_a_cycle() -> None:
    found = started("WHILE N<250\nN=N+1\nENDWHILE\nLOOP\nM=M+1\nENDLOOP")
    assert run(found, lambda: found.values["M"] == 3) == pytest.approx(5 * FRAME_S)


# The proxy.


def asked(found: KukaController, request: bytes, *, has_c3: bool = True) -> bytes:
    answers: list[bytes] = []
    client = KvpClient(found, answers.append, lambda _name, answer: answer(1), has_c3)
    for at in range(len(request)):
        client.feed(request[at : at + 1])
    (answer,) = answers
    return answer


def test_samples_of_the_protocol_document_are_answered_as_there() -> None:
    found = machine()
    # C3 Bridge Interface, Application Protocol Specification 1.5: 3.5.6 (write $OV_PRO=5) and 3.6.1
    write = bytes.fromhex("010000150500072400 4f0056005f00500052004f000001 3500")
    assert asked(found, write) == bytes.fromhex("010000080500013500000101")
    assert found.program_override == 5
    start = bytes.fromhex("028c00040a020001")
    assert asked(found, start) == bytes.fromhex("028c00050a02000000")  # nothing is selected


def test_vectors_of_the_page_are_answered_as_there() -> None:
    page = vectors("kuka_kvp")
    found = started("WAIT SEC 1")
    assert asked(found, bytes.fromhex(page["read_request"])).hex() == page["read_answer"]
    assert found.stop()
    assert asked(found, bytes.fromhex(page["start_request"])).hex() == page["start_answer"]
    assert found.state == "#P_ACTIVE"


def test_an_unknown_variable_is_an_error_of_its_own() -> None:
    found = machine()
    names = ("$MODE_OP", "NOWHERE")
    payload = bytes([2]) + b"".join(struct.pack(">H", len(name)) + name.encode("utf-16-le") for name in names)
    answer = asked(found, struct.pack(">HHB", 1, 1 + len(payload), 6) + payload)
    assert answer[5:] == b"\2\1\0\4" + "#AUT".encode("utf-16-le") + b"\0\0\0" + b"\0\0\0"


def test_kukavarproxy_answers_its_two_messages_only() -> None:
    found = machine()
    read = struct.pack(">HHBH", 7, 10, 0, 7) + b"$OV_PRO"
    assert asked(found, read, has_c3=False) == struct.pack(">HHBH", 7, 9, 0, 3) + b"100\0\1\1"
    assert asked(found, bytes.fromhex("028c00040a030001"), has_c3=False)[-3:] == b"\0\0\0"


def test_it_is_in_motion_from_its_first_move_to_its_next_wait_for_without_a_gap() -> None:
    body = "WAIT FOR N==1\n$VEL.CP=0.02\n" + "\n".join(f"{lin(float(at))}\nWAIT SEC 0.1" for at in range(1, 5))
    found = started(body + "\nWAIT FOR N==2", overhead_s=0.02)
    for _ in range(20):
        found.frame()
        assert not found.active  # PTP $AXIS_ACT is no motion
    found.write("N", 1)
    run(found, lambda: found.active)
    assert run(found, lambda: not found.active) > 0.6
    assert found.path.pose.xyz_mm[0] == pytest.approx(4.0)
    assert found.state == "#P_ACTIVE"
