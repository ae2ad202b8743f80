"""From a config to devices, recipe and limits; and ``check`` and ``probe``, which use no more than that."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import demo_program, with_values
from polishd.config.cell import CellConfig, load_config
from polishd.config.cell_sections import LimitsSection
from polishd.daemon import checks
from polishd.daemon.assembly import build_cell, contact_limits
from polishd.daemon.runtime.exit_record import locked
from polishd.daemon.runtime.process import host
from polishd.drivers.cia402.device_types import SIMULATED_EDS
from polishd.hookspecs import DeviceContext, DeviceType
from polishd.interfaces import Device, ForceActuator, Robot, Spindle
from polishd.model.errors import ComputeError, ConfigError, LinkError, PlanRefused
from polishd.model.estimates import Estimates, MachineEstimates
from polishd.model.surface import SurfaceMap
from polishd.pipeline.build_recipe import make_recipe, require_commissioned
from polishd.pipeline.precheck import read_programs
from polishd.plugin_loader import Hooks, load_own, load_plugins
from polishd.plugins.rnc_robot.formats import make_shipped
from polishd.programs.make import make_program
from polishd.programs.options import MakeOptions
from tests.commissioned import commissioned
from tests.fakes.devices import FakeCell

TWO_ROBOTS = Path(__file__).parents[3] / "examples" / "two_robots.toml"


@pytest.fixture(scope="module")
def hooks() -> Hooks:
    return load_own()


@pytest.fixture
def configured(tmp_path: Path, example: str) -> Any:
    """``configured(section={key: value})``: the shipped example with changes."""

    def make(**sections: dict[str, Any]) -> CellConfig:
        path = tmp_path / "cell.toml"
        path.write_text(with_values(example, {"instrument": {"profile": "instrument.toml"}, **sections}))
        commissioned(tmp_path)
        return load_config(path)

    return make


# the recipe


def test_the_recipe_is_the_configs(configured: Any, hooks: Hooks) -> None:
    config = configured(
        part={"aperture_mm": 60.0, "alignment": "power", "id": "P-9"},
        program={"offset_mm": [1.0, 2.0, 0.0], "rotation_deg": 90.0},
        process={"correction": "linear", "grid_mm": 0.8},
        job={"tolerance_nm": 3.0, "tolerance_period_mm": 12.0},
        dwell={"cpu_limit_s": 7.0, "kkt_tolerance": 1e-5},
        limits={"max_rate_change": 0.2},
    )
    recipe = make_recipe(config, hooks)
    assert (recipe.part.id, recipe.part.aperture_mm, recipe.part.alignment, recipe.grid_mm) == (
        "P-9",
        60.0,
        "power",
        0.8,
    )
    assert (recipe.program.offset_mm, recipe.program.rotation_deg) == ((1.0, 2.0, 0.0), 90.0)
    assert (recipe.correction, recipe.dwell.cpu_limit_s, recipe.dwell.kkt_tolerance) == ("linear", 7.0, 1e-5)
    assert (recipe.job.tolerance_nm, recipe.job.tolerance_period_mm, recipe.max_rate_change) == (3.0, 12.0, 0.2)
    assert (recipe.format.name, recipe.model.name, recipe.solver.name) == ("rs274", "hertz_preston", "auto")
    assert recipe.cross_check is not None
    assert recipe.cross_check.name == "qp"


def test_a_tilt_is_alignment_by_default(configured: Any, hooks: Hooks) -> None:
    """Every interferometer's map has one, and another each time."""
    assert make_recipe(configured(), hooks).part.alignment == "tilt"


def test_the_form_wanted_is_read_with_the_recipe(configured: Any, hooks: Hooks, tmp_path: Path) -> None:
    form = SurfaceMap(np.arange(12.0).reshape(3, 4), 0.5)
    reader = hooks.surface_readers()["x3p"]
    assert reader.write is not None
    (tmp_path / "form.x3p").write_bytes(reader.write(form))
    nominal = make_recipe(configured(part={"form": "form.x3p"}), hooks).nominal
    assert nominal is not None
    np.testing.assert_allclose(nominal.height_nm, form.height_nm)
    np.save(tmp_path / "form.npy", form.height_nm)
    for name, reason in (("none.x3p", "No such file"), ("form.npy", "does not say its pitch and surface and unit")):
        with pytest.raises(ConfigError, match=rf"cell\.toml.*part\.form.*{reason}"):
            make_recipe(configured(part={"form": name}), hooks)


def test_the_recipe_travels_to_the_worker(configured: Any, hooks: Hooks) -> None:
    recipe = pickle.loads(pickle.dumps(make_recipe(configured(), hooks)))
    assert recipe.solver.name == "auto"


def test_no_cross_check(configured: Any, hooks: Hooks) -> None:
    assert make_recipe(configured(dwell={"cross_check": ""}), hooks).cross_check is None


@pytest.mark.parametrize(
    ("section", "key", "name", "says"),
    [
        ("program", "format", "rs247", "rs274"),
        ("process", "removal_model", "preston", "hertz_preston"),
        ("process", "estimates", "machin", "machine"),
        ("dwell", "solver", "newton", "newton_cg"),
        ("dwell", "cross_check", "pq", "qp"),
    ],
)
def test_what_no_plugin_serves_is_named(
    configured: Any, hooks: Hooks, section: str, key: str, name: str, says: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        make_recipe(configured(**{section: {key: name}}), hooks)
    message = str(refused.value)
    assert f"{section}.{key}" in message
    assert repr(name) in message
    assert says in message
    assert "cell.toml" in message


@pytest.mark.parametrize(("learns", "believes"), [("rate", Estimates), ("machine", MachineEstimates)])
def test_a_cell_says_how_its_model_learns(configured: Any, hooks: Hooks, learns: str, believes: type) -> None:
    model = make_recipe(configured(process={"estimates": learns}), hooks).model
    assert type(model.beliefs) is believes
    assert pickle.loads(pickle.dumps(model)) == model, "it goes to the worker"


def test_a_plugin_that_is_not_loaded_serves_nothing(configured: Any) -> None:
    with pytest.raises(ConfigError, match=r"dwell\.solver"):
        make_recipe(configured(), load_plugins(["rnc_robot", "removal_models"]))


# the cell


def test_the_cell_has_what_the_config_names_and_opens_nothing(configured: Any, hooks: Hooks) -> None:
    cell = build_cell(configured(), hooks)
    assert isinstance(cell.robot, Robot)
    assert isinstance(cell.actuator, ForceActuator)
    assert isinstance(cell.spindle, Spindle)
    assert list(cell.devices) == ["actuator", "robot", "spindle", "metrology"]


def test_a_cell_with_two_robots_is_accepted(tmp_path: Path, hooks: Hooks) -> None:
    """The shipped example; the job's limits are its own devices'."""
    small = TWO_ROBOTS.read_text().replace("aperture_mm = 100.0", "aperture_mm = 30.0")
    path = tmp_path / "two_robots.toml"
    (tmp_path / "drive.eds").write_bytes(SIMULATED_EDS.read_bytes())
    path.write_text(small.replace("[process]", "[process]\ngrid_mm = 2.0"))
    config = load_config(path)
    config.program_path.write_bytes(demo_program(config))
    steps: list[str] = []
    facts = checks.check_cell(config, hooks, steps.append)
    assert steps[:2] == ["part, tool and instrument", "devices and their time limits"]
    assert [one.partition(" ")[0] for one in steps[2:]] == ["reading", "reach"]
    assert facts["devices"] == (
        "actuator.left, actuator.right (not used by this job), robot.left, robot.right (not used by this job), "
        "spindle.left, spindle.right (not used by this job), metrology"
    )
    keys = [limit["key"] for limit in facts["time limits"]]
    assert {"actuator.left.retract_s", "robot.left.watchdog_s", "job.stream_ahead_s"} <= set(keys)
    cell = build_cell(config, hooks)
    assert cell.robot is cell.devices["robot.left"]
    right = config.path.read_text().replace('= "left"', '= "right"')
    path.write_text(right.replace("retract_s = 3.0", "retract_s = 9.0"))
    line = path.read_text().splitlines().index("[robot.right]") + 1
    with pytest.raises(ConfigError, match=rf"two_robots.toml:{line}: robot.right.watchdog_s: .* at least 10.7 s"):
        checks.check_cell(load_config(path), hooks)


@pytest.mark.parametrize(
    ("section", "values", "says"),
    [
        ("robot", {"type": "robot_lnik"}, "robot_link"),
        ("robot", {"type": "cia402_spindle"}, "robot"),
        ("actuator", {"unit": 999}, "unit"),
        ("spindle", {"node": "five"}, "node"),
    ],
)
def test_a_device_that_the_config_gets_wrong(
    configured: Any, hooks: Hooks, section: str, values: dict[str, Any], says: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        build_cell(configured(**{section: values}), hooks)
    assert section in str(refused.value)
    assert says in str(refused.value)


def test_contact_limits(configured: Any) -> None:
    limits = contact_limits(
        configured(process={"force_n": 9.0, "rpm": 800.0}, limits={"force_band": 0.1, "force_alarm_delay_s": 0.2})
    )
    assert (limits.force_n, limits.rpm, limits.force_band, limits.alarm_delay_s) == (9.0, 800.0, 0.1, 0.2)
    assert (limits.force_max_n, limits.force_max_key) == (13.5, "process.force_max_n")


# check and probe


def test_check_reads_and_computes(configured: Any, hooks: Hooks) -> None:
    config = configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0})
    config.program_path.write_bytes(demo_program(config))
    facts = checks.check_cell(config, hooks)
    assert facts["program"].startswith("program.rnc: ")
    removal_nm = float(facts["removal of the program as it is"].split(" ")[0])
    lie = facts["if the actuator misreads its force"]
    assert lie.startswith("an actuator that presses 13 N and reads 12 N removes 8% more, ")
    (one_nm, most_nm) = map(float, re.findall(r"([\d.]+) nm", lie))
    assert (one_nm, most_nm) == pytest.approx((removal_nm / 12.0, 0.5 * removal_nm), abs=0.11)
    assert "an independent [force_sensor]" in lie
    low, high = map(float, facts["compliance_um_per_n"].split(" to "))
    assert 0.5 < low < high < 3.0
    assert facts["host"] == host()
    assert not config.state_dir.exists(), "nothing was opened"


def test_check_refuses_a_pass_that_can_never_be_short_enough(configured: Any, hooks: Hooks) -> None:
    """Before any map, and before anything is solved: the path alone takes longer at the largest feed."""
    config = configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0}, limits={"max_pass_s": 20.0})
    config.program_path.write_bytes(demo_program(config))
    with pytest.raises(ConfigError) as caught:
        checks.check_cell(config, hooks)
    said = re.fullmatch(
        r".*limits\.max_pass_s: program\.rnc at the largest feed takes (\d+) s, more than limits\.max_pass_s = 20 s; "
        r"set it to (\d+) or more, .*", str(caught.value)
    )  # fmt: skip
    assert said
    assert float(said[2]) > float(said[1]) > 20
    enough = configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0}, limits={"max_pass_s": float(said[2])})
    assert checks.check_cell(enough, hooks)["pass"].startswith(f"{said[1]} s at the largest feed, ")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"machine": {"x_mm": [-6.0, 6.0]}},
            r"starts at x = .*, outside -6 to 6 mm \(machine\.x_mm\); the path needs -",
        ),
        (
            {"process": {"grid_mm": 2.0, "preston": "1.49e-9 m2/N"}},
            r"removal is \d+ nm at x .* mm of the part, more than limits\.max_removal_nm = .* Check process\.preston",
        ),
    ],
)
def test_check_refuses_what_each_plan_would_be_refused_for(
    configured: Any, hooks: Hooks, change: dict[str, Any], says: str
) -> None:
    config = configured(**{"part": {"aperture_mm": 30.0}, "process": {"grid_mm": 2.0}} | change)
    config.program_path.write_bytes(demo_program(config))
    with pytest.raises(PlanRefused, match=says) as caught:
        checks.check_cell(config, hooks)
    assert str(caught.value).startswith(
        "program.rnc: plan would refuse it with any map. Correct the named key or the program:\n  plan_checks: "
    )


def test_check_warns_of_a_program_that_removes_too_much_as_it_is(configured: Any, hooks: Hooks) -> None:
    """Its times may be those of no part."""
    config = configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0})
    config.program_path.write_bytes(demo_program(config))
    facts = checks.check_cell(config, hooks)
    removal_nm = float(facts["removal of the program as it is"].split(" ")[0])
    assert not any("as it is" in one or "run will refuse" in one for one in facts["warnings"])
    limits = {"limits": {"max_removal_nm": 0.99 * removal_nm}}
    less = configured(**{"part": {"aperture_mm": 30.0}, "process": {"grid_mm": 2.0}} | limits)
    (said,) = (one for one in checks.check_cell(less, hooks)["warnings"] if "as it is" in one)
    assert said.startswith("program.rnc as it is removes up to ")
    assert "Check process.preston" in said


CANNOT_FOLLOW: list[tuple[dict[str, Any], str, str]] = [
    ({"process": {"grid_mm": 2.0, "dip_deg": 0.0}}, "process.dip_deg", "the dip is 15 deg, the process says 0"),
    ({"part": {"aperture_mm": 30.0, "origin_mm": [3000.0, 0.0, 2315.0]}}, "part.origin_mm", "the tip's radius is "),
    ({"process": {"grid_mm": 2.0, "tool_modulus_mpa": 3000.0}}, "process.force_n", "the way that the robot gives is "),
    ({"part": {"aperture_mm": 30.0, "curvature_radius_mm": 20.5}}, "part.curvature_radius_mm", "the nominal optic"),
]


@pytest.mark.parametrize(("change", "key", "says"), CANNOT_FOLLOW)
def test_a_program_that_the_cell_cannot_follow_is_an_error_at_its_key(
    configured: Any, hooks: Hooks, change: dict[str, Any], key: str, says: str
) -> None:
    base: dict[str, Any] = {"part": {"aperture_mm": 30.0}, "process": {"grid_mm": 2.0}}
    config = configured(**base)
    config.program_path.write_bytes(demo_program(config))
    wrong = configured(**base | change)
    with pytest.raises(ConfigError) as caught:
        checks.check_cell(wrong, hooks)
    said = str(caught.value)
    assert re.match(rf".*cell\.toml:\d+: {re.escape(key)}: program\.rnc:\d+: ", said), said
    assert says in said
    assert ": point " not in said


def test_a_bonnet_that_does_not_fit_into_the_part_is_an_error_at_its_key(configured: Any, hooks: Hooks) -> None:
    part = {"aperture_mm": 30.0, "curvature_radius_mm": 40.0}
    config = configured(part=part, process={"grid_mm": 2.0})
    config.program_path.write_bytes(demo_program(config))
    wrong = configured(part=part, process={"grid_mm": 2.0, "tool_radius_mm": 41.0})
    with pytest.raises(ConfigError, match=r"process\.tool_radius_mm: program\.rnc:\d+: .* the bonnet of 41 mm"):
        checks.check_cell(wrong, hooks)


def test_a_speed_that_machine_and_language_do_not_share_is_an_error_at_its_key(
    configured: Any, hooks: Hooks, monkeypatch: pytest.MonkeyPatch
) -> None:
    def envelope_of(*_: object) -> None:
        raise ComputeError("no speed in common")

    config = configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0})
    config.program_path.write_bytes(demo_program(config))
    monkeypatch.setattr("polishd.pipeline.precheck.envelope_of", envelope_of)
    with pytest.raises(ConfigError, match=r"machine\.max_feed_mm_s: program\.rnc: no speed in common\. Correct it"):
        checks.check_cell(config, hooks)


def test_check_warns_of_a_program_that_run_refuses(configured: Any, hooks: Hooks) -> None:
    config = configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0})
    config.program_path.write_bytes(demo_program(config))
    wider = configured(part={"aperture_mm": 60.0}, process={"grid_mm": 2.0}, program={"coverage": "zone"})
    said = [one for one in checks.check_cell(wider, hooks)["warnings"] if one.startswith("run will refuse: ")]
    assert [re.sub(r":\d+: .*, on the part", " on the part", one.partition(": ")[2])[:25] for one in said] == [
        "program.rnc on the part, "
    ] * 2


def test_check_says_what_a_pass_can_remove(configured: Any, hooks: Hooks) -> None:
    config = configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0}, limits={"max_pass_s": 3600.0})
    config.program_path.write_bytes(demo_program(config))
    said = re.search(r"(\d+) s as programmed; limits.max_pass_s = 3600 s removes ([\d.]+) nm",
                     checks.check_cell(config, hooks)["pass"])  # fmt: skip
    assert said
    area_mm2 = np.pi * (15.0 + 1.5) ** 2  # with the path's own overrun
    volume_nm_mm2_s = 0.058 / 60 * 1e6
    assert float(said[2]) == pytest.approx(3600 * volume_nm_mm2_s / area_mm2, rel=0.4)


def test_the_default_lets_a_large_parts_pass_end() -> None:
    """A metre's takes 17 h; what is wrong by a hundred still does not fit."""
    assert 17 * 3600 < LimitsSection().max_pass_s <= 24 * 3600


def test_check_needs_the_program(configured: Any, hooks: Hooks) -> None:
    with pytest.raises(ConfigError, match=r"cell\.toml:\d+: program\.path: .*program\.rnc: no such file"):
        checks.check_cell(configured(), hooks)


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeCell:
    found = FakeCell()
    monkeypatch.setattr(checks, "build_cell", lambda config, hooks: found.cell)
    return found


async def test_probe_identifies_all_and_leaves_them_safe(configured: Any, hooks: Hooks, fake: FakeCell) -> None:
    found = await checks.probe_cell(configured(), hooks)
    assert [identity.model for identity in found.identities.values()] == ["actuator", "robot", "spindle", "metrology"]
    assert not found.problems
    assert fake.of("make_safe", "close")[:3] == ["spindle.make_safe", "actuator.make_safe", "robot.make_safe"]
    assert fake.events[-4:] == [f"{name}.close" for name in found.identities]


async def test_probe_tells_what_is_not_safe(configured: Any, hooks: Hooks, fake: FakeCell) -> None:
    fake.actuator.acts.fails["make_safe"] = LinkError("deaf")
    found = await checks.probe_cell(configured(), hooks)
    assert found.problems == {"actuator": "not confirmed safe: deaf"}
    assert "actuator" in found.identities
    assert fake.events[-1] == "metrology.close"


async def test_a_dead_device_does_not_hide_the_others(configured: Any, hooks: Hooks, fake: FakeCell) -> None:
    fake.actuator.acts.fails["open"] = LinkError("no answer")
    fake.actuator.acts.fails["make_safe"] = LinkError("is not open")
    fake.spindle.acts.fails["identify"] = ZeroDivisionError()
    found = await checks.probe_cell(configured(), hooks)
    assert list(found.identities) == ["robot", "metrology"]
    assert found.problems == {"actuator": "no answer", "spindle": "ZeroDivisionError"}, "the first word of each"
    assert fake.of("make_safe")[-1] == "robot.make_safe", "after the actuator's own watchdog"


async def test_probe_of_one_asks_it_who_it_is_and_nothing_else(configured: Any, hooks: Hooks, fake: FakeCell) -> None:
    found = await checks.probe_cell(configured(), hooks, ["robot"])
    assert list(found.identities) == ["robot"]
    assert fake.events[:2] == ["robot.open", "robot.identify"]
    assert not fake.of("make_safe")
    with pytest.raises(ConfigError, match="--only arm: the cell has actuator, robot, spindle, metrology"):
        await checks.probe_cell(configured(), hooks, ["arm"])


async def test_probe_does_not_disturb_a_running_daemon(configured: Any, hooks: Hooks, fake: FakeCell) -> None:
    config = configured()
    with locked(config.state_dir), pytest.raises(ConfigError, match="another polishd"):
        await checks.probe_cell(config, hooks)
    assert fake.events == []


# the instrument


def test_the_instrument_reaches_recipe_and_devices(
    configured: Any, hooks: Hooks, monkeypatch: pytest.MonkeyPatch
) -> None:
    contexts: list[DeviceContext] = []

    def kept(kind: DeviceType) -> DeviceType:
        def build(options: Any, context: DeviceContext) -> Device:
            contexts.append(context)
            return kind.build(options, context)

        return replace(kind, build=build)

    kinds = {name: kept(kind) for name, kind in hooks.device_types().items()}
    monkeypatch.setattr(hooks, "device_types", lambda: kinds)
    config = configured()
    build_cell(config, hooks)
    recipe = make_recipe(config, hooks)
    assert recipe.instrument is not None
    assert [context.instrument for context in contexts] == [recipe.instrument] * 4
    require_commissioned(config, recipe.instrument)


@pytest.mark.full
def test_an_edited_profile_is_refused_and_check_says_so(configured: Any, hooks: Hooks) -> None:
    config = configured()
    assert config.profile_path is not None
    text = config.profile_path.read_text()
    config.profile_path.write_text(text.replace("mirror = false", "mirror = true"))
    recipe = make_recipe(config, hooks)
    assert recipe.instrument is not None
    assert recipe.instrument.mirror
    with pytest.raises(ConfigError, match="edited after it was commissioned"):
        require_commissioned(config, recipe.instrument)
    config.program_path.write_bytes(demo_program(config))
    found = checks.check_cell(config, hooks)
    assert "run will refuse" in found["instrument"]
    assert found["accepted"].startswith("as measured: the instrument's error is not known")


def test_a_cell_without_a_profile_is_refused(configured: Any, hooks: Hooks) -> None:
    config = configured()
    config.path.write_text(config.path.read_text().replace('profile = "instrument.toml"', ""))
    bare = load_config(config.path)
    recipe = make_recipe(bare, hooks)
    assert recipe.instrument is None
    with pytest.raises(ConfigError, match=r"cell.toml:\d+: instrument.profile: the cell names no"):
        require_commissioned(bare, recipe.instrument)


# programs that take turns


def with_between(config: CellConfig) -> CellConfig:
    """The cell with a second program between the lines of the first."""
    config.path.write_text(config.path.read_text().replace('path = "program.rnc"', 'path = ["program.rnc", "b.rnc"]'))
    config.program_path.write_bytes(demo_program(config))
    made = MakeOptions(
        "raster", config.program_path.with_name("b.rnc"), cell=config.path, pitch_mm=1.5, step_mm=1.5, phase=0.5
    )
    config.program_path.with_name("b.rnc").write_bytes(make_program(made, config, load_own()).text)
    return load_config(config.path)


def test_check_computes_along_each_program(configured: Any, hooks: Hooks) -> None:
    config = with_between(configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0}))
    seen: list[str] = []
    facts = checks.check_cell(config, hooks, seen.append)
    assert facts["program 1: program"].startswith("program.rnc: ")
    assert facts["program 2: program"].startswith("b.rnc: ")
    assert facts["program 1: covers"] != facts["program 2: covers"]
    assert "reach" not in facts
    assert "reading program.rnc, b.rnc" in seen


def test_check_refuses_a_second_program_of_another_part(configured: Any, hooks: Hooks) -> None:
    config = with_between(configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0}))
    config.path.write_text(config.path.read_text().replace("aperture_mm = 30.0", "aperture_mm = 60.0"))
    config.program_path.write_bytes(demo_program(load_config(config.path)))
    with pytest.raises(ConfigError, match=r"program\.path: b\.rnc reaches .* the part is a circle of 60 mm"):
        checks.check_cell(load_config(config.path), hooks)


def test_programs_with_the_same_content_are_refused(configured: Any, hooks: Hooks) -> None:
    config = with_between(configured(part={"aperture_mm": 30.0}, process={"grid_mm": 2.0}))
    config.program_paths[1].write_bytes(config.program_path.read_bytes())
    with pytest.raises(
        ConfigError, match=r"cell\.toml:\d+: program\.path: b\.rnc has the same content as program\.rnc"
    ):
        checks.check_cell(config, hooks)


@pytest.mark.parametrize("touch_off", [True, False])
def test_programs_for_two_tools_or_frames_of_the_controller_are_refused(
    configured: Any, hooks: Hooks, *, touch_off: bool
) -> None:
    config = configured(program={"format": "rapid"})
    text = config.path.read_text().replace('path = "program.rnc"', 'path = ["a.mod", "b.mod"]')
    without, cut = re.subn(r"(?m)^\[touch_off\].*\n(?:(?!\[).*\n)*", "", text)
    assert cut == 1
    config.path.write_text(text if touch_off else without)
    config = load_config(config.path)
    points, axes = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]] * 2)
    made = make_shipped("rapid", points, axes, 600.0, "a")
    first, second = config.program_paths
    first.write_bytes(made)
    second.write_bytes(made + b"\n")
    recipe = make_recipe(config, hooks)
    assert [program.name for program in read_programs(config, recipe)] == ["a.mod", "b.mod"]
    assert b"wPart" in made
    second.write_bytes(made.replace(b"wPart", b"glass"))
    with pytest.raises(ConfigError, match=r"program\.path: b\.mod names another tool or frame .* than a\.mod"):
        read_programs(config, recipe)
