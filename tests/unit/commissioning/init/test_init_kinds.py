"""``polishd init`` for one of each kind of robot, device and part: what it writes passes ``polishd check``."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from polishd.daemon.checks import check_cell
from polishd.model.errors import ConfigError
from polishd.plugin_loader import load_cell
from tests.unit.commissioning.init.test_write_cell import init
from tests.unit.maps.maps import dat, surface

EDS = Path(__file__).resolve().parents[4] / "examples" / "drive.eds"
ROUND = "[part]\naperture_mm = 12.0\n"
ARM = '[kinematics]\narm = "ur5e"\n'
KINDS = {
    "hybrid robot": ROUND,
    "sphere, concave, on an arm": ARM + ROUND + "curvature_radius_mm = 90.0\n",
    "sphere, convex, on an arm": ARM + ROUND + "curvature_radius_mm = -90.0\n",
    "asphere": ROUND + "curvature_radius_mm = 400.0\nconic = -1.0\neven = [1e-9]\n",
    "ring": "[part]\naperture_mm = 16.0\nhole_mm = 5.0\nedge_mm = 1.0\n",
    "rectangle": "[part]\nrectangle_mm = [16.0, 12.0]\n",
    "polygon": "[part]\npolygon_mm = [[9, 7], [-9, 7], [-9, -7], [9, -7]]\n",
    "spiral": ROUND + '[program]\nmake = "spiral"\n',
    "rings, shifted": ROUND + '[program]\nmake = "concentric"\nphase = 0.5\n',
    "two rasters": ROUND + "[program]\ncross_deg = 60.0\n",
    "pseudo-random": '[part]\naperture_mm = 16.0\n[program]\nmake = "random"\nseed = 3\n',
    "program turned and shifted": ROUND + "[program]\noffset_mm = [250.0, 100.0, 0.0]\nrotation_deg = 30.0\n",
    "LinuxCNC": ROUND + '[robot]\ntype = "linuxcnc"\naddress = "tcp://robot:5007"\nprogram_dir = "nc"\n',
    "profiles": ROUND + '[spindle]\ntype = "spindle_profile"\nprofile = "delta_ms300"\naddress = "serial:/dev/ttyS0"\n',
    "CiA 402": ROUND
    + '[spindle]\ntype = "cia402_spindle"\naddress = "slcan:/dev/ttyS0?bitrate=500000"\neds = "drive.eds"\nnode = 7\n',
    "monitored": ROUND
    + '[monitor]\ntype = "monitor_line"\naddress = "tcp://plc:4001"\n'
    + '[signals.flow]\nin_contact = { min = 0.8 }\naction = "lift"\n',
    "the drawing's lines": ROUND + "[[tolerance]]\nrms_nm = 2.0\nperiods_above_mm = 4.0\n[[tolerance]]\npv_nm = 30.0\n",
    "a robot by name": ROUND + '[robot.left]\ntype = "robot_link"\naddress = "tcp://a:1"\n[roles]\nrobot = "left"\n',
}


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("kind", KINDS)
def test_a_cell_of_each_kind_passes_its_check(tmp_path: Path, kind: str) -> None:
    shutil.copy(EDS, tmp_path)
    shown = init(tmp_path, KINDS[kind])
    assert "program.rnc" in shown["written"], shown["program"]
    facts = check_cell(*load_cell(tmp_path / "cell" / "cell.toml"))
    assert facts["reach"].startswith("all ")


@pytest.mark.full
def test_what_is_about_the_parts_safety_is_not_assumed_away(tmp_path: Path) -> None:
    """How deep a feed hold digs follows from times that only a person can state."""
    robot = 'type = "plc_robot"\nprofile = "plc-opcua"\naddress = "opc.tcp://plc:4840"\ndelivery = "folder:nc"'
    shown = init(tmp_path, f"{ROUND}[robot]\n{robot}\n")
    assert "program.rnc" in shown["written"]
    with pytest.raises(ConfigError, match=r"limits\.max_stall_removal_nm: a feed hold at the controller would dig"):
        check_cell(*load_cell(tmp_path / "cell" / "cell.toml"))


@pytest.mark.full
def test_a_controller_gets_its_program_in_its_own_language(tmp_path: Path) -> None:
    shown = init(tmp_path, ROUND + '[robot]\ntype = "universal_robots"\naddress = "tcp://ur:30004"\n')
    assert "program.rnc" in shown["written"]
    config, hooks = load_cell(tmp_path / "cell" / "cell.toml")
    content = config.program_path.read_bytes()
    program = hooks.program_formats()[config.program.format].read(content, "program.rnc")
    assert (program.dialect, program.n > 100, b"movel(" in content) == ("urscript", True, True)


@pytest.mark.full
def test_a_sample_map_tells_the_part_and_begins_the_profile(tmp_path: Path) -> None:
    """A file that says everything leaves nothing to be said; its part's name and size are the cell's."""
    dat(tmp_path / "part.dat", surface(60, 60), part="blank-7")
    shown = init(tmp_path, '[instrument]\nsample = "part.dat"\n')
    config, _ = load_cell(tmp_path / "cell" / "cell.toml")
    assert (config.part.id, config.part.aperture_mm, config.job.id) == ("blank-7", 29.0, "blank-7")
    assert {"part.id", "part.aperture_mm"} <= set(shown["look"])
    assert "gives" not in shown["texts"]["instrument.toml"]


@pytest.mark.parametrize(
    ("keys", "what"),
    [
        ('make = "spiral"\ncross_deg = 90.0', "cross_deg: goes with make = .raster., not with .spiral."),
        ('make = "random"\nphase = 0.5', "phase: does not go with make = .random."),
        ("seed = 3", "seed: goes with make = .random., not with .raster."),
    ],
)
def test_keys_of_another_path_are_refused(tmp_path: Path, keys: str, what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        init(tmp_path, f"{ROUND}[program]\n{keys}\n")
