"""Start time of imports and shell commands in fresh processes, beside bare Python and numpy.

Least CPU time of the whole process, which on a free machine is the wall time, in turns with the peers, so that a busy
spell of the machine hits all alike. The modules must stay below half a second.
``python -X importtime -c 'import polishd.api'`` shows the parts.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import Progress, Row
from polishd.commissioning.rehearsal.simulated_cell import write_demo

TURNS = 9
MOST_NUMPY = 4.4
"""Of ``import numpy``: the most that a module of polishd may cost to import; 0.5 s where numpy takes 0.113 s."""
PEERS: dict[str, tuple[str, ...]] = {"python": ("-c", "pass"), "numpy": ("-c", "import numpy")}
MODULES = ("polishd", "polishd.api", "polishd.plugins.interferometer")
MAP = ("-m", "polishd.cli.app", "map")
SAMPLES = 200
VERBS = ("status", "check")
"""Of the demo's cell, where no daemon runs: its program has 9,410 timed points."""
NO_DAEMON = 5


def rows(progress: Progress) -> Iterator[Row]:
    """Seconds from start to end of a process."""
    with tempfile.TemporaryDirectory() as scratch:
        surface = Path(scratch) / "map.npy"
        np.save(surface, np.random.default_rng(1).normal(0.0, 1.0, (SAMPLES, SAMPLES)))
        ours: dict[str, tuple[str, ...]] = {f"import {name}": ("-c", f"import {name}") for name in MODULES}
        ours |= {"polishd map --help": (*MAP, "--help"), "polishd map FILE --json": (*MAP, str(surface), "--json")}
        cell = write_demo(Path(scratch) / "demo", None, 2.0, 4, None).cell
        ours |= {f"polishd {verb} CELL.toml": ("-m", "polishd", verb, str(cell)) for verb in VERBS}
        taken = measured({**ours, **PEERS}, progress)
    cpu_s = {name: min(costs) for name, costs in taken.items()}
    for name in ours:
        yield Row(name, cpu_s[name], {peer: cpu_s[peer] for peer in PEERS})
    limit_s = MOST_NUMPY * cpu_s["numpy"]
    late = {name: cpu_s[name] for name in ours if name.startswith("import ") and cpu_s[name] > limit_s}
    if late:
        raise RuntimeError(
            f"above {limit_s:.2f} s: " + ", ".join(f"{name} {cost:.2f} s" for name, cost in late.items())
        )


def measured(commands: Mapping[str, Sequence[str]], progress: Progress) -> dict[str, list[float]]:
    """CPU seconds of ``TURNS`` processes of each command; a first turn, which fills caches, does not count."""
    taken: dict[str, list[float]] = {name: [] for name in commands}
    for turn in range(TURNS + 1):
        for name, words in commands.items():
            progress(f"import: {name} {turn}/{TURNS}")
            cost = cost_of(words)
            if turn:
                taken[name].append(cost)
    return taken


def cost_of(words: Sequence[str]) -> float:
    """CPU seconds of one fresh interpreter; RuntimeError where it fails."""
    before = _children_s()
    ended = subprocess.run([sys.executable, *words], check=False, capture_output=True)
    if ended.returncode not in {0, NO_DAEMON if "status" in words else 0}:
        raise RuntimeError(f"{' '.join(words)} failed:\n{ended.stderr.decode(errors='replace')}")
    return _children_s() - before


def _children_s() -> float:
    """CPU seconds of all ended child processes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
