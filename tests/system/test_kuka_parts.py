"""Functions beside a pass on a KUKA controller: touch-off, first touch, a queue of parts."""

from __future__ import annotations

import json
import re
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.config.cell import load_config
from tests.system.agreement import require_agreement
from tests.system.cell_rig import Daemon, account, events, summary, with_keys, with_part, write_small
from tests.system.kuka_rig import module, take, write_files
from tests.system.test_queue import polishd, queue

pytestmark = [pytest.mark.system, pytest.mark.full]

ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
WIDE_RIM = {"aperture_mm": 16.0, "edge_mm": 2.0}


def cell(files: DemoFiles) -> AbstractContextManager[object]:
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", "4"]
    return simulated_cell(files.sim, options, files.out / "sim.stderr")


def test_the_seat_is_measured_by_a_touch_off_before_the_pass(tmp_path: Path) -> None:
    files = write_files(tmp_path / "cell", part=WIDE_RIM, touch_off=True, **ONE_PASS)
    files.sim.write_text(with_keys(files.sim.read_text(), {"plant": {"pv_nm": 250.0, "rms_nm": 50.0}}))
    with cell(files), Daemon(files, "--no-hold") as daemon:
        assert daemon.wait() == 1, daemon.output.read_text()
        seat = json.loads((files.run_dir / "cycle-00/touch_off.json").read_text())["seat"]
        assert abs(seat["height_mm"]) < 0.1
        assert len(account(files)["stands"]) >= 3
        assert len(events(files, "program_loaded")) == 4
        require_agreement(files)


def test_a_program_runs_with_the_positions_of_the_dat_beside_it(tmp_path: Path) -> None:
    files = write_files(tmp_path / "cell", **ONE_PASS)
    path = load_config(files.cell).program_path
    poses: list[bytes] = []

    def name(pose: re.Match[bytes]) -> bytes:
        poses.append(b"DECL GLOBAL E6POS XP%d=%s" % (len(poses), pose[0]))
        return b"XP%d" % (len(poses) - 1)

    path.write_bytes(re.sub(rb"\{.*?\}", name, path.read_bytes()))
    path.with_suffix(".dat").write_bytes(b"\n".join([b"DEFDAT polish PUBLIC", *poses, b"ENDDAT", b""]))
    with cell(files), Daemon(files, "--no-hold") as daemon:
        assert daemon.wait() == 1, daemon.output.read_text()
        require_agreement(files)
    assert len(poses) > 100


@pytest.mark.slow
def test_a_first_touch_is_polished_as_it_was_planned(tmp_path: Path) -> None:
    files = write_small(tmp_path / "cell", tolerance_nm=3.0, max_cycles=2)
    take(files)
    with_part(files, {}, module)
    plain = with_keys(files.cell.read_text(), {"process": {"estimates": "machine"}})
    files.cell.write_text(plain)
    files.profile.write_text(with_keys(files.profile.read_text(), {"repeatability": {"rms_nm": 0.3}}))
    made = polishd("calibrate", "first-touch", files.cell, "--out", files.out / "touch", "--part", "W-1")
    assert made.returncode == 0, made.stderr
    files.cell.write_text(f'include = ["touch/fragment.toml"]\n{plain}')
    with cell(files), Daemon(files, "--no-hold") as daemon:
        assert daemon.wait() == 0, daemon.output.read_text()
        require_agreement(files)
    assert summary(files)["outcome"] == "as_programmed"


@pytest.mark.slow
def test_a_queue_of_two_parts(tmp_path: Path) -> None:
    files = write_files(tmp_path / "cell", tolerance_nm=60.0, max_cycles=2)
    loader = f'\n[loader]\ntype = "loader_line"\naddress = "tcp://127.0.0.1:{free_port()}"\n'
    files.cell.write_text(with_keys(files.cell.read_text() + loader, {"metrology": {"timeout_s": 8.0}}))
    files.sim.write_text(files.sim.read_text() + "\n[loader.faults]\n")
    with cell(files):
        jobs = {"one": "P-1", "two": "P-2"}
        for name, part in jobs.items():
            job = f'[job]\nid = "{name}"\ntolerance_nm = 60.0\nmax_cycles = 3\n[part]\nid = "{part}"\n'
            (files.out / f"{name}.toml").write_text(job)
        added = polishd("queue", "add", files.cell, *(files.out / f"{name}.toml" for name in jobs))
        assert added.returncode == 0, added.stderr
        with Daemon(files, "--queue", "--until-empty") as daemon:
            assert daemon.wait() == 0, daemon.output.read_text()
        moves = events(files, "loader_moves")
        assert not any(event["robot_moves"] or event["tool_is_out"] for event in moves)
        require_agreement(files)
    assert {name: job["state"] for name, job in queue(files).items()} == {"one": "accepted", "two": "accepted"}
