"""What polishd puts around a program, and what it refuses to follow."""

from __future__ import annotations

import pytest

from polishd.api import DeviceRefused
from polishd.drivers.universal_robots.rtde import UrRegisters
from polishd.drivers.universal_robots.script import Settings, UrScript, assemble, blocks_of
from polishd.sim_backends.universal_robots.urscript import parse

MOVE = b"  movel(p[0.1, 0, 0.06, 0, 3.14, 0], a=1, v=0.02)"
PROGRAM = [
    b"# posted",
    b"P1 = p[0, 0, 0.06, 0, 3.14, 0]",
    b"def old():",
    b"  movej_speed = 3",
    b"end",
    b"def polish():",
    b"  set_tcp(p[0, 0, 0.1, 0, 0, 0])",
    MOVE,
    b"  sleep(0.500)  # here",
    b"  movel(P1, a=1, v=0.02)",
    b"  sleep(.25)",
    b"end",
    b"polish()",
]
SETTINGS = Settings(UrRegisters(), watchdog_s=8.0)


def script(start: int = 0, spent_s: float = 0.0, settings: Settings = SETTINGS) -> UrScript:
    return assemble(blocks_of(PROGRAM), start, spent_s, 4711, settings)


def lines(found: UrScript) -> list[str]:
    return [line.strip() for line in found.text.decode().splitlines()]


def test_each_line_that_acts_is_announced_and_none_is_changed() -> None:
    found = lines(script())
    for seq in (7, 8, 9, 10):
        at = found.index(f"polishd_at({seq})")
        assert found[at + 1] == PROGRAM[seq].decode().strip()
    assert sum(line.startswith("polishd_at(") for line in found) == 4
    assert "set_tcp(p[0, 0, 0.1, 0, 0, 0])" in found
    assert "P1 = p[0, 0, 0.06, 0, 3.14, 0]" in found


def test_the_frame_of_the_file_and_uncalled_routines_are_left_out() -> None:
    found = lines(script())
    assert "movej_speed = 3" not in found
    assert not {"def polish():", "def old():", "polish()"} & set(found)


def test_it_is_one_program_that_the_controller_can_read() -> None:
    assert parse(script().text.decode()).name == "polishd"


def test_it_moves_only_for_its_own_token_and_stops_when_it_hears_nothing() -> None:
    found = script().text.decode()
    assert "read_input_integer_register(25) != 4711 or read_input_integer_register(26) <= seq" in found
    assert 'rtde_set_watchdog("input_int_register_24", 0.125, "stop")' in found


def test_registers_and_the_tools_axis_are_as_configured() -> None:
    found = script(settings=Settings(UrRegisters(30), 2.0, into_part=False)).text.decode()
    assert 'rtde_set_watchdog("input_int_register_30", 0.5, "stop")' in found
    assert "p[0, 0, 1, 0, 0, 0]" in found
    assert "p[0, 0, -1, 0, 0, 0]" in script().text.decode()


def test_from_a_block_on_what_takes_no_time_is_said_again_and_a_dwell_is_what_is_left_of_it() -> None:
    found = lines(script(8, 0.2))
    assert "polishd_at(7)" not in found
    assert MOVE.decode().strip() not in found
    assert "set_tcp(p[0, 0, 0.1, 0, 0, 0])" in found
    assert found[found.index("polishd_at(8)") + 1] == "sleep(0.3000)  # here"
    assert found[found.index("polishd_at(10)") + 1] == "sleep(.25)"


def test_a_complaint_names_the_block() -> None:
    found = script()
    at = lines(found).index(MOVE.decode().strip())
    assert found.names(at + 1) == "block 7"
    assert found.names(1) == "line 1, which polishd adds"
    assert found.names(10_000) == "line 10000, which polishd adds"


def test_an_arc_is_not_gone_on_with_from_within() -> None:
    blocks = blocks_of([MOVE, b"movec(P1, P2, a=1, v=0.02)"])
    assert assemble(blocks, 1, 0.0, 1, SETTINGS).text
    with pytest.raises(DeviceRefused, match="arc"):
        assemble(blocks, 1, 0.1, 1, SETTINGS)


@pytest.mark.parametrize(
    "line", [b"while True:", b"  if x == 1:", b"thread other():", b"def inner():", b"  while i < 3 :  "]
)
def test_what_cannot_be_followed_is_refused(line: bytes) -> None:
    with pytest.raises(DeviceRefused, match=r"block 2: loops, branches"):
        blocks_of([b"def polish():", MOVE, line, b"end", b"end"])


def test_a_program_in_another_language_is_refused() -> None:
    with pytest.raises(DeviceRefused, match="format"):
        blocks_of([b"G1 X1 F60", b"M2"])
