"""What sim.toml has of the cell that it names, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.cell import load_config
from polishd.config.simulator import SimConfig, load_plant, load_simulator
from polishd.model.errors import ConfigError
from tests.system.cell_rig import with_keys, without

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
CELL = (EXAMPLES / "cell.toml").read_text()
SENSOR = "serial:sim/force_sensor"


def simulator(folder: Path, cell: str, sim: str = "") -> SimConfig:
    (folder / "cell.toml").write_text(cell)
    (folder / "sim.toml").write_text(f'cell = "cell.toml"\n{sim}')
    return load_simulator(folder / "sim.toml")


def test_part_tool_robot_and_links_are_the_cells(tmp_path: Path) -> None:
    changed = {
        "part": {"aperture_mm": 60.0, "curvature_radius_mm": 300.0},
        "process": {"preston": "2e-9 cm2/N"},
        "robot": {"address": "tcp://127.0.0.1:4711", "watchdog_s": 12.0},
        "actuator": {"address": "tcp://localhost:4712", "unit": 3, "landing_s": 1.0},
    }
    sim = simulator(tmp_path, with_keys(CELL, changed))
    config = load_config(tmp_path / "cell.toml")
    sim.require_simulated()
    assert (sim.plant.outline, sim.plant.curvature_radius_mm) == (config.outline(), 300.0)
    assert sim.process.preston == config.process.preston == 2e-9
    assert sim.robot_model() == config.robot_model()
    assert (sim.robot.port, sim.robot.watchdog_s, sim.robot.x_mm) == (4711, 12.0, config.machine.x_mm)
    assert (sim.actuator.kind, sim.actuator.port, sim.actuator.unit) == ("modbus_tcp", 4712, 3)
    assert sim.actuator.land_s == 0.8, "within what the cell allows"
    assert (sim.spindle.kind, sim.loader) == ("slcan", None)


def test_what_sim_toml_has_is_true_of_the_machine(tmp_path: Path) -> None:
    text = '[process]\npreston = "1e-9 cm2/N"\n[plant]\nrectangle_mm = [40.0, 24.0]\n[robot]\nport = 0\n'
    sim = simulator(tmp_path, CELL, text)
    assert (sim.process.preston, sim.plant.outline_key, sim.robot.port) == (1e-9, "rectangle_mm", 0)


@pytest.mark.parametrize(
    ("section", "keys", "device"),
    [
        ("robot", {"address": "tcp://10.0.0.2:28500"}, "robot"),
        ("actuator", {"address": "serial:/dev/ttyUSB0"}, "actuator"),
        ("spindle", {"type": "spindle_of_others"}, "spindle"),
        ("metrology", {"request_file": "elsewhere/measure"}, "interferometer"),
        ("force_sensor", {"type": "force_sensor_profile", "profile": "laumas_tlb", "address": SENSOR}, "force_sensor"),
    ],
)
def test_a_device_that_is_not_simulated_is_refused_at_its_line(
    tmp_path: Path, section: str, keys: dict[str, str], device: str
) -> None:
    sim = simulator(tmp_path, with_keys(CELL, {section: keys}))
    key = r"(address|type|request_file|profile)"
    with pytest.raises(ConfigError, match=rf"cell\.toml:\d+: {section}\.{key}: .*polishd rehearse"):
        sim.require_simulated((device,))
    sim.require_simulated({"robot", "actuator", "spindle", "interferometer"} - {device})
    assert load_plant(tmp_path / "sim.toml")[0]["plant"]["part_id"] == "DEMO-100", "a plant has no links"


def test_a_device_with_a_kind_in_sim_toml_is_not_the_cells(tmp_path: Path) -> None:
    robot = {"robot": {"address": "tcp://10.0.0.2:28500"}}
    sim = simulator(tmp_path, with_keys(CELL, robot), '[robot]\nkind = "link"\nport = 0\n')
    sim.require_simulated()
    assert sim.robot.port == 0


def test_an_error_has_the_place_where_the_value_is(tmp_path: Path) -> None:
    deep = with_keys(CELL, {"part": {"curvature_radius_mm": 20.0, "aperture_mm": 20.0}})
    with pytest.raises(ConfigError, match=r"cell\.toml:\d+: part\.curvature_radius_mm: 20 mm is no surface"):
        simulator(tmp_path, deep)
    with pytest.raises(ConfigError, match=r"sim\.toml:3: plant\.rms_nm"):
        simulator(tmp_path, CELL, "[plant]\nrms_nm = -1.0\n")
    (tmp_path / "sim.toml").write_text('cell = "gone.toml"\n')
    with pytest.raises(ConfigError, match=r"sim\.toml:1: cell: .*gone\.toml: cannot be read"):
        load_simulator(tmp_path / "sim.toml")
    with pytest.raises(ConfigError, match=r"cell\.toml:\d+: actuator\.landing_s: must be a number"):
        simulator(tmp_path, with_keys(CELL, {"actuator": {"landing_s": "soon"}})).require_simulated()


def test_a_cells_file_is_refused_with_the_command_that_takes_it(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    with pytest.raises(
        ConfigError, match=r"cell\.toml:\d+: cell: this is a cell's file\. Use polishd rehearse .*cell\.toml"
    ):
        load_simulator(path)


def test_an_old_section_is_refused_with_its_new_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sim\.toml:2: truth: .*hidden_truth"):
        simulator(tmp_path, CELL, "[truth]\nworn = 0.5\n")


def test_a_signal_for_a_start_is_as_it_should_be(tmp_path: Path) -> None:
    clear = '\n[monitor]\ntype = "monitor_line"\naddress = "serial:sim/monitor"\n'
    clear += '[signals.clear]\non_start = { state = true }\n[signals.load]\nmeasures = "force"\n'
    sim = simulator(tmp_path, CELL + clear)
    assert sim.monitor is not None
    assert {name: one.value for name, one in sim.monitor.signals.items()} == {"clear": True, "load": 0.0}
    assert simulator(tmp_path, without(CELL, "touch_off")).monitor is None
