"""Lines that longer names made too long: a statement that is kept from the formatter is given to it. long_lines.py ROOT"""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(sys.argv[1])
check = [str(ROOT / ".venv/bin/ruff"), "check", ".", "--select", "E501", "--output-format", "json"]
found: dict[str, list[int]] = {}
for one in json.loads(subprocess.run(check, cwd=ROOT, capture_output=True, text=True, check=False).stdout):
    found.setdefault(one["filename"], []).append(one["location"]["row"])
for name, rows in found.items():
    path = Path(name)
    lines = path.read_text().splitlines(keepends=True)
    statements = [node for node in ast.walk(ast.parse("".join(lines))) if isinstance(node, ast.stmt)]
    for row in rows:
        around = [node for node in statements if node.lineno <= row <= (node.end_lineno or 0)]
        end = min(around, key=lambda node: (node.end_lineno or 0) - node.lineno).end_lineno if around else row
        lines[end - 1] = re.sub(r"  # fmt: skip\b", "", lines[end - 1])
    path.write_text("".join(lines))
