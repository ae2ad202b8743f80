"""``polishd rehearse``: what of a cell the simulator becomes, what it is not, and what is never touched."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.commissioning.rehearsal import rehearsal
from polishd.commissioning.rehearsal.draft import RehearsalDraft, cell_text, require_separate_folders, sim_text
from polishd.commissioning.rehearsal.rehearsal import draft_rehearsal, write_rehearsal
from polishd.config.cell import load_config
from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR
from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR
from polishd.config.simulator import SimConfig, load_simulator
from polishd.config.table_files import tif_bytes
from polishd.hookspecs import DeviceType
from polishd.model.errors import ConfigError
from polishd.model.process import HybridRobot, MeasuredCompliance, MeasuredTif, SerialRobot
from polishd.plugin_loader import Hooks, load_cell
from polishd.sim_backends.common.runtime import read_config
from tests.system.cell_rig import with_keys

EXAMPLES = Path(__file__).resolve().parents[4] / "examples"
CELL = (EXAMPLES / "cell.toml").read_text()
ROBOT = (
    '[robot]                              # device sections: `type`, then the keys of that type\ntype = "robot_link"\n'
)
ROBOT += 'address = "tcp://127.0.0.1:28500"\n'
LENS = {"part": {"id": "LENS-7", "aperture_mm": 150.0, "curvature_radius_mm": 800.0, "conic": -0.5}}
ARM = {
    "type": "serial",
    "dh": [[0, 90, 400, 0], [500, 0, 0, 0], [400, 0, 0, 0], [0, 90, 120, 0], [0, -90, 100, 0], [0, 0, 80, 0]],
    "joint_stiffness_n_mm_per_rad": [4e8, 4e8, 3e8, 1e8, 1e8, 8e7],
    "joint_limits_deg": [[-360, 360]] * 6,
    "home_deg": [0, -100, 100, -90, -90, 0],
}


def made(folder: Path, text: str) -> RehearsalDraft:
    """What is gathered of such a cell; nothing is written."""
    cell = folder / "cell.toml"
    cell.write_text(text)
    (folder / "program.rnc").write_text("G21 G90 G94\nM2\n")
    return draft_rehearsal(*load_cell(cell))


def sim_of(draft: RehearsalDraft, folder: Path) -> SimConfig:
    """What the simulator reads of the files that would be written."""
    written = folder / "written"
    written.mkdir(exist_ok=True)
    texts = {"cell.toml": cell_text(draft).encode(), "sim.toml": sim_text(draft, "cell.toml").encode()}
    for name, content in {**draft.files, **texts}.items():
        (written / name).write_bytes(content)
    sim = load_simulator(written / "sim.toml")
    sim.require_simulated()
    return sim


def changed(draft: RehearsalDraft, folder: Path) -> dict[str, Any]:
    """Dotted keys in which the rehearsal's cell is not the cell, and what they are there."""
    own = folder / "rehearsal"
    own.mkdir()
    (own / "cell.toml").write_text(cell_text(draft))
    return dict(_other(draft.config.effective(), load_config(own / "cell.toml").effective(), ""))


def _other(before: Any, after: Any, key: str) -> list[tuple[str, Any]]:
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        names = sorted({*before, *after})
        return [one for name in names for one in _other(before.get(name), after.get(name), f"{key}.{name}".strip("."))]
    return [] if before == after else [(key, after)]


def robot(section: str) -> str:
    assert ROBOT in CELL
    return CELL.replace(ROBOT, f"[robot]\n{section}\n").replace("watchdog_s = 8.0  ", "#")


@pytest.mark.full
def test_the_simulator_is_this_cells_part_tool_and_robot(tmp_path: Path) -> None:
    """Also where a fragment of a calibration has it; sim.toml has none of it."""
    calibrated = {"limb_stiffness_n_per_mm": 16.5e3, "a_stiffness_n_mm_per_rad": 5.1e7}
    lines = "\n".join(f"{key} = {value}" for key, value in calibrated.items())
    (tmp_path / "calibration.toml").write_text(f"[kinematics]\n{lines}\n")
    process = {"preston": "2.2e-9 cm2/N", "tool_radius_mm": 40.0, "normal_force": "resolved"}
    text = with_keys(CELL, {**LENS, "process": process}).replace("# include =", "include =")
    draft = made(tmp_path, text)
    sim = sim_of(draft, tmp_path)
    plant, tool = sim.plant, sim.process.tool()
    assert (plant.part_id, plant.aperture_mm, plant.curvature_radius_mm, plant.conic) == ("LENS-7", 150.0, 800.0, -0.5)
    assert (plant.origin_mm, plant.rotation_rpy_deg) == ((300.0, 220.0, 2315.0), (180.0, 0.0, 0.0))
    assert (tool.preston_cm2_per_n, tool.tool_radius_mm, tool.normal_force) == (2.2e-9, 40.0, "resolved")
    assert sim.robot_model() == replace(HybridRobot(), **calibrated) == draft.config.robot_model()
    assert set(tomllib.loads(sim_text(draft, "cell.toml"))) == {"cell", "plant", "hidden_truth", "robot"}


@pytest.mark.full
@pytest.mark.parametrize(
    "said", ["rectangle_mm = [40.0, 24.0]", "aperture_mm = 60.0\nhole_mm = 20.0", 'polygon_file = "corners.csv"']
)
def test_a_part_that_is_not_round_is_not_in_the_simulator_either(tmp_path: Path, said: str) -> None:
    (tmp_path / "corners.csv").write_text("x_mm,y_mm\n20,12\n-20,12\n-20,-12\n9,-12\n")
    draft = made(tmp_path, CELL.replace("aperture_mm = 100.0", said))
    played, real = sim_of(draft, tmp_path).plant.outline, draft.config.outline()
    assert played.corners().tolist() == real.corners().tolist()
    assert played.area_mm2 == real.area_mm2


@pytest.mark.full
def test_the_part_starts_as_one_that_the_job_may_polish(tmp_path: Path) -> None:
    plant = sim_of(made(tmp_path, CELL), tmp_path).plant
    assert (plant.rms_nm, plant.pv_nm) == (18.0, pytest.approx(149.4))
    plant = sim_of(made(tmp_path, with_keys(CELL, {"job": {"tolerance_nm": 40.0}})), tmp_path).plant
    assert (plant.rms_nm, plant.pv_nm) == (pytest.approx(60.2, abs=0.1), 500.0)


@pytest.mark.full
def test_the_cell_is_the_same_but_for_addresses_folders_and_where_its_files_lie(tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text("[kinematics]\ntool_length_mm = 419.0\n")
    draft = made(tmp_path, CELL.replace("# include =", "include =").replace('"state"', '"daemon"'))
    port = sim_of(draft, tmp_path).robot.port
    assert changed(draft, tmp_path) == {
        "cell.state_dir": "state",
        "include": [],
        "instrument.profile": "instrument.toml",
        "program.path": str(tmp_path / "program.rnc"),
        "robot.address": f"tcp://127.0.0.1:{port}",
        "spindle.eds": str(tmp_path / "drive.eds"),
    }
    assert "in the robot's base frame" in cell_text(draft), "comments stay"
    assert draft.notes == ["instrument.profile: there is none; the rehearsal has that of polishd demo"]


@pytest.mark.full
def test_programs_of_tools_lie_where_the_cell_says(tmp_path: Path) -> None:
    draft = made(tmp_path, CELL + '\n[tools.small]\nprogram = ["program.rnc", "sub/between.rnc"]\n')
    found = changed(draft, tmp_path)
    assert found["tools.small.program"] == [str(tmp_path / "program.rnc"), str(tmp_path / "sub" / "between.rnc")]


@pytest.mark.full
def test_a_measured_spot_and_a_measured_robot_come_along(tmp_path: Path) -> None:
    rate = np.zeros((9, 9))
    rate[2:7, 2:7] = 30.0
    (tmp_path / "spot.npz").write_bytes(tif_bytes(MeasuredTif(rate, 0.4, 30.0, 0.9)))
    places = "\n".join(f"{x},{y},2315,{1.0 + x / 1000}" for x in (200, 400) for y in (100, 340))
    (tmp_path / "load.csv").write_text(f"x_mm,y_mm,z_mm,compliance_um_per_n\n{places}\n")
    process = {"removal_model": "measured_tif", "tif": "spot.npz", "force_n": 9.0}
    text = with_keys(CELL, {"process": process, "kinematics": {"type": "measured", "table": "load.csv"}})
    draft = made(tmp_path, text.replace("tool_length_mm = 420.0", ""))
    sim = sim_of(draft, tmp_path)
    tif, table = sim.measured_tif(), sim.robot_model()
    assert tif is not None
    assert (tif.rate_nm_s == rate).all()
    assert sim.process.force_n == 9.0
    assert isinstance(table, MeasuredCompliance)
    assert table.compliance_um_per_n.tolist() == [1.2, 1.2, 1.4, 1.4]
    assert any("the simulated one goes everywhere" in note for note in draft.notes)


@pytest.mark.full
@pytest.mark.parametrize(
    ("profile", "address", "kind"),
    [
        ("twincat-nci", "ads://plc/5.1.2.3.1.1:851", "ads"),
        ("plc-opcua", "opc.tcp://10.0.0.2:4840", "opcua"),
        ("plc-modbus", "tcp://10.0.0.2:502", "modbus"),
    ],
)
def test_a_controller_that_loads_files(tmp_path: Path, profile: str, address: str, kind: str) -> None:
    keys = f'type = "plc_robot"\nprofile = "{profile}"\naddress = "{address}"\ndelivery = "sftp://me@10.0.0.2/nc"'
    secrets = 'delivery_password = "env:SECRET"\nserver_certificate = "plc.der"'
    draft = made(tmp_path, robot(f"{keys}\n{secrets}"))
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert sim.robot.kind == kind
    assert "127." in other["robot.address"]
    assert other["robot.delivery"] == "folder:sim/programs"
    assert other["robot.delivery_password"] is other["robot.server_certificate"] is None
    stands_in = profile == "twincat-nci"
    assert any("the simulated controller has the variables of plc-ads" in note for note in draft.notes) == stands_in
    assert ("controller.toml" in draft.files) == stands_in


@pytest.mark.full
def test_an_arm_of_universal_robots(tmp_path: Path) -> None:
    text = robot('type = "universal_robots"\naddress = "tcp://10.0.0.2:30004"\nfirst_register = 30\nrate_hz = 500.0')
    text = with_keys(text.replace('"rs274"', '"urscript"'), {"kinematics": ARM})
    draft = made(tmp_path, text)
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert (sim.robot.kind, sim.robot.cycle_hz, sim.plant.speed) == ("universal_robots", 500, 4.0)
    assert isinstance(sim.robot_model(), SerialRobot)
    assert sim.robot_model() == draft.config.robot_model()
    assert other["robot.dashboard_port"] == sim.robot.dashboard_port
    assert other["robot.first_register"] == 24
    assert sum("first_register" in note for note in draft.notes) == 1


@pytest.mark.full
def test_the_shipped_abb_cell_is_rehearsed_on_its_arm(tmp_path: Path) -> None:
    text = (EXAMPLES / "abb_cell.toml").read_text().replace("program.mod", "program.rnc")
    draft = made(tmp_path, text.replace('"drive.eds"', f'"{EXAMPLES / "drive.eds"}"'))
    sim = sim_of(draft, tmp_path)
    assert (sim.robot.kind, sim.robot.rws, sim.robot.watchdog_s) == ("abb_rws", "1.0", 10.0)
    assert isinstance(sim.robot_model(), SerialRobot)


@pytest.mark.full
def test_an_abb_controller(tmp_path: Path) -> None:
    text = robot('type = "abb_rws"\naddress = "tcp://10.0.0.3:443"\nversion = "2.0"\ntask = "T_ROB_L"')
    draft = made(tmp_path, text.replace('"rs274"', '"rapid"'))
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert (sim.robot.kind, sim.robot.rws, sim.plant.speed) == ("abb_rws", "2.0", 4.0)
    assert other["robot.task"] == "T_ROB1"
    assert "127.0.0.1" in other["robot.address"]


@pytest.mark.full
def test_a_kuka_controller_reads_its_modules_from_the_simulators_folder(tmp_path: Path) -> None:
    text = robot(
        'type = "kuka_kvp"\naddress = "tcp://10.0.0.2:7000"\ndelivery = "folder:/mnt/r1/Program"\nwatchdog_s = 9.0'
    )
    draft = made(tmp_path, text.replace('"rs274"', '"krl"'))
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert (sim.robot.kind, sim.robot.watchdog_s, sim.plant.speed) == ("kuka_kvp", 9.0, 4.0)
    assert other["robot.delivery"] == "folder:sim/programs"
    assert other["robot.address"] == f"tcp://127.0.0.1:{sim.robot.port}"


@pytest.mark.full
def test_linuxcnc_is_a_real_one_in_real_time(tmp_path: Path) -> None:
    draft = made(tmp_path, robot('type = "linuxcnc"\naddress = "tcp://10.0.0.2:5007"\nprogram_dir = "/mnt/cnc"'))
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert (sim.robot.kind, sim.plant.speed) == ("linuxcnc", 1.0)
    assert (other["robot.program_dir"], other["robot.controller_dir"]) == ("sim/linuxcnc/nc", "/mnt/nc")


@pytest.mark.full
def test_drives_by_profile_and_on_canopen_and_what_the_simulated_ones_count_in(tmp_path: Path) -> None:
    shutil.copy(EXAMPLES / "drive.eds", tmp_path)
    actuator = (
        '[actuator]\ntype = "cia402_actuator"\naddress = "slcan:/dev/ttyACM3?bitrate=500000"\neds = "drive.eds"\n'
    )
    actuator += "node = 9\nn_per_permille = 0.08\nmm_per_increment = 0.001\nbalance_n = 2.0\nstroke_mm = 20.0\n"
    spindle = (
        '[spindle]\ntype = "spindle_profile"\nprofile = "delta_ms300"\naddress = "serial:/dev/ttyUSB1"\nunit = 3\n'
    )
    spindle += "pole_pairs = 2\n"
    head, _, rest = CELL.partition("[actuator]")
    text = head + actuator + spindle + "[metrology]" + rest.partition("[metrology]")[2]
    draft = made(tmp_path, text)
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert (sim.actuator.kind, sim.actuator.node) == ("slcan", 9)
    assert (sim.spindle.kind, sim.spindle.unit, sim.spindle.pole_pairs) == ("profile", 3, 2)
    assert sim.resolve(sim.spindle.profile).samefile(DEVICE_PROFILE_DIR / "delta_ms300.toml")
    assert other["actuator.n_per_permille"] == 0.05
    assert other["touch_off.position_mm"] == 5.0
    assert other["actuator.address"] == "slcan:sim/actuator?bitrate=500000"
    assert other["spindle.address"] == "serial:sim/spindle"
    assert [note.partition(":")[0] for note in draft.notes[:2]] == ["actuator.n_per_permille", "touch_off.position_mm"]


@pytest.mark.full
def test_sensors_and_monitors_tell_what_lets_the_job_go_on(tmp_path: Path) -> None:
    draft = made(tmp_path, (EXAMPLES / "monitored_cell.toml").read_text())
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert sim.monitor is not None
    assert sim.force_sensor is not None
    for name, signal in draft.config.signals.items():
        value = sim.monitor.signals[signal.signal or name].value
        for asked in (signal.before, signal.in_contact):
            assert asked is not None
            assert asked.state in {None, value}
            assert (asked.min or value) <= value <= (asked.max or value)
    assert other["monitor.slurry.address"] == other["monitor.cabinet.address"]
    assert other["force_sensor.address"] == "serial:sim/force_sensor"


@pytest.mark.full
def test_of_several_devices_the_jobs_own_is_simulated_and_the_others_are_left_out_by_name(tmp_path: Path) -> None:
    draft = made(tmp_path, (EXAMPLES / "two_robots.toml").read_text())
    other = changed(draft, tmp_path)
    assert other["robot.left.address"].startswith("tcp://127.0.0.1:")
    assert other["robot.right"] is None
    assert "robot.right: the simulator has one robot; it is left out" in draft.notes
    assert sim_of(draft, tmp_path).robot.kind == "link"


@pytest.mark.full
def test_nothing_real_is_started_or_notified(tmp_path: Path) -> None:
    text = CELL.replace("# clean = { command", "clean = { command").replace(
        '"run_report"', '"run_report", "notifications"'
    )
    text += '\n[notify.siren]\ntype = "command"\ncommand = ["./siren.sh"]\n'
    draft = made(tmp_path, text)
    other = changed(draft, tmp_path)
    assert other["part_handling.clean.command"] == ["true"]
    assert other["notify.siren"] is None
    assert any("./wash.sh would act on the real cell" in note for note in draft.notes)


@pytest.mark.full
def test_maps_lie_as_the_cells_profile_says(tmp_path: Path) -> None:
    profile = (EXAMPLES / "instrument.toml").read_text().replace("mirror = false", "mirror = true")
    profile = profile.replace("rotation_deg = 0 ", "rotation_deg = 90").replace("factor = 1.0", "factor = 0.5")
    profile = profile.replace("# serials", "serials").replace("# pitch_mm = 0.5", "pitch_mm = 0.4")
    (tmp_path / "fizeau.toml").write_text(profile)
    draft = made(tmp_path, CELL.replace('# profile = "instrument.toml"', 'profile = "fizeau.toml"'))
    sim = sim_of(draft, tmp_path)
    faults = sim.interferometer.faults
    assert (faults.mirror, faults.rotation_deg, faults.factor) == (True, 90, 2.0)
    assert sim.plant.pitch_mm == 0.4
    assert "serials" not in tomllib.loads(draft.files["instrument.toml"].decode())
    assert len(draft.notes) == 1
    assert draft.notes[0].startswith("serials of instrument.profile: ")


class OtherTypes(Hooks):
    """The cell's plugins, and one more with a copy of each type, ``other_NAME``."""

    simulated_by = ""
    """Simulated device of the copies; empty: that of the original."""

    def device_types(self) -> dict[str, DeviceType]:
        own = super().device_types()
        copies = {f"other_{name}": one for name, one in own.items()}
        named = {name: self.simulated_by or one.simulated_by for name, one in copies.items()}
        return own | {name: replace(one, name=name, simulated_by=named[name]) for name, one in copies.items()}


def made_of_others(folder: Path, text: str, simulated_by: str = "") -> RehearsalDraft:
    """What is gathered of a cell with devices of another plugin; nothing is written."""
    draft = made(folder, CELL)
    (folder / "cell.toml").write_text(text)
    hooks = OtherTypes(draft.hooks.report)
    hooks.simulated_by = simulated_by
    return draft_rehearsal(load_config(folder / "cell.toml"), hooks)


@pytest.mark.full
def test_devices_of_another_plugin_have_the_shipped_simulated_devices(tmp_path: Path) -> None:
    """Each simulated device has the kind that its section takes, and the values of the cell."""
    text = CELL.replace('"robot_link"', '"other_robot_link"').replace('"watched_folder"', '"other_watched_folder"')
    text = text.replace('"cia402_spindle"', '"other_cia402_spindle"')
    text += '\n[monitor]\ntype = "other_monitor_line"\naddress = "serial:/dev/ttyUSB4"\n'
    text += "[signals.flow.before]\nmin = 1.0\n"
    text = with_keys(text, {"robot": {"watchdog_s": 12.0}, "metrology": {"request_file": "go.txt"}})
    draft = made_of_others(tmp_path, text)
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert (sim.robot.kind, sim.robot.watchdog_s) == ("link", 12.0)
    assert other["robot.address"] == f"tcp://127.0.0.1:{sim.robot.port}"
    assert (sim.interferometer.kind, sim.interferometer.request_file) == ("watched_folder", "go.txt")
    assert sim.spindle.kind == "slcan"
    assert sim.monitor is not None
    assert (sim.monitor.kind, sim.monitor.signals["flow"].value) == ("serial", 1.1)


@pytest.mark.full
def test_a_simulated_device_with_several_protocols_needs_its_kind(tmp_path: Path) -> None:
    text = CELL.replace('"voice_coil_modbus"', '"other_voice_coil_modbus"')
    with pytest.raises(ConfigError, match=r"cell\.toml:\d+: actuator\.type: .*several protocols.*modbus_rtu"):
        made_of_others(tmp_path, text)
    assert sim_of(made_of_others(tmp_path, text, "modbus_rtu"), tmp_path).actuator.kind == "modbus_rtu"


REFUSED = {
    "program.format: no simulated controller": {"program": {"format": "krl"}},
    "process.force_n: the simulated actuator presses with 50 N": {"process": {"force_n": 80.0}},
    "part.id: is longer than": {"part": {"id": "L" * 40}},
}


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("said", REFUSED)
def test_what_nothing_can_stand_in_for_is_refused_with_its_place(tmp_path: Path, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refused:
        made(tmp_path, with_keys(CELL, REFUSED[said]))
    assert "cell.toml:" in str(refused.value)


def test_a_rehearsal_is_never_written_where_the_real_cell_writes(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "state")
    text = CELL.replace("# run_dir", "run_dir").replace('"sim/maps"', '"incoming"')
    draft = made(tmp_path, text.replace("# accept_without_part_id = false", f'claimed_dir = "{tmp_path}/archive" #'))
    for folder in ("state", "state/sub", "link", "runs", "runs/today/x", "incoming", "archive", "incoming/quarantine"):
        with pytest.raises(ConfigError, match=r"of the real cell .* name another folder with --out"):
            require_separate_folders(draft, tmp_path / folder)
    with pytest.raises(ConfigError, match="is, holds or lies in the state folder"):
        require_separate_folders(draft, tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "old").touch()
    with pytest.raises(ConfigError, match=r"full: is there already; start that rehearsal with polishd sim .*sim\.toml"):
        require_separate_folders(draft, tmp_path / "full")
    require_separate_folders(draft, tmp_path / "apart")
    assert not (tmp_path / "apart").exists()


@pytest.mark.full
def test_what_cannot_be_simulated_leaves_no_folder_behind(tmp_path: Path) -> None:
    cell = tmp_path / "cell.toml"
    cell.write_text(with_keys(CELL, {"part": {"curvature_radius_mm": 22.0, "aperture_mm": 10.0}}))
    with pytest.raises(
        ConfigError, match=r"cell\.toml: there is no simulated cell like this: .*into a radius of 22 mm"
    ):
        write_rehearsal(cell)
    assert [path.name for path in tmp_path.iterdir()] == ["cell.toml"]


@pytest.mark.full
def test_a_full_disk_is_said_with_the_folder_and_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_args: object) -> None:
        raise OSError(28, "No space left on device")

    cell = tmp_path / "lens.toml"
    cell.write_text(with_keys(CELL, LENS))
    monkeypatch.setattr(rehearsal, "write_atomic", full)
    with pytest.raises(ConfigError, match=r"out: cannot be written: No space left on device; make room"):
        write_rehearsal(cell, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["lens.toml"]


@pytest.mark.full
def test_the_verb_writes_a_rehearsal_whose_instrument_is_proved(tmp_path: Path) -> None:
    cell = tmp_path / "lens.toml"
    cell.write_text(with_keys(CELL, LENS))
    before = cell.read_bytes()
    said = CliRunner().invoke(app, ["rehearse", str(cell), "--write-only"])
    assert said.exit_code == 0, said.output
    folder = tmp_path / "lens-rehearsal"
    assert load_simulator(folder / "sim.toml").plant.curvature_radius_mm == 800.0
    assert "[commissioned]" in (folder / "instrument.toml").read_text()
    assert "polishd run" in said.stderr
    assert str(folder / "lens-rehearsal.toml") in said.stderr
    assert cell.read_bytes() == before
    assert not (tmp_path / "state").exists()


@pytest.mark.full
def test_speed_and_seed_are_written_with_write_only(tmp_path: Path) -> None:
    cell = tmp_path / "lens.toml"
    cell.write_text(with_keys(CELL, LENS))
    words = ["rehearse", str(cell), "--write-only", "--speed", "20", "--seed=7"]
    said = CliRunner().invoke(app, words)
    assert said.exit_code == 0, said.output
    plant = load_simulator(tmp_path / "lens-rehearsal" / "sim.toml").plant
    assert (plant.speed, plant.seed) == (20.0, 7)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--surface", "a.dat"], "--surface a.dat: goes to the simulator, which --write-only does not start"),
        (["--speed", "fast"], "--speed fast: is no number"),
    ],
)
def test_an_option_that_would_be_dropped_is_refused(tmp_path: Path, options: list[str], said: str) -> None:
    cell = tmp_path / "lens.toml"
    cell.write_text(with_keys(CELL, LENS))
    with pytest.raises(ConfigError, match=said):
        CliRunner().invoke(app, ["rehearse", str(cell), "--write-only", *options], catch_exceptions=False)
    assert [path.name for path in tmp_path.iterdir()] == ["lens.toml"]


@pytest.mark.one_of_each
@pytest.mark.parametrize("arguments", [[], ["--write-only"], ["sim.toml", "--out", "x"]])
def test_out_and_write_only_go_with_a_cell(arguments: list[str]) -> None:
    assert CliRunner().invoke(app, ["sim", *arguments]).exit_code == 2


def test_folders_of_the_simulator_are_the_rehearsals_own(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--state and --artefact do not go with rehearse"):
        CliRunner().invoke(app, ["rehearse", str(tmp_path / "cell.toml"), "--state", "x"], catch_exceptions=False)


@pytest.mark.full
def test_a_fanuc_controller_is_the_simulated_one_in_real_time(tmp_path: Path) -> None:
    folder = Path(shutil.copytree(EXAMPLES / "fanuc_rmi", tmp_path / "fanuc_rmi"))
    shutil.copy(EXAMPLES / "instrument.toml", tmp_path)
    done = CliRunner().invoke(app, ["rehearse", str(folder / "cell.toml"), "--write-only"])
    assert done.exit_code == 0, done.stderr
    assert "in real time" in done.stderr + done.stdout
    config = read_config(folder / "cell-rehearsal" / "sim.toml")
    assert (config.robot.kind, config.plant.speed, config.robot.watchdog_s) == ("fanuc_rmi", 1.0, 60.0)
    assert config.robot.z_mm[1] >= 60.0


@pytest.mark.full
@pytest.mark.parametrize(("maker", "profile"), [("yaskawa", "yaskawa-inform"), ("staubli", "staubli-val3")])
def test_a_cell_with_programs_in_its_robots_language_is_rehearsed_in_it(
    tmp_path: Path, maker: str, profile: str
) -> None:
    folder = Path(shutil.copytree(EXAMPLES / maker, tmp_path / maker))
    shutil.copy(EXAMPLES / "instrument.toml", tmp_path)
    done = CliRunner().invoke(app, ["rehearse", str(folder / "cell.toml"), "--write-only"])
    assert done.exit_code == 0, done.stderr
    rehearsal = load_config(folder / "cell-rehearsal" / "cell-rehearsal.toml")
    assert (rehearsal.program.format, rehearsal.robot.model_dump()["profile"]) == (
        {"yaskawa": "inform", "staubli": "val3"}[maker],
        profile,
    )
    config = read_config(folder / "cell-rehearsal" / "sim.toml")
    assert (config.robot.kind, config.robot.report_ms, config.plant.speed) == ("opcua", 50.0, 3.2)


@pytest.mark.full
def test_a_yaskawa_cell_over_hses_is_rehearsed_in_real_time_and_in_inform(tmp_path: Path) -> None:
    keys = 'type = "plc_robot"\nprofile = "yaskawa-hses"\naddress = "hses://10.0.0.2:10040"\ndelivery = "folder:nc"'
    draft = made(tmp_path, robot(keys).replace('"rs274"', '"inform"'))
    sim, other = sim_of(draft, tmp_path), changed(draft, tmp_path)
    assert (sim.robot.kind, sim.plant.speed, sim.robot.report_ms) == ("hses", 1.0, 20.0)
    assert other["robot.address"].startswith("hses://127.0.0.1:")
    with pytest.raises(ConfigError, match=r"program\.format: is 'rs274'; the simulated controller reads inform only"):
        made(tmp_path, robot(keys))


@pytest.mark.full
@pytest.mark.parametrize(("maker", "profile"), [("yaskawa", "yaskawa-inform"), ("staubli", "staubli-val3")])
def test_node_ids_of_ones_own_are_those_of_the_simulated_controller_in_a_rehearsal(
    tmp_path: Path, maker: str, profile: str
) -> None:
    text = (CONTROLLER_PROFILE_DIR / f"{profile}.toml").read_text()
    mine = text.replace("nsu=urn:polishd:handover;s=", "ns=4;s=").replace("report_ms = 50.0", "report_ms = 40.0")
    (tmp_path / "mine.toml").write_text(mine)
    keys = 'type = "plc_robot"\nprofile = "mine.toml"\naddress = "opc.tcp://10.0.0.2:4840"\ndelivery = "folder:nc"'
    language = {"yaskawa": "inform", "staubli": "val3"}[maker]
    draft = made(tmp_path, robot(keys).replace('"rs274"', f'"{language}"'))
    written = draft.files["controller.toml"].decode()
    assert "nsu=urn:polishd:handover;s=line" in written
    assert "report_ms = 40.0" in written
    assert draft.sim["plant"]["speed"][0] == 4.0
    assert "program.format" not in changed(draft, tmp_path)
