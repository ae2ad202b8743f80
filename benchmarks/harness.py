"""Common parts of the benchmark modules: ``Row``, ``race`` that measures one, and a simulated cell."""

from __future__ import annotations

import ctypes
import gc
import json
import multiprocessing
import os
import re
import resource
import signal
import statistics
import tempfile
import time
import traceback
import tracemalloc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import simulated_cell

Progress = Callable[[str], None]
Runner = Callable[[], object]

PEER_CAP_S = 120.0
OURS_CAP_S = 600.0
ONCE_ABOVE_S = 30.0
MIN_REPEATS = 3


@dataclass(frozen=True, slots=True)
class Row:
    """One comparison. All values are costs: less is better. The ``None`` of a peer means that it did not finish."""

    name: str
    ours: float
    peers: Mapping[str, float | None]
    unit: str = "s"
    quartiles: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Quartiles of ``ours`` and of each peer that ran more than once."""

    @property
    def ratio(self) -> float | None:
        """Cost of the best peer over ours: above 1, ours is the better; None without a cost to divide."""
        finished = [value for value in self.peers.values() if value is not None]
        return min(finished) / self.ours if finished and self.ours > 0 else None

    def as_json(self) -> dict[str, Any]:
        """Return the row as values of JSON."""
        return {
            "name": self.name,
            "ours": self.ours,
            "peers": dict(self.peers),
            "unit": self.unit,
            "ratio": self.ratio,
            "quartiles": {name: list(ends) for name, ends in self.quartiles.items()},
        }


def race(
    name: str,
    ours: Runner,
    peers: Mapping[str, Runner],
    unit: str = "s",
    repeats: int = MIN_REPEATS,
    *,
    progress: Progress = lambda _: None,
    peer_cap_s: float = PEER_CAP_S,
    once_above_s: float = ONCE_ABOVE_S,
) -> Row:
    """Median CPU seconds of ours and of each peer, run in turns so that a busy spell of the machine hits all alike.

    Every run is a fork of this process: all start from the same state (what is imported or prepared here is not
    counted), and one that hangs can be killed. A peer whose first run takes over ``once_above_s`` is run only once;
    one that takes over ``peer_cap_s`` of wall time did not finish. A runner that raises fails the race.
    """
    if repeats < MIN_REPEATS:
        raise ValueError(f"a median of {repeats} says little: at least {MIN_REPEATS} repeats")
    running = {"ours": ours, **peers}
    if len(running) != 1 + len(peers):
        raise ValueError("no peer can be called 'ours'")
    taken: dict[str, list[float | None]] = {runner: [] for runner in running}
    for turn in range(1, repeats + 1):
        for runner, run in list(running.items()):
            progress(f"{name}: {runner} {turn}/{repeats}")
            cost = cpu_seconds(run, OURS_CAP_S if runner == "ours" else peer_cap_s)
            taken[runner].append(cost)
            if runner == "ours" and cost is None:
                raise TimeoutError(f"{name}: ours did not finish within {OURS_CAP_S:g} s")
            if runner != "ours" and (cost is None or cost > once_above_s):
                del running[runner]
    costs = {runner: _median(values) for runner, values in taken.items()}
    own = costs.pop("ours")
    assert own is not None  # an error was raised above
    spread = {runner: ends for runner, values in taken.items() if (ends := _quartiles(values)) is not None}
    return Row(name, own, costs, unit, spread)


def _quartiles(costs: list[float | None]) -> tuple[float, float] | None:
    finished = [cost for cost in costs if cost is not None]
    if len(finished) < MIN_REPEATS:
        return None
    low, _, high = statistics.quantiles(finished, n=4, method="inclusive")
    return low, high


def _median(costs: list[float | None]) -> float | None:
    finished = [cost for cost in costs if cost is not None]
    return statistics.median(finished) if len(finished) == len(costs) else None


def cpu_seconds(run: Runner, cap_s: float) -> float | None:
    """CPU seconds of one run in a fork, with those of the processes it waits for; None if capped."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_timed, args=(run, sender))
    process.start()
    sender.close()
    try:
        answer = receiver.recv() if receiver.poll(cap_s) else None
    except EOFError:
        answer = "the process died without a word"
    finally:
        _kill_group(process)
        receiver.close()
    if isinstance(answer, str):
        raise RuntimeError(f"a runner failed:\n{answer}")
    return answer


def _timed(run: Runner, sender: Connection) -> None:
    os.setsid()  # so that its children can be killed with it
    before = _cpu_s()
    try:
        run()
    except BaseException:  # noqa: BLE001  the parent reports every error
        sender.send(traceback.format_exc())
    else:
        sender.send(_cpu_s() - before)


def _cpu_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _kill_group(process: multiprocessing.process.BaseProcess) -> None:
    assert process.pid is not None
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        process.kill()  # it has no process group yet, or has ended
    process.join()
    process.close()


@contextmanager
def running_cell(sim: str) -> Iterator[dict[str, str]]:
    """Run a simulated cell of that SIM.toml; yield the address of each device."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        config, state = folder / "sim.toml", folder / "sim"
        config.write_text(sim)
        with simulated_cell(config, ["--state", str(state)], folder / "sim.stderr"):
            yield json.loads((state / "endpoints.json").read_text())


def memory_bytes(key: str, process: int | str = "self") -> int:
    """Return a memory figure of the kernel for a process: ``VmRSS`` is in use, ``VmHWM`` its peak."""
    found = re.search(rf"^{key}:\s*(\d+) kB", Path(f"/proc/{process}/status").read_text(), re.MULTILINE)
    if found is None:
        raise RuntimeError(f"/proc/{process}/status has no {key}")
    return int(found[1]) * 1024


def reset_peak() -> int:
    """Give freed memory back to the kernel, let ``VmHWM`` of this process begin anew, and return its ``VmRSS``."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # freed memory that is used again would hide what is measured next
    Path("/proc/self/clear_refs").write_text("5")
    return memory_bytes("VmRSS")


def peak_mb(run: Callable[[], object]) -> float:
    """Most memory that a run takes beyond its input, MB."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
