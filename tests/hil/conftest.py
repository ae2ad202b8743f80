"""Options of ``pytest -m hil``; without ``--cell`` these tests are skipped."""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Only ``--cell`` says what to try."""
    return True if config.getoption("--cell") is None else None
