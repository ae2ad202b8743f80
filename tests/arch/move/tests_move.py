"""Tests into the folders of what they test: tests_move.py ROOT OUT. After post.py; places are those of map.txt, tests_map.txt before."""

import collections
import json
import re
import subprocess
import sys
from pathlib import Path

from collide import read_map

ROOT, OUT, HERE = Path(sys.argv[1]), Path(sys.argv[2]), Path(__file__).parent
UNIT = ROOT / "tests/unit"
TARGETS, _ = read_map(HERE / "map.txt")
PACKAGES = json.loads((HERE / "packages.json").read_text())
ROWS = [line.split("#")[0].split() for line in (HERE / "tests_map.txt").read_text().splitlines()]
TABLE = {row[0].rstrip(":"): row[1] for row in ROWS if row}
PREFIX = re.compile("^(sim_|dwell_|robot_|map_|metrics_|registration_|edge_|ur_)")
SKIP = {".venv", "build", ".git", "node_modules", "__pycache__", ".mypy_cache", ".ruff_cache", ".pytest_cache", ".hypothesis"}


def module_of(path: str) -> str | None:
    """The old module that a test file has its name of."""
    folder, _, name = path.rpartition("/")
    if not name.startswith("test_"):
        return None
    package = ("polishd." + folder.replace("/", ".")).rstrip(".")
    for base in (name[5:], PREFIX.sub("", name[5:])):
        if f"{package}.{base}" in TARGETS:
            return f"{package}.{base}"
    found = [m for m in TARGETS if m.rpartition(".")[2] in (name[5:], PREFIX.sub("", name[5:])) and m.startswith(package + ".")]
    return found[0] if len(found) == 1 else None


def folder_of(folder: str) -> str:
    """The new folder of an old one, for files that are named for nothing."""
    package = ("polishd." + folder.replace("/", ".")).rstrip(".")
    for old in sorted(PACKAGES, key=len, reverse=True):
        if package == old or package.startswith(old + "."):
            new = PACKAGES[old] + package[len(old) :]
            return new[8:].replace(".", "/")
    return folder


old = sorted(p.relative_to(UNIT).with_suffix("").as_posix() for p in UNIT.rglob("*.py"))
targets = {path: TARGETS[m][:-3] for path in old if path not in TABLE and (m := module_of(path))}
shared = collections.Counter(targets.values())
new: dict[str, str] = {}
for path in old:
    folder, _, name = path.rpartition("/")
    if path in TABLE:
        new[path] = TABLE[path] + name if TABLE[path].endswith("/") else TABLE[path]
    elif path in targets:
        target = targets[path].removesuffix("/__init__")
        home, _, leaf = targets[path].removesuffix("/__init__").rpartition("/")
        if targets[path].endswith("/__init__"):
            home = target
        base = PREFIX.sub("", name[5:])
        if shared[targets[path]] == 1 or base == leaf:
            new[path] = f"{home}/test_{leaf}".lstrip("/")
        else:
            new[path] = f"{home}/test_{base if leaf in base else leaf + '_' + base}".lstrip("/")
    else:
        new[path] = f"{folder_of(folder)}/{name}".lstrip("/")
        if new[path] == path and folder:
            print("tests: stays:", path)
twice = [path for path, n in collections.Counter(new.values()).items() if n > 1]
assert not twice, twice

PARENTS = re.compile(r"(Path\(__file__\)(?:\.resolve\(\))?\.parents\[)(\d+)\]")
moved = {path: to for path, to in new.items() if path != to}
for path, to in moved.items():
    file = UNIT / f"{path}.py"
    deeper = to.count("/") - path.count("/")
    text = file.read_text()
    changed = PARENTS.sub(lambda m: f"{m[1]}{int(m[2]) + deeper}]", text)
    if changed != text:
        file.write_text(changed)


def git(*words: str) -> None:
    subprocess.run(["git", "-C", str(ROOT), *words], check=True, capture_output=True)


git("add", "-A")
for i, path in enumerate(moved):
    git("mv", f"tests/unit/{path}.py", f"tests/unit/_moving_{i}.py")
for i, to in enumerate(moved.values()):
    (UNIT / to).parent.mkdir(parents=True, exist_ok=True)
    git("mv", f"tests/unit/_moving_{i}.py", f"tests/unit/{to}.py")
for folder in sorted((p for p in UNIT.rglob("*") if p.is_dir() and p.name != "__pycache__"), reverse=True):
    if not any(p for p in folder.rglob("*") if p.is_file() and "__pycache__" not in p.parts):
        subprocess.run(["rm", "-rf", str(folder)], check=True)

names = {f"tests/unit/{path}.py": f"tests/unit/{to}.py" for path, to in moved.items()}
names |= {"tests.unit." + path.replace("/", "."): "tests.unit." + to.replace("/", ".") for path, to in moved.items()}
# `from tests.unit.a import b`: b by its package
ANY = re.compile(r"(?<![\w.-])(" + "|".join(map(re.escape, sorted(names, key=len, reverse=True))) + r")(?!\w)")
FROM = re.compile(r"^(\s*)from tests\.unit\.([\w.]+) import ([^(\n]+)$", re.M)


def by_package(m: re.Match[str]) -> str:
    lines, kept = [], []
    for part in m[3].split(","):
        name, _, alias = part.strip().partition(" as ")
        to = moved.get(f"{m[2].replace('.', '/')}/{name}")
        if to is None:
            kept.append(part.strip())
            continue
        home, _, leaf = to.rpartition("/")
        local = alias or name
        lines.append(f"{m[1]}from tests.unit.{home.replace('/', '.')} import {leaf}" + (f" as {local}" if local != leaf else ""))
    if kept:
        lines.append(f"{m[1]}from tests.unit.{m[2]} import {', '.join(kept)}")
    return "\n".join(lines)


for p in ROOT.rglob("*"):
    rel = p.relative_to(ROOT)
    if SKIP & set(rel.parts) or not p.is_file() or p.is_symlink() or rel.name in ("CHANGELOG.md", "requirements.lock") or "decisions" in rel.parts:
        continue
    if p.suffix in (".py", ".md", ".toml", ".jinja", ".html", ".json") or rel.name in ("Makefile", "run"):
        text = p.read_text()
        changed = ANY.sub(lambda m: names[m[1]], FROM.sub(by_package, text))
        if changed != text:
            p.write_text(changed)
(OUT / "tests.json").write_text(json.dumps(names, indent=0))
print(f"tests: {len(moved)} files moved")
