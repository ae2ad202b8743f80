"""Random writes into a watched folder: no map is taken incomplete or twice, and none is lost, with any faults."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from polishd.plugins.interferometer import map_files
from tests.campaigns.folder_world import LOST_AFTER_S, POLL_S, STABLE_S, Disk, World
from tests.campaigns.folder_writers import GOOD, Step, slow, torn

WRITES = 300
"""Number of writes of a round, which has a separate folder, daemon and seed."""
ROUNDS = 34
"""Rounds of the long campaign: 10,200 writes."""
REASONS = {
    "other": ("WrongPart: it shows part",),
    "old": ("StaleMap: out of order", "StaleMap: stale", "StaleMap: duplicate"),
    "good": ("StaleMap: duplicate", "StaleMap: stale", "StaleMap: out of order"),
    None: ("MapError",),
}
"""Reason of a quarantined file by its kind of content; None: content that was never complete."""


def finished(world: World) -> Step:
    """Return the step that records when the good map is complete."""

    def note() -> None:
        world.done_s = world.now_s

    return 0.0, note


def measure(world: World) -> Iterator[Step]:
    """Write the answer to a request in one of the ways."""
    way = GOOD[world.integer(0, len(GOOD))]
    path = world.maps / f"map-{world.ask}.dat"
    yield float(world.rng.uniform(0.5, 3.0)), partial(setattr, world, "done_s", None)
    yield from way(world, path, world.content("good"))
    yield finished(world)


def junk(world: World) -> Iterator[Step]:
    """Write a file that must not be taken."""
    path = world.maps / f"junk-{world.writes}.dat"
    yield float(world.rng.uniform(0.0, 6.0)), lambda: None
    kind = ("other", "old", "torn", "junk", "empty", "again")[world.integer(0, 6)]
    if kind == "other":
        yield from slow(world, path, world.content("other", part="X-9"))
    elif kind == "old":  # measured before the last map was, and copied in now
        yield from slow(world, path, world.content("old", before_last_s=float(world.rng.uniform(2.0, 1000.0))))
    elif kind == "torn":
        data = world.content("torn")
        yield from torn(world, path, data)
    elif kind == "again" and len(world.journal) > 1:
        name = world.journal[world.integer(1, len(world.journal))]
        yield from slow(world, path, (world.maps / "taken" / f"{name}.dat").read_bytes())
    else:
        yield 0.0, partial(world.put, path, b"hello" if kind == "junk" else b"")


def step_clocks(world: World) -> None:
    """Set a clock wrong for a map or two, by minutes or hours, forward or back; not for the very first map,
    which has no other to be compared with.
    """
    if world.ask == 1:
        return
    world.stepped = bool(world.instrument_off_s or world.folder_off_s)  # the last map may be dated by a wrong clock
    if world.stepped and world.rng.random() < 0.5:
        world.instrument_off_s = world.folder_off_s = 0.0
    elif not world.stepped and world.rng.random() < 0.15:
        off_s = float(world.rng.choice([-7200.0, -3600.0, -90.0, 90.0, 3600.0]))
        if world.rng.random() < 0.5:
            world.instrument_off_s = off_s
        else:
            world.folder_off_s = off_s
        world.stepped = True


def disturb(world: World) -> None:
    """Set faults of the share and the disk, a full disk, and kills of the daemon."""
    disk, chance = world.disk, world.rng.random()
    disk.broken, disk.full, world.disturbed = 0.0, False, False
    if chance < 0.15:
        disk.broken = 0.3
    elif chance < 0.25:
        disk.full = True
    elif chance < 0.5:
        disk.dies_in = world.integer(0, 6)
    world.disturbed = chance < 0.5


def one_ask(world: World) -> None:
    """Run from the request until its map is in the journal."""
    world.ask += 1
    world.done_s = None
    step_clocks(world)
    disturb(world)
    begun_s, asked = world.now_s, False
    while not world.poll():
        waited_s = world.now_s - begun_s
        if world.wait is not None and world.wait.ask is not None and not asked:
            asked = True  # it is on the disk: now the instrument measures
            world.start(measure(world))
            for _ in range(world.integer(0, 5)):
                world.start(junk(world))
        if waited_s > 15.0:
            world.disk.broken, world.disk.full = 0.0, False
        if world.stepped and world.done_s is not None:
            world.operator()
        if world.disk.broken == 0.0 and world.rng.random() < 0.002:
            world._die()
        assert waited_s < LOST_AFTER_S, f"ask {world.ask}: the map was not taken: lost"
    if not world.disturbed and not world.stepped and world.done_s is not None:
        world.latencies_s.append(world.now_s - world.done_s)


def drain(world: World) -> None:
    """Run until all files in the folder are complete and judged; none of them may be taken."""
    world.disk.broken, world.disk.full, world.disk.dies_in = 0.0, False, None
    for _ in range(round((25.0 + 12 * STABLE_S) / POLL_S)):
        assert not world.poll()


def check_all_is_kept(world: World) -> None:
    """Require that all complete files that were not overwritten exist, with a reason where they were refused."""
    kept = {hashlib.sha256(path.read_bytes()).hexdigest() for path in world.maps.rglob("*") if path.is_file()}
    assert set(world.journal[1:]) <= kept
    missing = [one for name, one in world.contents.items() if one.kind != "torn" and name not in kept]
    assert not missing
    assert not [path for path in world.maps.iterdir() if path.is_file()]
    for path in (world.maps / "quarantine").iterdir():
        if not path.name.endswith(".reason.txt"):
            known = world.contents.get(hashlib.sha256(path.read_bytes()).hexdigest())
            reason = (path.parent / f"{path.name}.reason.txt").read_text()
            kind = known.kind if known else None
            assert reason.endswith("\n")
            assert any(one in reason for one in REASONS[kind]), (kind, reason)


def play(root: Path, seed: int, writes: int) -> World:
    """Run one round."""
    (root / "maps").mkdir(parents=True)
    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)  # power cuts are another matter
        world = World(root, rng, Disk(patch, rng))
        world.journal.append("0" * 64)
        patch.setattr(map_files, "clock_of", world.clock)
        while world.writes < writes:
            one_ask(world)
            world.now_s += float(rng.uniform(5.0, 40.0))  # the pass; writers go on meanwhile
            world.run_due(world.now_s)
        world.ask += 1
        drain(world)
        check_all_is_kept(world)
    assert world.restarts > 5
    assert world.disk.faults > 5
    assert world.put_back > 0
    assert max(world.latencies_s) <= STABLE_S + 3 * POLL_S
    return world


@pytest.mark.full
def test_300_writes(tmp_path: Path) -> None:
    world = play(tmp_path, seed=1, writes=WRITES)
    assert len(world.journal) > 60


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("part", range(2))
def test_10_000_writes(tmp_path: Path, part: int) -> None:
    done = [play(tmp_path / str(seed), seed, WRITES) for seed in range(100 + part, 100 + ROUNDS, 2)]
    assert sum(world.writes for world in done) >= WRITES * ROUNDS // 2
