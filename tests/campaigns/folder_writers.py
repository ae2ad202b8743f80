"""Ways to write a file into a folder. Each yields (seconds to wait, next action)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from tests.campaigns.folder_world import Step, World

Way = Callable[[World, Path, bytes], Iterator[Step]]

NOT_SEEN_BYTES = 16
"""Number of zeros at the end of a preallocated ``.dat``; fewer may be heights."""


def pause(world: World, most_s: float = 4.0) -> float:
    """Return a pause: often short, sometimes longer than a file must be unchanged."""
    return float(min(world.rng.exponential(0.4), most_s))


def slow(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Write in chunks."""
    step = -(-len(data) // world.integer(1, 6))
    yield pause(world), partial(world.put, path, b"")
    for start in range(0, len(data), step):
        yield pause(world), partial(world.put, path, data[start : start + step], "ab")


def preallocated(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Write zeros of the full length first, then the content."""
    step = -(-len(data) // world.integer(1, 6))
    yield pause(world), partial(world.put, path, bytes(len(data)))
    for start in range(0, len(data), step):
        yield pause(world), partial(world.put, path, data[start : start + step], "r+b", start)


def reopened(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Close the file half way and append the rest later."""
    cut = world.integer(1, len(data))
    yield pause(world), partial(world.put, path, data[:cut])
    yield float(world.rng.uniform(0.0, 8.0)), partial(world.put, path, data[cut:], "ab")


def renamed(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Write under another name and rename when complete."""
    names = (path.name + ".part", path.name + ".tmp", f".{path.name}.x7")
    temporary = path.with_name(names[world.integer(0, 3)])
    yield from slow(world, temporary, data)
    yield pause(world), partial(os.replace, temporary, path)


def over_another(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Overwrite an incomplete file of that name, in place or by a rename."""
    yield pause(world), partial(world.put, path, data[: world.integer(0, len(data))])
    if world.rng.random() < 0.5:
        yield pause(world), partial(world.put, path, data)
    else:
        side = path.with_name(f".{path.name}.new")
        yield pause(world), partial(world.put, side, data)
        yield pause(world), partial(os.replace, side, path)


def retried(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Leave the first copy incomplete (killed, or disk full) and write a second one under another name."""
    cut = world.integer(0, len(data) - NOT_SEEN_BYTES)
    rest = bytes(len(data) - cut) if world.rng.random() < 0.5 else b""
    yield pause(world), partial(world.put, path.with_name(f"torn-{path.name}"), data[:cut] + rest)
    yield from slow(world, path, data)


def twice(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Write the file, and a copy of it under another name."""
    yield from slow(world, path, data)
    yield pause(world), partial(world.put, path.with_name(f"copy of {path.name.replace('.', '-', 1)}"), data)


GOOD: tuple[Way, ...] = (slow, preallocated, reopened, renamed, over_another, retried, twice)


def torn(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Stop in the middle of a copy."""
    cut = world.integer(0, len(data) - NOT_SEEN_BYTES)
    rest = bytes(len(data) - cut) if world.rng.random() < 0.5 else b""
    yield pause(world), partial(world.put, path, data[:cut] + rest)
