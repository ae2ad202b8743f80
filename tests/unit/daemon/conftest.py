"""What every test of the daemon gets."""

from __future__ import annotations

import gc

import pytest


@pytest.fixture(autouse=True)
def _what_is_there_before_is_not_searched() -> None:
    """Each pass thaws all, the suite's thousands of tests among it: the next collection would look around in them."""
    gc.freeze()
