"""Rules over the repository beside the code: the lock, what is tracked, the documentation, the examples."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

from tests.arch.source import sources

# Written as patterns that do not match themselves.
MACHINE_PATH = re.compile(r"(?<![\w.~$}])/(?:root|home|work|Users|opt/\w+/simple)/|\b[A-Z]:\\\\?Users\b")
REGISTRY_HOST = re.compile(r"pypi\.org|pythonhosted\.org|npmjs\.(?:org|com)|deb\.debian\.org|debian\.org/debian")

PIN = re.compile(r"^[A-Za-z0-9][\w.-]*(?:\[[\w,-]+\])?==\S+")
HASH = re.compile(r"--hash=sha256:[0-9a-f]{64}\b")


def lock_is_complete(root: Path) -> list[str]:
    """Each entry of the lock is one exact version with hashes."""
    entries = [
        line
        for line in (root / "requirements.lock").read_text().replace("\\\n", " ").splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not entries:
        return ["requirements.lock: empty"]
    return [
        f"requirements.lock: {entry.split()[0]} is not an exact version with hashes"
        for entry in entries
        if not (PIN.match(entry) and HASH.search(entry))
    ]


def lock_names_no_place(root: Path) -> list[str]:
    """The lock names no host, index, link or path: those belong to the machine that installs."""
    return [
        f"requirements.lock:{number}: names a place: {line.strip()}"
        for number, line in enumerate((root / "requirements.lock").read_text().splitlines(), 1)
        if "/" in line or "://" in line or re.search(r"--(?!hash=)", line)
    ]


def no_machine_named(root: Path) -> list[str]:
    """No tracked text names a path of one machine, or a package registry."""
    here = f"{root}/"
    return [
        f"{path.relative_to(root).as_posix()}:{number}: names a machine's path or a registry: {line.strip()[:80]}"
        for path in tracked_files(root)
        for number, line in enumerate(_text(path).splitlines(), 1)
        if here in line or MACHINE_PATH.search(line) or REGISTRY_HOST.search(line)
    ]


def tracked_files(root: Path) -> Iterator[Path]:
    """What git has, or would take: a new file counts before it is added."""
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listing, cwd=root, capture_output=True, text=True, check=True).stdout.split("\0")
    return (root / name for name in names if name and (root / name).is_file())


def _text(path: Path) -> str:
    """The file's text; nothing where it is binary."""
    data = path.read_bytes()
    return "" if b"\0" in data else data.decode(errors="replace")


def hooks_are_documented(root: Path) -> list[str]:
    """Every hook is in the plugin guide."""
    guide = root / "docs" / "how-to" / "plugins.md"
    text = guide.read_text() if guide.exists() else ""
    return [f"docs/how-to/plugins.md: {hook} is not mentioned" for hook in _hooks(root) if hook not in text]


def hooks_are_tested(root: Path) -> list[str]:
    """Every hook is named by some test."""
    texts = [source.text for source in sources(root, "tests") if not source.name.startswith("tests/arch/")]
    return [f"tests/: {hook} is named by no test" for hook in _hooks(root) if not any(hook in text for text in texts)]


def _hooks(root: Path) -> list[str]:
    tree = ast.parse((root / "polishd" / "hookspecs.py").read_text())
    hooks = [n.name for n in tree.body if isinstance(n, ast.FunctionDef) and n.name.startswith("polishd_")]
    assert hooks, "polishd/hookspecs.py specifies no hook"
    return hooks


RULES = (
    lock_is_complete,
    lock_names_no_place,
    no_machine_named,
    hooks_are_documented,
    hooks_are_tested,
)
