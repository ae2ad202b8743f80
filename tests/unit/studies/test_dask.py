"""The same study on a Dask scheduler and two workers over TCP, one of them killed: the same to the bit."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from polishd.config.sweep import load_swept
from polishd.model.errors import ConfigError
from polishd.studies import engine
from polishd.studies.cases import cases_of
from polishd.studies.engine import DaskCluster, Executor, LocalPool, work
from tests.unit.studies.dask_rig import Cluster
from tests.unit.studies.test_case_runner import LOOPS, NONE, study_file

SWEEP = """
[[sweep.group]]
how = "drawn"
draws = 4
[sweep.group.over]
"first_seed" = { numbers_from = 1 }
"plant_with.hidden_truth.rate" = { uniform = [-0.2, 0.1], pair = true }
"""
Rows = dict[int, tuple[dict[str, Any], ...]]


def rows(
    study: Path, executor: Executor, kill: Callable[[], None] = lambda: None, report_wait: Callable[[str], None] = print
) -> Rows:
    """Return the rows by case; ``kill`` is called after each result."""
    found = {}
    with executor:
        for done in work(study, cases_of(load_swept(study)), executor, report_wait=report_wait):
            found[done.case.number] = tuple(
                {key: value for key, value in row.items() if key != "cpu_s"} for row in done.answer.rows
            )
            kill()
    return found


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_cluster_that_loses_a_worker_gives_the_same_bits_as_a_pool(tmp_path: Path) -> None:
    study = study_file(tmp_path, f"{LOOPS}{NONE}{SWEEP}", near=-0.1)
    here = rows(study, LocalPool(2))
    with Cluster(tmp_path, 2) as cluster:
        there = rows(study, DaskCluster(cluster.address), cluster.workers[0].kill)
    assert len(here) == 8
    assert all(here.values())
    assert there == here


@pytest.mark.full
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_cluster_without_workers_is_waited_for_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """None at first, and none once the only one was killed; a read starts one."""
    monkeypatch.setattr(engine, "LOOK_S", 1.0)
    study, said = study_file(tmp_path, f"{LOOPS}{SWEEP}", near=-0.1), list[str]()
    with Cluster(tmp_path, 0) as cluster:

        def kill() -> None:
            cluster.workers[0].kill()

        def report_wait(words: str) -> None:
            said.append(words)
            if words.startswith("no worker"):
                cluster.add_worker()

        found = rows(study, DaskCluster(cluster.address), kill, report_wait)
        start = f"no worker at {cluster.address}: start one with `dask worker {cluster.address} --nthreads 1`"
    assert len(found) == 4
    assert all(found.values())
    assert said == [f"{start}; the study waits", "a worker is there; the study continues"] * 2
    assert len(cluster.workers) == 2


def test_an_address_without_a_scheduler_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.studies.engine.ANSWER_S", 0.2)
    with pytest.raises(ConfigError, match=r"--scheduler tcp://127.0.0.1:1: no scheduler answers"):
        DaskCluster("tcp://127.0.0.1:1")


def test_without_dask_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"polishd\[dask\]"):
        DaskCluster("tcp://127.0.0.1:1")
