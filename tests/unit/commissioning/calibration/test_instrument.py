"""``polishd calibrate instrument``: the poses it wants, and a system map that the cell's recipe takes off each map."""

from __future__ import annotations

import asyncio
import time
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.commissioning.calibration import instrument
from polishd.commissioning.calibration.instrument import needed_poses
from polishd.commissioning.rehearsal.simulated_cell import with_values
from polishd.config.instrument_profile import load_profile
from polishd.model.errors import ConfigError
from polishd.model.surface import SurfaceMap
from polishd.pipeline.build_recipe import system_of
from polishd.plugin_loader import load_cell
from polishd.process.metrology.absolute_poses import PartPose
from polishd.sim_backends.common.metropro import DatMap, pack
from tests.commissioned import commissioned
from tests.unit.cli_result import Polishd, unwrapped
from tests.unit.maps.maps import dat
from tests.unit.process.metrology.turned_maps import PITCH_MM, instrument_nm, maps, rms_nm, true_nm, turns

EXAMPLE = Path(__file__).resolve().parents[4] / "examples" / "cell.toml"
QUARTERS = ["--angles", "0,90,180,270"]


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """Write a cell with a commissioned instrument."""
    commissioned(tmp_path)
    path = tmp_path / "cell.toml"
    path.write_text(with_values(EXAMPLE.read_text(), {"instrument": {"profile": "instrument.toml"}}))
    return path


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    return [dat(tmp_path / f"p{k}.dat", height, PITCH_MM) for k, height in enumerate(maps(turns(4)))]


def system(cell: Path) -> Any:
    return system_of(*load_cell(cell))


@pytest.mark.full
def test_from_maps_to_what_goes_off_each_map(polishd: Polishd, cell: Path, files: list[Path]) -> None:
    assert system(cell) is None
    answer = polishd("calibrate", "instrument", cell, *files, *QUARTERS, "--json").answer
    assert {"power", "spherical", "tetrafoil"} <= set(answer["unknown"])
    found = system(cell)
    assert rms_nm(found.surface.height_nm - true_nm(instrument_nm)) < 0.2 * rms_nm(true_nm(instrument_nm))
    assert found.result.unknown[2, 0] == pytest.approx(1.0)
    assert (2, 2) not in found.result.unknown
    profile = load_profile(cell.parent / "instrument.toml")
    assert not profile.unproved, "the proof is of what the record does not touch"
    assert profile.system is not None
    assert profile.system.map_sha256 == found.surface.sha256 == answer["instrument"]["sha256"]


@pytest.mark.full
def test_a_record_is_replaced_and_no_map_is(polishd: Polishd, cell: Path, files: list[Path]) -> None:
    for name in ("one.x3p", "two.x3p"):
        out = cell.parent / name
        assert polishd("calibrate", "instrument", cell, *files, *QUARTERS, "--out", out).code == 0
    assert tomllib.loads((cell.parent / "instrument.toml").read_text())["system"]["map"] == "two.x3p"
    again = polishd("calibrate", "instrument", cell, *files, *QUARTERS, "--out", cell.parent / "one.x3p")
    assert again.code == 3
    assert "exists already" in again.err


@pytest.mark.full
def test_a_map_or_profile_that_was_changed_since_is_refused(polishd: Polishd, cell: Path, files: list[Path]) -> None:
    out, profile = cell.parent / "system.x3p", cell.parent / "instrument.toml"
    assert polishd("calibrate", "instrument", cell, *files, *QUARTERS, "--out", out).code == 0
    text, content = profile.read_text(), out.read_bytes()
    profile.write_text(text.replace("sign = 1", "sign = -1"))
    with pytest.raises(ConfigError, match=r"instrument\.toml:\d+: system\.map: the profile was edited after"):
        system(cell)
    profile.write_text(text)
    out.write_bytes(content[:-200])
    with pytest.raises(ConfigError, match=r"instrument\.toml:\d+: system\.map: "):
        system(cell)
    out.unlink()
    with pytest.raises(ConfigError, match=r"system\.map: .*cannot be read"):
        system(cell)
    out.write_bytes(files[0].read_bytes())
    with pytest.raises(ConfigError, match=r"is not the file that was calibrated.*polishd calibrate instrument"):
        system(cell)


def test_before_the_profile_is_proved_nothing_is_calibrated(polishd: Polishd, cell: Path, files: list[Path]) -> None:
    profile = cell.parent / "instrument.toml"
    profile.write_text(profile.read_text().replace("sign = 1", "sign = -1"))
    said = polishd("calibrate", "instrument", cell, *files, *QUARTERS)
    assert said.code == 3
    assert "polishd map commission" in said.err
    bare = cell.with_name("bare.toml")
    bare.write_text(EXAMPLE.read_text())
    said = polishd("calibrate", "instrument", bare, *files, *QUARTERS)
    assert said.code == 3
    assert "instrument.profile" in said.err


def test_nothing_is_written_where_nothing_is_wanted(polishd: Polishd, cell: Path, files: list[Path]) -> None:
    before = sorted(cell.parent.iterdir())
    said = polishd("calibrate", "instrument", cell, *files, *QUARTERS, "--dry-run")
    assert said.code == 0
    assert "nothing was written" in said.out
    assert sorted(cell.parent.iterdir()) == before
    assert load_profile(cell.parent / "instrument.toml").system is None


@pytest.mark.full
def test_a_reference_tells_the_power_that_no_pose_does(polishd: Polishd, cell: Path, files: list[Path]) -> None:
    asked = [*files, *QUARTERS, "--out", cell.parent / "a.x3p"]
    assert polishd("calibrate", "instrument", cell, *asked).code == 0
    without = system(cell)
    asked[-1] = cell.parent / "b.x3p"
    assert polishd("calibrate", "instrument", cell, *asked, "--power", "4", "--power-sigma", "0.5").code == 0
    found = system(cell)
    assert (2, 0) not in found.result.unknown
    assert found.result.covariance[1, 1] == pytest.approx(0.25)
    assert found.result.terms[1] == (2, 0)
    added = found.surface.height_nm - without.surface.height_nm
    assert np.nanstd(added) == pytest.approx(4.0, rel=0.05)
    ring, middle = added[44, 82], added[44, 44]
    assert ring > 0 > middle, "high at the rim"
    assert polishd("calibrate", "instrument", cell, *asked, "--power", "4").code == 2


def test_without_angles_it_says_which_poses_are_wanted(polishd: Polishd, cell: Path) -> None:
    answer = polishd("calibrate", "instrument", cell, "--json").answer
    assert answer["poses"][0] == {"angle_deg": 0.0, "shift_mm": [0.0, 0.0]}
    assert len(answer["poses"]) >= 3
    assert list(answer["demanded"]) == ["power"]
    assert f"--angles {','.join(format(one['angle_deg'], 'g') for one in answer['poses'])}" in answer["next"]


def test_the_poses_tell_all_but_power() -> None:
    poses, needs = needed_poses(50.0, 0.1, 0.5)
    assert any(pose.x_mm or pose.y_mm for pose in poses), "a shift determines symmetric terms"
    assert any(pose.angle_deg for pose in poses)
    assert set(needs) == {"power"}


@pytest.mark.full
def test_a_person_is_asked_for_each_pose_and_its_map_is_taken(
    polishd: Polishd, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heights = maps(turns(4))
    asked: list[float] = []

    async def measured(_config: object, _hooks: object, poses: list[PartPose]) -> list[SurfaceMap]:
        asked.extend(pose.angle_deg for pose in poses)
        return [SurfaceMap(height, PITCH_MM, sha256=str(k) * 64) for k, height in enumerate(heights)]

    monkeypatch.setattr(instrument, "measure_poses", measured)
    assert polishd("calibrate", "instrument", cell, *QUARTERS).code == 0
    assert asked == [0.0, 90.0, 180.0, 270.0]
    assert system(cell) is not None


def test_maps_are_taken_from_the_cells_own_folder(cell: Path) -> None:
    folder = cell.parent / "maps"
    folder.mkdir()
    changes = {"metrology": {"folder": "maps", "poll_s": 0.01, "stable_s": 0.0, "accept_without_part_id": True}}
    text = with_values(cell.read_text(), changes)
    cell.write_text("\n".join(line for line in text.splitlines() if not line.startswith("request_file")))
    config, hooks = load_cell(cell)
    heights, said = maps(turns(2)), []

    def ask(pose: PartPose, number: int, count: int) -> None:
        said.append((pose.angle_deg, number, count))
        now = DatMap(heights[number - 1], PITCH_MM, part="DEMO-100", taken_s=int(time.time()) + 1)
        (folder / f"m{number}.dat").write_bytes(pack(now))  # measured after it was asked for: an older one is stale

    found = asyncio.run(instrument.measure_poses(config, hooks, turns(2), ask))
    assert said == [(0.0, 1, 2), (180.0, 2, 2)]
    for surface, height in zip(found, heights, strict=True):
        assert np.allclose(surface.height_nm, height, atol=0.05, equal_nan=True)


@pytest.mark.full
def test_the_system_map_shows_its_terms_and_keeps_its_pitch(polishd: Polishd, cell: Path, files: list[Path]) -> None:
    out = cell.parent / "system.x3p"
    assert polishd("calibrate", "instrument", cell, *files, *QUARTERS, "--out", out).code == 0
    shown = unwrapped(polishd("map", out).out)
    assert "terms (degree, terms, covariance, unknown, rest_nm, circle_px)" in shown
    assert replace(system(cell).surface, path=None).pitch_mm == pytest.approx(PITCH_MM)
