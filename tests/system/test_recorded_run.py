"""Two cells in one process are recorded while they polish: each has a file, with its own wires in it."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.config.cell import load_config
from polishd.plugins import devices
from polishd.testing.device_rig import DriverCase
from polishd.testing.replay import replayed
from polishd.util.wire_recording import read_recording
from tests.system.cell_rig import PATIENT, Daemon
from tests.system.test_two_cells import two_cells

pytestmark = [pytest.mark.system, pytest.mark.full, pytest.mark.timeout(400)]


def devices_addresses(files: DemoFiles) -> dict[str, str]:
    devices = load_config(files.cell).devices
    return {name: str(devices[name].address).partition("?")[0] for name in ("actuator", "robot", "spindle")}


async def test_each_cell_has_a_file_of_its_own_wires(tmp_path: Path) -> None:
    cases = tmp_path / "cases"
    cases.mkdir()
    with ExitStack() as stack:
        left, right = two_cells(stack, tmp_path, speed=40.0)
        with Daemon(left, str(right.cell), "--record", str(cases)) as daemon:
            assert daemon.process.wait(300.0) == 0, daemon.output.read_text()
        expected = {"left-cell": devices_addresses(left), "right-cell": devices_addresses(right)}
    found = {recording.header["cell"]: recording for recording in map(read_recording, sorted(cases.iterdir()))}
    assert set(found) == set(expected)
    for cell, recording in found.items():
        assert recording.notes == ()
        links = {one.role: one.link for one in recording.passed}
        assert set(links) == {"actuator", "robot", "spindle"}
        assert links["robot"] == expected[cell]["robot"]
        assert cell in links["actuator"]
        assert cell in links["spindle"]
    patient = {key: value for key, value in PATIENT["robot"].items() if key != "no_progress_s"}  # the daemon's own key
    options = {"address": "{endpoint}", **patient}
    async with replayed(found["left-cell"].path, "robot") as link:
        robot = DriverCase(plugin=devices, type="robot_link", options=options).build(tmp_path, link.endpoint)
        await robot.open()
        assert (await robot.identify()).model
        await robot.close()
