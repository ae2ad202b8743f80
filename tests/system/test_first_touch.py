"""A first touch, as a person makes it: planned, polished on a witness part, and remembered by the next job."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from polishd.config.cell import load_config
from polishd.config.simulator import load_plant
from polishd.pipeline.records import EstimatesInUse
from polishd.studies.closed_loop import ClosedLoop, _Account
from polishd.studies.plant_client import PlantProcess
from tests.system.cell_rig import Daemon, summary, with_keys, write_small

pytestmark = [pytest.mark.system, pytest.mark.full]

RATE = -0.2
PLANTS = 40
MACHINE = {"estimates": "machine"}
AGAIN = {"settle.wait_s": 1.0, "settle.max_maps": 3}  # where a map is doubted: real seconds
PLANT = {
    "hidden_truth": {"rate": [RATE, RATE], "stiffness": 0.0, "drift": 0.0},
    "effects": {"eq_44": [1.0, 1.0]},  # else what is not lost as depth is a rate, too
}


def polishd(*arguments: str, cwd: Path) -> str:
    command = [sys.executable, "-m", "polishd.cli.app", *arguments]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.timeout(900)
def test_what_a_touch_teaches_the_next_job_begins_with(tmp_path: Path) -> None:
    files = write_small(tmp_path, tolerance_nm=3.0, max_cycles=2)
    plain = with_keys(files.cell.read_text(), {"process": MACHINE, "part_handling": AGAIN})
    files.cell.write_text(plain)
    files.sim.write_text(with_keys(files.sim.read_text(), PLANT))
    files.profile.write_text(with_keys(files.profile.read_text(), {"repeatability": {"rms_nm": 0.3}}))
    part = load_config(files.cell).part.id

    results = json.loads(
        polishd("calibrate", "first-touch", "cell.toml", "--out", "touch", "--part", part, "--json", cwd=tmp_path)
    )
    errors = {row["name"]: (row["before"], row["after"]) for row in results["parameters"]}
    assert results["contact_min"] < 5.0
    assert errors["rate"][1] < 0.1 * errors["rate"][0]
    assert errors["offset_x"][1] < 0.02

    files.cell.write_text(f'include = ["touch/fragment.toml"]\n{plain}')
    with cell(files), Daemon(files) as daemon:
        assert daemon.wait() == 0, files.daemon_log.read_text()
    touch = summary(files)
    assert touch["outcome"] == "as_programmed"
    assert len(touch["cycles"]) == 2, "one pass, between two maps"
    assert touch["cycles"][1]["rms_nm"] > touch["cycles"][0]["rms_nm"], "a touch corrects nothing"
    (belief,) = json.loads(polishd("estimates", "show", "cell.toml", "--json", cwd=tmp_path))["beliefs"]
    assert belief["job"] == f"first-touch-{part}"

    files.cell.write_text(plain)
    shutil.rmtree(files.sim_dir)
    with cell(files), Daemon(files) as daemon:  # the same machine, with a new part
        daemon.wait()
    first, second = summary(files)["cycles"][:2]
    assert any(f"pass 1 of job 'first-touch-{part}'" in note for note in first["notes"]), first["notes"]
    # The rate's field over the part takes some of it, as the noise of the maps has it; both are applied.
    assert first["rate"] == pytest.approx(1 + RATE, abs=0.1)
    assert first["expected_high_nm"] < 0.1 * first["rms_nm"], "it knows its machine, and what it knows it by"
    assert second["rms_nm"] < 0.15 * first["rms_nm"], "an unknown rate error of 20 % would leave 20 %"


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_rate_that_a_touch_states_is_as_far_off_as_it_says(tmp_path: Path) -> None:
    """Simulated plants with the demo's small part, friction, and rates that differ by 15 %."""
    files = write_small(tmp_path, tolerance_nm=3.0, max_cycles=2)
    files.cell.write_text(with_keys(files.cell.read_text(), {"process": MACHINE}))
    files.profile.write_text(with_keys(files.profile.read_text(), {"repeatability": {"rms_nm": 0.3}}))
    loop, off = ClosedLoop(files.cell, {}, 2, raster=True, witness="touch"), list[float]()
    plain, _ = load_plant(files.sim)
    with PlantProcess() as plant:
        for seed in range(PLANTS):
            rate = float(np.clip(np.random.default_rng([seed, 5]).normal(0.0, 0.15), -0.3, 0.35))
            truth = {**PLANT["hidden_truth"], "rate": [rate, rate]}
            plant.new({**plain, **PLANT, "hidden_truth": {**plain["hidden_truth"], **truth}}, seed)
            _, begun = loop._begun(plant, _Account())
            assert isinstance(begun, EstimatesInUse), begun
            found = begun.removal.rate
            assert found.sigma is not None
            off.append((found.value - 1 - rate) / found.sigma)
    held, rms = int(np.sum(np.abs(off) < 1.96)), float(np.sqrt(np.mean(np.square(off))))
    print(f"{held} of {PLANTS} held; RMS {rms:.2f}, at most {max(map(abs, off)):.1f} errors")
    assert stats.binom.cdf(held, PLANTS, 0.90) > 0.001, off
    assert max(map(abs, off)) < 4.0, off


def cell(files: DemoFiles) -> AbstractContextManager[object]:
    options = ["--state", str(files.sim_dir), "--seed", "4", "--speed", "10"]
    return simulated_cell(files.sim, options, files.out / "sim.stderr")
