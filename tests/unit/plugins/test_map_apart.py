"""Files that crash, hang or fill the process they are read in are refused, and the next file is read."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from polishd.api import BadMap, SurfaceMap
from polishd.plugins.interferometer.formats import apart
from tests.unit.plugins import parsers_apart

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def _fresh_worker(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    apart.close()
    yield
    apart.close()


def read(tmp_path: Path, what: str) -> SurfaceMap:
    path = tmp_path / "map.bin"
    path.write_text(what)
    return apart.read(parsers_apart.__name__, path)


def test_a_map_arrives_whole_and_can_be_changed(tmp_path: Path) -> None:
    surface = read(tmp_path, "map")
    assert (surface.pitch_mm, surface.path) == (0.5, tmp_path / "map.bin")
    np.testing.assert_array_equal(surface.height_nm, [[0, 1, 2], [3, 4, 5]])
    surface.height_nm[0, 0] = 7.0
    assert int(surface.part_id) != os.getpid()


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("crash", "was ended by SIGSEGV"),
        ("die", "was ended by SIGKILL"),
        ("spin", "was ended by SIGXCPU"),
        ("allocate", "more memory than 4 times its length"),
        ("raise", "ZeroDivisionError: of a parser"),
        ("refuse", "torn"),
    ],
)
def test_what_a_parser_does_is_a_bad_map(tmp_path: Path, what: str, reason: str) -> None:
    with pytest.raises(BadMap, match=reason) as caught:
        read(tmp_path, what)
    assert str(caught.value).startswith(f"{tmp_path / 'map.bin'}: ")
    assert read(tmp_path, "map").pitch_mm == 0.5


def test_one_that_only_waits_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read(tmp_path, "map")
    monkeypatch.setattr(apart, "WITHIN_S", 0.1)
    with pytest.raises(BadMap, match=r"within 0\.1 s"):
        read(tmp_path, "wait")
    monkeypatch.undo()
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    assert read(tmp_path, "map").pitch_mm == 0.5


def test_the_worker_is_kept_and_replaced_when_it_has_gone(tmp_path: Path) -> None:
    first = int(read(tmp_path, "map").part_id)
    with pytest.raises(BadMap, match="torn"):
        read(tmp_path, "refuse")
    assert int(read(tmp_path, "map").part_id) == first
    os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert int(read(tmp_path, "map").part_id) != first


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BadMap, match="No such file"):
        apart.read(parsers_apart.__name__, tmp_path / "none.bin")


def test_room_is_made_only_where_there_is_a_bound() -> None:
    from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit

    before = getrlimit(RLIMIT_AS)
    assert before[0] == RLIM_INFINITY
    apart.make_room(10)
    assert getrlimit(RLIMIT_AS) == before
