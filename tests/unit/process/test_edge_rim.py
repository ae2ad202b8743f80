"""How far inside a round part's rim a point lies."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.process.edge.rim import round_rim


def test_a_round_part() -> None:
    at = np.array([[0.0, 0.0], [28.0, 0.0], [0.0, -30.0], [3.0, 4.0]])
    np.testing.assert_allclose(round_rim(28.0).inside_mm(at), [28, 0, -2, 23], atol=1e-12)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_what_is_no_part_is_refused(radius: float) -> None:
    with pytest.raises(ComputeError, match="the part's radius"):
        round_rim(radius)
