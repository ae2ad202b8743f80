"""Scopes of the campaigns: campaigns.py ROOT OUT. Modules of the mutation scope, and what of them survives, by the new files."""

import json
import re
import sys
from pathlib import Path

ROOT, OUT = Path(sys.argv[1]), Path(sys.argv[2])
PATHS = {old[8:-3]: new[8:-3] for old, new in json.loads((OUT / "paths.json").read_text()).items()}
folder = ROOT / "tests/campaigns/mutation"


def modules(m: re.Match[str]) -> str:
    names = dict.fromkeys(PATHS.get(name, name) for name in re.findall(r'"([^"]+)"', m[2]) if name not in seen)
    new = [name for name in names if name not in seen]
    seen.update(new)
    return f"{m[1]} = [\n" + "".join(f'    "{name}",\n' for name in new) + "]"


scope, seen = folder / "scope.toml", set()
text = scope.read_text()
head, tests, rest = text.partition("\nstate_machine = ")
rest = re.sub(r"^(\w+) = \[(.*?)\]", modules, "state_machine = " + rest, flags=re.M | re.S)
head = head.replace('tests = ["tests/unit/daemon", ', 'tests = ["tests/unit/daemon", "tests/unit/model", ')
scope.write_text(head + "\n" + rest)

# A table for each file: what was of several files is in one.
left = folder / "survivors.toml"
first, *tables = re.split(r"^(?=\[)", left.read_text(), flags=re.M)
merged: dict[str, list[str]] = {}
for table in tables:
    name, _, lines = table.partition("\n")
    kept = merged.setdefault(name, [])
    kept += [line for line in lines.strip().split("\n") if line not in kept]
left.write_text(first + "\n".join(name + "\n" + "\n".join(lines) + "\n" for name, lines in merged.items()))
