"""The simulated controller's RAPID: data, branches, traps, and what it refuses with its line."""

from __future__ import annotations

from typing import Any

import pytest

from polishd.config.simulator_devices import SimRobotSection
from polishd.model.errors import ProgramError
from polishd.sim_backends.abb_rws.controller import AbbController
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.trajectory import Limits

TAIL = "[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]"


def controller(text: str) -> AbbController:
    motion = SimMotion(Limits(1000.0, 0.0, 30.0, 100.0, 100.0, 1.0), (0.0, 0.0, 60.0, 0.0, 0.0))
    made = AbbController(SimRobotSection(), motion, lambda *_args, **_data: None, 0.0, 1)
    for _ in made.loading("T_ROB1", text.encode(), replace=True):
        pass
    return made


def ran(text: str, until_s: float = 5.0) -> AbbController:
    made = controller(text)
    made.tick(0.0)
    assert made.start() == ""
    for at in range(1, int(until_s / 0.01)):
        made.tick(0.01 * at)
    return made


def value(made: AbbController, name: str) -> Any:
    return made.read("T_ROB1", name)


def test_data_branches_loops_and_calls() -> None:
    made = ran("""
MODULE m
  PERS num sum:=0;  ! a comment with ; and "
  PERS pos at:=[1,2,3];
  PERS bool odd:=FALSE;
  CONST num most:=4;
  PROC add(num n)
    VAR num twice;
    twice:=n*2;
    sum:=sum+twice;
  ENDPROC
  PROC main()
    VAR num k:=0;
    WHILE k<most DO
      k:=k+1;
      IF k MOD 2=1 AND NOT odd THEN
        add k;
      ELSEIF k=2 THEN
        add -k;
      ELSE
        Incr sum;
      ENDIF
    ENDWHILE
    odd:=TRUE;
    at.y:=sum;
  ENDPROC
ENDMODULE
""")
    assert (value(made, "sum"), value(made, "at"), value(made, "odd")) == ("5", "[1,5,3]", "TRUE")
    assert not made.running


def test_the_pointer_runs_ahead_of_fly_by_moves_and_a_trigger_does_not() -> None:
    moves = "\n".join(f"TriggL [[{k},0,60],{TAIL},v10,t,z1,tool0;" for k in range(1, 6))
    text = f"""
MODULE m
  PERS num ahead:=0;
  PERS num passed:=0;
  VAR intnum i;
  VAR triggdata t;
  TRAP at_point
    Incr passed;
  ENDTRAP
  PROC main()
    CONNECT i WITH at_point;
    TriggInt t,0,i;
    {moves}
    ahead:=1;
    WaitRob\\InPos;
    ahead:=2;
  ENDPROC
ENDMODULE
"""
    early = ran(text, 0.15)
    assert (value(early, "ahead"), value(early, "passed"), early.running) == ("1", "1", True)
    assert (value(ran(text), "ahead"), value(ran(text), "passed")) == ("2", "5")


def test_a_moves_time_replaces_its_speed_and_a_wait_begins_behind_it() -> None:
    made = ran(
        f"MODULE m\nPROC main()\nMoveL [[5,0,60],{TAIL},v5\\T:=0.5,fine,tool0;\nWaitTime 0.25;\nENDPROC\nENDMODULE"
    )
    (_, begin_s, move_s), (_, _, wait_s) = made.motion.executed
    assert move_s - begin_s == pytest.approx(0.51, abs=0.02)
    assert wait_s - move_s == pytest.approx(0.25, abs=1e-6)


def test_a_move_out_of_range_ends_the_program_with_its_line() -> None:
    made = ran(f"MODULE m\nPROC main()\nMoveL [[5000,0,60],{TAIL},v5,fine,tool0;\nENDPROC\nENDMODULE")
    assert not made.running
    assert made.log == [(40000, "T_ROB1 line 3: position outside reach: X 5000 is outside -150 to 150")]


@pytest.mark.parametrize(
    ("text", "line", "why"),
    [
        ("MODULE m\nPROC main()\nNoSuch 1;\nENDPROC\nENDMODULE", 3, "unknown entity nosuch"),
        ("MODULE m\nPROC main()\nx:=1\nENDPROC\nENDMODULE", 4, "';' is expected"),
        ("MODULE m\nPROC main()\nFOR k FROM 1 TO 2 DO\nENDFOR\nENDPROC\nENDMODULE", 3, "FOR is not simulated"),
        ("MODULE m\nPERS num a:=1;\nPERS num a:=2;\nENDMODULE", 3, "declared twice"),
        ("MODULE m\nPERS num a;\nENDMODULE", 2, "no value in any task"),
        ("MODULE m\nPROC main()\n", 2, "breaks off"),
        ("G1 X0", 1, "'module' is expected"),
    ],
)
def test_a_module_that_is_wrong_is_refused_with_its_line(text: str, line: int, why: str) -> None:
    with pytest.raises(ProgramError) as refusal:
        controller(text)
    assert why in refusal.value.args[0]
    assert refusal.value.args[1] == line


def test_a_variable_takes_values_of_its_type_only() -> None:
    made = controller("MODULE m\nPERS num a:=1;\nCONST num c:=2;\nENDMODULE")
    assert made.write("T_ROB1", "a", "2.5") == ""
    assert value(made, "a") == "2.5"
    assert "no value of its type" in made.write("T_ROB1", "a", "TRUE")
    assert made.write("T_ROB1", "c", "3") == "the variable is constant"
    assert made.write("T_ROB1", "b", "3") == "the variable does not exist"
    assert value(made, "a") == "2.5"
