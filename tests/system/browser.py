"""Run a headless browser for a test: Chromium or Firefox."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.system import chromium, firefox
from tests.system.browser_page import Page

__all__ = ["BROWSERS", "Page", "browsing", "each_browser"]

BROWSERS = {"chromium": chromium, "firefox": firefox}
each_browser = pytest.mark.parametrize("browser", BROWSERS)


@contextlib.contextmanager
def browsing(folder: Path, *options: str, browser: str = "chromium") -> Iterator[Page]:
    """Run a browser with these additional options for the duration of the block; skip the test if it is missing."""
    kind = BROWSERS[browser]
    missing = [program for program in kind.NEEDED if shutil.which(program) is None]
    if missing:
        pytest.skip(f"{', '.join(missing)}: not installed: apt-get install {' '.join(kind.NEEDED.values())}")
    with kind.browsing(folder, options) as page:
        yield page
