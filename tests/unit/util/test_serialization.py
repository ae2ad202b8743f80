"""Values that json alone cannot write."""

from __future__ import annotations

import json
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from polishd.daemon.socket.client import address_of
from polishd.model.states import Outcome
from polishd.model.surface import SurfaceStats
from polishd.util.serialization import plain


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.int64(3), 3),
        (np.float32(0.5), 0.5),
        (np.bool_(True), True),
        (np.array([[1, 2]]), [[1, 2]]),
        (Path("a/b"), "a/b"),
        (Outcome.DIVERGED, "diverged"),
        (MappingProxyType({"a": np.int64(1)}), {"a": 1}),
        (
            SurfaceStats(1.0, 2.0, 3.0, None, 4),
            {"rms_nm": 1.0, "pv_nm": 2.0, "lsf_rms_nm": 3.0, "band_rms_nm": None, "samples": 4},
        ),
        ((1, None, "x"), [1, None, "x"]),
    ],
)
def test_becomes_json(value: Any, expected: Any) -> None:
    assert json.loads(json.dumps({"value": value}, default=plain)) == {"value": expected}


def test_short_addresses_are_themselves(tmp_path: Path) -> None:
    with address_of(Path("/run/polishd.sock")) as address:
        assert address == "/run/polishd.sock"
    deep = tmp_path / ("d" * 120)
    deep.mkdir()
    with address_of(deep / "polishd.sock") as address:
        assert len(address) < 100
        assert Path(address).parent.resolve() == deep
    assert not Path(address).parent.exists()
