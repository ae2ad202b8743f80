"""What this process runs, as it lay on disk at its start: whatever is loaded later must be the same.

A daemon loads modules late, and starts its compute worker again. Where a distribution was updated or removed meanwhile,
these would be of another version than the rest of it.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import re
from collections.abc import Mapping
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import Distribution, EntryPoint
from pathlib import Path

from polishd.model.errors import HostFault

GROUP = "polishd"
"""Entry points of plugins, polishd's own among them."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def installed_now() -> dict[str, str]:
    """Version and hash of the sources of each distribution with plugins; the version of each that these require."""
    importlib.invalidate_caches()
    points: dict[str, list[EntryPoint]] = {}
    plugins: dict[str, Distribution] = {}
    for point in importlib.metadata.entry_points(group=GROUP):
        if point.dist is not None:
            points.setdefault(_key(point.dist.name), []).append(point)
            plugins[_key(point.dist.name)] = point.dist
    found = {name: f"{one.version}, sources {_sources(points[name])}" for name, one in plugins.items()}
    left = [needed for one in plugins.values() for needed in _required(one, extras=True)]
    looked = set(found)
    while left:
        name = left.pop()
        if name in looked:
            continue
        looked.add(name)
        try:
            one = importlib.metadata.distribution(name)
        except importlib.metadata.PackageNotFoundError:
            continue  # of an extra, or of another system
        found[name] = one.version
        left += _required(one)
    return found


@cache
def installed_at_start() -> Mapping[str, str]:
    """Of this process: what the first call finds. A daemon asks before it opens anything."""
    return installed_now()


def require_same(before: Mapping[str, str], now: Mapping[str, str]) -> None:
    """HostFault, naming each distribution that is another than before, or gone. What came anew disturbs nobody."""
    changed = [
        f"{name} ({was} when the daemon started, now {now.get(name, 'not installed')})"
        for name, was in sorted(before.items())
        if now.get(name) != was
    ]
    if changed:
        raise HostFault(
            f"installed software changed under the running daemon: {'; '.join(changed)}. Contact is not entered with "
            "mixed versions; restart the daemon"
        )


def _key(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _required(one: Distribution, *, extras: bool = False) -> list[str]:
    """Names; extras of a plugin may be its vendor's libraries, those of others are nobody's here."""
    texts = [text for text in one.requires or () if extras or "extra ==" not in text]
    return [_key(match.group()) for text in texts if (match := _NAME.match(text))]


def _sources(points: list[EntryPoint]) -> str:
    """Short hash of all Python files of the packages that hold those entry points."""
    digest = hashlib.sha256()
    for top in sorted({point.module.partition(".")[0] for point in points}):
        for path in _files(top):
            try:
                content = path.read_bytes()
            except OSError as error:
                content = f"cannot be read: {error.strerror}".encode()
            digest.update(f"{path.name} {len(content)}\n".encode(errors="surrogateescape"))
            digest.update(content)
    return digest.hexdigest()[:12]


def _files(top: str) -> list[Path]:
    """Python files of a package or module at the top; none where it is gone. It is not imported."""
    spec = PathFinder.find_spec(top) or _by_any_finder(top)
    if spec is None:
        return []
    if spec.submodule_search_locations is not None:
        return sorted(path for folder in spec.submodule_search_locations for path in Path(folder).rglob("*.py"))
    return [Path(spec.origin)] if spec.origin else []


def _by_any_finder(top: str) -> ModuleSpec | None:
    """An editable installation may have a finder of its own; a module that is loaded does not answer for the disk."""
    try:
        return importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
