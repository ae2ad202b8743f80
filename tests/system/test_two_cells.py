"""One daemon process with two simulated cells polishes two parts at once and keeps their data separate."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
from contextlib import ExitStack
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, with_values
from polishd.daemon.socket import client
from tests.system.cell_rig import Daemon, account, events, small_cell, summary
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import polishd, require_nothing_twice, require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full, pytest.mark.timeout(400)]


def two_cells(stack: ExitStack, tmp_path: Path, speed: float) -> list[DemoFiles]:
    """Run two cells, each with its simulator, name and seed."""
    found = []
    for seed, name in ((3, "left-cell"), (2, "right-cell")):
        files = stack.enter_context(small_cell(tmp_path / name, seed=seed, speed=speed, id=name))
        files.cell.write_text(with_values(files.cell.read_text(), {"cell": {"name": name}}))
        found.append(files)
    return found


def contact_begun(files: DemoFiles) -> bool:
    """Return whether the tool presses now."""
    log = events(files, "force_on", "tool_lifted")
    return bool(log) and log[-1]["event"] == "force_on"


def contact_spans(files: DemoFiles) -> list[tuple[float, float]]:
    """Return the time from force on to tool lifted, on the machine's monotonic clock."""
    on = [event["mono_s"] for event in events(files, "force_on")]
    off = [event["mono_s"] for event in events(files, "tool_lifted")]
    return list(zip(on, off, strict=False))


def test_two_parts_at_once_in_one_process(tmp_path: Path) -> None:
    with ExitStack() as stack:
        left, right = two_cells(stack, tmp_path, speed=20.0)
        with Daemon(left, str(right.cell)) as daemon:
            assert daemon.process.wait(300.0) == 0, daemon.output.read_text()
        for files in (left, right):
            require_nothing_twice(files)
            assert account(files)["programs"]
        spans = [(a, b) for a in contact_spans(left) for b in contact_spans(right)]
        assert any(a[0] < b[1] and b[0] < a[1] for a, b in spans), f"both tools press at the same time: {spans}"
    said = daemon.output.read_text().splitlines()
    result = json.loads(next(line for line in said if line.startswith("{")))
    assert {name: end["outcome"] for name, end in result["cells"].items()} == dict.fromkeys(
        ("left-cell", "right-cell"), "in_tolerance"
    )
    for files, name, other in ((left, "left-cell", "right-cell"), (right, "right-cell", "left-cell")):
        assert f"{name}: tool off the part: yes" in said
        assert summary(files)["job"] == name
        log = (files.state_dir / "polishd.log").read_text()
        assert str(files.run_dir) in log
        assert other not in log, "a line of one cell is not in the other's log"
        journal = sqlite3.connect(files.state_dir / "journal.sqlite")
        assert journal.execute("SELECT name, outcome FROM job").fetchall() == [(name, "in_tolerance")]
        journal.close()


def test_one_that_dies_in_contact_leaves_the_other_polishing_until_a_signal_stops_it(tmp_path: Path) -> None:
    with ExitStack() as stack:
        left, right = two_cells(stack, tmp_path, speed=10.0)
        with Daemon(left, str(right.cell)) as daemon:
            daemon.wait_in_contact()
            os.kill(json.loads((left.sim_dir / "pids.json").read_text())["robot"], signal.SIGKILL)
            wait_for(lambda: not daemon.status(), "the end of the left cell", 60.0)
            assert client.request(right.state_dir, "status")["state"] == "polishing"
            wait_for(lambda: contact_begun(right), "contact of the right cell", 60.0)
            assert daemon.end() in {5, 7}, daemon.output.read_text()
        require_safe_order(events(right))
    said = daemon.output.read_text()
    result = json.loads(next(line for line in said.splitlines() if line.startswith("{")))
    assert {name: end["outcome"] for name, end in result["cells"].items()} == {
        "left-cell": "failed", "right-cell": "stopped"
    }  # fmt: skip
    assert "left-cell: next: the daemon has ended; correct the cause" in said.replace("\n", " ")
    assert "right-cell: next: the daemon has ended; to continue" in said.replace("\n", " ")


def section(files: DemoFiles, port: str) -> str:
    """Return the lines of a device's section without its header."""
    return files.cell.read_text().split(f"[{port}]", 1)[1].split("\n", 1)[1].split("\n[", 1)[0] + "\n"


def test_a_cell_with_two_robots_polishes_with_those_of_its_roles(tmp_path: Path) -> None:
    """Both robots with their tools are opened, monitored and named; the job moves the right robot only."""
    with ExitStack() as stack:
        left, right = two_cells(stack, tmp_path, speed=40.0)
        text = right.cell.read_text()
        for port in ("robot", "actuator", "spindle"):
            other = section(left, port).replace("sim/", f"{left.sim_dir}/")
            text = text.replace(f"[{port}]", f"[{port}.left]\n{other}\n[{port}.right]")
        roles = "\n".join(f'{port} = "right"' for port in ("robot", "actuator", "spindle"))
        right.cell.write_text(f"{text}\n[roles]\n{roles}\n")
        probed = polishd("probe", right.cell, "--json")
        assert probed.returncode == 0, probed.stderr
        names = [f"{port}.{side}" for port in ("actuator", "robot", "spindle") for side in ("left", "right")]
        assert list(json.loads(probed.stdout)) == [*names, "metrology"]
        with Daemon(right) as daemon:
            daemon.wait_in_contact()
            devices = client.request(right.state_dir, "status")["devices"]
            assert {name for name, facts in devices.items() if facts["used"]} == {
                "robot.right", "actuator.right", "spindle.right", "metrology"
            }  # fmt: skip
            assert devices["robot.left"]["serial"]
            assert daemon.process.wait(300.0) == 0, daemon.output.read_text()
        require_nothing_twice(right)
        assert not events(left, "motion_started", "force_on")
    assert (summary(right)["outcome"], summary(right)["tool_off"]) == ("in_tolerance", "yes")
