"""Two tools on one part in a simulated cell: a command or the operator changes them, and each makes its pass."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from polishd.daemon.socket import client
from tests.system.agreement import require_agreement
from tests.system.cell_rig import Daemon, events, summary, with_keys, write_small
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import polishd

pytestmark = pytest.mark.system

TOOLS = {"tools.large": {"tool_radius_mm": 40.0, "change_s": 60.0}, "tools.small": {"tool_radius_mm": 15.0}}
RADIUS_MM = {"large": 40.0, "small": 15.0}
CHANGER = """
import json, os, pathlib, signal, time

here = pathlib.Path(__file__).parent
sim, log = here / "sim.toml", here / "sim" / "sim.log"
reloads = log.read_text().count('"signal": "SIGHUP"')
radius_mm = {radius_mm}[os.environ["POLISHD_TOOL"]]
sim.write_text(sim.read_text().partition("\\n[process]\\n")[0] + f"\\n[process]\\ntool_radius_mm = {{radius_mm}}\\n")
os.kill(json.loads((here / "sim" / "pids.json").read_text())["plant"], signal.SIGHUP)
while log.read_text().count('"signal": "SIGHUP"') == reloads:
    time.sleep(0.01)
"""
"""Script that puts that tool on the simulated spindle and waits until it is there."""


@contextlib.contextmanager
def two_tools(out: Path, *, change: bool, speed: float = 20.0, **job: Any) -> Iterator[DemoFiles]:
    """Run a small cell with two tools, the large one on its spindle."""
    files = write_small(out, touch_off=True, **{"tolerance_nm": 0.01, "max_cycles": 2, **job})
    changer = files.out / "change.py"
    changer.write_text(CHANGER.format(radius_mm=RADIUS_MM))
    cell = with_keys(files.cell.read_text(), TOOLS)
    if change:
        cell += f"\n[part_handling.change]\ncommand = {json.dumps([sys.executable, str(changer)])}\ntimeout_s = 60.0\n"
    files.cell.write_text(cell)
    files.sim.write_text(files.sim.read_text() + f"\n[process]\ntool_radius_mm = {RADIUS_MM['large']}\n")
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


def mounted(files: DemoFiles) -> list[str]:
    with contextlib.closing(sqlite3.connect(files.state_dir / "journal.sqlite")) as journal:
        rows = journal.execute("SELECT data FROM event WHERE name = 'tool_mounted' ORDER BY id")
        return [json.loads(data)["tool"] for (data,) in rows]


@pytest.mark.full
def test_a_command_changes_the_tool_and_each_makes_its_pass(tmp_path: Path) -> None:
    with two_tools(tmp_path / "cell", change=True) as files:
        checked = json.loads(polishd("check", str(files.cell), "--json").stdout)
        assert {"large: covers", "small: covers", "large: seat", "small: seat"} < set(checked)
        with Daemon(files) as daemon:
            assert daemon.wait() == 1, daemon.output.read_text()
        require_agreement(files)
    assert mounted(files) == ["large", "small"]
    assert len(events(files, "button")) == 2
    first, second, last = summary(files)["cycles"]
    assert [first["tool"], second["tool"], last["tool"]] == ["large", "small", None]
    assert last["rms_nm"] < second["rms_nm"] < first["rms_nm"]
    assert last["rms_nm"] < 0.25 * first["rms_nm"], "what the large tool left the small one took"
    assert json.loads((files.run_dir / "cycle-01" / "touch_off.json").read_text())["seat"], "the new tool is proved"


@pytest.mark.full
def test_a_person_changes_the_tool_and_a_killed_daemon_asks_again(tmp_path: Path) -> None:
    with two_tools(tmp_path / "cell", change=False) as files:
        with Daemon(files) as daemon:
            held = daemon.wait_for_state("held")
            assert "mount the tool 'large'" in held["reason"]
            assert not events(files, "engage"), "nothing is touched with an unknown tool"
            client.request(files.state_dir, "resume")
            wait_for(lambda: "'small'" in daemon.status().get("reason", ""), "the second tool is asked for")
            assert daemon.end(signal.SIGKILL) == -signal.SIGKILL
        with Daemon(files) as daemon:
            daemon.wait_for_state("held")
            client.request(files.state_dir, "resume")
            held = wait_for(
                lambda: "'small'" in (s := daemon.status()).get("reason", "") and s, "it is asked for again"
            )
            assert held["state"] == "held"
            polishd_tool = {**os.environ, "POLISHD_TOOL": "small"}
            os.spawnve(os.P_WAIT, sys.executable, [sys.executable, str(files.out / "change.py")], polishd_tool)
            client.request(files.state_dir, "resume")
            assert daemon.wait() == 1, daemon.output.read_text()
        require_agreement(files)
    assert mounted(files) == ["large", "small"]
    assert [cycle["tool"] for cycle in summary(files)["cycles"]] == ["large", "small", None]
