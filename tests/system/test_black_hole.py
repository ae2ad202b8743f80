"""Robot and actuator stop answering in contact while their links stay open: the daemon ends and reports it."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Literal

import pytest

from tests.system.cell_rig import Daemon, summary, write_small
from tests.system.plc_robot_rig import Kind, hand_over, running

pytestmark = [pytest.mark.system, pytest.mark.full]


@pytest.mark.parametrize("kind", ["link", "opcua", "ads"])
def test_a_stop_ends_in_time_though_robot_and_actuator_swallow_all(
    tmp_path: Path, kind: Kind | Literal["link"]
) -> None:
    """The processes are stopped: the kernel accepts new connections and bytes, but no answer comes.

    The limit that ``wait`` has ends what hangs: what the daemon may take by its own limits is much less.
    """
    files = write_small(tmp_path / "cell", tolerance_nm=0.01, max_cycles=1)
    if kind != "link":
        hand_over(files, kind)
    with running(files, 4.0), Daemon(files) as daemon:
        daemon.wait_in_contact(60)
        pids = json.loads((files.sim_dir / "pids.json").read_text())
        stopped = [pids["robot"], pids["actuator"]]
        try:
            for pid in stopped:
                os.kill(pid, signal.SIGSTOP)
            assert daemon.end() != 0, daemon.output.read_text()
        finally:
            for pid in stopped:
                os.kill(pid, signal.SIGCONT)
    end = summary(files)
    assert (end["tool_off"], end["robot_at_rest"]) == ("not confirmed", "not confirmed")
    assert [said.partition(":")[0] for said in end["unsafe"]] == ["actuator", "robot"]
    assert end["cycles"][0]["uncertain"], "the daemon has no report of the blocks after the silence began"
