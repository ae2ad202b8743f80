"""Long programs keep to their bytes a block, in memory and on the disk."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.long_path import (
    BOUNDS,
    WRITING,
    Stage,
    kept_stages,
    language_program,
    language_stages,
    nc_program,
    nc_stages,
)
from polishd.pipeline.disk_space import CSV_BYTES, ROW_BYTES
from tests.memory import peak_bytes

BLOCKS = 200_000
LONG = 50_000
LINES = 20_000
PIECES = {"read": 16e6, "rewrite": 12e6, "read back": 16e6}
"""Bytes of a program's text, and its columns, that are under way at once however long it is."""
FIXED = 3e6
"""Of every other stage."""


def over(stages: Iterator[Stage], count: int) -> dict[str, str]:
    """Stages that took more than they may, with what they took for each block."""
    found = {}
    for name, run in stages:
        most = PIECES.get(name, FIXED) + BOUNDS[name] * count
        gc.collect()
        taken = peak_bytes(run, most, readings=1)
        if taken > most:
            found[name] = f"{taken / count:.0f} bytes, {BOUNDS[name]} may be"
    return found


@pytest.mark.full
def test_from_the_text_to_the_robot() -> None:
    assert over(nc_stages(nc_program(BLOCKS)), BLOCKS) == {}


@pytest.mark.full
def test_from_what_the_robot_tells_to_the_report(tmp_path: Path) -> None:
    assert over(kept_stages(LONG, tmp_path), LONG) == {}
    run = tmp_path / "run"
    assert (run / "journal.sqlite").stat().st_size < ROW_BYTES * LONG, "what require_room counts with"
    assert (run / "cycle-00" / "executed.csv").stat().st_size < CSV_BYTES * LONG


@pytest.mark.full
@pytest.mark.parametrize("language", WRITING)
def test_a_robot_language(language: str) -> None:
    assert over(language_stages(language, language_program(language, LINES)), LINES) == {}
