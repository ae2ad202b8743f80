"""The confusion matrix of docs/naming.md: ``python -m docs.reference.naming DIR``, the study's ``--out``."""

from __future__ import annotations

import sys
from pathlib import Path

PAGE = Path(__file__).parents[1] / "naming.md"
BEGIN, END = "<!-- written by make naming -->\n", "<!-- end of what make naming writes -->"


def put(page: str, table: str) -> str:
    """The page with that table between its marks."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}{table}{END}{after}"


if __name__ == "__main__":
    confusion = Path(sys.argv[1]) / "confusion.md"
    PAGE.write_text(put(PAGE.read_text(), confusion.read_text()))
