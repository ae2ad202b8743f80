"""The whole simulated cell with a robot whose controller loads program files: the effects of a hold."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from asyncua import Client, ua

from polishd.sim_backends.plc_robot.device import NAMESPACE
from tests.system.agreement import disagreements, passes
from tests.system.cell_rig import Daemon, account, events, summary
from tests.system.plc_robot_rig import running, write_files
from tests.system.sim_rig import wait_for

pytestmark = pytest.mark.system


@pytest.mark.full
def test_a_feed_hold_in_contact_takes_the_tool_off_and_nothing_goes_on_by_itself(tmp_path: Path) -> None:
    """The part's seat is checked before, as with any robot."""
    files = write_files(tmp_path / "cell", "opcua", 30.0, touch_off=True, tolerance_nm=0.01, max_cycles=1)
    with running(files, 4.0), Daemon(files) as daemon:
        daemon.wait_in_contact(60)
        pids = json.loads((files.sim_dir / "pids.json").read_text())
        os.kill(pids["robot"], signal.SIGUSR2)
        assert daemon.wait() == 5, daemon.output.read_text()
        log = events(files)
        stands = account(files)["stands"]
    assert "the feed is held at the controller" in summary(files)["reason"]
    assert len(stands) >= 3, "the seat was proved"
    names = [event["event"] for event in log]
    left = names[max(k for k, name in enumerate(names) if name == "button") :]
    assert left.index("motion_stopped") < left.index("force_zero") < left.index("tool_lifted")
    assert "motion_started" not in left, "nothing resumes without a command"


@pytest.mark.full
@pytest.mark.parametrize("kind", ["opcua", "ads"])
def test_a_daemon_that_is_killed_takes_no_block_as_not_executed(tmp_path: Path, kind: str) -> None:
    """The controller keeps no history for the next client: all that the tool may have touched is uncertain."""
    files = write_files(tmp_path / "cell", kind, 30.0, tolerance_nm=0.01, max_cycles=1)
    with running(files, 4.0):
        with Daemon(files) as daemon:
            daemon.wait_in_contact(60)
            daemon.end(signal.SIGKILL)
        wait_for(lambda: events(files, "tool_lifted"), "the lift by the actuator's own watchdog")
        with Daemon(files) as daemon:
            said = daemon.wait_for_state("held")["reason"]
            daemon.end()
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
        found = disagreements(files.state_dir / "journal.sqlite", account(files)["programs"])
    assert [one for one in found if "not touched" in one] == []  # when a block ended is known to a report's time
    assert "estimated: the robot has no record of this pass" in said
    (one,) = passes(files.state_dir / "journal.sqlite")
    assert one.uncertain.size > 0
    assert one.uncertain[0] == np.flatnonzero(one.run_s)[-1] + 1, "the first block without a report"


BEAT = "controller_heartbeat"
LONG = 60_000
"""Lines of a program for 200 mm."""
TURN_S = 0.5
"""Share of the 1.5 s for which the shipped profiles allow a heartbeat not to change."""


@pytest.mark.full
def test_a_controller_that_loads_a_long_program_goes_on_answering(tmp_path: Path) -> None:
    """Cycle, heartbeat and server share one loop, which measures that none of its turns was long."""
    files = write_files(tmp_path / "cell", "opcua", 30.0)
    lines = ["G90 G94 G21", *(f"G1 X{k % 200 / 10:.3f} Y{k // 200 / 10:.3f} Z60 F600" for k in range(LONG - 1))]
    with running(files, 1.0):
        (files.sim_dir / "programs" / "long.nc").write_text("\n".join(lines) + "\n")
        endpoint = json.loads((files.sim_dir / "endpoints.json").read_text())["robot"]
        beats = asyncio.run(load(endpoint, "long.nc"))
        wait_for(lambda: events(files, "program_loaded"), "the loaded program")
        (loaded,) = events(files, "program_loaded")
    assert loaded["blocks"] == LONG
    assert loaded["longest_turn_s"] < TURN_S
    assert len(set(beats)) > 10, "it counted on meanwhile"


async def load(endpoint: str, program: str) -> list[int]:
    """Request the program and return the heartbeat at each reading until it is loaded."""
    beats: list[int] = []
    async with Client(endpoint) as client:
        index = await client.get_namespace_index(NAMESPACE)
        node = {name: client.get_node(f"ns={index};s={name}") for name in ("program", "load", "loaded", BEAT)}
        await node["program"].write_value(program, ua.VariantType.String)
        await node["load"].write_value(value=True)
        while await node["loaded"].read_value() != program:
            beats.append(await node[BEAT].read_value())
            await asyncio.sleep(0.02)
    return beats
