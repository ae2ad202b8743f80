"""The module that goes to the controller, and the record of what it executed, from samples."""

from __future__ import annotations

from dataclasses import replace

import pytest

from polishd.api import DeviceRefused, ProtocolError
from polishd.drivers.kuka_kvp.program import (
    READ_NAMES,
    KrlPhase,
    KrlProgram,
    KrlProgramTracker,
    KukaSample,
    data_list,
    krl_lines,
    require_declared,
)
from tests.programs import plan_of

LINES = [
    b"&ACCESS RVP",
    b"DEF polish( )",
    b"DECL E6POS XP1",
    b";FOLD INI",
    b"$VEL.CP=0.02",
    b"LIN {X 0,Y 0,Z 60,A 0,B 0,C 180}",
    b"SLIN {X 1,Y 0,Z 60,A 0,B 0,C 180} C_DIS ; next",
    b"WAIT SEC 0.250",
    b"END",
]
TOKEN = 77


def module(*stops: int) -> list[str]:
    return KrlProgram(krl_lines(LINES), stops, TOKEN).text.decode().splitlines()


def test_the_lines_are_unchanged_with_their_reports_between() -> None:
    text = module()
    at = text.index("$VEL.CP=0.02")
    assert text[at:] == [
        "$VEL.CP=0.02",
        "TRIGGER WHEN DISTANCE=0 DELAY=0 DO POLISHD_BLOCK=5",
        "LIN {X 0,Y 0,Z 60,A 0,B 0,C 180}",
        "TRIGGER WHEN PATH=0 ONSTART DELAY=0 DO POLISHD_BLOCK=6",
        "SLIN {X 1,Y 0,Z 60,A 0,B 0,C 180} C_DIS ; next",
        "WAIT SEC 0",
        "POLISHD_BLOCK=7",
        "WAIT SEC 0.250",
        "WAIT SEC 0",
        "POLISHD_BLOCK=9",
        "POLISHD_PHASE=3",
        "END",
    ]


def test_declarations_go_to_the_head_and_the_files_own_frame_is_left_out() -> None:
    text = module()
    assert [line for line in text if line.startswith("DEF")] == ["DEF POLISHD( )"]
    assert text.index("DECL E6POS XP1") < text.index("BAS(#INITMOV,0)") < text.index("PTP $AXIS_ACT")
    assert text.count("END") == 1
    assert sum(line.startswith("&") for line in text) == 1


def test_it_waits_before_its_first_line_and_before_each_stop() -> None:
    gates = [line for line in module(6, 0, 99) if line.startswith("WAIT FOR (")]
    assert gates == [f"WAIT FOR (POLISHD_GO=={TOKEN}) AND (POLISHD_UNTIL>{seq})" for seq in (0, 6)]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"LOOP", "block 1: 'LOOP' cannot be followed"),
        (b"IF X THEN", "cannot be followed"),
        (b"WAIT FOR $IN[1]", "cannot be followed"),
        (b"CONTINUE", "cannot be followed"),
        (b"GRIP( )", "cannot be followed"),
        (b"WAIT SEC 1.2.3", "no time"),
        (b"DEF OTHER( )", "several routines"),
    ],
)
def test_what_cannot_be_followed_is_refused_with_its_block(line: bytes, why: str) -> None:
    with pytest.raises(DeviceRefused, match=why.replace("'", ".")):
        krl_lines([b"DEF P( )", line, b"LIN P1", b"END"])


DAT = b"""&ACCESS RVP\r
DEFDAT POLISH PUBLIC\r
;FOLD EXTERNAL DECLARATIONS\r
EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )\r
; DECL E6POS XP9={X 0,Y 0,Z 0,A 0,B 0,C 0}\r
DECL GLOBAL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 180.0,S 2,T 35}\r
  GLOBAL REAL Speed=0.02, LIST[2,3]\r
DECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,AUX {A 1,B 2}}\r
DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,POINT2[] "a, B=1"}\r
ENDDAT\r
"""


def test_the_data_list_has_the_declarations_of_the_file_beside_for_the_module_only() -> None:
    assert data_list(DAT).decode().splitlines() == [
        "&ACCESS RV",
        "DEFDAT POLISHD",
        "EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )",
        "DECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 180.0,S 2,T 35}",
        "  REAL Speed=0.02, LIST[2,3]",
        "DECL LDAT LCPDAT1={VEL 2.0,ACC 100.0,AUX {A 1,B 2}}",
        'DECL FDAT FP1={TOOL_NO 1,BASE_NO 1,POINT2[] "a, B=1"}',
        "ENDDAT",
    ]
    assert data_list(b"") == b"&ACCESS RV\nDEFDAT POLISHD\nENDDAT\n"


DECLARED = [
    b"INI",
    b"$H_POS=XHOME",
    b"PDAT_ACT=PDEFAULT",
    b"FDAT_ACT=FP1",
    b"SET_CD_PARAMS (0)",
    b"BAS (#CP_PARAMS,0.02)",
    b"$VEL.CP=speed",
    b"list[1,2]=1.5E3",
    b"LIN xp1 C_DIS ; XP8",
    b"SLIN XP1 WITH $VEL=SVEL_CP(0.1,,LCPDAT1),$TOOL=STOOL2(FP1),$BASE=SBASE(FP1.BASE_NO) C_SPL",
]


def test_names_that_the_program_or_the_file_beside_it_declares_are_known() -> None:
    require_declared(krl_lines([*DECLARED, b"DECL INT N", b"N=1"]), DAT)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        (b"PTP XHOME", "XHOME"),
        (b"LIN XP9", "XP9"),
        (b"CIRC XP1,XP2", "XP2"),
        (b"$VEL.CP=FAST", "FAST"),
        (b"XP3={X 1,Y 2,Z 3,A 0,B 0,C 180}", "XP3"),
        (b"FDAT_ACT=FP2", "FP2"),
        (b"B=1", "B"),
    ],
)
def test_a_name_that_nothing_declares_is_refused_with_its_line(line: bytes, name: str) -> None:
    with pytest.raises(DeviceRefused, match=rf"line 11: neither the program nor the \.dat .* declares {name}\. Put"):
        require_declared(krl_lines([*DECLARED, line]), DAT)


def test_a_name_of_polishds_own_is_refused() -> None:
    with pytest.raises(DeviceRefused, match=r"declares POLISHD_BLOCK, and names .* Rename it"):
        require_declared(krl_lines([b"DECL INT POLISHD_BLOCK", b"WAIT SEC 1"]), b"")


def test_a_program_of_another_language_is_refused() -> None:
    with pytest.raises(DeviceRefused, match="cannot be followed"):
        krl_lines([b"G1 X1 F60", b"M2"])
    with pytest.raises(DeviceRefused, match="no line of the program moves"):
        krl_lines([b"DEF P( )", b"END"])


# Samples.

AT_REST = KukaSample(
    "#P_ACTIVE", "POLISHD", "#P_ACTIVE", "#AUT", 1.0, True, False, True, TOKEN, KrlPhase.WAITS, 0.0, 0, 10.0, 1
)


def values(**other: str) -> dict[str, str]:
    found = dict.fromkeys(READ_NAMES, "0")
    found |= {
        "$PRO_STATE1": "#P_ACTIVE",
        "$PRO_NAME1[]": '"POLISHD"',
        "$PRO_STATE0": "#P_ACTIVE",
        "$MODE_OP": "#AUT",
        "$OV_PRO": "100",
        "$PERI_RDY": "TRUE",
    }
    return found | {"$STOPMESS": "FALSE", "$ROB_STOPPED": "TRUE"} | other


def test_a_sample_is_read_from_the_texts_of_the_controller() -> None:
    sample = KukaSample.of(values(POLISHD_CLOCK="2500", POLISHD_SEEN="3", **{"$OV_PRO": "40"}))
    assert (sample.time_s, sample.block, sample.override) == (2.5, 3, 0.4)


@pytest.mark.parametrize(
    "wrong", [{"$OV_PRO": "1x"}, {"$PERI_RDY": "yes"}, {"POLISHD_SEEN": "#A"}, {"$MODE_OP": "100"}, {"$PRO_STATE1": ""}]
)
def test_a_value_of_another_type_is_a_protocol_error(wrong: dict[str, str]) -> None:
    with pytest.raises(ProtocolError, match=next(iter(wrong)).replace("$", ".")):
        KukaSample.of(values(**wrong))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"mode": "#T1"}, "mode T1"),
        ({"drives_ready": False}, "drives are off"),
        ({"stop_message": True}, "stop message"),
        ({"override": 0.5}, "override is at 50 %"),
        ({"selected": "CELL"}, "the program CELL is selected (deselect it"),
        ({"submit_state": "#P_STOP"}, "submit interpreter does not run (select and start SPS"),
        ({"is_watched": False}, "watchdog does not run (call POLISHD_WATCH"),
    ],
)
def test_a_controller_that_would_not_run_it_says_why(change: dict[str, object], why: str) -> None:
    assert why in replace(AT_REST, **change).obstacle()  # type: ignore[arg-type]
    assert AT_REST.obstacle() == ""


class Followed:
    """A tracker of LINES that gets samples."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.tracker = KrlProgramTracker(plan_of(LINES), len(LINES), lambda: self.now_s)
        lines = krl_lines(LINES)
        self.tracker.sent(KrlProgram(lines, (6,), TOKEN), lines)
        self.sample = AT_REST
        self.see(0.0)

    def see(self, time_s: float, *begins: tuple[int, float], **changed: object) -> KrlProgramTracker:
        """A sample at that time after the first; ``begins`` of the blocks since the sample before."""
        block = begins[-1][0] if begins else self.sample.block
        changes = {"block": block, "begins": begins, "run_s": self.run_s(time_s), **changed}
        self.sample = replace(self.sample, time_s=10.0 + time_s, **changes)  # type: ignore[arg-type]
        self.tracker.update(self.sample)
        return self.tracker

    def run_s(self, time_s: float) -> float:
        """Return the run time as the watchdog counts it: all time since the last sample if that ran."""
        ran = self.sample.phase == KrlPhase.RUNS and self.sample.active
        return self.sample.run_s + (time_s + 10.0 - self.sample.time_s if ran else 0.0)

    def runs(self) -> Followed:
        """It was commanded to run, and does."""
        self.tracker.until = len(LINES)
        self.tracker.go(10.0)
        self.see(0.0, phase=KrlPhase.RUNS, robot_stopped=False)
        return self


def test_a_block_ends_when_the_watchdog_saw_the_next_begin() -> None:
    followed = Followed().runs()
    followed.see(0.30, (6, 0.20))
    followed.see(0.60, (7, 0.45))
    tracker = followed.see(0.61)
    assert len(tracker) == 7
    # lines 0 to 4 take no time
    assert [tracker[5].start_s, tracker[5].end_s] == pytest.approx([0.0, 0.20])
    assert [tracker[6].start_s, tracker[6].end_s] == pytest.approx([0.20, 0.45])
    assert tracker[4].end_s == tracker[4].start_s == 0.0


def test_a_slow_reading_loses_the_begin_of_no_block() -> None:
    followed = Followed().runs()
    followed.see(0.90, (5, 0.0), (6, 0.20), (7, 0.45), (8, 0.70))
    tracker = followed.see(0.91)
    assert [tracker[seq].end_s for seq in range(5, 8)] == pytest.approx([0.20, 0.45, 0.70])


def test_blocks_that_ended_within_one_cycle_of_the_watchdog_share_its_time() -> None:
    followed = Followed().runs()
    followed.see(0.30, (5, 0.0), (6, 0.20), (7, 0.20))  # two moves
    tracker = followed.see(0.31)
    assert [tracker[seq].end_s - tracker[seq].start_s for seq in (5, 6)] == pytest.approx([0.10, 0.10])


def test_a_block_counts_only_with_a_second_sample() -> None:
    followed = Followed().runs()
    assert len(followed.see(0.3, (7, 0.2))) == 0
    with pytest.raises(ProtocolError, match="block 6 of 9, after block 7"):
        followed.see(0.4, block=6)


def test_a_damaged_begin_lies_within_the_samples_and_a_running_time_does_not_fall() -> None:
    followed = Followed().runs()
    followed.see(0.1)
    followed.see(0.30, (6, 71.0))
    tracker = followed.see(0.31, (7, 0.001))
    assert tracker[5].end_s == pytest.approx(0.31)
    tracker = followed.see(0.50)
    assert tracker[6].end_s == pytest.approx(0.31)
    with pytest.raises(ProtocolError, match="0 s of running, after 0"):
        followed.see(0.6, run_s=0.0)


def test_no_time_passes_while_it_is_held() -> None:
    followed = Followed().runs()
    followed.see(0.2, (6, 0.1))
    followed.tracker.holds = True
    followed.see(0.3, state="#P_STOP", robot_stopped=True)
    tracker = followed.see(9.0)
    assert tracker.state == "held"
    assert tracker.clock_s == pytest.approx(0.3)
    tracker.go(19.0)
    followed.see(9.1, state="#P_ACTIVE", robot_stopped=False)
    followed.see(9.5, (7, 0.6))
    followed.see(9.6)
    assert tracker[6].end_s - tracker[6].start_s == pytest.approx(0.5)


def test_a_dwell_right_behind_a_stop_lasts_as_long_as_programmed() -> None:
    followed = Followed().runs()
    followed.tracker.until = 7
    followed.see(0.3, (6, 0.1), (7, 0.2), run_s=0.2, phase=KrlPhase.WAITS, robot_stopped=True)
    followed.see(0.4)
    followed.tracker.until = 9
    followed.tracker.go(10.4)
    followed.see(9.0)
    followed.see(9.5, (8, 0.45), (9, 0.45), run_s=0.55, phase=KrlPhase.RUNS)
    tracker = followed.see(9.6)
    assert len(tracker) == 9
    assert tracker[7].end_s - tracker[7].start_s == pytest.approx(0.25)


def test_a_stop_at_the_pendant_is_a_fault_at_once() -> None:
    tracker = Followed().runs().see(0.2, state="#P_STOP")
    assert (tracker.state, tracker.detail) == ("fault", "the program was stopped at the controller")


def test_a_stop_at_the_pendant_leaves_no_block_out_that_was_reported() -> None:
    followed = Followed().runs()
    tracker = followed.see(0.3, (5, 0.0), (6, 0.2), (7, 0.25), state="#P_STOP")
    assert (tracker.state, len(tracker)) == ("fault", 0)
    followed.see(0.4)
    assert (tracker.state, len(tracker)) == ("fault", 7)


def test_another_program_is_a_fault() -> None:
    tracker = Followed().runs().see(0.2, token=3)
    assert "another program" in tracker.detail


def test_it_is_held_at_a_stop_and_does_not_begin_too_late() -> None:
    followed = Followed().runs()
    followed.tracker.until = 6
    followed.see(0.3, (6, 0.2), phase=KrlPhase.WAITS, robot_stopped=True)
    tracker = followed.see(0.4)
    assert (tracker.state, tracker.held_at) == ("held", 6)
    tracker.until = 9
    tracker.go(10.4)
    followed.now_s = 4.0
    assert followed.see(0.5).state == "running"
    followed.now_s = 6.0
    assert followed.see(0.6).detail == "it does not begin block 6"


def test_a_wait_that_is_reported_before_its_block_is_no_fault() -> None:
    followed = Followed().runs()
    followed.tracker.until = 6
    followed.now_s = 60.0  # the command was given long ago
    followed.see(0.3, (5, 0.2), phase=KrlPhase.WAITS, robot_stopped=True)
    assert followed.see(0.4, (6, 0.3)).state != "fault"
    tracker = followed.see(0.5)
    assert (tracker.state, tracker.held_at) == ("held", 6)


def test_the_end_needs_all_blocks() -> None:
    followed = Followed().runs()
    followed.see(0.3, (8, 0.2))
    assert followed.see(0.5, phase=KrlPhase.DONE, state="#P_END", robot_stopped=True).state == "running"
    followed.see(0.6, (9, 0.5))
    tracker = followed.see(0.7)
    assert (tracker.state, len(tracker)) == ("done", 9)
