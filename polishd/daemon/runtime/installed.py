"""Check that the installed software does not change while the daemon runs.

A daemon loads modules late and restarts its compute worker. After an update or removal of a distribution, these would
have another version than the rest of the daemon.
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
"""Group of the entry points of all plugins, also those of polishd."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def installed_now() -> dict[str, str]:
    """Return version and hash of the sources of each distribution with plugins; the version of each requirement."""
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
            continue  # of an extra, or for another system
        found[name] = one.version
        left += _required(one)
    return found


@cache
def installed_at_start() -> Mapping[str, str]:
    """Return the result of the first call in this process. A daemon calls it before it opens anything."""
    return installed_now()


def require_same(before: Mapping[str, str], now: Mapping[str, str]) -> None:
    """HostFault where a distribution was changed or removed; it names each. New distributions are allowed."""
    changed = [
        f"{name} ({was} when the daemon started, now {now.get(name, 'not installed')})"
        for name, was in sorted(before.items())
        if now.get(name) != was
    ]
    if changed:
        raise HostFault(
            f"installed software changed while the daemon runs: {'; '.join(changed)}; the tool does not enter contact "
            "with mixed versions. Restart the daemon"
        )


def _key(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _required(one: Distribution, *, extras: bool = False) -> list[str]:
    """Return the names of requirements. Only of plugins the extras count: they may be libraries of a vendor."""
    texts = [text for text in one.requires or () if extras or "extra ==" not in text]
    return [_key(match.group()) for text in texts if (match := _NAME.match(text))]


def _sources(points: list[EntryPoint]) -> str:
    """Return the short hash of all Python files of the packages with those entry points."""
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
    """Return the Python files of a top-level package or module, without importing it; none where it is missing."""
    spec = PathFinder.find_spec(top) or _by_any_finder(top)
    if spec is None:
        return []
    if spec.submodule_search_locations is not None:
        return sorted(path for folder in spec.submodule_search_locations for path in Path(folder).rglob("*.py"))
    return [Path(spec.origin)] if spec.origin else []


def _by_any_finder(top: str) -> ModuleSpec | None:
    """Return the spec from any finder: an editable installation may have a special one."""
    try:
        return importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
