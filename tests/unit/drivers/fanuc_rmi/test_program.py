"""TP program lines as instructions: what is read, rounding, and what is refused with line and remedy."""

from __future__ import annotations

import pytest

from polishd.api import DeviceRefused
from polishd.drivers.fanuc_rmi.driver import _takes
from polishd.drivers.fanuc_rmi.program import RmiInstruction, TpReader, instructions_of

HEAD = ["/PROG  P", "/ATTR", 'COMMENT = "Eign. f\xfcr" ;', "/MN"]
POSITION = """P[%d%s]{
   GP1:
\tUF : 1, UT : 2,\t\tCONFIG : 'F L D B, 1, 0, -1',
\tX = %s mm,\tY = 0.000 mm,\tZ = 3.500 mm,
\tW = 180.0 deg,\tP = 0.0 deg,\tR = 90.0 deg
};"""
FEED_S = 0.2504


def program(*body: str, x_mm: tuple[float, ...] = (0.0, 10.0, 20.0, 30.0)) -> list[bytes]:
    lines = [*HEAD, *(f"{number:4d}:{line}" for number, line in enumerate(body, 1)), "/POS"]
    for number, x in enumerate(x_mm, 1):
        lines += (POSITION % (number, ':"first"' if number == 1 else "", x)).splitlines()
    return [line.encode("latin-1") for line in [*lines, "/END"]]


def read(*body: str) -> list[RmiInstruction]:
    return list(instructions_of(program(*body)))


def test_a_move_has_its_target_with_frames_and_configuration_its_speed_and_its_end() -> None:
    (move,) = read("L P[2] 20mm/sec CNT100 ACC50    ;")
    assert move.block == len(HEAD)
    assert move.fields == {
        "Instruction": "FRC_LinearMotion",
        "Configuration": {
            "UToolNumber": 2, "UFrameNumber": 1, "Front": 0, "Up": 0, "Left": 1, "Flip": 1, "Turn4": 1, "Turn5": 0,
            "Turn6": -1,
        },
        "Position": {"X": 10.0, "Y": 0.0, "Z": 3.5, "W": 180.0, "P": 0.0, "R": 90.0},
        "SpeedType": "mmSec", "Speed": 20, "TermType": "CNT", "TermValue": 100, "ACC": 50,
    }  # fmt: skip


def test_waits_joint_moves_and_lines_that_do_nothing() -> None:
    found = read("!a remark ;", "UFRAME_NUM=1 ;", "J P[1] 30% FINE ;", "  WAIT   .25(sec) ;", "LBL[1:a] ;", ";")
    assert [one.fields["Instruction"] for one in found] == ["FRC_JointMotion", "FRC_WaitTime"]
    assert found[0].fields["Speed"] == 30
    assert (found[1].fields["Time"], found[1].seconds) == (0.25, 0.25)


def test_a_speed_with_a_fraction_is_the_time_of_the_move_and_rounding_goes_into_the_next() -> None:
    found = read(*(f"L P[{number}] 12.7mm/sec CNT100 ;" for number in (1, 2, 3, 4)))
    assert [one.fields["SpeedType"] for one in found] == ["mmSec", "mSec", "mSec", "mSec"], "the first has no length"
    ms = [one.fields["Speed"] for one in found[1:]]
    assert sum(ms) == pytest.approx(3 * 10.0 / 12.7 * 1000.0, abs=0.5)
    assert len(set(ms)) == 2


@pytest.mark.parametrize("speed", [f"{FEED_S}sec", f"{FEED_S * 1000:g}msec"])
def test_a_time_of_a_move_is_sent_in_whole_milliseconds_that_add_up(speed: str) -> None:
    found = read(*(f"L P[{1 + number % 4}] {speed} CNT100 ;" for number in range(100)))
    assert sum(one.fields["Speed"] for one in found) == pytest.approx(100 * FEED_S * 1000.0, abs=0.5)
    assert found[1].seconds == found[1].fields["Speed"] / 1000.0


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("CALL OTHER ;", "L, J, WAIT and comments only"),
        ("DO[1]=ON ;", "cannot be sent over RMI"),
        ("WAIT DI[1]=ON ;", "cannot be sent over RMI"),
        ("L P[9] 20mm/sec FINE ;", "lacks"),
        ("L P[1] 20mm/sec FINE Offset,PR[1] ;", "option Offset"),
        ("L P[1] 20mm/sec HALF ;", "FINE or CNT"),
        ("L P[1] 0mm/sec FINE ;", "speed"),
        ("L P[1] 0.0sec FINE ;", "time"),
        ("L P[1] 20deg/sec FINE ;", "cannot be sent"),
        ("UTOOL_NUM=1 ;", "another frame"),
        ("L P[1] 20mm/sec FINE", "no statement"),
    ],
)
def test_what_is_not_sent_is_refused_by_block_with_a_remedy(line: str, said: str) -> None:
    with pytest.raises(DeviceRefused, match=f"block {len(HEAD) + 1}.*{said}"):
        read("L P[1] 20mm/sec FINE ;", line)


def test_positions_in_two_frames_or_of_joints_are_refused() -> None:
    lines = program("L P[1] 20mm/sec FINE ;")
    other = [line.replace(b"UF : 1", b"UF : 3") for line in program()[len(HEAD) + 1 : -1]]
    with pytest.raises(DeviceRefused, match="several frames"):
        TpReader.of([*lines, *other[:6], *other[6:12]])
    joints = [line.replace(b"X = ", b"J1 = ") for line in lines]
    with pytest.raises(DeviceRefused, match=r"P\[1\] lacks"):
        TpReader.of(joints)


def configured(config: str) -> list[bytes]:
    """A program with another CONFIG at its first position."""
    lines = program("J P[1] 30% FINE ;")
    at = next(number for number, line in enumerate(lines) if b"CONFIG" in line)
    lines[at] = lines[at].replace(b"'F L D B, 1, 0, -1'", b"'" + config.encode() + b"'")
    return lines


@pytest.mark.parametrize(
    ("config", "arm"),
    [
        ("N U T, 0, 0, 0", (0, 0, 1, 1, 0, 0, 0)),
        ("NUT,0,0,0", (0, 0, 1, 1, 0, 0, 0)),
        ("F R U B , -1 , 0 , 1", (1, 0, 1, 0, -1, 0, 1)),
        ("FLDT, 0, 2, 0", (1, 1, 0, 1, 0, 2, 0)),
    ],
)
def test_a_configuration_is_read_with_and_without_blanks(config: str, arm: tuple[int, ...]) -> None:
    (move,) = instructions_of(configured(config))
    sent = move.fields["Configuration"]
    assert tuple(sent[key] for key in ("Flip", "Left", "Up", "Front", "Turn4", "Turn5", "Turn6")) == arm


@pytest.mark.parametrize(
    "config",
    ["", "N U T", "N U T, 0, 0", "N U T, 0, 0, 0, 0", "N U, 0, 0, 0", "N F U T, 0, 0, 0", "N U T T, 0, 0, 0",
     "X U T, 0, 0, 0", "n u t, 0, 0, 0", "N U T, a, 0, 0", "N U T, 0.5, 0, 0", "* * *, 0, 0, 0"],
)  # fmt: skip
def test_a_configuration_that_is_not_known_is_refused_by_line(config: str) -> None:
    """It is not sent as zeros: the robot would reach the target with another arm, and may flip on the way."""
    lines = configured(config)
    line = next(number for number, text in enumerate(lines, 1) if b"CONFIG" in text)
    with pytest.raises(DeviceRefused) as refused:
        list(instructions_of(lines))
    assert f"line {line}: the CONFIG of P[1] is '{config}', not N or F" in str(refused.value)
    assert "N U T, 0, 0, 0" in str(refused.value)


def test_the_device_type_refuses_programs_of_other_languages() -> None:
    assert not _takes(program("L P[1] 20mm/sec FINE ;"))
    assert "no statement" in _takes([b"G1 X1 F60"])
    assert "no line" in _takes(program("!nothing ;"))
