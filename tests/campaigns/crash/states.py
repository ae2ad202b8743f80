"""The campaign of crash states: for every prefix of a recording, states of the disk that a crash there can leave."""

from __future__ import annotations

import gc
import hashlib
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType

from polishd.daemon.journal.journal import JOURNAL_NAME
from tests.campaigns.crash.disk import Disk, Files
from tests.campaigns.crash.judge import Judge, Promised, Promises, Verdict, cached_checksums
from tests.campaigns.crash.recording import STATE, Op

PROCESSES = 2
KEY_BYTES = 32
"""Half of a state's name is of what is on the disk, half of what was promised."""
VARIANTS_PER_TASK = 1
"""Variants of a crash that one process tries at each prefix before it returns its result: some 20 s of work."""
MEMORY = Path("/dev/shm")
"""Where a disk of each state is laid out: what is synced there costs nothing."""


@dataclass(slots=True)
class Tried:
    """What came of some states."""

    keys: set[bytes] = field(default_factory=set)
    """Of states that were judged: what is on the disk, and what was promised."""
    bad: Counter[str] = field(default_factory=Counter)
    """By what is wrong."""
    examples: list[str] = field(default_factory=list)

    def take(self, verdict: Verdict, where: str) -> None:
        """Count it."""
        for name in ("lost", "twice_unmarked", "unopenable"):
            if said := getattr(verdict, name):
                self.bad[name] += 1
                self.examples += [f"{name}: {where}: {said}"] if self.bad[name] <= 3 else []

    def add(self, other: Tried) -> None:
        """Both."""
        self.keys |= other.keys
        self.bad += other.bad
        self.examples += other.examples


def crashes(recording: Sequence[Op], before: Files) -> Iterator[tuple[int, Disk, Promised]]:
    """Each prefix of the recording that ends before something may change on the disk; the last one is all of it."""
    disk, promises = Disk.of(before), Promises(before.get(f"{STATE}/{JOURNAL_NAME}", b""))
    for number, op in enumerate(recording):
        if op.kind == "mark":
            if "starts" in op.what:
                promises.start(disk.seen())
            else:
                promises.take(op)
            continue
        yield number, disk, promises.now()
        disk.apply(op)
    yield len(recording), disk, promises.now()


def round_of(
    recording: Sequence[Op],
    variants: Sequence[int],
    seed: int,
    known: frozenset[bytes] = frozenset(),
    before: Files = MappingProxyType({}),
) -> Tried:
    """These variants of a crash at each prefix; states that are known are not judged again.

    ``before``: the files that were there when the recording began.
    """
    tried = Tried()
    folder = Path(tempfile.mkdtemp(prefix="polishd-crash-", dir=MEMORY if MEMORY.is_dir() else None))
    try:
        judge = Judge(folder)
        with cached_checksums():
            for number, disk, promised in crashes(recording, before):
                for variant in variants if disk.pending() else (variants[:1] if 0 in variants else ()):
                    files = disk.crashed(variant, f"{seed} {number}")
                    key = _key(files, promised)
                    if key not in known and key not in tried.keys:
                        tried.keys.add(key)
                        tried.take(judge.judge(files, promised), f"seed {seed}, act {number}, variant {variant}")
    finally:
        shutil.rmtree(folder)
    return tried


_recording: list[Op] = []
"""Of this process of the pool: sent once."""


def _begin_process(recording: Sequence[Op]) -> None:
    _recording[:] = recording
    gc.freeze()  # the collector does not visit the recording again


def _round_in_process(variants: Sequence[int], seed: int, known: frozenset[bytes]) -> Tried:
    return round_of(_recording, variants, seed, known)


def rounds(recording: Sequence[Op], first: int, seed: int, known: set[bytes]) -> Iterator[tuple[int, Tried]]:
    """Yield the number of variants that were tried and the result of each task, while tasks find new states."""
    forkserver = get_context("forkserver")
    with ProcessPoolExecutor(PROCESSES, forkserver, _begin_process, (recording,)) as pool:
        while True:
            chunks = [
                range(first + k * VARIANTS_PER_TASK, first + (k + 1) * VARIANTS_PER_TASK) for k in range(PROCESSES)
            ]
            before = frozenset(known)
            tasks = [pool.submit(_round_in_process, chunk, seed, before) for chunk in chunks]
            found = [task.result() for task in tasks]
            yield from zip((chunk.stop for chunk in chunks), found, strict=True)
            if not any(tried.keys for tried in found):
                return
            first = chunks[-1].stop


def _key(files: Files, promised: Promised) -> bytes:
    """A name of this state."""
    content = hashlib.blake2b(digest_size=16)
    for path, data in sorted(files.items()):
        content.update(path.encode() + _digest(data))
    return content.digest() + hashlib.blake2b(repr(promised).encode(), digest_size=16).digest()


@lru_cache(64)
def _digest(data: bytes) -> bytes:
    """Most files of a state are those of the state before."""
    return hashlib.blake2b(data, digest_size=16).digest()
