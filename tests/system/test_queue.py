"""A queue of parts on a simulated cell with a loader, as processes over real wires."""

from __future__ import annotations

import contextlib
import json
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.daemon.socket import client
from tests.system.cell_rig import Daemon, events, with_keys, write_small
from tests.system.sim_rig import wait_for

pytestmark = pytest.mark.system

SPEED = 40.0


def job_text(name: str, part: str) -> str:
    """Return a job that one or two passes bring into tolerance."""
    return f'[job]\nid = "{name}"\ntolerance_nm = 5.0\nmax_cycles = 3\n[part]\nid = "{part}"\n'


def write_queue_cell(out: Path, **faults: list[str]) -> DemoFiles:
    """Write the small cell's files with a loader."""
    files = write_small(out)
    port = free_port()
    cell = files.cell.read_text()
    cell += f'\n[loader]\ntype = "loader_line"\naddress = "tcp://127.0.0.1:{port}"\n'
    files.cell.write_text(with_keys(cell, {"metrology": {"timeout_s": 8.0}}))
    keys = "".join(f"{name} = {json.dumps(parts)}\n" for name, parts in faults.items())
    with files.sim.open("a") as sim:
        sim.write(f"\n[loader.faults]\n{keys}")
    return files


def polishd(*words: object) -> subprocess.CompletedProcess[str]:
    """Run a command of polishd."""
    command = [sys.executable, "-m", "polishd", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def add(files: DemoFiles, *jobs: tuple[str, str]) -> None:
    """Run ``polishd queue add``."""
    paths = [files.out / f"{name}.toml" for name, _ in jobs]
    for path, (name, part) in zip(paths, jobs, strict=True):
        path.write_text(job_text(name, part))
    said = polishd("queue", "add", files.cell, *paths)
    assert said.returncode == 0, said.stderr


def queue(files: DemoFiles) -> dict[str, dict[str, Any]]:
    """Return the jobs of ``polishd queue list`` by name."""
    said = polishd("queue", "list", files.cell, "--json")
    assert said.returncode == 0, said.stderr
    return {job["name"]: job for job in json.loads(said.stdout)["jobs"]}


def states(files: DemoFiles) -> dict[str, str]:
    """Return the states of the jobs from the daemon."""
    return {job["name"]: job["state"] for job in client.request(files.state_dir, "queue_list")["jobs"]}


def journal(files: DemoFiles, sql: str) -> list[tuple[Any, ...]]:
    """Return the rows of a query to the journal file."""
    with contextlib.closing(sqlite3.connect(files.state_dir / "journal.sqlite")) as connection:
        return connection.execute(sql).fetchall()


@contextlib.contextmanager
def queue_cell(out: Path, **faults: list[str]) -> Iterator[DemoFiles]:
    files = write_queue_cell(out, **faults)
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{SPEED:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


@pytest.mark.full
def test_parts_without_a_person_and_one_that_comes_while_it_runs(tmp_path: Path) -> None:
    with queue_cell(tmp_path / "cell") as files:
        add(files, ("one", "P-1"))
        with Daemon(files, "--queue") as daemon:
            assert daemon.wait_for_state("polishing")["job"] == "one"
            add(files, ("two", "P-2"))
            wait_for(lambda: states(files) == {"one": "accepted", "two": "accepted"}, "both parts")
            daemon.wait_for_state("idle")
            assert polishd("stop", files.cell).returncode == 0
            assert daemon.wait() == 0, daemon.output.read_text()
        moves = events(files, "loader_moves")
        assert [event["part"] for event in moves] == ["", "P-1", "", "P-2"]
        assert not any(event["robot_moves"] or event["tool_is_out"] for event in moves)
        assert len(list((files.run_dir).glob("*/summary.json"))) == 2
    require_second_part_began_with_what_the_first_taught(files)


def require_second_part_began_with_what_the_first_taught(files: DemoFiles) -> None:
    sql = "SELECT job, json_extract(facts, '$.rate'), json_extract(facts, '$.taught.believed.rate') FROM pass ORDER BY "
    (*_, (_, _, taught)), (second, *_) = (
        [row for row in journal(files, f"{sql} job, cycle") if row[0] == number] for number in (1, 2)
    )
    assert second[1] == taught != 1.0
    (lesson,) = json.loads(polishd("estimates", "show", files.cell, "--json").stdout)["beliefs"]
    assert lesson["job"] == "two"
    assert polishd("estimates", "forget", files.cell, "--reason", "another pad").returncode == 0
    assert json.loads(polishd("estimates", "show", files.cell, "--json").stdout)["beliefs"] == []


@pytest.mark.full
def test_a_wrong_part_is_put_aside_and_a_kill_in_between_loses_nothing(tmp_path: Path) -> None:
    with queue_cell(tmp_path / "cell", wrong=["P-1"], wrong_part_unnoticed=["P-3"]) as files:
        add(files, ("one", "P-1"), ("two", "P-2"), ("three", "P-3"), ("four", "P-4"))
        with Daemon(files, "--queue", "--until-empty") as daemon:
            daemon.wait_in_contact(50)
            daemon.end(signal.SIGKILL)
        assert queue(files)["one"]["state"] == "set aside"
        assert "'OTHER-7' is on the seat instead of 'P-1'" in queue(files)["one"]["reason"]
        assert queue(files)["two"]["state"] == "under way"
        with Daemon(files, "--queue", "--until-empty") as daemon:
            assert "pass 0 was interrupted" in daemon.wait_for_state("held")["reason"]
            assert polishd("resume", files.cell).returncode == 0
            assert daemon.wait() == 1, daemon.output.read_text()
        found = queue(files)
        assert {name: job["state"] for name, job in found.items()} == {
            "one": "set aside",
            "two": "accepted",
            "three": "set aside",
            "four": "accepted",
        }
        assert found["three"]["reason"].startswith("WrongPart: ")
        assert "it shows part 'OTHER-7'" in found["three"]["reason"]
        assert journal(files, "SELECT name, count(*) FROM job GROUP BY name ORDER BY min(id)") == [
            ("one", 1),
            ("two", 1),
            ("three", 1),
            ("four", 1),
        ]
        assert journal(files, "SELECT how FROM pass JOIN job ON job = id WHERE name = 'two' AND cycle = 0") == [
            ("interrupted",)
        ]
