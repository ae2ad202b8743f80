"""A fit begins where the removal is, however far off that is from where it was thought to be."""

from __future__ import annotations

import pytest

from polishd.model.surface import FloatArray
from polishd.process.identification.fit import initial_guess
from polishd.process.identification.forward_model import build_forward_model
from tests.unit.process.identification.identified import PROCESS, RADIUS_MM, knowing, polished, spot


def begun(names: str, **truth: float) -> FloatArray:
    one, known = polished(), knowing(names)
    removed = one.removed(truth)
    model = build_forward_model(
        one.blocks(),
        removed.grid,
        removed.mask,
        spot(),
        PROCESS,
        parameters=known.parameters,
        projection="linear",
        radius_mm=RADIUS_MM,
    )
    return initial_guess(model, removed, known)[
        [known.at(name) for name in known.names if name[:6] in {"offset", "shift_"}]
    ]


@pytest.mark.full
def test_what_fits_begins_at_what_was_known() -> None:
    assert not begun("offset", rate=0.1, offset_x=0.1).any()


@pytest.mark.full
def test_where_the_noise_is_all_there_is_nothing_to_look_for() -> None:
    assert not begun("offset", rate=-6.0, offset_x=3.0).any()


@pytest.mark.full
@pytest.mark.parametrize(("names", "kind"), [("offset", "offset"), ("shift", "shift"), ("offset shift", "shift")])
def test_what_is_far_off_begins_near_where_it_is(names: str, kind: str) -> None:
    step_mm = 0.8
    found = begun(names, **{f"{kind}_x": 1.5, f"{kind}_y": -2.2, "rate": -0.2})
    own = found[-2:]
    assert own == pytest.approx((1.5, -2.2), abs=step_mm)
    assert not found[:-2].any()
