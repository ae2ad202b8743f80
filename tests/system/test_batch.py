"""The batch plant as a process, over its pipes."""

from __future__ import annotations

import io
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from polishd.model.surface import FloatArray
from polishd.util import array_stream
from tests.time_limits import SOON_S

SMALL = {"plant": {"aperture_mm": 40.0, "rms_nm": 5.0, "pv_nm": 40.0, "seed": 4}}
Answers = list[tuple[dict[str, Any], dict[str, FloatArray]]]


def asked(*requests: tuple[dict[str, Any], dict[str, FloatArray]], tail: bytes = b"") -> tuple[int, Answers]:
    """Run the requests in a new process and return its exit code and answers."""
    sent = io.BytesIO()
    for message, arrays in requests:
        array_stream.write(sent, message, arrays)
    ended = subprocess.run(
        [sys.executable, "-m", "polishd.sim_backends.batch"],
        input=sent.getvalue() + tail,
        capture_output=True,
        timeout=SOON_S,
        check=False,
    )
    assert ended.stderr == b""
    output, answers = io.BytesIO(ended.stdout), []
    while (answer := array_stream.read(output)) is not None:
        answers.append(answer)
    return ended.returncode, answers


def line() -> dict[str, FloatArray]:
    """Return twenty blocks of 1 mm."""
    x = np.arange(-10.0, 10.0)
    zero = np.zeros(20)
    return {
        "begin_mm": np.column_stack([x, zero, zero]),
        "end_mm": np.column_stack([x + 1.0, zero, zero]),
        "axis": np.tile([0.0, -np.sin(np.radians(15.0)), np.cos(np.radians(15.0))], (20, 1)),
        "seconds": np.full(20, 0.2),
        "force_n": np.full(20, 12.0),
        "rpm": np.full(20, 1000.0),
    }


@pytest.mark.full
def test_a_pass_and_what_is_wrong_with_requests() -> None:
    wrong = {**line(), "rpm": np.zeros(3)}
    code, answers = asked(
        ({"do": "truth"}, {}),
        ({"do": "new", "config": {"plant": {"colour": 1}}}, {}),
        ({"do": "new", "config": SMALL}, {}),
        ({"do": "truth"}, {}),
        ({"do": "polish"}, wrong),
        ({"do": "polish"}, line()),
        ({"do": "measure"}, {}),
        ({"do": "truth"}, {}),
    )
    early, unknown, _, (_, before), short, (done, executed), (_, seen), (_, after) = answers
    assert code == 0
    assert "Send new first" in early[0]["error"]
    assert "config.plant.colour" in unknown[0]["error"]
    assert "rpm is of shape (3,)" in short[0]["error"]
    assert done["now_s"] == pytest.approx(4.0)
    assert executed["contact_s"] == pytest.approx(np.full(20, 0.2))
    assert executed["force_n"] == pytest.approx(np.full(20, 12.0), rel=0.1)
    inside = np.isfinite(seen["height_nm"])
    assert (before["height_nm"] - after["height_nm"])[inside].max() > 1.0
    assert np.std((seen["height_nm"] - after["height_nm"])[inside]) == pytest.approx(0.3, rel=0.1)


@pytest.mark.full
def test_a_frame_without_end_ends_it() -> None:
    code, answers = asked(tail=b"no json\n")
    assert code == 1
    assert "a line of JSON" in answers[0][0]["error"]
