"""Functions beside a pass on the controllers of robot makers: touch-off, first touch, a queue of parts.

KUKA: test_kuka_parts.py.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.config.cell import CellConfig, load_config
from tests.system import abb_rig, fanuc_rmi_rig, plc_robot_rig
from tests.system.cell_rig import Daemon, Sections, events, summary, with_keys, with_part
from tests.system.test_queue import polishd, queue
from tests.time_limits import SOON_S

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(6 * SOON_S)]

RIM_MM = 2.0
"""Width of the rim on which the tool rests."""
WITNESS = {"aperture_mm": 30.0, "edge_mm": 1.0}
"""Part that is wide enough for the tracks of a first touch."""
TOLERANCE_NM = 60.0
"""RMS that one or two passes reach from 100 nm, on FANUC from 60 nm."""


@dataclass(frozen=True)
class Maker:
    """Controller with a small part and a program in its language."""

    write: Callable[..., DemoFiles]
    program: Callable[[CellConfig], bytes]
    speed: float = 4.0
    """Speed of the simulated cell; 1: real time."""
    part_mm: float = 14.0
    tolerance_nm: float = TOLERANCE_NM

    def running(self, files: DemoFiles) -> AbstractContextManager[object]:
        options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{self.speed:g}"]
        return simulated_cell(files.sim, options, files.out / "sim.stderr")


PROMPT: Sections = {
    "actuator": {"silence_s": 0.8, "watchdog_ms": 1200, "release_s": 0.2, "retract_s": 0.6},
    "machine": {"least_point_s": 0.36},
    "job": {"stream_ahead_s": 2.4},
}


def fanuc(out: Path, **job: Any) -> DemoFiles:
    """Return a cell whose actuator lifts within 2 s: 8 instructions are then short enough to correct a part."""
    files = fanuc_rmi_rig.write_files(out, **job)
    files.cell.write_text(with_keys(files.cell.read_text(), PROMPT))
    return files


def language(name: str, encoding: Any) -> Maker:
    write = partial(plc_robot_rig.write_language_cell, language=name, encoding=encoding)
    return Maker(write, partial(plc_robot_rig.language_program, encoding=encoding), speed=2.0)


MAKERS: Mapping[str, Maker] = {
    "abb": Maker(abb_rig.write_files, abb_rig.module),
    "fanuc": Maker(
        fanuc, partial(plc_robot_rig.language_program, encoding="time"), speed=1.0, part_mm=12.0, tolerance_nm=30.0
    ),
    "yaskawa": language("inform", "dwell"),
    "staubli": language("val3", "feed"),
}


@pytest.fixture(params=MAKERS)
def maker(request: pytest.FixtureRequest) -> Maker:
    return MAKERS[request.param]


def test_a_queue_touches_each_part_off_and_polishes_one_after_the_other(tmp_path: Path, maker: Maker) -> None:
    """The programs of a touch-off are in the robot's language, with the tool and frame of the part program."""
    job = {"tolerance_nm": maker.tolerance_nm, "max_cycles": 3}
    files = maker.write(tmp_path / "cell", touch_off=True, **job)
    with_part(files, {"aperture_mm": maker.part_mm, "edge_mm": RIM_MM}, maker.program)
    loader = f'\n[loader]\ntype = "loader_line"\naddress = "tcp://127.0.0.1:{free_port()}"\n'
    keys = {"metrology": {"timeout_s": 8.0}, "limits": {"max_removal_nm": 2000.0}}
    files.cell.write_text(with_keys(files.cell.read_text() + loader, keys))
    files.sim.write_text(files.sim.read_text() + "\n[loader]\n")
    jobs = [files.out / f"{name}.toml" for name in ("one", "two")]
    for path in jobs:
        path.write_text(f'[job]\nid = "{path.stem}"\n[part]\nid = "P-{path.stem}"\n')
    added = polishd("queue", "add", files.cell, *jobs)
    assert added.returncode == 0, added.stderr
    with maker.running(files):
        with Daemon(files, "--queue", "--until-empty") as daemon:
            assert daemon.process.wait(4 * SOON_S) == 0, daemon.output.read_text()
        found, log = queue(files), events(files)
    assert {name: one["state"] for name, one in found.items()} == {"one": "accepted", "two": "accepted"}
    passes = sum(event["event"] == "tool_landed" for event in log) - 2 * 3
    assert passes >= 2, "three places of each seat, and a pass at least"
    moves = [event for event in log if event["event"] == "loader_moves"]
    assert [event["part"] for event in moves] == ["", "P-one", "", "P-two"]
    assert not any(event["robot_moves"] or event["tool_is_out"] for event in moves)
    seats = sorted(files.run_dir.glob("*/cycle-00/touch_off.json"))
    assert [abs(json.loads(path.read_text())["seat"]["height_mm"]) < 0.1 for path in seats] == [True, True]


@pytest.mark.parametrize("maker", ["fanuc", "yaskawa"], indirect=True)
def test_a_first_touch_is_polished_as_it_was_planned(tmp_path: Path, maker: Maker) -> None:
    files = maker.write(tmp_path / "cell", tolerance_nm=3.0, max_cycles=2)
    with_part(files, WITNESS, maker.program)
    plain = with_keys(files.cell.read_text(), {"process": {"estimates": "machine"}})
    files.cell.write_text(plain)
    files.profile.write_text(with_keys(files.profile.read_text(), {"repeatability": {"rms_nm": 0.3}}))
    part = load_config(files.cell).part.id
    made = polishd("calibrate", "first-touch", files.cell, "--out", files.out / "touch", "--part", part, "--json")
    assert made.returncode == 0, made.stderr
    assert json.loads(made.stdout)["contact_min"] < 8.0
    files.cell.write_text(f'include = ["touch/fragment.toml"]\n{plain}')
    with maker.running(files), Daemon(files, "--no-hold") as daemon:
        assert daemon.process.wait(4 * SOON_S) == 0, daemon.output.read_text()
    assert summary(files)["outcome"] == "as_programmed"
