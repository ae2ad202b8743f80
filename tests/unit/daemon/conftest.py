"""Shared fixtures of the daemon's tests."""

from __future__ import annotations

import gc

import pytest


@pytest.fixture(autouse=True)
def _what_is_there_before_is_not_searched() -> None:
    """Exclude existing objects from garbage collection: each pass of the daemon includes all objects again."""
    gc.freeze()
