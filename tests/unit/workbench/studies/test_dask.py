"""The same study on a Dask scheduler and two workers over TCP, one of them killed: the same to the bit."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.config.sweep_points import load_swept
from polishd.model.errors import ConfigError
from polishd.workbench.studies.cases import cases_of
from polishd.workbench.studies.engine import work
from polishd.workbench.studies.executors import DaskCluster, Executor, LocalPool
from tests.unit.workbench.studies.test_loops import LOOPS, NONE, study_file

SWEEP = """
[[sweep.group]]
how = "drawn"
draws = 4
[sweep.group.over]
"first_seed" = { numbers_from = 1 }
"plant_with.truth.rate" = { uniform = [-0.2, 0.1], pair = true }
"""
Rows = dict[int, tuple[dict[str, Any], ...]]


class Cluster:
    """A scheduler and two workers, as anybody starts them."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "scheduler.json"
        self._log = (folder / "dask.log").open("wb")
        self.processes = [self._start("scheduler", "--host", "127.0.0.1", "--port", "0")]
        self.processes += [
            self._start(
                "worker", "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1", "--local-directory", str(folder)
            )
            for _ in range(2)
        ]

    def _start(self, what: str, *more: str) -> subprocess.Popen[bytes]:
        words = (sys.executable, "-m", "dask", what, *more, "--no-dashboard", "--scheduler-file", str(self._file))
        return subprocess.Popen(words, stdout=self._log, stderr=self._log)

    @property
    def address(self) -> str:
        """Where the scheduler is; it writes its file when it listens."""
        from distributed import Client

        with Client(scheduler_file=str(self._file), timeout=120) as client:
            client.wait_for_workers(2, timeout=120)
        return str(json.loads(self._file.read_text())["address"])

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
        self._log.close()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    started = Cluster(tmp_path)
    yield started
    started.close()


def rows(study: Path, executor: Executor, kill: subprocess.Popen[bytes] | None = None) -> Rows:
    """By case; after the first that came, that worker is killed."""
    found = {}
    with executor:
        for done in work(study, cases_of(load_swept(study)), executor):
            found[done.case.number] = tuple(
                {key: value for key, value in row.items() if key != "cpu_s"} for row in done.answer.rows
            )
            if kill is not None:
                kill.kill()
    return found


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_cluster_that_loses_a_worker_gives_the_same_bits_as_a_pool(tmp_path: Path, cluster: Cluster) -> None:
    study = study_file(tmp_path, f"{LOOPS}{NONE}{SWEEP}", near=-0.1)
    here = rows(study, LocalPool(2))
    there = rows(study, DaskCluster(cluster.address), cluster.processes[1])
    assert len(here) == 8
    assert all(here.values())
    assert there == here


def test_nobody_at_the_address_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.workbench.studies.executors.WORKERS_S", 0.2)
    with pytest.raises(ConfigError, match=r"--scheduler tcp://127.0.0.1:1: no scheduler with workers answers"):
        DaskCluster("tcp://127.0.0.1:1")


def test_without_dask_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"install polishd\[dask\]"):
        DaskCluster("tcp://127.0.0.1:1")
