"""Write the study's confusion matrix into docs/reference/results.md: ``python -m docs.reference.naming DIR``."""

from __future__ import annotations

import sys
from pathlib import Path

PAGE = Path(__file__).with_name("results.md")
BEGIN, END = "<!-- written by make naming -->\n", "<!-- end of what make naming writes -->"


def put(page: str, table: str, marks: tuple[str, str] = (BEGIN, END)) -> str:
    """The page with that table between its marks."""
    begin, end = marks
    before, _, rest = page.partition(begin)
    _, _, after = rest.partition(end)
    return f"{before}{begin}{table}{end}{after}"


if __name__ == "__main__":
    confusion = Path(sys.argv[1]) / "confusion.md"
    PAGE.write_text(put(PAGE.read_text(), confusion.read_text()))
