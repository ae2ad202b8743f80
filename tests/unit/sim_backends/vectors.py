"""Read the test vectors of docs/protocols/ for the simulator's codecs."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).resolve().parents[3] / "docs" / "protocols"


def vectors(name: str) -> dict[str, str]:
    """Return the values by name from the vectors block of a protocol's page."""
    text = (DOCS / f"{name}.md").read_text()
    block = re.search(r"```vectors\n(.*?)```", text, re.DOTALL)
    assert block is not None, f"{name}.md has no vectors"
    return dict(line.split(" ", 1) for line in block[1].strip().splitlines())
