"""Exact replacements by a table: replace.py ROOT TABLE. ``[[at]] file = [...] old new``; one that is not found is said."""

import sys
import tomllib
from pathlib import Path

root = Path(sys.argv[1])
table = Path(sys.argv[2])
for row in tomllib.loads(table.read_text()).get("at", []):
    files = row["file"] if isinstance(row["file"], list) else [row["file"]]
    for name in files:
        path = root / name
        if not path.exists():
            print(f"{table.name}: no file {name}")
            continue
        text = path.read_text()
        if row["old"] not in text:
            print(f"{table.name}: not in {name}: {row['old'][:80]!r}")
            continue
        path.write_text(text.replace(row["old"], row["new"]))
