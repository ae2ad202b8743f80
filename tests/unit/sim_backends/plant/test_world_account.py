"""The plant's book of contact time, and its server's view of who is where."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.simulator import SimConfig, load_simulator
from polishd.config.simulator_physics import Plant
from polishd.sim_backends.common import runtime
from polishd.sim_backends.common.runtime import Start
from polishd.sim_backends.plant import part as parts
from polishd.sim_backends.plant.server import PlantServer, build
from polishd.sim_backends.plant.world import DwellAccount
from tests.time_limits import SOON_S

SMALL = SimConfig(plant=Plant(aperture_mm=10.0, ring_mm=4.0))


def test_blocks_are_booked_on_the_program_they_belong_to() -> None:
    book = DwellAccount()
    book.load("a", 4)
    book.dwell("a", np.array([1.0, 1.0, 3.0]), np.array([0.25, 0.5, 2.0]))
    book.load("b", 2)
    book.dwell("a", np.array([0.0]), np.array([1.0]))
    book.dwell("b", np.array([1.0]), np.array([4.0]))
    book.dwell("unknown", np.array([0.0]), np.array([9.0]))
    assert book.programs["a"].tolist() == [1.0, 0.75, 0.0, 2.0]
    assert book.programs["b"].tolist() == [0.0, 4.0]


def test_a_program_loaded_again_is_counted_and_keeps_its_seconds() -> None:
    book = DwellAccount()
    book.load("a", 2)
    book.dwell("a", np.array([1.0]), np.array([4.0]))
    book.load("a", 2)
    assert (book.loads["a"], book.programs["a"].tolist()) == (2, [0.0, 4.0])
    book.load("a", 3)
    assert book.programs["a"].tolist() == [0.0, 0.0, 0.0], "another length is another program"


def test_standing_in_one_place_is_one_stand() -> None:
    book = DwellAccount()
    for k in range(5):
        book.stand(1.0, 2.0, 10.0 + 0.1 * k, 0.1)
    book.stand(1.5, 2.0, 10.5, 0.1)
    book.stand(1.5, 2.0, 12.0, 0.1)
    assert [round(stand["seconds"], 6) for stand in book.stands] == [0.5, 0.1, 0.1]
    assert book.standstill_s == pytest.approx(0.7)


def test_it_is_written_whole_beside_the_truth(tmp_path: Path) -> None:
    part = parts.make(SMALL.plant, 1)
    part.height_nm -= 5.0
    book = DwellAccount()
    book.load("a", 3)
    book.dwell("a", np.array([2.0]), np.array([1.5]))
    book.write(tmp_path, part, 42.0, 7.0)
    reported = json.loads((tmp_path / "dwell_account.json").read_text())
    assert reported["programs"] == [{"sha256": "a", "blocks": 3, "loads": 1, "contact_s": [0.0, 0.0, 1.5]}]
    assert (reported["process_s"], reported["until_s"]) == (42.0, 7.0)
    assert reported["rms_nm"] == pytest.approx(SMALL.plant.rms_nm), "a piston is no figure"
    truth = np.load(tmp_path / reported["truth"])
    np.testing.assert_allclose(truth["start_nm"] - truth["height_nm"], 5.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dwell_account.json", "truth.npz"]


async def until(condition: Callable[[], object]) -> None:
    """Wait until it is so."""
    async with asyncio.timeout(SOON_S):
        while not condition():  # noqa: ASYNC110 -- no event exists
            await asyncio.sleep(0.005)


class Writer:
    """What the server says to a device."""

    def __init__(self) -> None:
        self.said: list[bytes] = []

    def write(self, data: bytes) -> None:
        """Keep it."""
        self.said.append(data)

    def close(self) -> None:
        """Nothing to close."""

    def reported(self, key: str) -> list[Any]:
        """Values of that key in all JSON frames."""
        frames = [json.loads(data[5:]) for data in self.said if data[4] == 0]
        return [frame[key] for frame in frames if key in frame]


@pytest.fixture
def server(tmp_path: Path) -> PlantServer:
    return build(Start(SMALL, tmp_path, seed=1, speed=60.0))


def arrive(server: PlantServer, device: str, at_s: float) -> Writer:
    """A device introduces itself."""
    writer = Writer()
    server._arrive(device, at_s, writer)  # type: ignore[arg-type]
    return writer


def test_the_truth_is_drawn_by_the_seed_and_left_in_the_state_folder(tmp_path: Path) -> None:
    drawn = []
    for seed in (1, 1, 2):
        build(Start(SMALL, tmp_path, seed=seed, speed=60.0))
        drawn.append((tmp_path / "truth.json").read_text())
    assert drawn[0] == drawn[1] != drawn[2]


def test_a_part_that_is_taken_off_stays_to_be_seen_and_the_file_says_what_the_next_is_like(tmp_path: Path) -> None:
    file = tmp_path / "sim.toml"
    file.write_text("[plant]\npart_id = 'A/1'\naperture_mm = 10.0\nring_mm = 4.0\nrms_nm = 8.0\npv_nm = 60.0\n")
    server = build(Start(load_simulator(file), tmp_path, seed=1, speed=60.0))
    file.write_text(
        file.read_text().replace("8.0", "3.0").replace("60.0", "20.0") + "[hidden_truth]\ntool_wear = 0.5\n"
    )
    server.again()
    server.change("")
    kept = np.load(tmp_path / "parts" / "A%2F1.npz")
    server.change("B")
    assert kept["start_nm"][kept["pad"] : -kept["pad"], kept["pad"] : -kept["pad"]][kept["clear"]].std() == (
        pytest.approx(8.0)
    )
    assert server.world.part.stats()[0] == pytest.approx(3.0)
    assert server.world.config.hidden_truth.tool_wear == 0.5


def test_a_device_gets_the_positions(server: PlantServer) -> None:
    now = time.monotonic()
    robot, actuator = arrive(server, "robot", now), arrive(server, "actuator", now)
    assert robot.reported("pose") == [list(SMALL.robot.home)]
    assert robot.reported("pitch_mm") == [0.5]
    assert actuator.reported("touch_um") == [None]
    server._hear("robot", {"mark": now + 0.1, "pose": [0.0, 0.0, 0.0, 15.0, 0.0]})
    server._send_touch()
    server._send_touch()
    assert actuator.reported("touch_um") == [None, 5000.0], "once for each change"
    server._hear("robot", {"mark": now + 0.2, "pose": [0.0, 0.0, 9.0, 15.0, 0.0]})
    server._send_touch()
    assert actuator.reported("touch_um") == [None, 5000.0, None]


def test_a_measurement_waits_for_the_tool_and_the_robot(server: PlantServer) -> None:
    now = time.monotonic()
    for device in ("robot", "actuator"):
        arrive(server, device, now)
    instrument = arrive(server, "interferometer", now)
    greeting = len(instrument.said)
    server._hear("actuator", {"event": "engage", "t": now + 0.1})
    server._hear("interferometer", {"measure": True, "t": now + 0.2})
    server._measure(now + 1.0)
    assert len(instrument.said) == greeting, "the tool is on the part"
    server._hear("actuator", {"event": "retracted", "t": now + 2.0})
    server._hear("robot", {"event": "motion_started", "t": now + 2.1})
    server._measure(now + 3.0)
    assert len(instrument.said) == greeting, "the robot moves"
    server._hear("robot", {"event": "motion_stopped", "t": now + 4.0})
    server._measure(now + 3.9)
    assert len(instrument.said) == greeting, "what happened before is not all in the part yet"
    server._measure(now + 4.1)
    server._measure(now + 5.0)
    (asked,) = instrument.said[greeting:]
    assert asked[4] == 1, "heights, once"


def test_a_device_that_is_lost_exerts_nothing_from_then_on(server: PlantServer) -> None:
    now = time.monotonic()
    arrive(server, "actuator", now - 1.0)
    server._hear("actuator", {"samples": [[now - 0.9, 12.0]], "mark": now - 0.5})
    assert server.world.force.at(np.array([now - 0.6])).tolist() == [12.0]
    server._leave("actuator")
    assert server.world.force.mark_s == math.inf, "no device delays the plant any more"
    assert server.world.force.at(np.array([time.monotonic() + 1.0])).tolist() == [0.0]
    server.finish()
    log = (server.start.state / "sim.log").read_text().splitlines()
    assert json.loads(log[-1])["event"] == "lost"


async def test_frames_of_devices_reach_the_plant_and_its_answers_them(server: PlantServer) -> None:
    """Over a real socket, as in the cell."""
    path = server.start.state / runtime.SOCKET
    listener = await asyncio.start_unix_server(server.serve, str(path))
    async with listener:
        link = await runtime.connect(server.start.state, "robot")
        assert link.welcome["pose"] == list(SMALL.robot.home)
        link.event("program_loaded", sha256="ab", blocks=3)
        seconds = time.monotonic() + np.array([[0.0, 0.5], [0.5, 1.0]])
        motion = np.column_stack([[0.0, 1.0], seconds, [0.5, 0.5], np.zeros((2, 5))])
        link.rows(motion, float(seconds[-1, 1]), (1.0, 2.0, 3.0, 0.0, 0.0))
        await until(lambda: server.world.pose == (1.0, 2.0, 3.0, 0.0, 0.0))
        assert server.world.account.loads == {"ab": 1}
        link.writer.close()
        await link.writer.wait_closed()
        await until(lambda: "robot" not in server.writers)


async def test_a_client_without_hello_is_ignored(server: PlantServer) -> None:
    path = server.start.state / runtime.SOCKET
    listener = await asyncio.start_unix_server(server.serve, str(path))
    async with listener:
        reader, writer = await asyncio.open_unix_connection(str(path))
        writer.write(runtime.pack_json({"event": "force_on", "t": 0.0}))
        assert await asyncio.wait_for(reader.read(), SOON_S) == b""
        writer.close()
        await writer.wait_closed()
    assert server.writers == {}


def test_the_account_is_written_when_motion_stops(server: PlantServer) -> None:
    now = time.monotonic()
    arrive(server, "robot", now - 3.0)
    account = server.start.state / "dwell_account.json"
    server._hear("robot", {"event": "motion_stopped", "t": now - 2.0})
    server.advance()
    assert not account.exists(), "the robot has not vouched for that time yet"
    server._hear("robot", {"mark": now - 1.0, "pose": list(SMALL.robot.home)})
    server.advance()
    assert account.exists()


def test_each_start_has_another_identity(tmp_path: Path) -> None:
    start = Start(SMALL, tmp_path, seed=1, speed=60.0)
    assert replace(start, seed=2) != start
