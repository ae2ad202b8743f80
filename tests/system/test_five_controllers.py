"""Two passes on five controllers with different delays, for the table in docs/reference/results.md.

After all of them, ``python -m tests.system.five_controllers`` writes the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from tests.system.five_controllers import FIVE, PAGE, SLOW_PLC, Controller, Figures, link_like, polish, rows_of, save

pytestmark = pytest.mark.system

PREDICTED, ACCOUNTED, AS_GOOD = 0.01, 1e-3, 0.1
AS_CERTIFIED = 3.0
"""Permitted multiple of the certified RMS: a robot link without delays leaves 2.2 to 2.9 times as much (results.md)."""
SLOW = ("linuxcnc",)
"""LinuxCNC runs in real time only."""


@pytest.fixture(scope="module")
def of_the_link(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Controller], float]:
    """Return a function for the RMS in nm that a robot link leaves; each one is run once."""

    @cache
    def rms_nm(controller: Controller) -> float:
        return polish(tmp_path_factory.mktemp("link") / "cell", controller).rms_nm[-1]

    return rms_nm


CASES = [
    pytest.param(one, id=one.name, marks=pytest.mark.slow if one.kind in SLOW else pytest.mark.full) for one in FIVE
]


@pytest.mark.parametrize("controller", CASES)
def test_what_was_learned_predicts_a_pass_and_all_of_it_is_accounted_for(
    tmp_path: Path, controller: Controller, of_the_link: Callable[[Controller], float]
) -> None:
    """Acceptance: the second pass within 1 %, contact times within 0.1 %, and an RMS as good as over a robot link."""
    found = polish(tmp_path / "cell", controller)
    if controller.kind != "link":
        found = replace(found, link_rms_nm=of_the_link(link_like(controller)))
    save(found)
    require_good(found)
    if controller.beyond_s is not None:
        assert abs(found.missed[0]) > PREDICTED, "the first pass cannot know"


@pytest.mark.slow
def test_a_floor_of_290_ms_a_point_is_in_the_certificate(
    tmp_path: Path, of_the_link: Callable[[Controller], float]
) -> None:
    """Acceptance against the certificate with that additional time, which the first pass estimates for the second."""
    found = replace(polish(tmp_path / "cell", SLOW_PLC), link_rms_nm=of_the_link(link_like(SLOW_PLC)))
    save(found)
    require_good(found)
    assert found.beyond_ms == pytest.approx(290.0, abs=1.0)
    assert found.certified_nm[1] < found.rms_nm[2] < AS_CERTIFIED * found.certified_nm[1]


def require_good(found: Figures) -> None:
    assert abs(found.missed[1]) < PREDICTED, found
    assert max(map(abs, found.unaccounted)) < ACCOUNTED, found
    assert found.rms_nm[2] < found.rms_nm[1] < 0.3 * found.rms_nm[0], found
    if found.link_rms_nm is not None:
        assert found.rms_nm[2] == pytest.approx(found.link_rms_nm, rel=AS_GOOD), found


def test_the_table_shows_nothing_that_would_not_pass() -> None:
    rows = rows_of(PAGE.read_text())
    assert {row[0] for row in rows} <= {controller.name for controller in (*FIVE, SLOW_PLC)}
    for name, _, _, missed, unaccounted, *_ in rows:
        assert abs(float(missed.split(", ")[1])) < 100 * PREDICTED, name
        assert max(abs(float(share)) for share in unaccounted.split(", ")) < 100 * ACCOUNTED, name
