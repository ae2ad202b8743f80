"""The last look at a plan: a good one passes, and each broken limit is named with line and value."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from polishd.api import Envelope, Plan, Program, Segment
from polishd.model.surface import Grid
from polishd.plugins.plan_checks import polishd_check_plan
from tests.rs274 import read

ENVELOPE = Envelope(
    max_feed_mm_s=50.0, min_feed_mm_s=0.5, accel_mm_s2=800.0, block_overhead_s=0.0, corner_deg=30.0,
    x_mm=(-90.0, 90.0), y_mm=(-90.0, 90.0), z_mm=(-1.0, 60.0), max_removal_nm=1000.0, max_pass_s=7200.0,
)  # fmt: skip
FEED = b"G21 G90 G94\nG0 X0 Y0 Z20\nG0 Z0\nG1 X10 F600\nX20 F300\nX30 F200\nG0 Z20\nM2\n"
DWELL = b"G21 G90 G94\nG0 X0 Y0 Z0\nG1 X10 F600\nG4 P1\nG1 X20\nG4 P2\nM2\n"


def plan_of(text: bytes = FEED) -> Plan:
    program = read(text, "t.rnc")
    segments = tuple(Segment(seq, block) for seq, block in enumerate(program.blocks))
    return Plan(
        program=program,
        approach_blocks=int(program.block[0]),
        contact_blocks=int(program.block[-1]) + 1,
        expected_time_s=program.time_s + 0.01,
        predicted_removal_nm=np.full((4, 5), 12.0),
        segments=segments,
    )


def judge(plan: Plan, envelope: Envelope = ENVELOPE) -> list[str]:
    return list(polishd_check_plan(plan, envelope))


def with_program(**changes: object) -> Plan:
    plan = plan_of()
    return replace(plan, program=replace(plan.program, **changes))


def changed(column: str, index: tuple[int, ...], value: float) -> Plan:
    array = np.array(getattr(plan_of().program, column))
    array[index] = value
    return with_program(**{column: array})


@pytest.mark.parametrize("text", [FEED, DWELL, FEED.replace(b"\n", b"\r\n")])
def test_a_good_plan_passes(text: bytes) -> None:
    assert judge(plan_of(text)) == []
    assert judge(replace(plan_of(text), segments=())) == []


def test_the_hash_covers_the_file_beside_the_program() -> None:
    both = hashlib.sha256(FEED + b"DEFDAT").hexdigest()
    assert judge(with_program(beside=b"DEFDAT", sha256=both)) == []
    assert "sha256" in judge(with_program(beside=b"DEFDAT "))[0]


BAD: dict[str, tuple[Callable[[], Plan], str]] = {
    "x outside": (
        lambda: changed("end_mm", (1, 0), 91.0),
        "line 5: ends at x = 91 mm, outside -90 to 90 mm (machine.x_mm); the path needs 0 to 91 mm",
    ),
    "z below": (
        lambda: changed("start_mm", (0, 2), -1.5),
        "line 4: starts at z = -1.5 mm, outside -1 to 60 mm (machine.z_mm)",
    ),
    "NaN position": (lambda: changed("end_mm", (2, 1), np.nan), "line 6: ends at y = nan"),
    "no unit axis": (lambda: changed("axis", (2, 2), 0.9), "line 6: tool axis of length 0.9"),
    "jump": (lambda: changed("start_mm", (1, 1), 5.0), "line 5: an untimed move of 5 mm leads here, in contact"),
    "too fast": (
        lambda: changed("time_s", (0,), 0.1),
        "line 4: asks for 100 mm/s, above 50 mm/s (machine.max_feed_mm_s)",
    ),
    "too slow": (
        lambda: changed("time_s", (2,), 100.0),
        "line 6: asks for 0.1 mm/s, below 0.5 mm/s (machine.min_feed_mm_s)",
    ),
    "NaN time": (lambda: changed("time_s", (2,), np.nan), "line 6: asks for a time of nan s"),
    "no time": (lambda: changed("time_s", (2,), 0.0), "line 6: asks for a time of 0 s"),
    "program's feed": (
        lambda: with_program(max_feed_mm_min=6000.0),
        "a feed of 100 mm/s, above 50 mm/s (machine.max_feed_mm_s)",
    ),
    "another text": (lambda: with_program(text=FEED + b"\n"), "sha256"),
    "not in order": (lambda: with_program(block=np.array([3, 5, 4])), "not in the program's order"),
    "beyond the text": (lambda: with_program(block=np.array([3, 4, 50])), "only 9 lines"),
    "approach": (lambda: replace(plan_of(), approach_blocks=2), "line 4: first timed point in block 3"),
    "contact": (lambda: replace(plan_of(), contact_blocks=7), "line 6: last timed point in block 5"),
    "expected too fast": (
        lambda: replace(plan_of(), expected_time_s=np.array([1.0, 0.1, 3.0])),
        "line 5: is expected at",
    ),
    "expected NaN": (
        lambda: replace(plan_of(), expected_time_s=np.array([1.0, np.nan, 3.0])),
        "line 5: is expected to",
    ),
    "expected zero": (lambda: replace(plan_of(), expected_time_s=np.array([0.0, 2.0, 3.0])), "line 4: is expected to"),
    "expected shape": (lambda: replace(plan_of(), expected_time_s=np.ones(2)), "expected times of shape (2,)"),
    "expected too long": (
        lambda: replace(plan_of(), expected_time_s=np.full(3, 2401.0)),
        "the pass is expected to take 7203 s, more than limits.max_pass_s = 7200 s: set it to 7203 or more",
    ),
    "too deep": (
        lambda: replace(plan_of(), predicted_removal_nm=np.full((2, 2), 1001.0), grid=Grid(2, 2, 3.0)),
        "1001 nm at x -1.5, y 1.5 mm of the part, more than limits.max_removal_nm = 1000 nm. Check process.preston",
    ),
    "too deep somewhere": (
        lambda: replace(plan_of(), predicted_removal_nm=np.full((2, 2), 1001.0)),
        "the predicted removal is 1001 nm, more than limits.max_removal_nm",
    ),
    "negative": (lambda: replace(plan_of(), predicted_removal_nm=np.full((2, 2), -1.0)), "falls to -1 nm"),
    "removal NaN": (lambda: replace(plan_of(), predicted_removal_nm=np.full((2, 2), np.nan)), "not finite"),
    "no removal": (lambda: replace(plan_of(), predicted_removal_nm=np.zeros((0, 0))), "not finite"),
    "segment missing": (lambda: replace(plan_of(), segments=plan_of().segments[:4]), "4 segments"),
    "segment changed": (
        lambda: replace(plan_of(), segments=(*plan_of().segments[:4], Segment(4, b"X99"), *plan_of().segments[5:])),
        "line 5: segment 4 is b'X99'",
    ),
    "segment numbers": (
        lambda: replace(plan_of(), segments=tuple(Segment(s.seq + 1, s.text) for s in plan_of().segments)),
        "line 1: segment 1",
    ),
}


@pytest.mark.parametrize("case", BAD, ids=str)
def test_each_violation_is_named(case: str) -> None:
    make, expected = BAD[case]
    assert any(expected in violation for violation in judge(make())), judge(make())


def test_many_lines_are_counted() -> None:
    body = b"".join(b"G1 X%d F600\n" % x for x in range(80, 120))
    found = judge(plan_of(b"G21 G90 G94\nG0 X0 Y0 Z0\n" + body + b"M2\n"))
    counted = "(so at 28 of 40 points, the last in line 42)"
    assert found == [
        f"line 15: starts at x = 91 mm, outside -90 to 90 mm (machine.x_mm); the path needs 0 to 119 mm {counted}"
    ]


def test_no_points() -> None:
    plan = plan_of()
    names = ("line", "block", "start_mm", "end_mm", "axis", "time_s")
    empty: Program = replace(plan.program, **{name: getattr(plan.program, name)[:0] for name in names})
    found = judge(replace(plan, program=empty, expected_time_s=np.zeros(0)))
    assert "the plan has no timed points" in found


def test_limits_that_are_nan_veto() -> None:
    nan = float("nan")
    assert judge(plan_of(), replace(ENVELOPE, max_feed_mm_s=nan))
    assert judge(plan_of(), replace(ENVELOPE, max_removal_nm=nan))
    assert judge(plan_of(), replace(ENVELOPE, x_mm=(nan, nan)))
