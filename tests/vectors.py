"""Read the test vectors of the protocol documents: the lines of their ```vectors blocks."""

from __future__ import annotations

import re
from pathlib import Path

PROTOCOLS = Path(__file__).resolve().parents[1] / "docs" / "protocols"


def vectors(document: str) -> dict[str, str]:
    """Return the values by name, from all blocks of docs/protocols/<document>.md."""
    text = (PROTOCOLS / f"{document}.md").read_text()
    blocks = re.findall(r"^```vectors\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    found = dict(line.split(maxsplit=1) for block in blocks for line in block.splitlines())
    assert found, f"{document}.md has no vectors"
    return found
