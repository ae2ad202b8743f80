"""The ways in which a file comes into a folder. Each yields (seconds to wait, what to do)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from tests.campaigns.folder_world import Step, World

Way = Callable[[World, Path, bytes], Iterator[Step]]

NOT_SEEN_BYTES = 16
"""Of a preallocated ``.dat``: fewer zeros at its end may be heights."""


def pause(world: World, most_s: float = 4.0) -> float:
    """Often short, sometimes longer than a file must rest."""
    return float(min(world.rng.exponential(0.4), most_s))


def slow(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """In chunks."""
    step = -(-len(data) // world.integer(1, 6))
    yield pause(world), partial(world.put, path, b"")
    for start in range(0, len(data), step):
        yield pause(world), partial(world.put, path, data[start : start + step], "ab")


def preallocated(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Its full length at once, all zeros, then filled."""
    step = -(-len(data) // world.integer(1, 6))
    yield pause(world), partial(world.put, path, bytes(len(data)))
    for start in range(0, len(data), step):
        yield pause(world), partial(world.put, path, data[start : start + step], "r+b", start)


def reopened(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Closed half way, and appended to later."""
    cut = world.integer(1, len(data))
    yield pause(world), partial(world.put, path, data[:cut])
    yield float(world.rng.uniform(0.0, 8.0)), partial(world.put, path, data[cut:], "ab")


def renamed(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Under another name, and renamed when it is whole."""
    names = (path.name + ".part", path.name + ".tmp", f".{path.name}.x7")
    temporary = path.with_name(names[world.integer(0, 3)])
    yield from slow(world, temporary, data)
    yield pause(world), partial(os.replace, temporary, path)


def over_another(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """A torn file of that name is there already and is written over, in place or by a rename."""
    yield pause(world), partial(world.put, path, data[: world.integer(0, len(data))])
    if world.rng.random() < 0.5:
        yield pause(world), partial(world.put, path, data)
    else:
        side = path.with_name(f".{path.name}.new")
        yield pause(world), partial(world.put, side, data)
        yield pause(world), partial(os.replace, side, path)


def retried(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """The first copy is killed, or the disk fills up: it stays torn for ever. The second has another name."""
    cut = world.integer(0, len(data) - NOT_SEEN_BYTES)
    rest = bytes(len(data) - cut) if world.rng.random() < 0.5 else b""
    yield pause(world), partial(world.put, path.with_name(f"torn-{path.name}"), data[:cut] + rest)
    yield from slow(world, path, data)


def twice(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """And a copy of it under another name."""
    yield from slow(world, path, data)
    yield pause(world), partial(world.put, path.with_name(f"copy of {path.name.replace('.', '-', 1)}"), data)


GOOD: tuple[Way, ...] = (slow, preallocated, reopened, renamed, over_another, retried, twice)


def torn(world: World, path: Path, data: bytes) -> Iterator[Step]:
    """Killed mid-copy."""
    cut = world.integer(0, len(data) - NOT_SEEN_BYTES)
    rest = bytes(len(data) - cut) if world.rng.random() < 0.5 else b""
    yield pause(world), partial(world.put, path, data[:cut] + rest)
