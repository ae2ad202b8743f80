"""What the config says of seat and steps, and the programs that a touch-off runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import CellConfig, load_config
from polishd.model.errors import ConfigError, PlanRefused
from polishd.model.part_handling import HandlingStep, TouchOff
from polishd.pipeline import part_handling
from polishd.pipeline.build_recipe import make_recipe
from polishd.pipeline.part_handling import touch_off_of
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.steps import in_part_frame
from polishd.plugin_loader import Hooks, load_own
from polishd.process.removal.contact import contact_radius_mm, hertz_depth_mm
from tests.system.cell_rig import with_keys, without
from tests.unit.daemon.small_job import accept

Cell = Callable[..., CellConfig]


@pytest.fixture(scope="module")
def hooks() -> Hooks:
    return load_own()


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    """The demo's cell with other values, by section."""
    path = write_demo(tmp_path, None, 2.0, 4, None).cell
    text = path.read_text()

    def changed(**sections: dict[str, object]) -> CellConfig:
        path.write_text(with_keys(text, sections))
        return load_config(path)

    return changed


def asked_by(config: CellConfig, hooks: Hooks) -> tuple[Recipe, TouchOff]:
    recipe = make_recipe(config, hooks)
    assert recipe.touch_off is not None
    return recipe, recipe.touch_off


def test_the_places_lie_on_the_rim_and_the_contact_in_it(cell: Cell, hooks: Hooks) -> None:
    recipe, asked = asked_by(cell(), hooks)
    radius = np.hypot(*asked.points_mm[:, :2].T)
    assert radius == pytest.approx([48.5] * 3)
    reach = contact_radius_mm(recipe.process, hertz_depth_mm(recipe.process))
    assert reach < 3.0, "under the whole force, too"
    assert asked.lean == pytest.approx([np.cos(np.radians(15.0))] * 3)
    assert (asked.force_n, asked.max_offset_mm, asked.position_mm, asked.each_pass) == (0.8, 0.3, None, False)


def test_on_a_curved_part_they_lie_on_its_surface(cell: Cell, hooks: Hooks) -> None:
    _, asked = asked_by(cell(part={"curvature_radius_mm": 400.0}), hooks)
    sag_mm = 400.0 - np.sqrt(400.0**2 - 48.5**2)
    assert asked.points_mm[:, 2] == pytest.approx([sag_mm] * 3)
    assert asked.lean == pytest.approx([np.cos(np.radians(15.0))] * 3), "the tool leans as it does in a pass"


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"part": {"edge_mm": 1.0}}, r"touch_off: the rim .* is 1 mm wide, and the tool needs 1\.\d\d mm.*points_mm"),
        (
            {"touch_off": {"points_mm": [[0, 46], [-42, -24], [42, -24]]}},
            r"touch_off\.points_mm: x 0, y 46 mm lies in the clear",
        ),
        (
            {"touch_off": {"points_mm": [[0, 49], [0, 52], [0, -49]]}},
            r"touch_off\.points_mm: the three positions lie on a line",
        ),
        ({"touch_off": {"points_mm": [[0, 49], [0, 52]]}}, r"touch_off\.points_mm: has too few"),
        ({"touch_off": {"force_n": 1.2}}, "touch_off.force_n"),
        ({"part_handling": {"settle": {}}}, r"part_handling\.settle: .*repeatability.*\[repeatability\] rms_nm"),
        ({"part_handling": {"clean": {}}}, r"part_handling\.clean\.operator: "),
        (
            {"part_handling": {"clean": {"operator": "x", "command": ["y"]}}},
            r"part_handling\.clean\.operator: ",
        ),
        ({"part_handling": {"settle": {"max_maps": 1}}}, r"part_handling\.settle\.max_maps"),
    ],
)
def test_what_cannot_be_is_refused_with_its_key(
    cell: Cell, hooks: Hooks, sections: dict[str, dict[str, object]], says: str
) -> None:
    with pytest.raises(ConfigError, match=rf"cell\.toml:\d+: {says}"):
        make_recipe(cell(**toml(sections)), hooks)


def test_a_touch_off_needs_a_format_that_writes_programs(cell: Cell, hooks: Hooks) -> None:
    config = cell()
    mute = replace(hooks.program_formats()["rs274"], make=None)
    with pytest.raises(ConfigError, match=r"cell\.toml:\d+: touch_off: no programs are made in 'rs274'"):
        touch_off_of(config, mute)


def toml(sections: dict[str, dict[str, object]]) -> dict[str, dict[str, object]]:
    """Tables in a section as dotted keys, since JSON's are not TOML's."""
    flat: dict[str, dict[str, object]] = {}
    for section, values in sections.items():
        flat[section] = {}
        for key, value in values.items():
            if isinstance(value, dict) and value:
                flat[section] |= {f"{key}.{inner}": one for inner, one in value.items()}
            else:
                flat[section][key] = value
    return flat


def test_left_out_nothing_is_done(cell: Cell, hooks: Hooks) -> None:
    path = cell().path
    path.write_text(without(path.read_text(), "touch_off"))
    recipe = make_recipe(load_config(path), hooks)
    assert recipe.touch_off is None
    assert (recipe.part_handling.clean, recipe.part_handling.settle, recipe.part_handling.condition) == (
        None,
        None,
        None,
    )


def test_steps_as_they_are_written(cell: Cell, hooks: Hooks, tmp_path: Path) -> None:
    config = cell(**toml({"part_handling": {"clean": {"command": ["./wash.sh", "hard"]}, "settle": {"max_maps": 5}}}))
    profile = tmp_path / "instrument.toml"
    profile.write_text(with_keys(profile.read_text(), {"repeatability": {"rms_nm": 0.4}}))
    part_handling = make_recipe(config, hooks).part_handling
    assert part_handling.clean == HandlingStep(command=("./wash.sh", "hard"), folder=tmp_path)
    assert part_handling.settle is not None
    assert (part_handling.settle.limit_nm, part_handling.settle.max_maps, part_handling.settle.wait_s) == (0.8, 5, 60.0)


# the programs


@pytest.mark.parametrize("program", [{}, {"rotation_deg": 30.0, "offset_mm": [3.0, -2.0, 1.0]}])
def test_each_place_is_reached_on_the_part_whatever_the_programs_frame(
    cell: Cell, hooks: Hooks, program: dict[str, object]
) -> None:
    recipe, asked = asked_by(cell(program=program), hooks)
    plans = part_handling.plans(recipe, asked)
    for place, axis, plan in zip(asked.points_mm, asked.axis, plans, strict=True):
        there = in_part_frame(recipe, plan.program)
        np.testing.assert_allclose(there.start_mm[0], place, atol=2e-4)
        np.testing.assert_allclose(there.axis[0], axis, atol=1e-6)
        assert plan.approach_blocks == plan.program.block[0], "where the robot waits for contact"
        assert not plan.predicted_removal_nm.any()
        assert plan.program.n == 1
    part_handling.require_allowed(recipe, plans, hooks.check_plan)


@pytest.mark.one_of_each
@pytest.mark.parametrize("format_", ["fanuc", "siemens", "haas", "twincat-nci", "weihong"])
def test_other_dialects_say_it_too(cell: Cell, hooks: Hooks, format_: str) -> None:
    recipe, asked = asked_by(cell(program={"format": format_}), hooks)
    plans = part_handling.plans(recipe, asked)
    np.testing.assert_allclose([plan.program.start_mm[0] for plan in plans], asked.points_mm, atol=2e-4)


def test_a_place_beyond_the_machine_is_refused(cell: Cell, hooks: Hooks) -> None:
    recipe, asked = asked_by(cell(machine={"y_mm": [-90.0, 40.0]}), hooks)
    with pytest.raises(PlanRefused, match=r"touch-off, place 1: plan_checks: .* y = 48\.5 mm, outside -90 to 40"):
        part_handling.require_allowed(recipe, part_handling.plans(recipe, asked), hooks.check_plan)


def test_what_a_plugin_says_against_it_is_reported(cell: Cell, hooks: Hooks) -> None:
    recipe, asked = asked_by(cell(), hooks)
    plans = part_handling.plans(recipe, asked)
    part_handling.require_allowed(recipe, plans, accept)
    with pytest.raises(PlanRefused, match="nothing moved:\n  touch-off, place 1: not there\n"):
        part_handling.require_allowed(recipe, plans, lambda plan, envelope: ["not there"])
